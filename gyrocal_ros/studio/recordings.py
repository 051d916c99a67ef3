"""Recordings of a session: a bag, or a simulated robot with hidden effects that is never written to disk."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gyrocal_ros.bag.check import CheckReport, check_bag
from gyrocal_ros.bag.source import open_bag
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Source
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
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

TASK_SCENARIO = 'cleaning'
TASK_DURATION_S = 240.0


@dataclass(frozen=True, slots=True)
class Bag:
    """A recording on disk, with the options for reading it."""

    path: Path
    config: Config
    options: Mapping[str, Any] = field(default_factory=dict)
    """Keywords of `open_bag` and `check_bag`."""
    name: str = ''
    """Name in place of that of its file, where bags of several robots have the same."""

    @property
    def title(self) -> str:
        """Name of the recording for the user, and name of its folder of revisions."""
        return self.name or self.path.resolve().name


@dataclass(frozen=True, slots=True)
class HiddenEffectTask:
    """A simulated robot with hidden effects, drawn by a seed."""

    seed: int
    config: Config
    duration_s: float = TASK_DURATION_S

    @property
    def title(self) -> str:
        """Name of the recording for the user, and name of its folder of revisions."""
        return f'lesson_{self.seed}'

    def source(self) -> SimSource:
        """Simulate the recording."""
        scenario = find_scenario(TASK_SCENARIO)
        errors = replace(scenario.errors, scale_factor=draw_scale_factor(self.seed))
        scenario = replace(scenario, duration_s=self.duration_s, errors=errors)
        hidden = hide(draw_hidden(self.seed, self.duration_s), find_effect)
        return SimSource(scenario, self.seed, hidden=hidden)


@dataclass(frozen=True, slots=True, eq=False)
class LoadedRecording:
    """A recording in memory, for several runs of the filter."""

    source: Source
    config: Config
    recorded: RecordingSummary
    answer: Mapping[str, Any] | None
    """Hidden effects; None for a bag."""


@dataclass(frozen=True, slots=True)
class RecordingContents:
    """Contents and issues of a recording."""

    duration_s: float
    check: CheckReport | None
    """None for a simulated robot, whose recording has no issues."""

    @property
    def issues(self) -> tuple[tuple[str, str], ...]:
        """Severity and text of each issue."""
        issues = self.check.issues if self.check is not None else ()
        return tuple((issue.severity, str(issue)) for issue in issues)


def inspect_recording(recording: Bag | HiddenEffectTask) -> RecordingContents:
    """Check a recording.

    Raises:
        GyrocalError: it cannot be read.
    """
    if isinstance(recording, HiddenEffectTask):
        return RecordingContents(recording.duration_s, None)
    report = check_bag(recording.path, recording.config, **recording.options)
    return RecordingContents(report.duration_s, report)


def identity(recording: Bag | HiddenEffectTask, contents: RecordingContents) -> dict[str, Any]:
    """Return properties that distinguish a recording from others."""
    if isinstance(recording, HiddenEffectTask):
        return {'seed': recording.seed, 'duration_s': contents.duration_s}
    assert contents.check is not None
    topics = {topic.name: topic.count for topic in contents.check.topics}
    options = {name: value for name, value in recording.options.items() if value}
    return {'duration_s': contents.duration_s, 'messages': topics, **options}


def load_recording(
    recording: Bag | HiddenEffectTask,
    contents: RecordingContents,
    model: SensorModel,
    report: Callable[[Progress], None],
) -> LoadedRecording:
    """Read a recording into memory, and track features in its images.

    Args:
        recording: the recording.
        contents: its contents, from `inspect_recording`.
        model: the sensor model for the filter that guides the tracker.
        report: called with the progress about once a second of recorded time.

    Raises:
        GyrocalError: it cannot be used for a calibration.
    """
    if isinstance(recording, HiddenEffectTask):
        simulated = recording.source()
        source, config = preload(simulated, recording.config, model, report)
        return LoadedRecording(source, config, summarise_recording(source), answer_of(simulated))
    assert contents.check is not None
    raise_first_error(contents.check.issues, str(recording.path))
    bag = open_bag(recording.path, recording.config, with_covariates=True, **recording.options)
    source, config = preload(bag, recording.config, model, report)
    return LoadedRecording(source, config, summarise_recording(source), None)
