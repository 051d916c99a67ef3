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

from gyrocal_ros.data import ImuSample, WheelSample, seconds

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


class FaultyGyro:
    """Keeps spikes and frozen readings of a gyro from the filter, reading by reading."""

    def __init__(self) -> None:
        self.spikes = self.frozen = 0
        """Numbers of readings left out, by their fault."""
        self._news: list[str] = []
        self._last: ImuSample | None = None
        self._newest_ns: float = -math.inf
        self._held: list[ImuSample] = []
        self._is_frozen = False
        self._mean_step_rad_s = 0.0
        self._largest_rad_s = 0.0
        self._passed = self._repeated = 0

    def sound(self, sample: ImuSample) -> Sequence[ImuSample]:
        """Take the next reading; return those known to be sound, in order. An older one is ignored."""
        if sample.t_ns <= self._newest_ns:
            return ()
        self._newest_ns = sample.t_ns
        if self._held:
            return self._judge(sample)
        last = self._last
        if last is not None and (self._jumps(last, sample) or self._may_be_frozen(last, sample)):
            self._held = [sample]
            return ()
        self._pass(sample)
        return (sample,)

    def news(self) -> str:
        """Return the faults that have appeared for the first time since the last call; empty without."""
        news, self._news = '; '.join(self._news), []
        return news

    def _judge(self, sample: ImuSample) -> Sequence[ImuSample]:
        """Return the readings that are sound by the next one, while some are held."""
        held = self._held
        if self._may_be_frozen(held[-1], sample):
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
            self._pass(each)
        return sound

    def _jumps(self, before: ImuSample, sample: ImuSample) -> bool:
        """Return True if neither motion nor noise explains the step between two readings."""
        jump_rad_s = abs(sample.rate_rad_s[2] - before.rate_rad_s[2])
        if jump_rad_s < MIN_JUMP_RAD_S:
            return False
        by_motion_rad_s = MAX_ACCELERATION_RAD_S2 * seconds(sample.t_ns - before.t_ns)
        return jump_rad_s > max(by_motion_rad_s, ROUGH_STEPS * self._mean_step_rad_s)

    def _may_be_frozen(self, before: ImuSample, sample: ImuSample) -> bool:
        """Return True if a reading repeats the one before, which is rare, and is not at the limit."""
        if sample.rate_rad_s != before.rate_rad_s:
            return False
        is_rare = self._passed > MIN_READINGS and self._repeated < MAX_REPEATED_SHARE * self._passed
        return is_rare and abs(sample.rate_rad_s[2]) < self._largest_rad_s

    def _has_returned(self, sample: ImuSample) -> bool:
        """Return True if few readings are held, they jumped away as by no blow, and this one is back."""
        assert self._last is not None
        before, away = self._last.rate_rad_s[2], self._held[0].rate_rad_s[2]
        jump_rad_s, left_rad_s = abs(away - before), abs(sample.rate_rad_s[2] - before)
        lasts_s = seconds(sample.t_ns - self._last.t_ns)
        is_no_blow = lasts_s < BLOW_S or 0.5 * lasts_s * jump_rad_s > MAX_BLOW_RAD
        return len(self._held) <= MAX_SPIKE_READINGS and left_rad_s < RETURNED * jump_rad_s and is_no_blow

    def _pass(self, sample: ImuSample) -> None:
        """Learn what is usual from a sound reading."""
        rate = sample.rate_rad_s
        if self._last is not None:
            before = self._last.rate_rad_s
            weight = max(STEP_MEMORY, 1.0 / self._passed)
            self._mean_step_rad_s += weight * (abs(rate[2] - before[2]) - self._mean_step_rad_s)
            self._repeated += rate == before
        if abs(rate[2]) > self._largest_rad_s:
            self._largest_rad_s = abs(rate[2])
        self._passed += 1
        self._last = sample


class FaultyWheels:
    """Replaces spikes in the speed by the encoders, reading by reading."""

    def __init__(self) -> None:
        self.spikes = 0
        """Number of readings replaced."""
        self._last: WheelSample | None = None
        self._newest_ns: float = -math.inf
        self._held: list[WheelSample] = []

    def sound(self, sample: WheelSample) -> Sequence[WheelSample]:
        """Take the next reading; return those known to be sound, in order. An older one is ignored."""
        if sample.t_ns <= self._newest_ns:
            return ()
        self._newest_ns = sample.t_ns
        held, last = self._held, self._last
        jumps = last is not None and self._jumps(last, sample)
        if jumps and len(held) < MAX_SPIKE_READINGS:
            held.append(sample)
            return ()
        if last is not None and held and not jumps:
            self.spikes += len(held)
            speed_m_s = 0.5 * (last.speed_m_s + sample.speed_m_s)
            yaw_rate_rad_s = 0.5 * (last.yaw_rate_rad_s + sample.yaw_rate_rad_s)
            held = [WheelSample(item.t_ns, speed_m_s, yaw_rate_rad_s) for item in held]
        self._held, self._last = [], sample
        return (*held, sample)

    def _jumps(self, before: WheelSample, sample: WheelSample) -> bool:
        """Return True if no motion explains the step between two readings."""
        jump_m_s = abs(sample.speed_m_s - before.speed_m_s)
        by_motion_m_s = MAX_WHEEL_ACCELERATION_M_S2 * seconds(sample.t_ns - before.t_ns)
        return jump_m_s > max(by_motion_m_s, MIN_SPEED_JUMP_M_S)
