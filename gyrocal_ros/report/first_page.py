"""What a printed page adds below its verdict: where the result comes from, and the values for the robot."""

from __future__ import annotations

from datetime import UTC, datetime
from html import escape

from gyrocal_ros import __version__, kernels
from gyrocal_ros.data import NS_PER_S
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.pipeline.calibration import calibration_to_yaml, conclude
from gyrocal_ros.report.html import table

FOR_THE_ROBOT = """With a green status above, save this as calibration.yaml and give it to
    robot.launch.py with calibration:=FILE. With a yellow one, follow the next step first; with a red one, do
    not use it. It has no settings, because the robot has its own."""


def first_page(run: Run) -> str:
    """Return origin and values of a run as HTML that is shown on paper only.

    Args:
        run: run of the model that the page recommends.
    """
    origin = table('Origin', ('', ''), _origin(run))
    values = calibration_to_yaml(conclude(run))
    return (
        f'<section class="paper-only">{origin}<h2>For the robot</h2>'
        f'<p class="note">{escape(FOR_THE_ROBOT)}</p><pre>{escape(values)}</pre></section>'
    )


def _origin(run: Run) -> list[tuple[str, str]]:
    first, last = (_utc(stamp_ns) for stamp_ns in (run.span.start_ns, run.span.end_ns))
    effects = ', '.join(effect.name for effect in run.model.effects)
    return [
        ('recording', run.source),
        ('recorded', f'{first} to {last} UTC, {run.span.duration_s:.0f} s'),
        ('model', f'{run.model.name} {run.model.version}: {effects}'),
        ('software', f'gyrocal_ros {__version__}, {kernels.IN_USE} kernels'),
    ]


def _utc(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns / NS_PER_S, UTC).strftime('%Y-%m-%d %H:%M:%S')
