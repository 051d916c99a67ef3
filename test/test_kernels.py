"""Compiled kernels against their NumPy forms, and the choice between them."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import FrozenInstanceError, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contracts import CAMERA, NOISE_PX, eventful_block

from gyrocal_ros import kernels
from gyrocal_ros.cli.main import main
from gyrocal_ros.data import (
    Array,
    CameraIntrinsics,
    ImuSample,
    Mount,
    WheelSample,
    changed,
    quickly_filled,
)
from gyrocal_ros.diagnose.analysis.heading_filter import INITIAL_BIAS_STD_RAD_S
from gyrocal_ros.ekf.equations.effects_by_place import MotionContribution
from gyrocal_ros.ekf.equations.update import Innovation
from gyrocal_ros.ekf.features.robust import CONVERGED, HUBER_BOUND, MAX_INFLATION, MAX_ITERATIONS
from gyrocal_ros.ekf.intervals import PAUSE_NS
from gyrocal_ros.ekf.noise.process_noise import BlockNoise
from gyrocal_ros.ekf.noise.reference_noise import ReferenceNoise
from gyrocal_ros.ekf.state.layout import State, no_landmarks
from gyrocal_ros.ekf.state.normal_equations import NOTHING, normal_equations
from gyrocal_ros.ekf.state.positive_definite import whitener
from gyrocal_ros.ekf.stream import SlamStream  # noqa: F401  (marks all kernels)
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.faulty_readings import MIN_READINGS, UsualReadings
from gyrocal_ros.model.features.base import Anchors, Prediction, posed_camera
from gyrocal_ros.model.gyro import Correction
from gyrocal_ros.model.rotation import rotation_from_euler

Arguments = tuple[Any, ...]
ROUNDING = 1e-12
LENSES = {
    'pinhole': replace(CAMERA, lens='plumb_bob', distortion=(0.0,) * 5),
    'plumb_bob': replace(CAMERA, lens='plumb_bob', distortion=(-0.2, 0.05, 0.001, -0.002, 0.01)),
    'rational': replace(
        CAMERA, lens='rational_polynomial', distortion=(0.1, 0.05, 0.001, -0.002, 0.01, 0.3, 0.02, 0.003)
    ),
    'equidistant': replace(CAMERA, lens='equidistant', distortion=(0.02, -0.01, 0.003, -0.001)),
}


def intervals_s(rng: np.random.Generator, count: int) -> Array:
    return rng.uniform(0.002, 0.012, count)


def carry(rng: np.random.Generator, count: int, eventful: bool = True) -> Arguments:
    """Return arguments of `carry`, with effects on all that moves the robot if the block is eventful."""
    n, k, c = count, 1 + count % 3, count % 4
    size = 9 + k + 3 * count
    mean = np.concatenate([rng.normal(size=3), rng.normal(0.0, [0.1, 0.1, 2.0]), rng.normal(size=size - 6)])
    robot = State(0, mean, covariance(rng, size), k, no_landmarks(), rng.normal(size=(size, c)))
    rates, readings = rng.normal(0.0, [0.1, 0.1, 1.5], (2, n, 3))
    dt_s, of_interval = intervals_s(rng, n), rng.normal(0.002, 0.001, n)
    block = replace(eventful_block(), dt_s=dt_s, rate_rad_s=readings, distance_m=of_interval)
    correction = Correction(rng.normal(size=n), rng.normal(size=(n, k)), 0.0, ())
    added = MotionContribution(correction, 0.0, None, 0.0, None)
    of_wheels = (0.01, 0.02, 0.03, 0.04)
    noise = BlockNoise(np.full(2, 3e-4), 4e-4, 0.0, 0.0, of_wheels, 0.0, 1e-4, 2e-4, np.zeros(k), 0.1)
    if eventful:
        correction = changed(correction, valid=(rng.uniform(size=n) < 0.8).astype(float))
        wheels = 0.1 * of_interval, rng.normal(size=(n, k))
        added = MotionContribution(correction, *wheels, rng.normal(size=3), rng.normal(size=(3, k)))
        of_tilt, of_yaw, walks = (rng.uniform(1e-4, 1e-3, width) for width in (2, n, k))
        noise = BlockNoise(of_tilt, of_yaw, 0.01, 0.02, of_wheels, 0.03, 1e-4, 2e-4, walks, 0.1)
    return robot, block, rates, added, noise, 0.01, 0.99


def step_numbers(rng: np.random.Generator, count: int) -> Arguments:
    robot, block, rates, added, *_ = carry(rng, count)
    states = [replace(robot, mean=rng.normal(size=len(robot.mean))) for _ in range(3)]
    return *states, block.dt_s, added.correction, rates, rng.normal(size=3)


def corrected_rates(rng: np.random.Generator, count: int) -> Arguments:
    valid = (rng.uniform(size=count) < 0.8).astype(float)
    rates, correction, bias = rng.normal(size=(count, 3)), rng.normal(size=count), rng.normal(size=3)
    return rates, correction, valid if count % 2 else 1.0, bias


def path_in_block(rng: np.random.Generator, count: int) -> Arguments:
    return rng.normal(size=9), *way_and_turn(rng, count)


def way_and_turn(rng: np.random.Generator, count: int) -> Arguments:
    return *rate_scatter(rng, count), rng.normal(0.0, 0.01, count)


def mean_at_end(rng: np.random.Generator, count: int) -> Arguments:
    return rng.normal(size=count), intervals_s(rng, count), 0.02


def rate_scatter(rng: np.random.Generator, count: int) -> Arguments:
    return rng.normal(size=(count, 3)), intervals_s(rng, count)


def fading_memory(rng: np.random.Generator, count: int) -> Arguments:
    return rng.normal(size=count), intervals_s(rng, count), rng.uniform(0.1, 40.0, 3), rng.normal(size=3)


def low_pass(rng: np.random.Generator, count: int) -> Arguments:
    return rng.normal(size=(count, 3)), rng.uniform(0.0, 1.0, (count, 3)), rng.normal(size=3)


def imu_samples(rng: np.random.Generator, count: int) -> list[ImuSample]:
    """Return samples, one of them after a pause."""
    gaps_ns = rng.integers(1, 10**7, count)
    gaps_ns[rng.integers(count)] += 2 * PAUSE_NS * rng.integers(2)
    times_ns = (10**18 + gaps_ns.cumsum()).tolist()
    rows = [tuple(row) for row in rng.normal(size=(count, 6)).tolist()]
    return [ImuSample(t_ns, row[:3], row[3:]) for t_ns, row in zip(times_ns, rows, strict=True)]


def intervals(rng: np.random.Generator, count: int) -> Arguments:
    samples = imu_samples(rng, count + 1)
    times_ns = [sample.t_ns for sample in samples]
    low, high = times_ns[0] - 10**6, times_ns[-1] + 10**6
    start_ns, end_ns = sorted(rng.choice([*times_ns, *rng.integers(low, high, 4).tolist()], 2, replace=False))
    _, _, wheels_ns, travelled_m = interpolate(rng, count)
    of_wheels = wheels_ns, travelled_m, travelled_m[::-1]
    return times_ns, samples, int(start_ns), int(end_ns), *rng.normal(size=2).tolist(), *of_wheels


def usual_interval_ns(rng: np.random.Generator, count: int) -> Arguments:
    return [sample.t_ns for sample in imu_samples(rng, count)], 1 + count // 3, 7e6


def pass_usual(rng: np.random.Generator, count: int) -> Arguments:
    """Return arguments of `pass_usual`: among the readings may be a jump, a repeated and an older one."""
    samples = imu_samples(rng, 20 * count)
    rates = rng.normal(0.0, 0.02, (len(samples), 3)).cumsum(axis=0)
    faults = rng.integers(len(samples), size=3)
    rates[faults[0]] += rng.choice([0.0, 3.0])
    if rng.integers(2):
        rates[faults[1]] = rates[faults[1] - 1]
    samples = [replace(it, rate_rad_s=tuple(rate)) for it, rate in zip(samples, rates.tolist(), strict=True)]
    if rng.integers(2):
        samples[faults[2]] = replace(samples[faults[2]], t_ns=samples[0].t_ns)
    seen = int(rng.choice([1, MIN_READINGS, 3 * MIN_READINGS]))
    usual = UsualReadings(samples[0], seen, int(rng.integers(8)), 0.02, float(rng.uniform(0.05, 1.0)))
    return (UsualReadings() if rng.integers(4) == 0 else usual), samples[1:], int(rng.integers(3))


def interpolate(rng: np.random.Generator, count: int) -> Arguments:
    start_ns = 10**18
    offsets_ns = rng.integers(1, 10**7, count).cumsum().astype(float)
    times_ns = (start_ns + rng.integers(-(10**7), 8 * 10**7, count)).tolist()
    return start_ns, offsets_ns, sorted(set(times_ns)), rng.normal(size=len(set(times_ns))).tolist()


def points(rng: np.random.Generator, count: int) -> Array:
    """Return points (count, 3) before the camera, one in its axis and one behind it."""
    points_c = np.column_stack([rng.uniform(-1.0, 1.0, (count, 2)), rng.uniform(0.5, 3.0, count)])
    points_c[0, :2] = 0.0
    points_c[-1, 2] *= -1.0
    return points_c


def project_with_jacobian(
    rng: np.random.Generator, count: int, camera: CameraIntrinsics = CAMERA
) -> Arguments:
    return camera, points(rng, count)


def predict_inverse_depth(
    rng: np.random.Generator, count: int, camera: CameraIntrinsics = CAMERA
) -> Arguments:
    mount = Mount(rotation_from_euler(rng.normal(0.0, 0.1, 3)), rng.normal(0.0, 0.1, 3))
    view = posed_camera(camera, mount, rng.normal(0.0, 0.1, 3), rng.normal(0.0, 0.1, 3))
    parameters = np.column_stack([rng.uniform(-1.0, 1.0, (count, 2)), rng.uniform(0.0, 1.0, count)])
    return view, parameters, anchors(rng, count)


def anchors(rng: np.random.Generator, count: int, widths: tuple[int, int] = (0, 0)) -> Anchors:
    """Return anchors that coefficients of two kinds move, as many as the widths tell."""
    attitudes = np.array([rotation_from_euler(rng.normal(0.0, 0.1, 3)) for _ in range(count)])
    by_effects = (rng.normal(size=(count, 3, width)) for width in widths)
    return Anchors(attitudes, rng.normal(0.0, 0.1, (count, 3)), *by_effects)


def mapped(rng: np.random.Generator, count: int, widths: tuple[int, int, int] = (3, 4, 4)) -> State:
    """Return a state of twice as many features, half of them seen now, and two anchors.

    Its k, width of the candidates that move anchors, and c are given.
    """
    (k, of_candidates, c), m = widths, 2 * count
    size = 9 + k + 3 * m + 6
    landmarks = replace(
        no_landmarks(),
        ids=rng.permutation(3 * m)[:m],
        anchors=anchors(rng, m, (k, of_candidates)),
        anchor_rows=rng.choice([-1, 0, 1], m),
        last_seen_ns=rng.permutation(m) % 2,
    )
    mean = rng.uniform(0.2, 0.6, size)
    return State(1, mean, covariance(rng, size), k, landmarks, rng.normal(size=(size, c)))


def features_seen(rng: np.random.Generator, count: int) -> Arguments:
    return mapped(rng, count), rng.permutation(2 * count)[:count]


def ids_by_way(rng: np.random.Generator, count: int) -> Arguments:
    return mapped(rng, count), rng.normal(size=3), 0.5


def known_anchored(rng: np.random.Generator, count: int) -> Arguments:
    return mapped(rng, count), 2.0


def covariance(rng: np.random.Generator, size: int) -> Array:
    mixing = rng.normal(size=(size, size))
    return mixing @ mixing.T / size + 0.1 * np.eye(size)


def noises(rng: np.random.Generator, count: int, width: int = 2) -> Array:
    return NOISE_PX**2 * np.array([covariance(rng, width) for _ in range(count)])


def innovation_matrices(
    rng: np.random.Generator, count: int, widths: tuple[int, int, int] = (3, 4, 4)
) -> Arguments:
    k, of_candidates, _ = widths
    nothing = np.empty(0)
    by_pose, by_feature = rng.normal(size=(count, 2, 6)), rng.normal(size=(count, 2, 3))
    return (
        mapped(rng, count, widths),
        rng.permutation(2 * count)[:count],
        Prediction(rng.normal(size=(count, 2)), by_pose, by_feature, nothing, nothing, nothing),
        rng.normal(size=(count, 2)),
        noises(rng, count),
        rng.normal(size=(count, 2, k)) if k else None,
        rng.normal(size=(count, 2, of_candidates)) if of_candidates else None,
    )


def innovation(rng: np.random.Generator, count: int, width: int = 2, outliers: int = 1) -> Innovation:
    noise = noises(rng, count, width)
    shared = rng.normal(size=(count * width, 3))
    S = (shared @ shared.T).reshape(count, width, count, width)
    each = np.arange(count)
    S[each, :, each, :] += noise
    residual = rng.normal(0.0, NOISE_PX, (count, width))
    residual[:outliers] += 20.0 * NOISE_PX
    nothing = np.empty((count, 0))
    seen = Prediction(nothing, rng.normal(size=(count, width, 6)), nothing, nothing, nothing, nothing)
    return Innovation(each, residual, seen, nothing, S, noise, 0)


def weigh(rng: np.random.Generator, count: int, width: int = 2, outliers: int = 1) -> Arguments:
    return innovation(rng, count, width, outliers), HUBER_BOUND, MAX_INFLATION, MAX_ITERATIONS, CONVERGED


def weigh_loosely(rng: np.random.Generator, count: int, width: int = 2, outliers: int = 1) -> Arguments:
    seen, *settings = weigh(rng, count, width, outliers)
    return seen, NOISE_PX * rng.uniform(0.0, 3.0, 6), *settings


def looser_pose_gain(rng: np.random.Generator, count: int) -> Arguments:
    return innovation(rng, count), NOISE_PX * rng.uniform(0.0, 3.0, 6), rng.uniform(size=count)


def fit_heading(rng: np.random.Generator, count: int) -> Arguments:
    return innovation(rng, count), 5


def given_others(rng: np.random.Generator, count: int) -> Arguments:
    rows = 1 + count % 3
    return rng.normal(size=(count, rows)), whitener(covariance(rng, rows * count))


def differences(rng: np.random.Generator, count: int) -> Arguments:
    residual, whitening = given_others(rng, count)
    return residual, whitening, rng.normal(size=(*residual.shape, 10))


def products_with_last(rng: np.random.Generator, count: int) -> Arguments:
    last, new = rng.permutation(2 * count)[:count], rng.permutation(2 * count)[:count]
    errors = np.where(rng.uniform(size=(count, 1)) < 0.2, np.nan, rng.normal(size=(count, 2)))
    return new, errors, last, rng.normal(size=(count, 2)), 1.5


def position_score(rng: np.random.Generator, count: int) -> Arguments:
    residual, whitening = given_others(rng, count)
    return rng.normal(size=(*residual.shape, 6)), residual, whitening, 5


def stamp_score(rng: np.random.Generator, count: int) -> Arguments:
    residual, whitening = given_others(rng, count)
    return rng.normal(size=(*residual.shape, 6)), rng.normal(size=6), residual, whitening


def match_ids(rng: np.random.Generator, count: int) -> Arguments:
    return rng.permutation(3 * count)[: 2 * count], rng.permutation(3 * count)[:count]


def of_map(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Return directions and pixels of twice as many features."""
    return rng.normal(size=(2 * count, 2)), rng.uniform(0.0, 640.0, (2 * count, 2))


