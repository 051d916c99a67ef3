"""Which figures show which results of `gyrocal reproduce`, and what stands below them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from gyrocal_ros.bench.paper.at_rest import AtRest
from gyrocal_ros.bench.paper.catalogue import EXPERIMENTS, PaperResult
from gyrocal_ros.bench.paper.convergence import ConvergenceFigure
from gyrocal_ros.bench.paper.experiment import TRUE_VOLT
from gyrocal_ros.bench.paper.landmark import LandmarkErrors
from gyrocal_ros.bench.paper.mapping import FeatureMap
from gyrocal_ros.bench.paper.rate_table import RateTable
from gyrocal_ros.bench.paper.tracks import Tracks
from gyrocal_ros.bench.paper.without_camera import (
    PAPER_CALIBRATED_DEG,
    PAPER_NOMINAL_DEG,
    HeadingTable,
    Histograms,
)
from gyrocal_ros.report import paper as figures
from gyrocal_ros.report.html import Section
from gyrocal_ros.report.paper import Part, paper_page

PAPER_MEAN_SD_DEG = (-0.18, 0.91)
"""Fig. 11 of the paper, calibrated."""


def page(results: Mapping[str, PaperResult]) -> str:
    """The page about some results, by name, as HTML text."""
    return paper_page(_part(name, result) for name, result in results.items())


def _part(name: str, result: PaperResult) -> Part:
    rows = [(claim.what, claim.paper, claim.here, claim.verdict) for claim in result.claims]
    return Part(EXPERIMENTS[name].title, rows, SECTIONS[type(result)](name, result))


def _feature_map(name: str, result: FeatureMap) -> list[Section]:
    figure = figures.feature_map(result.ceiling, result.path, result.corners_m)
    caption = """Seed 0 after two minutes of lanes with 5 features at a time. Most ellipses, of three standard
        deviations, are smaller than the marks; a long one is a feature that was seen for a moment only."""
    return [Section(name, figure, caption)]


def _rate_table(name: str, result: RateTable) -> list[Section]:
    samples = {item.sample.name: (item.volt, item.volt_std) for item in result.samples}
    caption = """Each rate is held for 30 s between rests of 10 s, from which the zero is taken. What bias
        wander is left makes the slowest rates worst."""
    return [Section(name, figures.scale_by_rate(result.rates_deg_s, samples), caption)]


def _at_rest(name: str, result: AtRest) -> list[Section]:
    figure = figures.at_rest(result.time_s, result.read_deg_s, result.fits[0].at(result.time_s))
    return [
        Section(name, figure, 'Seed 0, means over 10 s. The residual of the fit is the wander of the bias.')
    ]


def _convergence(name: str, result: ConvergenceFigure) -> list[Section]:
    courses = {
        variant.name: (variant.first.time_s, variant.first.volt, variant.first.std_volt)
        for variant in result.varieties
        if variant.first is not None
    }
    caption = 'Seed 0 with 5 features. The scale factor is not observable before the first turn.'
    return [Section(name, figures.convergence(courses, TRUE_VOLT), caption)]


def _ten_rotations(name: str, result: HeadingTable) -> list[Section]:
    here = {'nominal': result.nominal_deg, 'calibrated': result.calibrated_deg}
    paper = {'nominal': PAPER_NOMINAL_DEG, 'calibrated': PAPER_CALIBRATED_DEG}
    caption = 'Two minutes of lanes with the camera, then ten rotations on the spot without it.'
    return [Section(name, figures.ten_rotations(here, paper), caption)]


def _histograms(name: str, result: Histograms) -> list[Section]:
    kinds = {kind.gyro.name: (kind.calibrated_deg, kind.nominal_deg) for kind in result.kinds}
    caption = """Four parts, three runs each; two minutes of lanes with the camera, then ten minutes of
        cleaning without it. The spread of the calibrated errors comes from noise and bias."""
    return [Section(name, figures.histograms(kinds, PAPER_MEAN_SD_DEG), caption)]


def _tracks(name: str, result: Tracks) -> list[Section]:
    caption = 'Seed 0, aligned to the ground truth at the beginning of each path. Crosses mark the ends.'
    ends = figures.end_errors('Where they end', result.end_errors_m)
    return [
        Section(name, figures.tracks('Tracks', result.tracks), caption, half=True),
        Section(f'{name}_ends', ends, 'All seeds.', half=True),
    ]


def _landmark(name: str, result: LandmarkErrors) -> list[Section]:
    methods = {}
    for method in result.methods:
        low, middle, high = method.quartiles_cm
        methods[method.name] = (middle, np.stack([middle - low, high - middle]))
    title = EXPERIMENTS[name].title.partition(': ')[2].capitalize()
    figure = figures.landmark_errors(title, result.moved_cm, methods, result.bound_cm)
    caption = (
        'One run; without noise all are the same.'
        if result.noise_px == 0.0
        else """Medians over the seeds with quartiles; runs in which the filter failed are left out from there
        on. The bound is that of the root mean square, which is larger than the median."""
    )
    return [Section(name, figure, caption)]


SECTIONS: dict[type, Callable[[str, Any], list[Section]]] = {
    FeatureMap: _feature_map,
    RateTable: _rate_table,
    AtRest: _at_rest,
    ConvergenceFigure: _convergence,
    HeadingTable: _ten_rotations,
    Histograms: _histograms,
    Tracks: _tracks,
    LandmarkErrors: _landmark,
}
