"""The calibration file of a running robot: read at the start, kept up to date, never spoiled."""

from __future__ import annotations

from pathlib import Path

from gyrocal_ros.config.sections import Config
from gyrocal_ros.errors import ConfigError, GyrocalError
from gyrocal_ros.pipeline.calibration import Calibration, load_calibration, save_calibration

UNUSABLE, FORGOTTEN = '.bad', '.old'
"""What is put behind the name of a file that was set aside."""


class CalibrationStore:
    """Keeps a calibration in a file.

    Args:
        path: the file; None for none.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.complaint = ''
        """What is wrong with the file, or with the writing of it."""
        self._on_file: Calibration | None = None

    def load(self, config: Config) -> Calibration | None:
        """Read what was kept; None where there is nothing. What cannot be used is told and set aside.

        Raises:
            ConfigError: the path is that of a folder.
        """
        if self.path is None or not self.path.exists():
            return None
        if self.path.is_dir():
            raise ConfigError('is a folder', where=str(self.path), todo='name a file in live.calibration')
        try:
            self._on_file = load_calibration(self.path)
            _refuse_other_gyro(self._on_file, config, self.path)
        except ConfigError as error:
            self._on_file = None
            self.complaint = f'begun with the priors: {error}; {self._set_aside(UNUSABLE)}'
        return self._on_file

    def save(self, calibration: Calibration, config: Config) -> bool:
        """Write it in one step; return whether that was possible. A failure is told, never raised."""
        if self.path is None:
            return False
        try:
            save_calibration(calibration, config, self.path, overwrite=True)
        except GyrocalError as error:
            self.complaint = f'the calibration could not be saved: {error}'
            return False
        self._on_file, self.complaint = calibration, ''
        return True

    def is_better(self, calibration: Calibration) -> bool:
        """Whether a calibration may replace that in the file: a half-done one no finished one."""
        return self._on_file is None or calibration.converged or not self._on_file.converged

    def forget(self) -> str:
        """Set the file aside; return what became of it, empty where there was none."""
        self._on_file, self.complaint = None, ''
        return self._set_aside(FORGOTTEN) if self.path is not None and self.path.exists() else ''

    def _set_aside(self, suffix: str) -> str:
        """Give the file another name; where that fails, leave it alone for good."""
        assert self.path is not None
        other = self.path.with_name(self.path.name + suffix)
        try:
            self.path.replace(other)
        except OSError as error:
            path, self.path = self.path, None
            return f'{path} could not be set aside ({error.strerror}): nothing is saved'
        return f'the file was set aside as {other}'


def _refuse_other_gyro(calibration: Calibration, config: Config, path: Path) -> None:
    """A scale factor is worth nothing where another nominal one is applied to the samples.

    Raises:
        ConfigError: it was another one.
    """
    then, now = calibration.nominal_scale_factor_volt, config.gyro.nominal_scale_factor_volt
    if abs(then / now - 1.0) > 1e-9:
        raise ConfigError(
            f'was made with a nominal scale factor of {then:g} deg/s/V, now it is {now:g}', where=str(path)
        )