def motion_in_image(rng: np.random.Generator, count: int) -> Arguments:
    last_directions, last_pixels = of_map(rng, count)
    rows = rng.permutation(2 * count)[:count]
    directions = last_directions[rows] + rng.normal(0.0, 0.002, (count, 2))
    points_c = rng.uniform(-0.1, 1.0, (count, 1)) * np.column_stack([directions, np.ones(count)])
    return points_c, last_pixels[rows] + 1.0, last_directions, last_pixels, rows, 250.0, 1e-3


def matches_counted(rng: np.random.Generator, count: int) -> Arguments:
    last_directions, last_pixels = of_map(rng, count)
    last_seen_ns, rejections = rng.integers(0, 10**18, 2 * count), rng.integers(0, 3, 2 * count)
    rows, accepted = rng.permutation(2 * count)[:count], rng.uniform(size=count) < 0.7
    matched = rng.normal(size=(2, count, 2))
    return last_seen_ns, rejections, last_pixels, last_directions, 2 * 10**18, rows, accepted, *matched


def changed_depths(rng: np.random.Generator, count: int) -> Arguments:
    mean, rows = rng.uniform(0.2, 0.6, 12 + 6 * count), rng.permutation(2 * count)[:count]
    before = mean[14 + 3 * rows] + rng.normal(0.0, 0.01, count)
    return mean, 12, rows, before, rng.uniform(-0.1, 1.0, (count, 3)), 0.005, 0.1


