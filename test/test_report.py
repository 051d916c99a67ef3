"""The result folder of a calibration: files that load again, and a self-contained page."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal_ros.cli.replay import as_text
from gyrocal_ros.config.declare import with_settings
from gyrocal_ros.config.parameter_file import load_config
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import seconds
from gyrocal_ros.diagnose.advice import RECORD
from gyrocal_ros.diagnose.analysis.comparison import compare
from gyrocal_ros.diagnose.analysis.drift import blind_drift, dead_reckoning, heading_error, held_out_from_s
from gyrocal_ros.diagnose.analysis.model_fit import ModelFit
from gyrocal_ros.diagnose.json_summary import summarise
from gyrocal_ros.diagnose.series.run_series import (
    CONFIDENCE,
    MAX_WINDOWS,
    distances_m,
    rows_to_draw,
    uncorrected,
    windows,
)
from gyrocal_ros.diagnose.status import (
    DIAGNOSE,
    DOES_NOT_FIT,
    KNOWN_LATE,
    MORE_TURNS,
    calibration_status,
    turned_deg,
)
from gyrocal_ros.effects import default_model
from gyrocal_ros.effects.model_file import load_model, model_from_dict
from gyrocal_ros.ekf.history.run import Run, RunEvent
from gyrocal_ros.ekf.state.layout import EULER, YAW_BIAS, no_landmarks
from gyrocal_ros.ekf.state.map import ceiling_map
from gyrocal_ros.ekf.watches.camera_faults import TILT
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.files import new_folder
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.msgs.transforms import rotation_from_quaternion
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import Calibration, conclude, load_calibration
from gyrocal_ros.report import calibration_figures as figures
from gyrocal_ros.report import plot, write
from gyrocal_ros.report.calibration import (
    OTHERS,
    calibration_page,
    calibration_sections,
    coefficient_rows,
    conclusion,
)
from gyrocal_ros.report.describe import sigma_in_words, summarised, with_std
from gyrocal_ros.report.html import table
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

FILES = {
    'calibration.yaml',
    'model.yaml',
    'settings.yaml',
    'summary.json',
    'trajectory.txt',
    'trajectory_gyro.txt',
    'report.html',
}
SCENARIO = replace(find_scenario('cleaning'), duration_s=90.0, camera_until_s=80.0)

FITS = ModelFit((), True)


@pytest.fixture(scope='module')
def run() -> Run:
    config = with_settings(Config(), {'tracker': {'features': 12}})
    return calibrate(SimSource(SCENARIO, 0), config, default_model())


@pytest.fixture(scope='module')
def calibration(run: Run) -> Calibration:
    return conclude(run)


@pytest.fixture(scope='module')
def folder(run: Run, calibration: Calibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp('report') / 'out'
    write_results(run, calibration, target, [('warning', 'gaps in the <imu>')])
    return target


def write_results(
    run: Run,
    calibration: Calibration,
    folder: Path,
    findings: Sequence[tuple[str, str]] = (),
    overwrite: bool = False,
) -> None:
    """Write the results as the command does."""
    with new_folder(folder, overwrite=overwrite) as part:
        write.fill_calibration(part, run, calibration, findings)


def without_features(run: Run) -> Run:
    """Return the run as with another heading reference: without a map and without used features."""
    size = run.state.robot_size
    state = replace(
        run.state,
        mean=run.state.mean[:size],
        covariance=run.state.covariance[:size, :size],
        landmarks=no_landmarks(),
    )
    nothing = np.zeros_like(run.history.used)
    return replace(run, state=state, history=replace(run.history, used=nothing, rejected=nothing))


def shortened(run: Run, steps: int) -> Run:
    """Return a run that ends after a number of steps."""
    history = run.history
    columns = {item.name: getattr(history, item.name)[:steps] for item in fields(type(history))}
    return replace(run, history=type(history)(**columns))


def repeated(run: Run, times: int) -> Run:
    """Return a run that repeats this one a number of times."""
    history = run.history
    length_ns = int(history.t_ns[-1] - history.t_ns[0]) + 66_000_000
    columns = {
        item.name: np.concatenate([getattr(history, item.name)] * times) for item in fields(type(history))
    }
    columns['t_ns'] = np.concatenate([history.t_ns + i * length_ns for i in range(times)])
    columns['time_s'] = np.concatenate([history.time_s + i * seconds(length_ns) for i in range(times)])
    return replace(run, history=type(history)(**columns))


def figure_names(run: Run) -> list[str]:
    return [section.name for section in calibration_sections(run, conclude(run))]


class TestFolder:
    @pytest.mark.slow
    def test_it_contains_all_files(self, folder: Path) -> None:
        assert {file.name for file in folder.iterdir()} == FILES
        assert [item.name for item in folder.parent.iterdir()] == ['out']

    @pytest.mark.slow
    def test_calibration_model_and_settings_load_again(
        self, folder: Path, run: Run, calibration: Calibration
    ) -> None:
        loaded = load_calibration(folder / 'calibration.yaml')
        assert loaded.names == calibration.names
        np.testing.assert_array_equal(loaded.values, calibration.values)
        assert load_model(folder / 'model.yaml') == run.model
        assert load_config(folder / 'settings.yaml') == run.config != Config()

    @pytest.mark.slow
    def test_the_summary_is_that_of_the_run(self, folder: Path, run: Run, calibration: Calibration) -> None:
        assert json.loads((folder / 'summary.json').read_text()) == summarise(run, calibration)

    def test_trajectories_are_in_tum_format(self, folder: Path, run: Run) -> None:
        for name in ('trajectory.txt', 'trajectory_gyro.txt'):
            poses = np.loadtxt(folder / name)
            assert poses.shape == (len(run.history.t_ns), 8)
            np.testing.assert_allclose(poses[:, 0], run.history.t_ns / 1e9, rtol=0.0, atol=1e-6)
            np.testing.assert_allclose(np.linalg.norm(poses[:, 4:], axis=1), 1.0, atol=1e-8)
        poses = np.loadtxt(folder / 'trajectory.txt')
        np.testing.assert_allclose(poses[:, 1:4], run.history.mean[:, :3], atol=1e-6)
        first = (folder / 'trajectory.txt').read_text().splitlines()[1].split()[0]
        assert int(first.replace('.', '')) == run.history.t_ns[0], 'to the nanosecond'
        for row in (0, 400, 1000):
            np.testing.assert_allclose(
                rotation_from_quaternion(*poses[row, 4:]),
                rotation_from_euler(run.history.mean[row, EULER]),
                atol=1e-7,
            )

    @pytest.mark.slow
    def test_files_of_the_user_are_kept(self, run: Run, calibration: Calibration, tmp_path: Path) -> None:
        (tmp_path / 'mine.txt').write_text('mine')
        with pytest.raises(GyrocalError, match='not empty'):
            write_results(run, calibration, tmp_path)
        write_results(run, calibration, tmp_path, overwrite=True)
        assert {file.name for file in tmp_path.iterdir()} == FILES | {'mine.txt'}

    def test_an_interruption_leaves_no_folder(
        self, run: Run, calibration: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def interrupted(*_: object) -> str:
            raise KeyboardInterrupt

        monkeypatch.setattr(write, 'calibration_page', interrupted)
        with pytest.raises(KeyboardInterrupt):
            write_results(run, calibration, tmp_path / 'out')
        assert list(tmp_path.iterdir()) == []


class TestPage:
    def test_it_needs_no_other_file_and_no_network(self, folder: Path) -> None:
        text = (folder / 'report.html').read_text(encoding='utf-8')
        library = plot.plotly_js()
        assert text.count(library) == 1
        own = text.replace(library, '')
        assert re.findall(r'(?:src|href)\s*=(?!"#)|@import|url\(|https?://', own) == []
        assert own.count('"showSendToCloud": false') == own.count('Plotly.newPlot(') > 0
        assert len(text) < 6_000_000

    def test_it_shows_every_figure_once(self, folder: Path, run: Run) -> None:
        text = (folder / 'report.html').read_text(encoding='utf-8')
        names = figure_names(run)
        assert len(set(names)) == len(names)
        assert re.findall(r'<div id="(\w+)" class="plotly-graph-div"', text) == names

    def test_text_from_outside_is_escaped(self, run: Run, calibration: Calibration, folder: Path) -> None:
        assert 'gaps in the &lt;imu&gt;' in (folder / 'report.html').read_text(encoding='utf-8')
        text = calibration_page(replace(run, source='<b>bag</b>'), calibration)
        assert '<b>bag' not in text
        assert 'No warnings' in text

    def test_events_are_listed_with_their_times(self, run: Run, calibration: Calibration) -> None:
        event = RunEvent(run.span.start_ns + 12_300_000_000, 'a new map was begun')
        text = calibration_page(replace(run, events=(event,)), calibration)
        assert '12.3 s after the start: a new map was begun' in text

    @pytest.mark.slow
    def test_the_same_run_gives_the_same_page(self, run: Run, calibration: Calibration) -> None:
        assert calibration_page(run, calibration) == calibration_page(run, calibration)


class TestSections:
    @pytest.mark.slow
    def test_figures_without_data_are_omitted(self, run: Run) -> None:
        assert figure_names(run) == [
            'scale_factor', 'path', 'map', 'distance', 'blind_drift', 'heading', 'bias', 'innovations',
        ]  # fmt: skip
        bare = without_features(replace(run, truth=None))
        assert figure_names(bare) == [
            'scale_factor', 'path', 'blind_drift', 'heading_alone', 'bias', 'innovations',
        ]  # fmt: skip
        assert 'blind_drift' not in figure_names(without_features(shortened(run, 1000))), (
            'one span, no figure'
        )

    @pytest.mark.slow
    def test_other_coefficients_of_a_larger_model_are_shown(self) -> None:
        model = model_from_dict({'effects': ['scale_factor', 'scale_cubic', 'bias_warmup']}, 'test')
        run = calibrate(SimSource(replace(SCENARIO, duration_s=25.0), 0), Config(), model)
        calibration = conclude(run)
        assert figure_names(run)[1] == 'coefficients'
        figure = figures.coefficients(run, OTHERS)
        drawn = {trace.name: trace for trace in figure.data}
        assert set(drawn) == {'3 sigma', *model.coefficient_names[1:]}
        amplitude = drawn['bias_warmup.amplitude']
        place = calibration.names.index('bias_warmup.amplitude')
        assert amplitude.y[-1] == pytest.approx(math.degrees(calibration.values[place]), rel=1e-5)
        assert amplitude.customdata[-1] >= 0.99 * 3.0 * math.degrees(run.history.std[-1, YAW_BIAS + place])
        assert any(axis.title.text == 'bias_warmup<br>amplitude<br>(deg/s)' for axis in figure.select_yaxes())
        with_bias = {trace.name for trace in figures.coefficients(run).data}
        assert with_bias == {'3 sigma', 'bias', *model.coefficient_names}
        rows = coefficient_rows(calibration, run.history)
        assert [row.name for row in rows] == ['bias', *model.coefficient_names]
        last = model.coefficients[-1]
        assert rows[-1].prior == with_std(last.prior_mean, last.prior_std)

    def test_the_size_does_not_grow_with_the_recording(self, run: Run) -> None:
        hour = repeated(run, 40)
        assert len(hour.history.t_ns) > 40_000
        for section in calibration_sections(hour, conclude(hour)):
            for trace in section.figure.data:
                assert len(trace.x) == len(trace.y) < 2.2 * plot.MAX_POINTS, (section.name, trace.name)

    def test_axes_have_titles_and_lines_have_names(self, run: Run, calibration: Calibration) -> None:
        for section in calibration_sections(run, calibration):
            layout = section.figure.layout
            assert layout.title.text
            assert all(trace.name for trace in section.figure.data)
            assert any(axis.title.text for axis in section.figure.select_xaxes())
            panels = sum(bool(axis.title.text) for axis in section.figure.select_yaxes())
            assert panels >= len(list(section.figure.select_yaxes())) - 1


class TestSeries:
    def test_thinning_keeps_the_extremes(self) -> None:
        values = np.random.default_rng(0).normal(size=(50_000, 2))
        values[31_234, 0], values[7, 1], values[100:200, 0] = 50.0, -60.0, np.nan
        rows = rows_to_draw(values, 1000)
        assert len(rows) <= 1002
        assert {0, 7, 31_234, 49_999} <= set(rows.tolist())
        assert (np.diff(rows) > 0).all()
        np.testing.assert_array_equal(rows_to_draw(values[:1000], 1000), np.arange(1000))

    def test_windows_contain_every_step(self, run: Run) -> None:
        found = windows(run.history)
        assert found.rejected.sum() == run.history.rejected.sum()
        covered = found.used == 0.0
        assert covered.any(), 'the camera is off at the end'
        assert np.isnan(found.nis_per_dof[covered]).all()

    def test_a_consistent_filter_stays_within_the_bounds(self, run: Run) -> None:
        rng = np.random.default_rng(1)
        hour = repeated(run, 40).history
        consistent = windows(replace(hour, nis=rng.chisquare(np.maximum(hour.dof, 1e-9))))
        assert len(consistent.time_s) <= MAX_WINDOWS + 1
        assert consistent.share_inside == pytest.approx(CONFIDENCE, abs=0.04)
        overconfident = windows(replace(hour, nis=2.0 * hour.dof))
        assert overconfident.share_inside == 0.0

    def test_the_uncorrected_gyro_turns_by_its_samples_alone(self, run: Run) -> None:
        history = run.history
        track = dead_reckoning(uncorrected(run), run.state.coefficients, 0.0)
        turned = track.yaw_rad - track.yaw_rad[0]
        sampled = np.cumsum(history.turn_rad + history.tilt_rad)
        np.testing.assert_allclose(turned, sampled - sampled[0], atol=1e-9)

    def test_the_heading_error_fits_its_standard_deviation(self, run: Run) -> None:
        error = heading_error(run)
        assert error is not None
        assert np.mean(np.abs(error.error_rad) < 3.0 * error.std_rad) > 0.97
        assert heading_error(replace(run, truth=None)) is None

    def test_outlines_have_the_given_distance_in_sigmas(self, run: Run) -> None:
        ceiling = ceiling_map(run.state, run.config.features.parametrisation)
        assert len(ceiling.ids) == len(run.state.landmarks.ids) > 5
        offsets = ceiling.outlines(3.0) - ceiling.points_m[:, None, :2]
        information = np.linalg.inv(ceiling.covariances_m2[:, :2, :2])
        distances = np.einsum('mci,mij,mcj->mc', offsets, information, offsets)
        np.testing.assert_allclose(distances, 9.0, rtol=1e-4)
        assert 2.0 < np.median(ceiling.points_m[:, 2]) < 3.0, 'a ceiling is above the floor'

    def test_distances_are_those_from_the_truth(self, run: Run) -> None:
        path = dead_reckoning(run, run.state.coefficients, float(run.state.bias_rad_s[2]))
        moved = replace(path, position_m=path.position_m + [0.3, -0.4])
        _, distances = distances_m({'moved': moved}, path)
        np.testing.assert_allclose(distances['moved'], 0.5)


class TestSentences:
    @pytest.mark.parametrize(
        ('value', 'std', 'text'),
        [
            (0.9255473, 0.0000209, '0.925547 ± 0.000021'),
            (135.50013, 0.00307, '135.5001 ± 0.0031'),
            (-0.0744, 0.1, '-0.07 ± 0.10'),
            (577.2, 112.0, '580 ± 110'),
            (1e-10, 3e-11, '1e-10 ± 3e-11'),
            (1.0, 0.0, '1 ± 0'),
            (1.0, math.nan, '1 ± nan'),
        ],
    )
    def test_numbers_have_two_digits_of_their_std(self, value: float, std: float, text: str) -> None:
        assert with_std(value, std) == text

    def test_a_good_calibration(self, run: Run, calibration: Calibration) -> None:
        verdict = conclusion(calibration, run, FITS, blind_drift(uncorrected(run)), blind_drift(run))
        assert verdict.status.level == 'green'
        assert verdict.headline.startswith('Calibrated: the scale factor was known to 0.05 % after')
        assert '135.' in verdict.sentences[0]
        assert '8.0' in verdict.sentences[0]
        assert 'too much' in verdict.sentences[0]
        assert 'against the ground truth' in verdict.sentences[2]

    def test_a_calibration_that_needs_more_turns(self, run: Run, calibration: Calibration) -> None:
        early = replace(calibration, converged=False, convergence_time_s=None)
        run = replace(run, history=replace(run.history, turn_rad=0.1 * run.history.turn_rad))
        verdict = conclusion(early, run, FITS, blind_drift(run), blind_drift(run))
        assert verdict.status.level != 'green'
        assert 'Record more turns' in verdict.steps[0]

    def test_a_model_that_does_not_fit(self, run: Run, calibration: Calibration) -> None:
        misfit = ModelFit(('the heading drifts by 3 deg',), True)
        verdict = conclusion(calibration, run, misfit, blind_drift(run), blind_drift(run))
        assert verdict.status.level != 'green'
        assert verdict.headline.startswith('Not to be trusted: the heading drifts by 3 deg')
        assert verdict.headline.endswith(DOES_NOT_FIT)

    def test_an_inconsistent_calibration(self, run: Run, calibration: Calibration) -> None:
        inconsistent = replace(calibration, converged=False)
        verdict = conclusion(inconsistent, run, FITS, blind_drift(run), blind_drift(run))
        assert verdict.status.level != 'green'
        assert 'Not to be trusted' in verdict.headline

    def test_a_gyro_mounted_upside_down(self, run: Run, calibration: Calibration) -> None:
        turned = replace(calibration, values=np.array([0.0, -1.99]))
        verdict = conclusion(turned, run, FITS, blind_drift(run), blind_drift(run))
        assert 'reports 1.01 % too much, and turns the wrong way round' in verdict.sentences[0]

    def test_page_and_command_state_the_same_reason(self, run: Run, calibration: Calibration) -> None:
        for converged_s in (None, calibration.convergence_time_s):
            failed = replace(calibration, converged=False, convergence_time_s=converged_s)
            headline = conclusion(failed, run, FITS, blind_drift(run), blind_drift(run)).headline
            summary = summarise(run, failed)
            assert f'] {headline}' in as_text(summary).splitlines()[0]
            assert headline == summary['status']['sentence']


class TestStatus:
    def test_green_needs_turns_to_both_sides(self, run: Run, calibration: Calibration) -> None:
        assert calibration_status(calibration, run, FITS).level == 'green'
        left = replace(run.history, turn_rad=np.maximum(run.history.turn_rad, 0.0))
        status = calibration_status(calibration, replace(run, history=left), FITS)
        assert status.level == 'yellow'
        assert 'hardly turned to the right' in status.sentence and 'right' in status.next_step

    def test_green_needs_a_model_that_was_judged(self, run: Run, calibration: Calibration) -> None:
        status = calibration_status(calibration, run, ModelFit((), False))
        assert status.level == 'yellow' and 'too short' in status.sentence

    def test_too_little_after_a_change_is_no_short_recording(
        self, run: Run, calibration: Calibration
    ) -> None:
        history = run.history
        followed = (np.arange(len(history.time_s)) == 50).astype(np.int8)
        after = replace(run, history=replace(history, scale_followed=followed))
        status = calibration_status(calibration, after, ModelFit((), False))
        assert f'changed at {history.time_s[50]:.0f} s' in status.sentence
        assert 'too short' not in status.sentence
        late = replace(calibration, convergence_time_s=run.span.duration_s)
        status = calibration_status(late, run, ModelFit((), True, 1.0, 1.1))
        assert status.sentence.endswith(f'but {KNOWN_LATE}.')

    def test_what_a_longer_recording_would_settle_is_no_reason_for_distrust(
        self, run: Run, calibration: Calibration
    ) -> None:
        """Another gyro in place of the stored one: the noise was learned while it was not known."""
        failed = replace(calibration, converged=False)
        assert calibration_status(failed, run, FITS).level == 'red'
        early = replace(failed, doubt='it is early')
        status = calibration_status(early, run, FITS)
        assert (status.level, status.next_step) == ('yellow', RECORD)
        assert status.sentence == 'Not calibrated yet: it is early.'
        event = RunEvent(run.span.start_ns, f'{TILT} 1.5 deg beside its transform; diagnose it')
        status = calibration_status(early, replace(run, events=(event,)), FITS)
        assert (
            status.sentence
            == 'Not calibrated yet: it is early; the camera looks 1.5 deg beside its transform.'
        )
        assert status.next_step != RECORD

    @pytest.mark.parametrize(('walk', 'level'), [(2, 'green'), (4, 'yellow')])
    def test_green_needs_a_bias_that_walks_about_as_set(
        self, run: Run, calibration: Calibration, walk: int, level: str
    ) -> None:
        history = replace(run.history, bias_walk=np.full(len(run.history.time_s), walk, np.int8))
        status = calibration_status(calibration, replace(run, history=history), FITS)
        assert status.level == level
        assert ('the bias of the gyro walks 4 times as much' in status.sentence) == (level == 'yellow')

    def test_a_large_drift_is_named_before_the_scale_factor_is_known(
        self, run: Run, calibration: Calibration
    ) -> None:
        unknown = replace(calibration, converged=False, convergence_time_s=None)
        for drift_deg, is_named in ((0.9, False), (1.1, True)):
            status = calibration_status(unknown, run, ModelFit((), True, 1.0, drift_deg))
            assert ('deg in 60 s without the camera' in status.sentence) == is_named

    def test_green_needs_a_heading_that_lasts_a_minute(self, run: Run, calibration: Calibration) -> None:
        """A model with much noise fits a drift of any size."""
        for drift_deg, level in ((0.9, 'green'), (1.1, 'yellow')):
            status = calibration_status(calibration, run, ModelFit((), True, 1.0, drift_deg))
            assert status.level == level
        assert '1.1 deg in 60 s without the camera' in status.sentence

    def test_more_turns_are_no_remedy_for_a_wrong_camera(self, run: Run, calibration: Calibration) -> None:
        unknown = replace(calibration, converged=False, convergence_time_s=None)
        few = replace(run.history, turn_rad=0.1 * run.history.turn_rad)
        assert calibration_status(unknown, replace(run, history=few), FITS).next_step == MORE_TURNS
        assert min(turned_deg(run)) > 360.0
        assert calibration_status(unknown, run, FITS).next_step == DIAGNOSE
        told = f'{TILT} 1.5 deg beside its transform; diagnose it'
        event = RunEvent(run.span.start_ns, f'the bias walks; {told}; the map was dropped')
        status = calibration_status(unknown, replace(run, events=(event,)), FITS)
        assert status.sentence.endswith('; the camera looks 1.5 deg beside its transform.')
        assert status.next_step == 'Diagnose it.'
        status = calibration_status(calibration, replace(run, events=(event,)), FITS)
        assert status.level == 'yellow' and status.next_step == 'Diagnose it.'
        assert status.sentence.endswith(' s, but the camera looks 1.5 deg beside its transform.')

    def test_turns_are_summed_by_side(self, run: Run) -> None:
        dt_s, bias = run.history.dt_s, run.history.mean[:, YAW_BIAS]
        rate = np.where(np.arange(len(dt_s)) % 3 == 0, 1.0, -0.5)
        rate[:4] = 0.01  # too slow for a turn
        turned = replace(run, history=replace(run.history, turn_rad=(rate - bias) * dt_s))
        left, right = (
            float(np.degrees(rate * dt_s)[4:][side].sum()) for side in (rate[4:] > 0, rate[4:] < 0)
        )
        assert turned_deg(turned) == pytest.approx((left, -right))


def test_a_calibration_and_a_comparison_have_the_same_drift(run: Run) -> None:
    drift = compare({'default': run}).results[0].drift
    assert summarise(run, conclude(run))['blind_drift_deg'] == {
        'rms': drift.rms_deg,
        'max': drift.max_deg,
        'from_s': held_out_from_s(run),
    }


def test_of_many_events_of_one_kind_the_first_is_told() -> None:
    jumps = [RunEvent(k, f'the heading reference jumped by {0.1 * k:+.1f} deg') for k in range(5)]
    others = [RunEvent(9, 'neither gyro nor images for 3 s'), RunEvent(11, 'neither gyro nor images for 4 s')]
    told = list(summarised([*jumps[:3], *others, *jumps[3:]]))
    assert told[1:] == others and told[0].t_ns == 0
    assert told[0].text == 'the heading reference jumped by +0.0 deg; 4 more like this'


@pytest.mark.parametrize(('sigma', 'text'), [(7.46, '7.5'), (30.0, '30.0'), (37.0, '> 30'), (math.nan, '-')])
def test_large_sigmas_have_no_exact_number(sigma: float, text: str) -> None:
    assert sigma_in_words(sigma) == text


@pytest.mark.slow
@pytest.mark.parametrize('module', ['diagnose.json_summary', 'report.describe', 'studio.worker'])
def test_numbers_and_sentences_need_no_plotly(module: str) -> None:
    code = f'import sys, gyrocal_ros.{module}; print("plotly" in sys.modules)'
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == 'False'


def test_a_table_with_sentences_gives_them_room_and_breaks_long_names() -> None:
    sentence = 'kept: in closed form the recording is predicted as well (log-likelihood +48.8)'
    shown = table('Revisions', ('revision', 'reason'), [('2_bias_memory', sentence)])
    assert '<table class="reasons">' in shown and '2_<wbr>bias_<wbr>memory' in shown
    plain = table('Topics', ('topic', 'messages'), [('imu_data', '12')])
    assert '<table>' in plain and 'imu_data' in plain
