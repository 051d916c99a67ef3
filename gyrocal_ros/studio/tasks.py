"""The long work of a studio as values: tasks for the worker, and its messages about them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel
from gyrocal_ros.diagnose.analysis.ranking import RankedEffect
from gyrocal_ros.diagnose.analysis.validation import Validation
from gyrocal_ros.diagnose.analysis.wander import Wander
from gyrocal_ros.diagnose.diagnosis import Diagnosis
from gyrocal_ros.diagnose.series.error_curves import ErrorCurve
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.calibration import Calibration
from gyrocal_ros.studio.recordings import Bag, HiddenEffectTask, RecordingContents


@dataclass(frozen=True, slots=True)
class OpenRecording:
    """Task: inspect a recording, and load it."""

    recording: Bag | HiddenEffectTask
    model: SensorModel


@dataclass(frozen=True, slots=True)
class Examine:
    """Task: run a model over the recording, with all other effects as candidates."""

    model: SensorModel
    is_first: bool = False
    """If the filter diverges with this model, look for an effect with which it does not."""


@dataclass(frozen=True, slots=True)
class LearnLaw:
    """Task: learn a law that no effect of the library has, from what a model leaves unexplained."""

    model: SensorModel


@dataclass(frozen=True, slots=True)
class ValidateModels:
    """Task: run models that were fitted on the open recording over another one."""

    recording: Bag
    trained: Mapping[str, Calibration]
    """Calibrations by the open recording, by label of the model; the last is that of the present model."""


Task: TypeAlias = OpenRecording | Examine | LearnLaw | ValidateModels


@dataclass(frozen=True, slots=True)
class TaskProgress:
    """Progress of a task."""

    fraction: float
    """0 to 1."""
    text: str
    """Description of the present step."""


@dataclass(frozen=True, slots=True, eq=False)
class RunPreview:
    """The heading error of a running filter up to now."""

    wander: Wander
    time_s: Array
    rate_deg_s: Array


@dataclass(frozen=True, slots=True, eq=False)
class Examination:
    """A model on the recording, with everything about it that takes long to compute."""

    examined: ExaminedModel
    best: RankedEffect | None
    """The effect that explains most of the remaining error; None if that is no more than chance."""
    limits: tuple[Effect, ...]
    """Limits that the readings suggest; only a run can score them."""
    diagnosis: Diagnosis
    """The conclusions, before anything is added."""
    wander: Wander
    error_curves: Mapping[tuple[str, bool], ErrorCurve]
    """Remaining error of the bias (False) or the scale (True) by signal, the most significant first."""
    is_contradicted: bool
    """True if the recording contradicts the model, whatever the model lacks."""

    @property
    def indistinguishable(self) -> tuple[str, ...]:
        """Effects that this recording cannot distinguish from the best."""
        return self.diagnosis.missing[0].confused_with if self.diagnosis.missing else ()


@dataclass(frozen=True, slots=True, eq=False)
class LearnedResult:
    """Result: what was learned beside a model."""

    examination: Examination | None
    """Examination of the model with the law; None where no law predicts the recording better."""
    as_curve: Examination | None = None
    """The same of the curve or memory as it was learned, before it was written in closed form."""
    gain: float = 0.0
    """Marginal log-likelihood gained."""
    sigma: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class ValidationResult:
    """Result: models on another recording."""

    recording: str
    """Title of the other recording."""
    models: Mapping[str, Validation]
    """By label of the model."""


@dataclass(frozen=True, slots=True)
class Ready:
    """Result: a recording that was loaded."""

    recorded: RecordingSummary
    answer: Any


@dataclass(frozen=True, slots=True)
class Failed:
    """Result: the reason why a task failed."""

    why: str


@dataclass(frozen=True, slots=True)
class Stopped:
    """Result: the task was cancelled."""


TaskMessage: TypeAlias = (
    TaskProgress
    | RecordingContents
    | Ready
    | RunPreview
    | Examination
    | LearnedResult
    | ValidationResult
    | Failed
    | Stopped
)
Listener: TypeAlias = Callable[[int, TaskMessage], None]
"""Called with the number of a task and a message about it."""