def shared_ways(rng: np.random.Generator, count: int) -> Arguments:
    rows = rng.permutation(2 * count)[:count]
    return mapped(rng, count), rows, rng.normal(size=count), rng.normal(size=3), 0.3


def compared_depths(rng: np.random.Generator, count: int) -> Arguments:
    state = mapped(rng, count)
    known = rng.permutation(np.concatenate([state.landmarks.ids, 6 * count + np.arange(count)]))[:count]
    known_variances = rng.uniform(0.5, 8.0, count)
    return known, rng.uniform(0.2, 0.6, count), known_variances, state, 0.5, 8.0


def shift(rng: np.random.Generator, count: int) -> Arguments:
    n = 12 + 6 * count
    places = np.sort(rng.permutation(np.arange(12, n))[: 2 * count])
    causes = np.array([0, 1, 2, 3, 4, 5, 9, 10])
    return covariance(rng, n), rng.normal(size=(n, count)), places, causes, rng.normal(size=(2 * count, 8))


def scale_changes(
    rng: np.random.Generator, count: int, others_explained: float = 100.0, others: int = 4
) -> Arguments:
    sums = rng.uniform(0.0, 100.0, (count, 4 + others))
    sums[:, 4:] = 0.1 * np.sqrt(sums[:, :1]) * rng.normal(size=(count, others))
    matrix, direction = covariance(rng, others), rng.normal(size=others)
    if others:
        direction *= math.sqrt(others_explained / (direction @ np.linalg.solve(matrix, direction)))
    start = others // 2
    group = normal_equations(matrix[start:, start:], direction[start:])
    return sums, group, start, 2e4, 0.2


