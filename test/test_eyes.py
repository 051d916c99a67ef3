"""The bench over image scenes: its figures, stored images, a short run, and its options."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gyrocal_ros.bench import eyes as bench
from gyrocal_ros.bench.eyes import EyesRun, StoredImages, eyes, eyes_row, run_eyes
from gyrocal_ros.cli.main import main
from gyrocal_ros.data import Frame, ImuSample
from gyrocal_ros.sim.image_scenes import SCENES
from gyrocal_ros.sim.scenarios import SCENARIOS
from gyrocal_ros.sim.world import SimSource

RUN = EyesRun('tiles', 0, '', 3e-4, 1.5, -0.5, 0.03, 1.1, True, 14.0, 12.0, 4.0)
OTHER = EyesRun('tiles', 1, '', -4e-4, -2.5, 0.7, 0.04, 1.3, False, 10.0, 14.0, 6.0)


def test_rows_summarise_the_seeds() -> None:
    row = eyes_row('tiles', [RUN, OTHER, EyesRun('tiles', 2, failure='diverged')])
    expected = {
        'bags': 3,
        'failed': 1,
        'converged': 1.0 / 3.0,
        'scale_rms_percent': 100.0 * math.sqrt(12.5) * 1e-4,
        'scale_max_percent': 0.04,
        'scale_z_rms': math.sqrt((1.5**2 + 2.5**2) / 2.0),
        'scale_in_95': 0.5,
        'bias_z_rms': math.sqrt((0.25 + 0.49) / 2.0),
        'bias_in_95': 1.0,
        'heading_rms_deg': math.sqrt((9.0 + 16.0) / 2.0) * 0.01,
        'nis_per_dof': 1.2,
        'features': 12.0,
        'render_ms': 13.0,
        'tracker_ms': 5.0,
    }
    assert {name: row[name] for name in expected} == pytest.approx(expected)
    nothing = eyes_row('tiles', [EyesRun('tiles', 2, failure='diverged')])
    assert nothing['failed'] == 1 and nothing['scale_rms_percent'] is None and nothing['converged'] == 0.0


def test_one_row_a_scene_and_one_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    def in_order(function: object, tasks: list[tuple[str, int, float]]) -> Any:
        assert [seed for _, seed, _ in tasks] == [0, 1, 2, 3]
        return (replace(RUN, scene=scene, seed=seed) for scene, seed, _ in tasks)

    monkeypatch.setattr(bench, 'in_parallel', in_order)
    rows = [(row['scene'], row['bags']) for row in eyes(2, ['slow', 'plain'], 60.0)]
    assert rows == [('slow', 2), ('plain', 2), ('all', 4)]


@pytest.mark.slow
def test_images_are_stored_with_the_quality_of_the_scene() -> None:
    scenario = SCENES['dirty'].applied_to(replace(SCENARIOS['cleaning'], duration_s=0.4))
    simulated = SimSource(scenario, 0, images=True)
    stored = StoredImages(simulated)
    pairs = list(zip(simulated.measurements(), stored.measurements(), strict=True))
    frames = [(a.image, b.image) for a, b in pairs if isinstance(a, Frame) and isinstance(b, Frame)]
    assert len(frames) == stored.frames == 6 and stored.spent_s > 0.0
    assert all(0.5 < np.abs(a.astype(int) - b).mean() < 10.0 for a, b in frames)
    assert all(a == b for a, b in pairs if isinstance(a, ImuSample))


@pytest.mark.slow
def test_a_run_has_errors_of_the_right_size() -> None:
    run = run_eyes('slow', 0, 25.0)
    assert not run.failure and abs(run.scale_error) < 1e-3 and abs(run.scale_z) < 5.0
    assert abs(run.bias_z) < 5.0 and run.heading_rms_deg < 0.2 and 0.3 < run.nis_per_dof < 10.0
    assert 5.0 < run.features < 22.0 and run.render_ms > 1.0 and run.tracker_ms > 0.1


@pytest.mark.slow
def test_a_run_that_cannot_be_calibrated_says_why() -> None:
    run = run_eyes('slow', 0, 4.0)
    assert 'turns' in run.failure and math.isnan(run.scale_error)


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        (['eyes', '--scenes', 'tyles'], 'tyles'),
        (['accuracy', '--scenes', 'tiles'], '--scenes'),
        (['blind', '--scenes', 'tiles'], '--scenes'),
        (['eyes', '--images'], '--images'),
        (['eyes', '--seconds', '3'], '--seconds'),
    ],
)
def test_wrong_options_are_refused(
    options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['bench', *options]) == 2
    assert message in capsys.readouterr().err
