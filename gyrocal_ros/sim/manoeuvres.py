"""Motion of a cleaning robot as sequences of legs: lanes, turns, spins, arcs along walls, rests."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.sim.trajectory import Leg, Trajectory

ACCELERATION_M_S2 = 0.5
ANGULAR_ACCELERATION_RAD_S2 = 5.0

Pose = tuple[float, float, float]
Manoeuvre = tuple[Leg, ...]


@dataclass(frozen=True, slots=True)
class DrivingStyle:
    """Speeds, turn rates and area of a robot."""

    speed_m_s: float = 0.3
    turn_rates_deg_s: tuple[float, float] = (30.0, 90.0)
    """Range from which the rate of each turn is drawn."""
    area_m: tuple[float, float] = (4.0, 3.6)
    """Length and width of the cleaned area, around the origin."""
    lane_width_m: float = 0.3


# --- single manoeuvres --------------------------------------------------------------------------


def rest(duration_s: float) -> Manoeuvre:
    """Stand still."""
    return (Leg(duration_s),)


def drive(distance_m: float, speed_m_s: float) -> Manoeuvre:
    """Drive straight, from rest to rest."""
    # A ramp with peak acceleration a takes 1.5 v / a and covers half the distance of full speed.
    peak = min(speed_m_s, math.sqrt(distance_m * ACCELERATION_M_S2 / 1.5))
    return _trapezium(distance_m, peak, ACCELERATION_M_S2, lambda v: (v, 0.0))


def turn(angle_rad: float, rate_rad_s: float) -> Manoeuvre:
    """Turn on the spot, from rest to rest; a positive angle is to the left."""
    angle, sign = abs(angle_rad), math.copysign(1.0, angle_rad)
    peak = min(rate_rad_s, math.sqrt(angle * ANGULAR_ACCELERATION_RAD_S2 / 1.5))
    return _trapezium(angle, peak, ANGULAR_ACCELERATION_RAD_S2, lambda w: (0.0, sign * w))


def arc(angle_rad: float, radius_m: float, rate_rad_s: float) -> Manoeuvre:
    """Drive an arc of the given radius, from rest to rest."""
    angle, sign = abs(angle_rad), math.copysign(1.0, angle_rad)
    limit = min(ANGULAR_ACCELERATION_RAD_S2, ACCELERATION_M_S2 / radius_m)
    peak = min(rate_rad_s, math.sqrt(angle * limit / 1.5))
    return _trapezium(angle, peak, limit, lambda w: (radius_m * w, sign * w))


def _trapezium(
    amount: float, peak: float, limit: float, split: Callable[[float], tuple[float, float]]
) -> Manoeuvre:
    """Ramp up to the peak rate, hold it and ramp down, with the integral `amount`."""
    ramp_s = 1.5 * peak / limit
    hold_s = amount / peak - ramp_s
    hold = (Leg(hold_s, *split(peak)),) if hold_s > 1e-9 else ()
    return (Leg(ramp_s, *split(peak)), *hold, Leg(ramp_s))


# --- plans: infinite sequences of manoeuvres ----------------------------------------------------


class Planner:
    """Concatenates manoeuvres and tracks the pose of the robot after each of them."""

    def __init__(self, style: DrivingStyle, rng: np.random.Generator, pose: Pose) -> None:
        self.style, self.rng, self.pose = style, rng, pose
        self._lane_direction = 1.0

    def execute(self, manoeuvre: Manoeuvre) -> Manoeuvre:
        """Advance the pose by a manoeuvre, and return the manoeuvre."""
        self.pose = Trajectory(manoeuvre, start=self.pose).end
        return manoeuvre

    def turn_rate(self) -> float:
        """Draw the rate of a turn, rad/s."""
        return math.radians(self.rng.uniform(*self.style.turn_rates_deg_s))

    def turn_to(self, yaw_rad: float) -> Manoeuvre:
        """Turn to a heading in the shorter direction."""
        angle = math.remainder(yaw_rad - self.pose[2], 2.0 * math.pi)
        return self.execute(turn(angle, self.turn_rate())) if abs(angle) > 1e-6 else ()

    def lane(self) -> Manoeuvre:
        """Drive to the end of the lane."""
        x, _, yaw = self.pose
        distance = self.style.area_m[0] / 2.0 - x * math.copysign(1.0, math.cos(yaw))
        return self.execute(drive(max(distance, 0.05), self.style.speed_m_s))

    def change_lane(self) -> Iterator[Manoeuvre]:
        """Move to the next lane and reverse the heading by two turns."""
        _, y, yaw = self.pose
        step = self.style.lane_width_m
        if y * self._lane_direction + step > self.style.area_m[1] / 2.0:
            self._lane_direction = -self._lane_direction
        back = math.pi if math.cos(yaw) > 0.0 else 0.0
        yield self.turn_to(self._lane_direction * math.pi / 2.0)
        yield self.execute(drive(step, self.style.speed_m_s))
        yield self.turn_to(back)

    def change_lane_by_arc(self) -> Iterator[Manoeuvre]:
        """Move to the next lane by one half circle."""
        _, y, yaw = self.pose
        radius = self.style.lane_width_m / 2.0
        if y * self._lane_direction + 2.0 * radius > self.style.area_m[1] / 2.0:
            self._lane_direction = -self._lane_direction
        left = self._lane_direction * math.copysign(1.0, math.cos(yaw))
        yield self.execute(arc(left * math.pi, radius, self.turn_rate()))

    def spin(self) -> Manoeuvre:
        """Turn once by 360 degrees on the spot."""
        sign = self.rng.choice([-1.0, 1.0])
        return self.execute(turn(sign * 2.0 * math.pi, self.turn_rate()))

    def avoid_obstacle(self) -> Iterator[Manoeuvre]:
        """Drive around an obstacle: out to one side and back to the lane."""
        sign = self.rng.choice([-1.0, 1.0])
        angle, radius = math.radians(self.rng.uniform(30.0, 60.0)), self.rng.uniform(0.25, 0.5)
        rate = min(self.turn_rate(), self.style.speed_m_s / radius)
        for share in (1.0, -2.0, 1.0):
            yield self.execute(arc(sign * share * angle, radius, rate))


def lanes(planner: Planner) -> Iterator[Manoeuvre]:
    """Drive parallel lanes, with two turns to one side, then two to the other."""
    while True:
        yield planner.lane()
        yield from planner.change_lane()


def cleaning(planner: Planner) -> Iterator[Manoeuvre]:
    """Drive lanes with various turns, and occasional half circles, spins and obstacles."""
    while True:
        is_long = planner.style.area_m[0] > 3.0
        if is_long and planner.rng.random() < 0.25:
            yield planner.execute(drive(planner.rng.uniform(0.3, 0.8), planner.style.speed_m_s))
            yield from planner.avoid_obstacle()
        yield planner.lane()
        if planner.rng.random() < 0.2:
            yield planner.spin()
        yield from planner.change_lane_by_arc() if planner.rng.random() < 0.25 else planner.change_lane()


def rest_and_go(planner: Planner) -> Iterator[Manoeuvre]:
    """Drive lanes with a rest after most of them."""
    for number, manoeuvre in enumerate(lanes(planner)):
        yield manoeuvre
        if number % 3 == 2:
            yield rest(planner.rng.uniform(2.0, 8.0))


def spins(planner: Planner) -> Iterator[Manoeuvre]:
    """Turn ten times to one side, rest, turn ten times to the other, and so on."""
    sign = planner.rng.choice([-1.0, 1.0])
    while True:
        yield planner.execute(turn(sign * 20.0 * math.pi, planner.turn_rate()))
        yield rest(2.0)
        sign = -sign


def standing(planner: Planner) -> Iterator[Manoeuvre]:
    """Stand still."""
    while True:
        yield rest(60.0)


PLANS: dict[str, Callable[[Planner], Iterator[Manoeuvre]]] = {
    plan.__name__: plan for plan in (lanes, cleaning, rest_and_go, spins, standing)
}


def plan_legs(
    stages: tuple[tuple[str, float], ...],
    standing_s: float,
    duration_s: float,
    style: DrivingStyle,
    rng: np.random.Generator,
) -> tuple[list[Leg], Pose]:
    """Return the legs of a whole recording and its start pose.

    Args:
        stages: names of plans and the time until which each is followed; the last one continues to the
            end.
        standing_s: rest before the first motion.
        duration_s: minimum duration of the legs.
        style: speeds, turn rates and area.
        rng: generator for turn rates and the choice of manoeuvres.
    """
    start: Pose = (-style.area_m[0] / 2.0, -style.area_m[1] / 2.0, 0.0)
    planner = Planner(style, rng, start)
    legs = [Leg(standing_s)] if standing_s > 0.0 else []
    time_s = standing_s
    for number, (name, until_s) in enumerate(stages):
        last = number == len(stages) - 1
        end_s = duration_s if last else min(until_s, duration_s)
        for manoeuvre in PLANS[name](planner):
            legs.extend(manoeuvre)
            time_s += sum(leg.duration_s for leg in manoeuvre)
            if time_s >= end_s:
                break
    return [*legs, Leg(1.0)], start


def repeated_legs(legs: tuple[Leg, ...], standing_s: float, duration_s: float) -> tuple[list[Leg], Pose]:
    """Return a rest followed by as many repetitions of the legs as needed, and the start pose."""
    repetitions = math.ceil(max(duration_s - standing_s, 0.0) / sum(leg.duration_s for leg in legs))
    return [Leg(standing_s), *legs * repetitions], (0.0, 0.0, 0.0)
