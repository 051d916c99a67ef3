"""Readings that no motion explains: spikes of gyro and encoders, and a frozen gyro.

A bit that flips on the bus makes a single reading that is far from those before and after it; a driver that
stalls repeats its last reading, or zeros. Both are faults of the sensor, not of its model. Such readings of
the gyro are left out, so that the filter treats their time as any other without samples. Spikes of the speed
are replaced by their neighbours, so that the way goes on.

A reading that may be faulty waits for the next ones. All others are passed on at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from gyrocal_ros.data import ImuSample, WheelSample, quickly_filled, seconds
from gyrocal_ros.kernels import compiled

MAX_ACCELERATION_RAD_S2 = 40.0
"""Yaw acceleration that a robot may reach both up and down within two samples, even if it hits something."""
MIN_JUMP_RAD_S = 0.2
"""Jump of the yaw rate up to which no reading is a spike."""
ROUGH_STEPS = 10.0
"""The same in usual steps from reading to reading, where noise or vibration is large."""
STEP_MEMORY = 0.02
"""Weight of a new step in their mean, once there are many."""
RETURNED = 0.25
"""Part of its jump that a spike leaves behind."""
MAX_SPIKE_READINGS = 2
BLOW_S, MAX_BLOW_RAD = 0.025, 0.1
"""Shortest time in which a blow may turn the robot to and fro, and largest turn by it: what lasts longer and
turns less may be one."""
FROZEN_S, MIN_FROZEN_READINGS = 0.1, 5
"""Time and number of equal readings from which a gyro is frozen."""
MAX_REPEATED_SHARE, MIN_READINGS = 0.02, 200
"""Share of readings that repeat the one before, above which that is the resolution of the gyro, and the
number of readings that tell it."""
MAX_WHEEL_ACCELERATION_M_S2, MIN_SPEED_JUMP_M_S = 30.0, 0.5
"""Acceleration of the wheels, even if they spin, and jump of the speed up to which no reading is a spike."""
SPIKE = 'a reading of the gyro was far from those before and after it: such readings are left out'
FROZEN = 'the gyro repeated one reading, as if its driver had stalled: such readings are left out'


@quickly_filled
@dataclass(frozen=True, slots=True)
class UsualReadings:
    """The sound readings of a gyro so far: the last one, and what is usual."""

    last: ImuSample | None = None
    passed: int = 0
    repeated: int = 0
    """Numbers of readings, and of those that repeat the one before."""
    mean_step_rad_s: float = 0.0
    """Mean size of the step from one to the next."""
    largest_rad_s: float = 0.0
    """Largest rate about z."""

    def jumps(self, sample: ImuSample) -> bool:
        """Return True if neither motion nor noise explains the step to the next reading."""
        if self.last is None:
            return False
        jump_rad_s = abs(sample.rate_rad_s[2] - self.last.rate_rad_s[2])
        if jump_rad_s < MIN_JUMP_RAD_S:
            return False
        by_motion_rad_s = MAX_ACCELERATION_RAD_S2 * seconds(sample.t_ns - self.last.t_ns)
        return jump_rad_s > max(by_motion_rad_s, ROUGH_STEPS * self.mean_step_rad_s)

    def may_be_frozen(self, before: ImuSample, sample: ImuSample) -> bool:
        """Return True if a reading repeats the one before, which is rare, and is not at the limit."""
        if sample.rate_rad_s != before.rate_rad_s:
            return False
        is_rare = self.passed > MIN_READINGS and self.repeated < MAX_REPEATED_SHARE * self.passed
        return is_rare and abs(sample.rate_rad_s[2]) < self.largest_rad_s

    def after(self, sample: ImuSample) -> UsualReadings:
        """Return the same after one more sound reading."""
        rate, repeated, mean_step_rad_s = sample.rate_rad_s, self.repeated, self.mean_step_rad_s
        if self.last is not None:
            before = self.last.rate_rad_s
            weight = max(STEP_MEMORY, 1.0 / self.passed)
            mean_step_rad_s += weight * (abs(rate[2] - before[2]) - mean_step_rad_s)
            repeated += rate == before
        largest_rad_s = max(self.largest_rad_s, abs(rate[2]))
        return UsualReadings(sample, self.passed + 1, repeated, mean_step_rad_s, largest_rad_s)


@compiled
def pass_usual(
    usual: UsualReadings, samples: list[ImuSample], first: int
) -> tuple[int, int, int, float, float]:
    """Pass readings on that are newer than the last one, and neither jump nor repeat it.

    Args:
        usual: the readings so far.
        samples: the next ones.
        first: index of the first of them.

    Returns:
        Index of the first reading that is not passed on, or their number; the fields of `UsualReadings` but
        for the last reading.
    """
    for i in range(first, len(samples)):
        sample, last = samples[i], usual.last
        if last is not None:
            is_newer = sample.t_ns > last.t_ns
            if not is_newer or usual.jumps(sample) or usual.may_be_frozen(last, sample):
                break
        usual, first = usual.after(sample), i + 1
    return first, usual.passed, usual.repeated, usual.mean_step_rad_s, usual.largest_rad_s


class FaultyGyro:
    """Keeps spikes and frozen readings of a gyro from the filter."""

    def __init__(self) -> None:
        self.spikes = self.frozen = 0
        """Numbers of readings left out, by their fault."""
        self._news: list[str] = []
        self._usual = UsualReadings()
        self._held: list[ImuSample] = []
        self._is_frozen = False

    def sound(self, samples: list[ImuSample]) -> list[ImuSample]:
        """Take the next readings; return those known to be sound, in order. Older ones are ignored."""
        sound: list[ImuSample] = []
        i = 0
        while i < len(samples):
            if self._held:
                if samples[i].t_ns > self._held[-1].t_ns:
                    sound += self._judge(samples[i])
            else:
                first = i
                i, passed, repeated, mean_step_rad_s, largest_rad_s = pass_usual(self._usual, samples, first)
                if i > first:
                    self._usual = UsualReadings(
                        samples[i - 1], passed, repeated, mean_step_rad_s, largest_rad_s
                    )
                    sound += samples[first:i]
                if i < len(samples) and self._is_newer(samples[i]):
                    self._held = [samples[i]]
            i += 1
        return sound

    def news(self) -> str:
        """Return the faults that have appeared for the first time since the last call; empty without."""
        news, self._news = '; '.join(self._news), []
        return news

    def _judge(self, sample: ImuSample) -> Sequence[ImuSample]:
        """Return the readings that are sound by the next one, while some are held."""
        held = self._held
        if self._usual.may_be_frozen(held[-1], sample):
            held.append(sample)
            lasts_s = seconds(sample.t_ns - held[0].t_ns)
            if self._is_frozen or (lasts_s >= FROZEN_S and len(held) >= MIN_FROZEN_READINGS):
                self._news += [] if self.frozen else [FROZEN]
                self.frozen += len(held) - self._is_frozen
                self._is_frozen, self._held = True, [sample]
            return ()
        if self._is_frozen:
            self._is_frozen, held = False, []
        elif self._has_returned(sample):
            self._news += [] if self.spikes else [SPIKE]
            self.spikes += len(held)
            held = []
        elif len(held) < MAX_SPIKE_READINGS:
            held.append(sample)
            return ()
        self._held = []
        sound = [*held, sample]
        for each in sound:
            self._usual = self._usual.after(each)
        return sound

    def _is_newer(self, sample: ImuSample) -> bool:
        return self._usual.last is None or sample.t_ns > self._usual.last.t_ns

    def _has_returned(self, sample: ImuSample) -> bool:
        """Return True if few readings are held, they jumped away as by no blow, and this one is back."""
        last = self._usual.last
        assert last is not None
        before, away = last.rate_rad_s[2], self._held[0].rate_rad_s[2]
        jump_rad_s, left_rad_s = abs(away - before), abs(sample.rate_rad_s[2] - before)
        lasts_s = seconds(sample.t_ns - last.t_ns)
        is_no_blow = lasts_s < BLOW_S or 0.5 * lasts_s * jump_rad_s > MAX_BLOW_RAD
        return len(self._held) <= MAX_SPIKE_READINGS and left_rad_s < RETURNED * jump_rad_s and is_no_blow


class FaultyWheels:
    """Replaces spikes in the speed by the encoders."""

    def __init__(self) -> None:
        self.spikes = 0
        """Number of readings replaced."""
        self._last: WheelSample | None = None
        self._newest_ns: float = -math.inf
        self._held: list[WheelSample] = []

    def sound(self, samples: list[WheelSample]) -> list[WheelSample]:
        """Take the next readings; return those known to be sound, in order. Older ones are ignored."""
        sound: list[WheelSample] = []
        for sample in samples:
            if sample.t_ns > self._newest_ns:
                self._newest_ns = sample.t_ns
                last = self._last
                if last is not None and self._jumps(last, sample) and len(self._held) < MAX_SPIKE_READINGS:
                    self._held.append(sample)
                    continue
                if self._held:
                    sound += self._replaced(sample)
                self._last = sample
                sound.append(sample)
        return sound

    def _replaced(self, sample: WheelSample) -> list[WheelSample]:
        """Return the readings held back, replaced by their neighbours if the next one is back."""
        held, last, self._held = self._held, self._last, []
        if last is None or self._jumps(last, sample):
            return held
        self.spikes += len(held)
        speed_m_s = 0.5 * (last.speed_m_s + sample.speed_m_s)
        yaw_rate_rad_s = 0.5 * (last.yaw_rate_rad_s + sample.yaw_rate_rad_s)
        return [WheelSample(item.t_ns, speed_m_s, yaw_rate_rad_s) for item in held]

    def _jumps(self, before: WheelSample, sample: WheelSample) -> bool:
        """Return True if no motion explains the step between two readings."""
        jump_m_s = abs(sample.speed_m_s - before.speed_m_s)
        by_motion_m_s = MAX_WHEEL_ACCELERATION_M_S2 * seconds(sample.t_ns - before.t_ns)
        return jump_m_s > max(by_motion_m_s, MIN_SPEED_JUMP_M_S)
