"""Keeps the calibration of a running robot in a file, read at the start and updated while it runs."""

from __future__ import annotations

from pathlib import Path

from gyrocal_ros.config.sections import Config
from gyrocal_ros.errors import ConfigError, GyrocalError
from gyrocal_ros.pipeline.calibration import Calibration, load_calibration, save_calibration

UNUSABLE, DISCARDED = '.bad', '.old'
"""Suffixes of a renamed file: one that could not be read, and one that the user has discarded."""
MAX_KEPT = 10
"""Number of renamed files of each kind that are kept; the oldest is removed before one more is added."""


class CalibrationStore:
    """Reads and writes one calibration file.

    Args:
        path: the file; None for none.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.problem = ''
        """Why the file could not be read or written; empty without a problem."""
        self._stored: Calibration | None = None
        self._version: tuple[int, int] | None = None

    def load(self, config: Config) -> Calibration | None:
        """Return the stored calibration; None if there is none. An unusable file is renamed and reported.

        Raises:
            ConfigError: the path is that of a folder.
        """
        if self.path is None or not self.path.exists():
            return None
        if self.path.is_dir():
            raise ConfigError('is a folder', where=str(self.path), todo='name a file in live.calibration')
        try:
            self._version = self._version_now()
            self._stored = load_calibration(self.path)
            _check_nominal_scale(self._stored, config, self.path)
        except ConfigError as error:
            self._stored = None
            self.problem = f'started with the priors: {error}; {self._rename(UNUSABLE)}'
        return self._stored

    def save(self, calibration: Calibration, config: Config) -> bool:
        """Write the file atomically; return False, and report it, where that fails."""
        if self.path is None:
            return False
        is_shared = self._version is not None and self._version_now() not in (None, self._version)
        try:
            save_calibration(calibration, config, self.path, overwrite=True)
        except GyrocalError as error:
            self.problem = f'the calibration could not be saved: {error}'
            return False
        self._stored, self._version, self.problem = calibration, self._version_now(), ''
        if is_shared:
            self.problem = (
                f'{self.path} is also written by another program, and each overwrites the other; give every '
                'calibrator a file of its own in live.calibration'
            )
        return True

    def may_replace(self, calibration: Calibration) -> bool:
        """Return True if a calibration may replace the stored one: converged, or the stored one is not."""
        return self._stored is None or calibration.converged or not self._stored.converged

    def discard(self) -> str:
        """Rename the file; return a clause about it, empty where there was none."""
        self._stored, self.problem = None, ''
        return self._rename(DISCARDED) if self.path is not None and self.path.exists() else ''

    def _version_now(self) -> tuple[int, int] | None:
        """Return what changes with each write of the file: inode and time; None where there is no file."""
        try:
            found = Path(self.path or '').stat()
        except OSError:
            return None
        return found.st_ino, found.st_mtime_ns

    def _rename(self, suffix: str) -> str:
        """Rename the file; where that fails, leave it alone from now on."""
        assert self.path is not None
        try:
            other = _free_name(self.path, suffix)
            self.path.replace(other)
        except OSError as error:
            path, self.path = self.path, None
            return f'{path} could not be renamed ({error.strerror}): nothing is saved'
        return f'the file was renamed to {other}'


def _free_name(path: Path, suffix: str) -> Path:
    """Return the name for a renamed file: with the suffix, then with .2, .3 and so on after it.

    The numbers increase for ever, so the highest belongs to the newest file. Beyond `MAX_KEPT` files the
    oldest is removed.

    Raises:
        OSError: the folder cannot be read, or the oldest file not removed.
    """
    first = path.name + suffix
    kept: dict[int, Path] = {}
    for file in path.parent.iterdir():
        number = file.name.removeprefix(f'{first}.')
        if file.name == first:
            kept[1] = file
        elif file.name.startswith(f'{first}.') and number.isdecimal():
            kept[int(number)] = file
    for oldest in sorted(kept)[: max(0, len(kept) - MAX_KEPT + 1)]:
        kept[oldest].unlink()
    newest = max(kept, default=0)
    return path.with_name(f'{first}.{newest + 1}' if newest else first)


def _check_nominal_scale(calibration: Calibration, config: Config, path: Path) -> None:
    """Refuse a calibration made with another nominal scale factor: its scale factor is relative to that.

    Raises:
        ConfigError: the nominal scale factors differ.
    """
    then, now = calibration.nominal_scale_factor_volt, config.gyro.nominal_scale_factor_volt
    if abs(then / now - 1.0) > 1e-9:
        raise ConfigError(
            f'was made with a nominal scale factor of {then:g} deg/s/V, now it is {now:g}', where=str(path)
        )
