"""Accuracy of the tracker alone: the turn of its tracks compared with the true turn.

A tracker whose turns are too short by a fraction makes the gyro's scale factor wrong by the same fraction,
and no filter can detect that. Therefore it is measured separately, at each rate.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.bench.track_errors import TrackErrors, track_errors, track_row
from gyrocal_ros.config.sections import TrackerConfig
from gyrocal_ros.data import (
    Array,
    CameraIntrinsics,
    FeatureObservations,
    Frame,
    SearchRegions,
    nanoseconds,
    seconds,
)
from gyrocal_ros.model.camera import bearing, project
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.sim.render import CeilingRenderer, ceiling_renderer
from gyrocal_ros.vision.tracker import Tracker

CAMERA = CameraIntrinsics(640, 480, 250.0, 250.0, 320.0, 240.0, (-0.05, 0.01, 5e-4, -3e-4, 0.0))
CEILING_M = 2.5
CAMERA_M = 0.1
RATES_DEG_S = (10.0, 20.0, 40.0, 60.0, 80.0, 100.0)
CORNER_PX = 400.0
"""Distance of the corners of the image from its centre."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Conditions that make tracking difficult."""

    frames_per_s: float = 10.0
    frames: int = 60
    speed_m_s: float = 0.3
    attitude_error: float = 0.08
    """Fraction by which the turns of the attitudes for the tracker are too small."""
    exposure_s: float = 0.008
    """Exposure time, in which the motion blurs the image."""
    exposure_swing: float = 0.2
    """Amplitude of the variation of brightness, relative; its period is 7 s."""


def tracker_accuracy(
    seeds: int, rates_deg_s: Sequence[float] = RATES_DEG_S, conditions: Conditions = Conditions()
) -> Iterator[dict[str, Any]]:
    """Track rendered images of a turning and driving camera; yield one row per rate.

    turn_error_percent: relative error of the turn of the tracks, mean over the seeds.
    turn_error_max_percent: the same for the worst seed.
    rms_px, white_px, slow_px, slow_5_px, slow_95_px: errors of whole tracks, see `track_errors`.
    features: number of observed features per frame.
    frame_ms: processing time of the tracker per frame.
    """
    renderers = [
        ceiling_renderer(CAMERA, seed, ceiling_height_m=CEILING_M, objects=0) for seed in range(seeds)
    ]
    for rate_deg_s in rates_deg_s:
        drives = [_Drive(math.radians(rate_deg_s), conditions) for _ in renderers]
        for seed, (drive, renderer) in enumerate(zip(drives, renderers, strict=True)):
            _track(drive, renderer, np.random.default_rng(seed))
        errors = np.array([_turn(drive) / drive.yaw(drive.end_s) - 1.0 for drive in drives])
        errors_px = track_row([_track_errors(drive) for drive in drives])
        yield {
            'rate_deg_s': rate_deg_s,
            'turn_error_percent': 100.0 * float(errors.mean()),
            'turn_error_max_percent': 100.0 * float(np.abs(errors).max()),
            'features': float(np.mean([len(seen.ids) for drive in drives for seen in drive.seen])),
            'frame_ms': 1e3 * float(np.mean([drive.spent_s for drive in drives])) / conditions.frames,
        } | errors_px


