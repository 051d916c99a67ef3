"""What a session works on: a bag, or a riddle that is drawn and never written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gyrocal_ros.bag.check import CheckReport, check_bag
from gyrocal_ros.bag.source import open_bag
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Source
from gyrocal_ros.diagnose.summarise import summarise_recording
from gyrocal_ros.effects import find_effect
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.msgs.issues import raise_first_error
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.pipeline.run_filter import Progress
from gyrocal_ros.sim.hidden import draw_hidden, draw_scale_factor, hide
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.sealed import answer_of
from gyrocal_ros.sim.world import SimSource

RIDDLE_SCENARIO = 'cleaning'
RIDDLE_S = 240.0


@dataclass(frozen=True, slots=True)
class Bag:
    """A recording on disk, and how to read it."""

    path: Path
    config: Config
    options: Mapping[str, Any] = field(default_factory=dict)
    """Keywords of `open_bag` and `check_bag`."""

    @property
    def title(self) -> str:
        """What a person calls it, and the name of its folder of revisions."""
        return self.path.resolve().name


@dataclass(frozen=True, slots=True)
class HiddenEffectTask:
    """A simulated robot that hides what its seed decides."""

    seed: int
    config: Config
    duration_s: float = RIDDLE_S

    @property
    def title(self) -> str:
        """What a person calls it, and the name of its folder of revisions."""
        return f'lesson_{self.seed}'

    def source(self) -> SimSource:
        """The recording, made anew."""
        scenario = find_scenario(RIDDLE_SCENARIO)
        errors = replace(scenario.errors, scale_factor=draw_scale_factor(self.seed))
        scenario = replace(scenario, duration_s=self.duration_s, errors=errors)
        hidden = hide(draw_hidden(self.seed, self.duration_s), find_effect)
        return SimSource(scenario, self.seed, hidden=hidden)


@dataclass(frozen=True, slots=True, eq=False)
class Opened:
    """A recording, held for many runs of the filter."""

    source: Source
    config: Config
    recorded: RecordingSummary
    answer: Mapping[str, Any] | None
    """What a riddle hides."""


@dataclass(frozen=True, slots=True)
class Contents:
    """What is in a recording, for a person."""

    duration_s: float
    check: CheckReport | None
    """None for a riddle, whose recording is in order."""

    @property
    def findings(self) -> tuple[tuple[str, str], ...]:
        """Severity and text of what is odd."""
        issues = self.check.issues if self.check is not None else ()
        return tuple((issue.severity, str(issue)) for issue in issues)


def look_into(what: Bag | HiddenEffectTask) -> Contents:
    """See what a recording holds.

    Raises:
        GyrocalError: it cannot be read.
    """
    if isinstance(what, HiddenEffectTask):
        return Contents(what.duration_s, None)
    report = check_bag(what.path, what.config, **what.options)
    return Contents(report.duration_s, report)


def read(
    what: Bag | HiddenEffectTask, contents: Contents, model: SensorModel, report: Callable[[Progress], None]
) -> Opened:
    """Read a recording, and follow its images once.

    Args:
        what: the recording.
        contents: what was found when it was looked into.
        model: the sensor model that helps to follow the images.
        report: told of the progress about once a second of recorded time.

    Raises:
        GyrocalError: it cannot be calibrated from.
    """
    if isinstance(what, HiddenEffectTask):
        riddle = what.source()
        held, config = preload(riddle, what.config, model, report)
        return Opened(held, config, summarise_recording(held), answer_of(riddle))
    assert contents.check is not None
    raise_first_error(contents.check.issues, str(what.path))
    source = open_bag(what.path, what.config, with_covariates=True, **what.options)
    held, config = preload(source, what.config, model, report)
    return Opened(held, config, summarise_recording(held), None)
