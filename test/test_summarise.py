"""Summary of a recording: its signals, its readings, and the quantisation step of the gyro."""

from __future__ import annotations

import math

import numpy as np
import pytest
from recordings import recording
from synthetic import RIG, readings

from gyrocal_ros.data import (
    Array,
    CovariateSample,
    ImuSample,
    Measurement,
    Span,
    TemperatureSample,
    WheelSample,
    nanoseconds,
)
from gyrocal_ros.diagnose.analysis.candidates import candidates_for
from gyrocal_ros.diagnose.analysis.summarise import MAX_SIGNALS, coarse_step, summarise_recording
from gyrocal_ros.effects import default_model
from gyrocal_ros.model.recording import SPEED_SIGNAL, TEMPERATURE
from gyrocal_ros.pipeline.in_memory import InMemorySource


class TestSummary:
    def source(self, *measurements: Measurement) -> InMemorySource:
        return InMemorySource('made', RIG, Span(0, nanoseconds(10.0)), measurements)

    def signal(self, name: str, *values: float) -> list[Measurement]:
        return [CovariateSample(place, name, value) for place, value in enumerate(values)]

    def test_signals_and_readings(self) -> None:
        found = summarise_recording(
            self.source(
                *(ImuSample(t_ns, (9.0, 9.0, 0.1 * t_ns), (0.0, 0.0, 9.8)) for t_ns in range(3)),
                *self.signal('fan', 1.0, 3.0),
                *self.signal('still', 7.0, 7.0),
                WheelSample(1, 0.2, 0.0),
                WheelSample(2, 0.4, 0.0),
                TemperatureSample(3, 25.0),
            )
        )
        assert found.readings.t_ns.tolist() == [0, 1, 2]
        np.testing.assert_allclose(found.readings.rate_rad_s, [0.0, 0.1, 0.2])
        about = {signal.name: (signal.mean, signal.spread) for signal in found.signals}
        assert about == {'fan': (2.0, 1.0), SPEED_SIGNAL: (pytest.approx(0.3), pytest.approx(0.1))}
        assert found.recorded == {TEMPERATURE, 'fan', 'still', SPEED_SIGNAL}
        assert found.duration_s == 10.0 and found.left_out == () and found.rig is RIG

    def test_of_too_many_signals_those_that_vary_most_are_tried(self) -> None:
        few = [f'steady{place}' for place in range(3)]
        many = [f'lively{place}' for place in range(MAX_SIGNALS)]
        measurements = [item for name in few for item in self.signal(name, 10.0, 10.1)]
        measurements += [item for name in many for item in self.signal(name, 1.0, -1.0)]
        found = summarise_recording(self.source(*measurements))
        assert {signal.name for signal in found.signals} == set(many)
        assert sorted(found.left_out) == few
        assert found.recorded == {*many, *few}, 'an effect that needs one of them is a candidate nevertheless'

    def test_an_empty_recording(self) -> None:
        found = summarise_recording(self.source())
        assert found.signals == () and found.recorded == frozenset() and len(found.readings.rate_rad_s) == 0

    def test_signals_of_a_recording_are_candidates(self) -> None:
        found = summarise_recording(recording('cleaning', 1, 20.0))
        names = {signal.name for signal in found.signals}
        assert {SPEED_SIGNAL, 'battery_state.current'} <= names
        candidates = {item.effect.name for item in candidates_for(default_model(), found).candidates}
        assert f'covariate_bias:{SPEED_SIGNAL}' in candidates
        assert len(found.readings.rate_rad_s) == pytest.approx(2000, abs=5)


class TestCoarseStep:
    """The quantisation step of the gyro's converter, estimated from its readings."""

    @staticmethod
    def step_deg_s(rate_rad_s: Array) -> float | None:
        step = coarse_step(readings(rate_rad_s))
        return None if step is None else math.degrees(step)

    @staticmethod
    def turning(noise_deg_s: float) -> Array:
        time_s = np.arange(12_000) / 200.0
        noise = np.random.default_rng(1).normal(size=len(time_s))
        slow: Array = np.radians(60.0 * np.sin(0.2 * time_s) ** 5 + noise_deg_s * noise)
        return slow

    @pytest.mark.parametrize('step_deg_s', [0.1, 0.5])
    def test_a_step_wider_than_the_noise_is_found(self, step_deg_s: float) -> None:
        step = math.radians(step_deg_s)
        read = step * np.round(self.turning(0.2 * step_deg_s) / step) - 0.0123
        assert self.step_deg_s(read) == pytest.approx(step_deg_s)
        assert self.step_deg_s(-1.07 * read) == pytest.approx(1.07 * step_deg_s)

    def test_a_step_narrower_than_the_noise_does_no_harm(self) -> None:
        step = math.radians(0.1)
        assert self.step_deg_s(step * np.round(self.turning(0.1) / step)) is None

    def test_a_dead_band_of_fine_readings(self) -> None:
        """Its zeros repeat, but what it lets through has noise of many steps."""
        step, rate = math.radians(5e-4), self.turning(0.03)
        read = step * np.round(np.where(np.abs(rate) < math.radians(0.4), 0.0, rate) / step)
        assert self.step_deg_s(read) is None

    def test_readings_without_a_step(self) -> None:
        smooth = self.turning(0.01)
        assert self.step_deg_s(smooth) is None
        assert self.step_deg_s(np.where(np.abs(smooth) < 0.01, 0.0, smooth)) is None, 'a dead band'
        assert self.step_deg_s(np.clip(smooth, -0.5, 0.5)) is None, 'a limit'
        assert self.step_deg_s(np.zeros(5000)) is None
        assert self.step_deg_s(np.empty(0)) is None