def equations_added(rng: np.random.Generator, count: int) -> Arguments:
    sums = normal_equations(covariance(rng, count), rng.normal(size=count))
    return sums, covariance(rng, count + 5), rng.normal(size=count + 5), 2


def scores_added(rng: np.random.Generator, count: int) -> Arguments:
    others = count % 3
    c = count + others + 2
    sums = rng.uniform(0.0, 100.0, (count, 4 + others))
    return sums, covariance(rng, c), rng.normal(size=c), 20.0, 30, others + 2


def scores_weighted(rng: np.random.Generator, count: int) -> Arguments:
    return covariance(rng, count), rng.normal(size=count), rng.integers(2, size=count).astype(float)


def variances_grown(rng: np.random.Generator, count: int) -> Arguments:
    places = np.sort(rng.choice(2 * count, count, replace=False))
    grown, before = rng.uniform(0.0, 3.0, (2, count))
    return grown, before, covariance(rng, 2 * count), places


def filter_headings(rng: np.random.Generator, count: int, jump_rad: float = 0.0) -> Arguments:
    n, m = 200, count
    white, walk = np.exp(rng.uniform(-9.0, -4.0, (2, m)))
    noise = ReferenceNoise(white, walk, rng.uniform(3.0, 30.0, m), rng.uniform(0.0, 0.01, m))
    dt_s, rates = rng.uniform(0.02, 0.1, n), rng.normal(0.0, 0.5, n)
    differences = rng.normal(0.0, 0.01, n) + jump_rad * (np.arange(n) > n // 2)
    rest_s, rest_turn_rad = dt_s * (np.arange(n) % 50 < 20), rng.normal(0.0, 1e-3, n)
    rests = rest_s, rest_turn_rad + 0.1 * (np.arange(n) == 10), 3e-3 * np.sqrt(dt_s)
    headings = np.column_stack([dt_s, rates * dt_s, 0.1 * dt_s, rates, differences, *rests])
    state = rng.normal(0.0, 0.01, (m, 4)), np.array([0.1 * covariance(rng, 4) for _ in range(m)])
    return *state, *np.zeros((2, m)), np.zeros(m, int), *np.zeros((2, m)), noise, 1e-9, 0.5, headings


def compare_headings(rng: np.random.Generator, count: int) -> Arguments:
    """Return headings with gaps and outliers; nothing is seen in the first steps."""
    n = 200
    measured = rng.normal(0.0, 0.01, n) + rng.normal(0.0, 0.001, n).cumsum()
    measured[::17] += 1.0
    measured[[0, 1, *range(50, 60), *range(7, n, 13)]] = np.nan
    noise, away_walk, bias_walk = 10.0 ** rng.uniform(-8.0, -4.0, (3, n))
    valid_s = np.where(rng.uniform(size=n) < 0.9, 0.05, 0.0)
    start = INITIAL_BIAS_STD_RAD_S**2
    return measured, noise, valid_s, away_walk, start, bias_walk, 3.0, rng.normal(0.0, 0.1, (n, count - 1))


def euler_angles(rng: np.random.Generator, count: int) -> Arguments:
    return (rng.normal(size=3),)


def undistort_brown(rng: np.random.Generator, count: int, camera: CameraIntrinsics = CAMERA) -> Arguments:
    return camera, rng.uniform(-0.5, 0.5, (count, 2)), 20, 1e-5


def pixels_by_radial_coefficients(
    rng: np.random.Generator, count: int, camera: CameraIntrinsics = CAMERA
) -> Arguments:
    return camera, points(rng, count)


def pixels_by_tilt(rng: np.random.Generator, count: int) -> Arguments:
    return points(rng, count), rng.normal(size=(count, 2, 3)), float(rng.normal())


def corrected(rng: np.random.Generator, count: int) -> Arguments:
    n, c = 3 * count, count % 3
    mean, before, sensitivity = rng.normal(size=n), covariance(rng, n), rng.normal(size=(n, c))
    whitened = rng.normal(size=(2 * count, n + 1 + c))
    products = whitened[:, :n].T @ whitened
    return mean, before, sensitivity, whitened, products, covariance(rng, 2 * count)


def solve(rng: np.random.Generator, count: int) -> Arguments:
    return covariance(rng, count), rng.normal(size=count)


def learned_noise(rng: np.random.Generator, count: int) -> Arguments:
    of_map = rng.uniform(0.0, 100.0, (2, 2 * count))
    rows = rng.permutation(2 * count)[:count]
    return (
        *of_map,
        rows,
        rng.uniform(0.0, 50.0, count),
        rng.uniform(0.1, 1.0, count),
        20.0,
        0.3,
        10.0,
        0.99,
        2.0,
    )


def scaled_noise(rng: np.random.Generator, count: int) -> Arguments:
    weights, sums, rows, *_ = learned_noise(rng, count)
    return noises(rng, count), weights, sums, rows, 20.0, 0.3


def turned_camera(rng: np.random.Generator, count: int) -> Arguments:
    position, euler, lever = rng.normal(size=(3, 3))
    return position, euler, rotation_from_euler(rng.normal(size=3)), lever


def pixels_by_delay(rng: np.random.Generator, count: int) -> Arguments:
    by_pose, pixels = rng.normal(size=(count, 2, 6)), rng.uniform(0.0, 480.0, (count, 2))
    return by_pose, pixels, *rng.normal(size=(2, 6)), float(rng.normal(scale=0.03)), 480


def side_by_side(rng: np.random.Generator, count: int) -> Arguments:
    widths = [1, 3, 2]
    starts = [0, 4, 7]
    return [rng.normal(size=(count, 2, width)) for width in widths], starts, 9


def hardly_known(rng: np.random.Generator, count: int) -> Arguments:
    state, rows, *_ = shared_ways(rng, count)
    variances = state.covariance.diagonal()[state.robot_size : state.anchors_start]
    return state, rows, float(np.sqrt(np.median(variances)))


def noise_dominated(rng: np.random.Generator, count: int) -> Arguments:
    return *rng.uniform(0.0, 1.0, (2, count)), rng.uniform(size=count) < 0.3, 0.5


def cosines(rng: np.random.Generator, count: int) -> Arguments:
    values = np.where(rng.uniform(size=count) < 0.2, np.nan, rng.uniform(-1.5, 1.5, count))
    return values, -1.0, 1.2, rng.normal(size=(1 + count % 2, 8))


def gained(rng: np.random.Generator, count: int) -> Arguments:
    parts = [rng.normal(size=(count, 2)), rng.normal(size=(3, count)).T, rng.normal(size=(count, 4))[:, 2:3]]
    return rng.normal(size=(6, count)), parts, [0, 3, 6], 8


def split_by_feature(rng: np.random.Generator, count: int) -> Arguments:
    whitening, both = whitener(covariance(rng, 2 * count)), rng.normal(size=(count, 2, 1 + count % 4))
    return both, rng.normal(size=(2 * count, both.shape[2])), whitening


Maker = Callable[[np.random.Generator, int], Arguments]
MAKERS: tuple[Maker, ...] = (
    carry,
    changed_depths,
    compared_depths,
    compare_headings,
    corrected,
    corrected_rates,
    differences,
    cosines,
    equations_added,
    fading_memory,
    features_seen,
    filter_headings,
    fit_heading,
    gained,
    given_others,
    hardly_known,
    ids_by_way,
    innovation_matrices,
    interpolate,
    intervals,
    known_anchored,
    learned_noise,
    looser_pose_gain,
    low_pass,
    match_ids,
    matches_counted,
    mean_at_end,
    motion_in_image,
    noise_dominated,
    pass_usual,
    path_in_block,
    pixels_by_delay,
    pixels_by_radial_coefficients,
    pixels_by_tilt,
    position_score,
    products_with_last,
    predict_inverse_depth,
    project_with_jacobian,
    rate_scatter,
    scale_changes,
    scaled_noise,
    scores_added,
    scores_weighted,
    shared_ways,
    shift,
    side_by_side,
    solve,
    split_by_feature,
    stamp_score,
    step_numbers,
    turned_camera,
    undistort_brown,
    usual_interval_ns,
    variances_grown,
    way_and_turn,
    weigh,
    weigh_loosely,
)
ARGUMENTS: dict[str, Maker] = {make.__name__: make for make in MAKERS}
ARGUMENTS |= {
    'whitener': lambda rng, count: (covariance(rng, 2 * count),),
    'rotation_from_euler': euler_angles,
    'rotation_derivatives': euler_angles,
}
needs_kernels = pytest.mark.skipif(not kernels.TWINS, reason='the compiled kernels were not built')
FORMS = [
    pytest.param(kernels.REFERENCES, id='numpy'),
    pytest.param(kernels.TWINS, id='compiled', marks=needs_kernels),
]


def assert_equal_to_rounding(name: str, arguments: Arguments) -> None:
    """Compare all results of a twin with those of its NumPy form, relative to the largest of each."""
    twin, reference = kernels.TWINS[name](*arguments), kernels.REFERENCES[name](*arguments)
    one = isinstance(reference, tuple)
    for mine, expected in zip(twin if one else (twin,), reference if one else (reference,), strict=True):
        size = max(float(np.abs(np.nan_to_num(expected)).max(initial=0.0)), np.finfo(float).tiny)
        np.testing.assert_allclose(mine, expected, rtol=0.0, atol=ROUNDING * size)
        assert np.shape(mine) == np.shape(expected)


def test_every_kernel_is_compared() -> None:
    compared = {*ARGUMENTS, changed.__name__, quickly_filled.__name__}
    assert set(kernels.REFERENCES) == compared
    if kernels.TWINS:
        assert set(kernels.TWINS) == compared


@needs_kernels
@pytest.mark.parametrize('count', [1, 2, 3, 15, 40])
@pytest.mark.parametrize('name', ARGUMENTS)
def test_twins_agree_with_numpy(name: str, count: int) -> None:
    for seed in range(10):
        assert_equal_to_rounding(name, ARGUMENTS[name](np.random.default_rng(seed), count))


@needs_kernels
@pytest.mark.parametrize('lens', LENSES)
def test_twins_agree_behind_every_lens(lens: str) -> None:
    rng = np.random.default_rng(1)
    assert_equal_to_rounding('project_with_jacobian', (LENSES[lens], points(rng, 20)[:-1]))
    assert_equal_to_rounding('predict_inverse_depth', predict_inverse_depth(rng, 20, LENSES[lens]))
    if lens != 'equidistant':
        assert_equal_to_rounding('undistort_brown', undistort_brown(rng, 20, LENSES[lens]))
    by_radial = pixels_by_radial_coefficients(rng, 20, LENSES[lens])
    assert_equal_to_rounding('pixels_by_radial_coefficients', by_radial)


@needs_kernels
@pytest.mark.parametrize('count', [1, 2, 12])
def test_a_block_in_which_nothing_happens(count: int) -> None:
    assert_equal_to_rounding('carry', carry(np.random.default_rng(5), count, eventful=False))


@needs_kernels
@pytest.mark.parametrize('widths', [(0, 0, 0), (2, 0, 0), (0, 5, 5), (2, 0, 5)])
def test_innovations_without_coefficients_or_candidates(widths: tuple[int, int, int]) -> None:
    assert_equal_to_rounding('innovation_matrices', innovation_matrices(np.random.default_rng(2), 7, widths))


@needs_kernels
@pytest.mark.parametrize(('width', 'outliers'), [(2, 0), (2, 4), (3, 0), (3, 2)])
def test_weights_of_pixels_and_of_points(width: int, outliers: int) -> None:
    for seed in range(10):
        for make in (weigh, weigh_loosely):
            arguments = make(np.random.default_rng(seed), 9, width, outliers)
            assert_equal_to_rounding(make.__name__, arguments)


@needs_kernels
@pytest.mark.parametrize('others_explained', [0.0, 1e6])
def test_changes_of_the_scale_with_and_without_other_errors(others_explained: float) -> None:
    assert_equal_to_rounding('scale_changes', scale_changes(np.random.default_rng(3), 6, others_explained))
    sums, _, *settings = scale_changes(np.random.default_rng(4), 6, others=0)
    assert_equal_to_rounding('scale_changes', (sums, NOTHING, *settings))


@pytest.mark.parametrize('forms', FORMS)
def test_a_change_of_which_nothing_is_known(forms: dict[str, Callable[..., Any]]) -> None:
    sums = np.array([[0.0, 0.0, 9.0, 1.0], [0.0, 0.0, 0.0, 1.0]])
    values, variances, sigmas = forms['scale_changes'](sums, NOTHING, 0, 1.0, 1.0)
    assert not values.any() and not sigmas.any() and (variances > 1e300).all()


@needs_kernels
def test_headings_that_jump() -> None:
    arguments = filter_headings(np.random.default_rng(5), 9, jump_rad=1.0)
    assert kernels.REFERENCES['filter_headings'](*arguments)[-1].any()
    assert_equal_to_rounding('filter_headings', arguments)


@pytest.mark.parametrize('forms', FORMS)
@pytest.mark.parametrize('shape', [(4, 2), (6, 2), (5, 3)])
def test_columns_of_another_shape_are_refused(
    shape: tuple[int, int], forms: dict[str, Callable[..., Any]]
) -> None:
    """A user's effect may return them: for other samples, or for more coefficients than it has."""
    assert forms['gained'](np.ones((6, 5)), [np.ones((5, 2))], [6], 8)[:, 6:].all()
    with pytest.raises(ValueError, match='shape|dimension|broadcast'):
        forms['gained'](np.ones((6, 5)), [np.ones(shape)], [6], 8)


@pytest.mark.parametrize('forms', FORMS)
def test_a_changed_copy(forms: dict[str, Callable[..., Any]]) -> None:
    sample = WheelSample(5, 0.3, 0.1)
    assert forms['changed'](sample, speed_m_s=0.4) == WheelSample(5, 0.4, 0.1)
    assert sample == WheelSample(5, 0.3, 0.1)
    with pytest.raises(TypeError):
        forms['changed'](sample, speed=0.4)


@pytest.mark.parametrize('forms', FORMS)
def test_records_that_are_filled(forms: dict[str, Callable[..., Any]]) -> None:
    @dataclass(frozen=True, slots=True)
    class Record:
        first: int
        second: float = 2.0
        others: list[int] = field(default_factory=list)

    filled = forms['quickly_filled'](Record)
    for record in (filled(1), filled(first=1), filled(1, 2.0, []), filled(1, others=[])):
        assert (record.first, record.second, record.others) == (1, 2.0, [])
    assert filled(1) == filled(1) != filled(2)
    assert filled(1).others is not filled(1).others
    for arguments, names in (((), {}), ((1, 2.0, [], 4), {}), ((1,), {'third': 3}), ((1,), {'first': 1})):
        with pytest.raises(TypeError):
            filled(*arguments, **names)
    with pytest.raises(FrozenInstanceError):
        filled(1).first = 2


@pytest.mark.parametrize('forms', FORMS)
def test_an_indefinite_covariance_is_an_error(forms: dict[str, Callable[..., Any]]) -> None:
    bad = innovation(np.random.default_rng(3), 5)
    bad = replace(bad, covariance=-bad.covariance)
    with pytest.raises(FilterDivergedError):
        forms['weigh'](bad, HUBER_BOUND, MAX_INFLATION, MAX_ITERATIONS, CONVERGED)
    with pytest.raises(FilterDivergedError):
        forms['weigh_loosely'](bad, np.ones(6), HUBER_BOUND, MAX_INFLATION, MAX_ITERATIONS, CONVERGED)


def test_both_forms_calibrate_alike(tmp_path: Path) -> None:
    gyrocal = [sys.executable, '-m', 'gyrocal_ros.cli.main']
    bag = str(tmp_path / 'bag')
    assert main(['simulate', bag, '--duration', '20', '--seed', '3']) == 0

    def replayed(**choice: str) -> dict[str, Any]:
        environment = os.environ | choice
        done = subprocess.run(
            [*gyrocal, 'replay', bag, '--json'], env=environment, capture_output=True, check=True
        )
        return json.loads(done.stdout)

    by_default, by_numpy = replayed(), replayed(**{kernels.CHOICE: 'numpy'})
    assert by_numpy['kernels'] == 'numpy'
    assert by_default['kernels'] == kernels.IN_USE
    for key in ('scale_factor', 'scale_factor_std', 'bias', 'bias_std', 'nis_per_dof'):
        assert by_default[key] == pytest.approx(by_numpy[key], rel=1e-8, abs=1e-12), key
