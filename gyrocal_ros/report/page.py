"""The page about a calibration that a person looks at."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from gyrocal_ros import __version__
from gyrocal_ros.config.declare import to_yaml
from gyrocal_ros.data import NS_PER_S
from gyrocal_ros.diagnose.drift import BlindDrift, blind_drift, held_out_from_s
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.pipeline.calibration import Calibration
from gyrocal_ros.report import series
from gyrocal_ros.report.html import Section, details, document, gallery, table, verdict_box, warnings
from gyrocal_ros.report.sections import sections
from gyrocal_ros.report.tables import Row, coefficient_rows, verdict


def report_page(run: Run, calibration: Calibration, findings: Sequence[tuple[str, str]] = ()) -> str:
    """The whole page as HTML text.

    Args:
        run: a finished run.
        calibration: what it has found.
        findings: severity and text of what is odd about the recording.
    """
    before, after = _drifts(run)
    return document(
        f'Gyro calibration of {run.source}',
        f'{calibration.duration_s:.0f} s recorded, model {run.model.name}, gyrocal {__version__}',
        [
            verdict_box(verdict(calibration, run.config, before, after)),
            warnings([*findings, *events(run)]),
            _coefficients(coefficient_rows(calibration, run.history)),
            gallery(sections(run, calibration, before, after)),
            details('Sensor model (model.yaml)', model_to_yaml(run.model)),
            details('Settings (settings.yaml)', to_yaml(run.config)),
        ],
    )


def report_sections(run: Run, calibration: Calibration) -> Iterator[Section]:
    """The figures of the page."""
    yield from sections(run, calibration, *_drifts(run))


def _drifts(run: Run) -> tuple[BlindDrift, BlindDrift]:
    """Blind drift of the nominal and of the calibrated gyro."""
    from_s = held_out_from_s(run)
    return blind_drift(series.uncorrected(run), from_s=from_s), blind_drift(run, from_s=from_s)


def events(run: Run) -> Iterator[tuple[str, str]]:
    """What happened during a run, as warnings with their times."""
    for event in run.events:
        yield 'warning', f'{(event.t_ns - run.span.start_ns) / NS_PER_S:.1f} s after the start: {event.text}'


def _coefficients(rows: Iterable[Row]) -> str:
    return table(
        'Coefficients',
        ('coefficient', 'value', 'unit', 'before', 'which means'),
        ((row.name, row.value, row.unit, row.known_before, row.meaning) for row in rows),
        '± is one standard deviation, here and above.',
    )
