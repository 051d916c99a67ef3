"""Measure accuracy, consistency, speed and diagnosis on simulated robots whose truth is known.

Without a name: accuracy, comparison, speed and blind diagnosis, which takes hours. With --quick and no
name a few quick figures are compared with the kept ones, and the command fails if accuracy or consistency
is worse by more than chance; time is not compared. Seeds are 0, 1, 2 and so on.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from gyrocal_ros.bench.accuracy import accuracy, in_parallel
from gyrocal_ros.bench.accuracy import cases as accuracy_cases
from gyrocal_ros.bench.bag_tracks import bag_rows
from gyrocal_ros.bench.blind import blind
from gyrocal_ros.bench.blind_cases import cases as blind_cases
from gyrocal_ros.bench.camera_off import camera_off
from gyrocal_ros.bench.eyes import eyes
from gyrocal_ros.bench.faults.soak import SESSION_S, soak
from gyrocal_ros.bench.faults.suite import KINDS, REFERENCES, SEMANTIC, SOUND, faults
from gyrocal_ros.bench.gate import BASELINE, Outcome, baseline_to_dict, gate, load_baseline, measure_baseline
from gyrocal_ros.bench.growth import growth
from gyrocal_ros.bench.image_speed import image_speed
from gyrocal_ros.bench.methods import comparison
from gyrocal_ros.bench.references import cases as reference_cases
from gyrocal_ros.bench.references import references
from gyrocal_ros.bench.separability import motions
from gyrocal_ros.bench.speed import speed
from gyrocal_ros.bench.strangers import labels as stranger_labels
from gyrocal_ros.bench.strangers import strangers
from gyrocal_ros.bench.tracker import tracker_accuracy
from gyrocal_ros.cli.fleet import require_extra
from gyrocal_ros.cli.main import main
from gyrocal_ros.cli.numbers import number, whole_number
from gyrocal_ros.cli.options import complete_with
from gyrocal_ros.cli.output import print_json, print_message, print_row, progress
from gyrocal_ros.cli.provenance import provenance
from gyrocal_ros.config.robot_sections import LiveConfig
from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.settings import DiagnosisSettings, differing, with_thresholds
from gyrocal_ros.effects import default_model
from gyrocal_ros.errors import GyrocalError, did_you_mean
from gyrocal_ros.files import json_text, write_text_atomic
from gyrocal_ros.robot.calibrator import LiveCalibrator
from gyrocal_ros.sim.image_scenes import SCENES, find_scene

EXAMPLE = """gyrocal bench
gyrocal bench accuracy comparison --seeds 20
gyrocal bench blind --seeds 10 --only none scale_cubic
gyrocal bench blind --only none --set significant_sigma=3.5 --set min_predictive_gain=2
gyrocal bench blind --images --seeds 2 --only none gyro_lag
gyrocal bench blind --varied --seeds 5 --only none rate_deadband
gyrocal bench blind --strangers --seeds 2
gyrocal bench eyes --scenes tiles fisheye --seeds 2
gyrocal bench growth -o growth.html
gyrocal bench faults --seeds 2 --only clouds images
gyrocal bench soak --seeds 6
gyrocal bench soak --seeds 4 --seconds 21600
gyrocal bench fleet --only coverage effects
gyrocal bench references --seeds 6 --only lidar effects
gyrocal bench tracker --bag drive_with_images
gyrocal bench image_speed --bag drive_with_images
gyrocal bench --quick"""

BENCHES: dict[str, Callable[[argparse.Namespace], Iterator[dict[str, Any]]]] = {
    'accuracy': lambda args: accuracy(args.seeds, args.quick, args.only),
    'comparison': lambda args: comparison(args.seeds),
    'camera_off': lambda args: camera_off(args.seeds),
    'blind': lambda args: _blind(args),
    'eyes': lambda args: eyes(args.seeds, args.scenes or tuple(SCENES), args.seconds or EYES_S),
    'tracker': lambda args: bag_rows(args.bag) if args.bag else tracker_accuracy(args.seeds),
    'motions': lambda args: motions(),
    'speed': lambda args: speed(args.quick),
    'image_speed': lambda args: image_speed(args.bag),
    'growth': lambda args: growth(args.quick),
    'faults': lambda args: faults(args.seeds, args.only, main, quick=args.quick, report=print_message),
    'soak': lambda args: soak(args.seeds, _start_calibrator, args.seconds or SESSION_S),
    'fleet': lambda args: _fleet(args),
    'references': lambda args: references(args.seeds, args.only, varied=args.varied),
}

CASES: dict[str, Callable[[], list[str]]] = {
    'accuracy': lambda: [case[0] for case in accuracy_cases(quick=False)],
    'blind': lambda: [*(case.label for case in blind_cases()), *stranger_labels()],
    'faults': lambda: [*KINDS, SEMANTIC, REFERENCES, SOUND],
    'fleet': lambda: ['coverage', 'effects', 'prior', 'size', 'engine'],
    'references': reference_cases,
}
"""Labels of the cases of the benches that can run some of them."""

DEFAULT_BENCHES = ('accuracy', 'comparison', 'speed', 'blind')

EYES_S = 120.0
"""Length of a recording for `eyes`."""
MAX_SECONDS = 12.0 * 3600.0
"""Bound of `--seconds`."""

T = TypeVar('T')
R = TypeVar('R')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    what = parser.add_argument(
        'what', nargs='*', metavar='WHAT', help=f'what to measure: {", ".join(BENCHES)}'
    )
    complete_with(what, BENCHES)
    parser.add_argument(
        '--seeds',
        type=whole_number(1),
        default=20,
        help='number of recordings per case; for soak: of sessions (default 20)',
    )
    parser.add_argument(
        '--quick', action='store_true', help='compare with the kept figures; with a name, its first case only'
    )
    parser.add_argument('--keep', action='store_true', help='with --quick: keep the figures of this code')
    parser.add_argument(
        '--only',
        nargs='+',
        default=[],
        metavar='CASE',
        help='for accuracy, blind, faults, fleet and references: run these cases only',
    )
    parser.add_argument(
        '--bag',
        nargs='+',
        default=[],
        type=Path,
        help='for tracker and image_speed: recordings in place of rendered images; tracker needs true poses',
    )
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='for blind: a threshold of the diagnosis (docs/diagnosis_settings.md); may be repeated',
    )
    parser.add_argument(
        '--images', action='store_true', help='for blind: recordings with images, of a scene by the seed'
    )
    parser.add_argument(
        '--varied',
        action='store_true',
        help='for blind and references: another robot, room, drive and set of sensors for every seed',
    )
    parser.add_argument(
        '--strangers',
        action='store_true',
        help='for blind: laws that no effect of the library has, and what `gyrocal learn` makes of them',
    )
    parser.add_argument(
        '--scenes',
        nargs='+',
        default=[],
        metavar='NAME',
        help=f'for eyes and blind --images: these scenes only, of {", ".join(SCENES)}',
    )
    parser.add_argument(
        '--seconds',
        type=number(20.0, MAX_SECONDS, 's'),
        metavar='S',
        help=f'length of a recording for eyes ({EYES_S:g}), of a session for soak ({SESSION_S:g})',
    )
    parser.add_argument(
        '-o', '--out', type=Path, metavar='FILE', help='for growth: write a page with the plots'
    )
    parser.add_argument('--overwrite', action='store_true', help='overwrite the page')
    parser.add_argument('--json', action='store_true', help='one JSON object in place of the tables')


def run(args: argparse.Namespace) -> None:
    """Measure, and print each row as it becomes ready.

    Raises:
        GyrocalError: a name is not known, or a figure is worse than the kept one.
    """
    for name in args.what:
        if name not in BENCHES:
            raise GyrocalError('is not a bench', where=repr(name), todo=did_you_mean(name, BENCHES))
    if args.only:
        _refuse_unknown_cases(args)
    settings = _settings(args)
    if args.set and (not args.what or set(args.what) != {'blind'}):
        raise GyrocalError('is only for the bench blind', where='--set', todo='name blind')
    if args.strangers and (set(args.what) != {'blind'} or args.images or args.set):
        raise GyrocalError('is for the bench blind alone', where='--strangers', todo='name only blind')
    _refuse_wrong_scenes(args)
    is_for_varied = args.what and set(args.what) <= {'blind', 'references'}
    if args.varied and (not is_for_varied or args.images or args.strangers):
        todo = 'name blind or references, without --images and --strangers'
        raise GyrocalError(
            'is for the benches blind, on features, and references', where='--varied', todo=todo
        )
    if args.keep and (args.what or not args.quick):
        raise GyrocalError('is for `gyrocal bench --quick` only', where='--keep')
    if args.quick and not args.what:
        _compare_with_kept(args)
        return
    if args.out and args.out.exists() and not args.overwrite:
        raise GyrocalError('exists already', where=str(args.out), todo='choose another name or --overwrite')
    tables = {name: _rows(name, args) for name in args.what or DEFAULT_BENCHES}
    if args.json:
        print_json(provenance() | {'seeds': args.seeds, 'settings': differing(settings), 'benches': tables})
    if args.out and 'growth' in tables:
        from gyrocal_ros.report.growth import growth_page  # only a page needs the plotting library

        about = provenance()
        page = growth_page(tables['growth'], f'gyrocal {about["version"]}, {about["machine"]}')
        write_text_atomic(args.out, page, overwrite=args.overwrite)


def _refuse_unknown_cases(args: argparse.Namespace) -> None:
    if not args.what or not CASES.keys() >= set(args.what):
        raise GyrocalError('needs the name of a bench', where='--only', todo=f'name {" or ".join(CASES)}')
    known = [label for name in args.what for label in CASES[name]()]
    for label in args.only:
        if label not in known:
            raise GyrocalError('is not a case', where=repr(label), todo=did_you_mean(label, known))


def _refuse_wrong_scenes(args: argparse.Namespace) -> None:
    if args.images and set(args.what) != {'blind'}:
        raise GyrocalError('is only for the bench blind', where='--images', todo='name blind')
    if args.scenes and not args.images and set(args.what) != {'eyes'}:
        raise GyrocalError('needs images', where='--scenes', todo='name eyes, or blind with --images')
    for name in args.scenes:
        find_scene(name)


def _scenes(args: argparse.Namespace) -> tuple[str, ...]:
    """Return the scenes of the blind trials; none for trials without images."""
    return tuple(args.scenes or SCENES) if args.images else ()


def _start_calibrator(file: Path, now_s: float) -> LiveCalibrator:
    live = LiveConfig(calibration=str(file))
    return LiveCalibrator(default_model(), Config(), live, name='bench', steady=True, now_s=now_s)


def _blind(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    if args.strangers:
        return strangers(args.seeds, args.only)
    return blind(args.seeds, args.only, _settings(args), _scenes(args), args.varied)


def _fleet(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    # The libraries of fleets are an extra.
    require_extra()
    from gyrocal_ros.bench.fleet import fleet

    return fleet(args.seeds, args.only)


def _settings(args: argparse.Namespace) -> DiagnosisSettings:
    return with_thresholds(args.set, '--set')


def _rows(name: str, args: argparse.Namespace) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for row in progress(f'bench {name}', BENCHES[name](args), unit='case'):
        rows.append(row)
        if not args.json:
            if len(rows) == 1:
                about = provenance()
                changed = ''.join(f', {key} = {value:g}' for key, value in differing(_settings(args)).items())
                print(f'{name}: gyrocal {about["version"]}, {about["machine"]}{changed}')
            print_row(row, header=len(rows) == 1 or row.keys() != rows[-2].keys())
    return rows


def _compare_with_kept(args: argparse.Namespace) -> None:
    def each(function: Callable[[T], R], tasks: Sequence[T], /) -> Iterable[R]:
        return progress(function.__name__, in_parallel(function, tasks), total=len(tasks), unit='seed')

    if args.keep:
        write_text_atomic(BASELINE, json_text(baseline_to_dict(measure_baseline(each))), overwrite=True)
        print_message(f'kept in {BASELINE}')
        return
    outcomes = gate(each, load_baseline())
    if args.json:
        print_json(provenance() | {'figures': {item.name: _as_row(item) for item in outcomes}})
    for place, item in enumerate(outcomes if not args.json else ()):
        print_row({'figure': item.name} | _as_row(item), header=place == 0)
    left = [item.name for item in outcomes if not item.passes]
    if left:
        todo = 'fix it, or, if the change is intended, `gyrocal bench --quick --keep`'
        raise GyrocalError('worse than what is kept, beyond chance', where=', '.join(left), todo=todo)


def _as_row(item: Outcome) -> dict[str, Any]:
    kept = item.baseline
    return {'value': item.value, 'kept': kept.value, 'tolerance': kept.tolerance, 'passes': item.passes}
