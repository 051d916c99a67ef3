"""What pages about models have in common: how the heading runs away, and how far it drifts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gyrocal_ros.diagnose.drift import REFERENCES
from gyrocal_ros.diagnose.heading_filter import Headings
from gyrocal_ros.diagnose.regimes import Failure
from gyrocal_ros.ekf.run import History
from gyrocal_ros.report.diagnosis_series import wander
from gyrocal_ros.report.figures.diagnosis import where_it_fails
from gyrocal_ros.report.figures.models import Mark, drift_by_model
from gyrocal_ros.report.html import Section
from gyrocal_ros.report.series import camera_off

HEADING = """Above, the heading by the gyro alone, from the beginning to the end, less the heading that was
    seen; the bias that fits best is taken out. Inside the band, noise is explanation enough. In the middle,
    what that error gained in each 10 s, with three standard deviations; below, what the robot was doing."""
STRETCHES = ' Shaded are the stretches of time in which it is worst, the worst is number 1.'
DRIFT = """Heading error after {span_s:.0f} s without the camera, compared with {reference}. Held out: each
    span begins with what was known by then, so nothing was fitted on what follows. The bars hold in 90 of
    100 recordings; the spans are the same for all models, so that these can differ by more than chance even
    where bars overlap. """


def heading_section(
    title: str,
    seen: Mapping[str, Headings],
    history: History,
    stretches: Sequence[Failure] = (),
    jump_s: float | None = None,
) -> Section:
    """How the gyro's heading runs away from the one that was seen.

    Args:
        title: of the figure.
        seen: by name of the model.
        history: what the robot was doing.
        stretches: of time to mark, the worst first.
        jump_s: when the bias jumped, where it did.
    """
    wanders = {name: wander(headings) for name, headings in seen.items()}
    rate_deg_s = np.degrees(history.turn_rad / history.dt_s)
    figure = where_it_fails(
        title, wanders, history.time_s, rate_deg_s, stretches, jump_s, camera_off(history)
    )
    return Section('heading', figure, HEADING + (STRETCHES if stretches else ''))


def drift_section(
    title: str, marks: Sequence[Mark], joined: bool = True, half: bool = False, more: str = ''
) -> Section:
    """How far each model drifts without the camera.

    Args:
        title: of the figure.
        marks: one or more.
        joined: draw lines from model to model: each builds on the one before.
        half: two of them stand side by side.
        more: to be said below it.
    """
    drift = marks[0].drift
    caption = DRIFT.format(span_s=drift.span_s, reference=REFERENCES[drift.reference])
    return Section('drift', drift_by_model(title, marks, joined), caption + more, half)
