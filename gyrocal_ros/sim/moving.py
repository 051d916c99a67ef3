"""Things that move in the images of a ceiling although the robot stands still."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.sim.canvas import LEVELS_PER_GREY, Canvas, Grid, Layer, Motion, cut_out
from gyrocal_ros.sim.image_conditions import ImageConditions

CURTAIN_BELOW_M, FAN_BELOW_M, PERSON_BELOW_M = 0.6, 0.3, 0.85
"""Distances below the ceiling."""


def moving_layers(
    conditions: ImageConditions, rng: np.random.Generator, ceiling_m: float, grid: Grid
) -> list[Layer]:
    """Draw the moving things that the conditions contain.

    Args:
        conditions: conditions of the images.
        rng: generator of places and directions.
        ceiling_m: height of the ceiling.
        grid: resolution of the ceiling.
    """
    return [draw(rng, ceiling_m, grid) for name, draw in MOVING.items() if getattr(conditions, name)]


def sun_patch(rng: np.random.Generator, ceiling_m: float, grid: Grid) -> Layer:
    """Draw the light that the sun casts through a window with bars; it wanders, and trees sway before it."""
    canvas = Canvas(1.4, 1.0, grid, brightness=0.0)
    for x in (-0.29, 0.29):
        for y in (-0.19, 0.19):
            canvas.rectangle(0.5 * canvas.size_m + (x, y), (0.52, 0.34), 0.0, 90.0)
    light = canvas.blurred(LEVELS_PER_GREY)
    angle, (x, y) = rng.uniform(0.0, math.pi), rng.uniform(-1.2, 1.2, 2) - 0.5 * canvas.size_m

    def motion(time_s: float) -> tuple[float, float, float]:
        sway = 0.02 * math.sin(1.9 * time_s) + 0.015 * math.sin(3.1 * time_s + 1.0)
        return 1.2 * math.sin(0.007 * time_s) + sway, 0.5 * sway, angle

    return Layer(ceiling_m, (float(x), float(y)), grid.texel_m, light, np.zeros_like(light), motion=motion)


def curtain(rng: np.random.Generator, ceiling_m: float, grid: Grid) -> Layer:
    """Draw a curtain that waves in the wind of an open window."""
    fine = grid.scaled(1.0 - CURTAIN_BELOW_M / ceiling_m)
    marks, outline = _pair(1.8, 0.7, fine, brightness=120.0)
    for x in np.arange(0.1, 1.7, 0.09):
        marks.rectangle((x, 0.35), (0.045, 0.6), 0.0, rng.uniform(-60.0, 60.0))
    outline.rectangle(0.5 * outline.size_m, (1.7, 0.6), 0.0, 1.0)

    def motion(time_s: float) -> tuple[float, float, float]:
        wave = math.sin(2.0 * time_s) + 0.5 * math.sin(3.3 * time_s)
        return 0.04 * wave, 0.10 * math.sin(1.7 * time_s), 0.08 * wave

    return _moving(ceiling_m - CURTAIN_BELOW_M, rng.uniform(-1.2, 1.2, 2), marks, outline, motion)


def fan(rng: np.random.Generator, ceiling_m: float, grid: Grid) -> Layer:
    """Draw a ceiling fan with four blades at two turns per second."""
    fine = grid.scaled(1.0 - FAN_BELOW_M / ceiling_m)
    marks, outline = _pair(1.4, 1.4, fine, brightness=60.0)
    middle = 0.5 * outline.size_m
    for angle in (0.0, math.pi / 2):
        outline.rectangle(middle, (1.3, 0.14), angle, 1.0)
    outline.disc(middle, 0.12, 1.0)
    outline.texels = np.minimum(outline.texels, 1.0)
    marks.disc(middle, 0.10, 60.0)

    def motion(time_s: float) -> tuple[float, float, float]:
        return 0.0, 0.0, 4.0 * math.pi * time_s

    return _moving(ceiling_m - FAN_BELOW_M, rng.uniform(-1.0, 1.0, 2), marks, outline, motion)


def person(rng: np.random.Generator, ceiling_m: float, grid: Grid) -> Layer:
    """Draw a person seen from below who walks in a circle: shoulders and head."""
    fine = grid.scaled(1.0 - PERSON_BELOW_M / ceiling_m)
    marks, outline = _pair(0.7, 0.5, fine, brightness=45.0)
    middle = 0.5 * outline.size_m
    outline.rectangle(middle, (0.44, 0.22), 0.0, 1.0)
    for x in (-0.22, 0.0, 0.22):
        outline.disc(middle + (x, 0.0), 0.11, 1.0)
    outline.texels = np.minimum(outline.texels, 1.0)
    marks.disc(middle, 0.09, 70.0)
    rate, radius_m = rng.choice([-1.0, 1.0]) * 0.5, rng.uniform(0.8, 1.4)

    def motion(time_s: float) -> tuple[float, float, float]:
        angle = rate * time_s
        return radius_m * math.cos(angle), radius_m * math.sin(angle), angle

    return _moving(ceiling_m - PERSON_BELOW_M, rng.uniform(-0.5, 0.5, 2), marks, outline, motion)


MOVING: dict[str, Callable[[np.random.Generator, float, Grid], Layer]] = {
    'sun_patch': sun_patch,
    'curtain': curtain,
    'fan': fan,
    'person': person,
}
"""Moving things by the names of their fields of `ImageConditions`."""


def _pair(width_m: float, height_m: float, grid: Grid, *, brightness: float) -> tuple[Canvas, Canvas]:
    """Return the canvases of marks and outline."""
    marks, outline = (Canvas(width_m, height_m, grid, brightness=grey) for grey in (brightness, 0.0))
    return marks, outline


def _moving(height_m: float, centre_m: Array, marks: Canvas, outline: Canvas, motion: Motion) -> Layer:
    return replace(cut_out(height_m, centre_m, marks, outline), motion=motion)