@dataclass(slots=True)
class _Drive:
    """A camera that turns at a constant rate and drives straight below a flat ceiling."""

    rate_rad_s: float
    conditions: Conditions
    seen: list[FeatureObservations] = field(default_factory=list)
    points_w: dict[int, Array] = field(default_factory=dict)
    """Point of the ceiling at which each feature was first observed."""
    spent_s: float = 0.0

    @property
    def end_s(self) -> float:
        """Time of the last frame."""
        return (self.conditions.frames - 1) / self.conditions.frames_per_s

    def yaw(self, t_s: float) -> float:
        """Return the true yaw."""
        return self.rate_rad_s * t_s

    def pose(self, t_s: float) -> tuple[Array, Array]:
        """Return the true attitude (3, 3) and position (3,)."""
        return _attitude(self.yaw(t_s)), np.array([self.conditions.speed_m_s * t_s, 0.0, CAMERA_M])

    def image(self, renderer: CeilingRenderer, t_s: float, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Render the image of the camera at a time."""
        exposure_s = self.conditions.exposure_s
        steps = 1 + math.ceil(CORNER_PX * self.rate_rad_s * exposure_s)  # a pixel each
        moments = t_s + exposure_s * ((np.arange(steps) + 0.5) / steps - 0.5)
        exposure = 1.0 + self.conditions.exposure_swing * math.sin(0.9 * t_s)
        poses = [self.pose(moment) for moment in moments]
        return renderer.render(*self.pose(t_s), exposure=exposure, blur=poses, rng=rng)

    def on_ceiling(self, t_s: float, pixels: Array) -> Array:
        """Return the true points (n, 3) of the ceiling at pixels."""
        R_wc, p_wc = self.pose(t_s)
        rays_w = np.column_stack([bearing(CAMERA, pixels), np.ones(len(pixels))]) @ R_wc.T
        return p_wc + rays_w * ((CEILING_M - p_wc[2]) / rays_w[:, 2:])

    def regions(self, t_s: float) -> SearchRegions:
        """Return the search regions of a filter without errors, except for the turn since the last frame."""
        error_rad = self.conditions.attitude_error * self.rate_rad_s / self.conditions.frames_per_s
        R_wc, p_wc = self.pose(t_s)
        ids = np.array(list(self.points_w), dtype=np.int64)
        points_w = np.array(list(self.points_w.values())).reshape(-1, 3)
        points_c = (points_w - p_wc) @ R_wc @ _attitude(error_rad)
        std_px = 0.5 + CORNER_PX * error_rad
        covariances = np.tile(std_px**2 * np.eye(2), (len(ids), 1, 1))
        ahead = points_c[:, 2] > 0.0
        return SearchRegions(
            nanoseconds(t_s), ids[ahead], project(CAMERA, points_c[ahead]), covariances[ahead]
        )


def _attitude(yaw_rad: float) -> Array:
    return rotation_from_euler(np.array([0.0, 0.0, yaw_rad]))


def _track(drive: _Drive, renderer: CeilingRenderer, rng: np.random.Generator) -> None:
    """Run a tracker over the whole drive."""
    tracker = Tracker(CAMERA, TrackerConfig())
    for t_s in np.arange(drive.conditions.frames) / drive.conditions.frames_per_s:
        frame = Frame(nanoseconds(t_s), drive.image(renderer, t_s, rng))
        R_wc = _attitude((1.0 - drive.conditions.attitude_error) * drive.yaw(t_s))
        regions = drive.regions(t_s)
        start_s = time.process_time()
        drive.seen.append(tracker.track(frame, R_wc, regions))
        drive.spent_s += time.process_time() - start_s
        points_w = drive.on_ceiling(t_s, drive.seen[-1].pixels)
        for id_, point_w in zip(drive.seen[-1].ids.tolist(), points_w, strict=True):
            drive.points_w.setdefault(id_, point_w)


def _turn(drive: _Drive) -> float:
    """Return the turn over the drive, summed over the rotations that fit the tracks from frame to frame."""
    turn = 0.0
    for before, after in zip(drive.seen, drive.seen[1:], strict=False):
        _, first, second = np.intersect1d(before.ids, after.ids, return_indices=True)
        a, b = bearing(CAMERA, before.pixels[first]), bearing(CAMERA, after.pixels[second])
        a, b = a - a.mean(axis=0), b - b.mean(axis=0)
        turn -= math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    return turn


def _track_errors(drive: _Drive) -> TrackErrors:
    """Return the errors of the tracks with the true poses."""
    R_wc, p_wc = zip(*(drive.pose(seconds(seen.t_ns)) for seen in drive.seen), strict=True)
    return track_errors(CAMERA, drive.seen, np.array(R_wc), np.array(p_wc))
