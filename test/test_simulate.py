"""The command `simulate` writes a bag of the simulated measurements."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal_ros.bag.source import open_bag
from gyrocal_ros.cli.main import main
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    CovariateSample,
    FeatureObservations,
    Frame,
    HeadingSample,
    ImuSample,
    TruthSample,
    WheelSample,
)
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.sim.image_scenes import SCENES
from gyrocal_ros.sim.references import KINDS, ReferenceSource
from gyrocal_ros.sim.scenarios import SCENARIOS, find_scenario
from gyrocal_ros.sim.world import SimSource

CLEANING = replace(SCENARIOS['cleaning'], duration_s=5.0)


def simulate(out: Path, *options: str) -> int:
    return main(['simulate', str(out), '--duration', '5', '--seed', '3', *options])


def digest(bag: Path) -> str:
    return hashlib.sha256(b''.join(file.read_bytes() for file in sorted(bag.iterdir()))).hexdigest()


@pytest.mark.slow
@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_the_bag_contains_the_measurements_of_the_simulator(tmp_path: Path, storage: str) -> None:
    assert simulate(tmp_path / 'bag', '--storage', storage) == 0
    bag, source = open_bag(tmp_path / 'bag', Config(), with_covariates=True), SimSource(CLEANING, 3)
    assert bag.rig.camera == source.rig.camera
    np.testing.assert_allclose(bag.rig.camera_mount.R_bs, source.rig.camera_mount.R_bs, atol=1e-12)
    np.testing.assert_allclose(bag.rig.camera_mount.p_bs, source.rig.camera_mount.p_bs, atol=1e-12)
    recorded, measured = list(bag.measurements()), list(source.measurements())
    for kind in (ImuSample, WheelSample):
        assert [item for item in recorded if isinstance(item, kind)] == [
            item for item in measured if isinstance(item, kind)
        ]
    recorded_features = [item for item in recorded if isinstance(item, FeatureObservations)]
    measured_features = [item for item in measured if isinstance(item, FeatureObservations)]
    for one, other in zip(recorded_features, measured_features, strict=True):
        assert one.t_ns == other.t_ns
        np.testing.assert_array_equal(one.ids, other.ids)
        np.testing.assert_allclose(one.pixels, other.pixels, atol=1e-4)
    names = {item.name for item in recorded if isinstance(item, CovariateSample)}
    assert {'battery_state.current', 'battery_state.voltage', 'fan_speed.data'} <= names
    assert sum(isinstance(item, TruthSample) for item in recorded) == 251


@pytest.mark.slow
def test_images_are_recorded_in_place_of_features(tmp_path: Path) -> None:
    assert simulate(tmp_path / 'bag', '--scenario', 'demo', '--images', '--duration', '1') == 0
    recorded = list(open_bag(tmp_path / 'bag', Config()).measurements())
    frames = [item for item in recorded if isinstance(item, Frame)]
    assert len(frames) == 10
    assert frames[0].image.shape == (480, 640)
    assert not any(isinstance(item, FeatureObservations) for item in recorded)


@pytest.mark.slow
def test_a_scene_has_its_lens_rate_and_ceiling(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SCENES, 'fisheye', replace(SCENES['fisheye'], camera_hz=4))
    options = ('--images', '--duration', '1', '--scene', 'fisheye', '--condition', 'jpeg_quality=95')
    assert simulate(tmp_path / 'one', *options) == 0
    assert simulate(tmp_path / 'other', *options, '--ceiling', 'lamps', '--condition', 'fan=true') == 0
    one, other = (open_bag(tmp_path / name, Config()) for name in ('one', 'other'))
    assert one.rig.camera == other.rig.camera == SCENES['fisheye'].camera
    images = [[item.image for item in bag.measurements() if isinstance(item, Frame)] for bag in (one, other)]
    assert len(images[0]) == len(images[1]) == SCENES['fisheye'].camera_hz
    assert np.abs(images[0][0].astype(int) - images[1][0]).mean() > 5.0


def test_the_old_name_of_the_jpeg_quality_still_works(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ('--images', '--duration', '1')
    assert simulate(tmp_path / 'old' / 'bag', *options, '--jpeg-quality', '40') == 0
    assert 'deprecated' in capsys.readouterr().err
    assert simulate(tmp_path / 'new' / 'bag', *options, '--condition', 'jpeg_quality=40') == 0
    assert digest(tmp_path / 'old' / 'bag') == digest(tmp_path / 'new' / 'bag')


def test_the_same_seed_writes_the_same_bytes(tmp_path: Path) -> None:
    for folder in ('one', 'two'):
        assert simulate(tmp_path / folder / 'bag') == 0
    assert digest(tmp_path / 'one' / 'bag') == digest(tmp_path / 'two' / 'bag')


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        (['--scenario', 'cleanin'], "did you mean 'cleaning'?"),
        (['--seed', '-1'], '--seed'),
        (['--duration', 'nan'], '--duration'),
        (['--duration', '0'], '--duration'),
        (['--images', '--condition', 'jpeg_quality=101'], 'jpeg_quality'),
        (['--images', '--ceiling', 'beems'], "did you mean 'beams'?"),
        (['--images', '--scene', 'fishey'], "did you mean 'fisheye'?"),
        (['--ceiling', 'beams'], '--images'),
    ],
)
def test_bad_arguments_are_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    assert simulate(tmp_path / 'bag', *options) == 2
    captured = capsys.readouterr()
    assert captured.out == ''
    assert captured.err.count('\n') == 1
    assert message in captured.err
    assert list(tmp_path.iterdir()) == []


def test_a_bag_is_not_overwritten_by_default(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert simulate(tmp_path / 'bag') == 0
    before = digest(tmp_path / 'bag')
    assert simulate(tmp_path / 'bag', '--seed', '4') == 2
    assert 'is not empty' in capsys.readouterr().err
    assert digest(tmp_path / 'bag') == before
    assert simulate(tmp_path / 'bag', '--seed', '4', '--overwrite') == 0
    assert digest(tmp_path / 'bag') != before


def test_an_interrupted_run_leaves_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(self: SimSource) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(SimSource, 'measurements', interrupted)
    assert simulate(tmp_path / 'bag') == 130
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('kind', KINDS)
def test_a_reference_in_place_of_the_camera(kind: str) -> None:
    robot = SimSource(replace(find_scenario('cleaning'), duration_s=30.0), 2)
    first, again = (list(ReferenceSource(robot, kind).measurements()) for _ in range(2))
    assert first == again and [item.t_ns for item in first] == sorted(item.t_ns for item in first)
    found = [item for item in first if isinstance(item, HeadingSample)]
    drawn, true = ReferenceSource(robot, kind).reference, robot.truth.trajectory
    hidden_s = sum(min(end_s, 30.0) - start_s for start_s, end_s in drawn.gaps_s)
    assert len(found) == pytest.approx(drawn.rate_hz * (30.0 - hidden_s), rel=0.05, abs=2.0)
    time_s = np.array([(item.t_ns - robot.span.start_ns) / 1e9 for item in found]) - drawn.offset_s
    wrong = np.unwrap([item.yaw_rad for item in found]) - true.motion(time_s).euler_rad[:, 2]
    jumps_rad = sum(abs(size) for _, size in drawn.jumps)
    spread = 6.0 * drawn.white_rad + 4.0 * drawn.walk_rad * math.sqrt(30.0) + jumps_rad
    assert drawn.white_rad / 3.0 < np.std(wrong) < spread


def test_an_unknown_reference_is_refused() -> None:
    with pytest.raises(ConfigError, match="did you mean 'lidar'"):
        ReferenceSource(SimSource(find_scenario('cleaning')), 'lidr')
