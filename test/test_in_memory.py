"""A recording in memory: read once, its images tracked once, with the same results."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from recordings import ModifiedSource, recording, with_clock_step

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    FeatureObservations,
    Frame,
    Measurement,
    MotionBlock,
    Rig,
    Source,
    Span,
    nanoseconds,
)
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.step_record import StepRecord
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import MAX_IN_MEMORY_S, InMemorySource, preload
from gyrocal_ros.pipeline.run_filter import Progress
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

FILMED_S, IMAGES_HZ = 14.0, 5


@dataclass
class Counted:
    """A source that counts its passes and images."""

    source: Source
    passes: int = 0
    images: list[int] = field(default_factory=list)

    @property
    def name(self) -> str:
        return self.source.name

    @property
    def rig(self) -> Rig:
        return self.source.rig

    @property
    def span(self) -> Span:
        return self.source.span

    def measurements(self) -> Iterator[Measurement]:
        self.passes += 1
        for item in self.source.measurements():
            if isinstance(item, Frame):
                self.images.append(item.t_ns)
            yield item


def assert_same(one: Run, other: Run) -> None:
    """Check that two runs are bit-identical."""
    for name in ('t_ns', 'mean', 'std', 'log_likelihood', 'heading_innovation_rad', 'signals'):
        np.testing.assert_array_equal(getattr(one.history, name), getattr(other.history, name), err_msg=name)
    np.testing.assert_array_equal(one.state.covariance, other.state.covariance)


class TestFeatures:
    @pytest.mark.slow
    def test_the_filter_gives_the_same_result(self) -> None:
        source = Counted(recording('cleaning', 1, 30.0))
        loaded, config = preload(source, Config(), default_model())
        assert config == Config() and (loaded.name, loaded.span) == (source.name, source.span)
        runs = [calibrate(loaded, config, default_model()) for _ in range(2)]
        assert source.passes == 1, 'two runs of the filter, one pass over the source'
        assert_same(runs[0], calibrate(source, Config(), default_model()))
        assert_same(*runs)
        assert runs[0].truth is not None, 'ground truth is in memory, too'

    def test_the_progress_is_reported(self) -> None:
        reported: list[Progress] = []
        preload(recording('cleaning', 1, 30.0), Config(), default_model(), reported.append)
        done_s = [progress.done_s for progress in reported]
        assert len(done_s) == pytest.approx(30, abs=2) and done_s == sorted(done_s)
        assert all(progress.total_s == reported[0].total_s for progress in reported)

    def test_a_long_recording_is_not_loaded(self) -> None:
        short = recording('cleaning', 1, 30.0)
        long = Counted(InMemorySource('long', short.rig, Span(0, nanoseconds(MAX_IN_MEMORY_S + 1.0)), []))
        assert preload(long, Config(), default_model()) == (long, Config())
        assert long.passes == 0


@pytest.fixture(scope='module')
def filmed() -> Source:
    """Return a short drive with images, rendered once."""
    scenario = replace(
        find_scenario('spins'), duration_s=FILMED_S, imu_hz=100, camera_hz=IMAGES_HZ, standing_s=1.0
    )
    source = SimSource(scenario, 1, images=True)
    return InMemorySource(source.name, source.rig, source.span, list(source.measurements()))


class TestImages:
    @pytest.mark.slow
    def test_they_are_tracked_once_and_calibrate_as_well(self, filmed: Source) -> None:
        source = Counted(filmed)
        loaded, config = preload(source, Config(), default_model())
        measurements = list(loaded.measurements())
        assert source.passes == 1
        assert not any(isinstance(item, Frame) for item in measurements)
        seen = [item for item in measurements if isinstance(item, FeatureObservations)]
        assert [item.t_ns for item in seen] == source.images
        assert np.mean([len(item.ids) for item in seen]) > 5.0
        stamps = [item.t_ns for item in measurements]
        assert stamps == sorted(stamps)
        assert config == replace(
            Config(), camera=replace(Config().camera, pixel_noise_px=Config().tracker.noise_px)
        ), 'the noise is that of the tracker'

        direct = calibrate(filmed, Config(), default_model())
        again = calibrate(loaded, config, default_model())
        np.testing.assert_array_equal(again.history.t_ns, direct.history.t_ns)
        off = abs(float(again.state.coefficients[0] - direct.state.coefficients[0]))
        assert off < 0.1 * direct.history.std[-1, 9]

    @pytest.mark.slow
    def test_features_are_tracked_on_where_the_filter_diverges(
        self, filmed: Source, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """What the model lacks may break the filter that guides the tracker; the diagnosis is to find it."""
        broken_ns, step = filmed.span.start_ns + nanoseconds(0.5 * FILMED_S), EkfSlam.step
        filters: list[EkfSlam] = []

        def breaking(slam: EkfSlam, block: MotionBlock, *seen: Any) -> StepRecord:
            if slam not in filters:
                filters.append(slam)
            if len(filters) == 1 and block.end_ns > broken_ns:
                raise FilterDivergedError('broken')
            return step(slam, block, *seen)

        monkeypatch.setattr(EkfSlam, 'step', breaking)
        loaded, _ = preload(filmed, Config(), default_model())
        seen = [item for item in loaded.measurements() if isinstance(item, FeatureObservations)]
        images = [item.t_ns for item in filmed.measurements() if isinstance(item, Frame)]
        assert len(filters) == 2 and [item.t_ns for item in seen] == images
        place = next(k for k, item in enumerate(seen) if item.t_ns > broken_ns)
        assert len(np.intersect1d(seen[place - 1].ids, seen[place].ids)) > 5
        assert np.mean([len(item.ids) for item in seen[place:]]) > 5.0

    @pytest.mark.slow
    def test_a_recording_with_a_clock_step_keeps_its_images(self, filmed: Source) -> None:
        stepped = ModifiedSource(filmed, with_clock_step(30.0, 0.5 * FILMED_S))
        assert preload(stepped, Config(), default_model()) == (stepped, Config())
