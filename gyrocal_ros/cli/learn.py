"""Learn a law that no effect of the library has: what the gyro's bias or scale follows, and how.

First the library is searched, as by `gyrocal improve`. If the recording still contradicts the model, the
filter runs once with many general functions beside it: curves of every recorded signal, of acceleration and
heading, memories of turns, a map of the room, jumps. The likeliest ones get a run of their own. A law is kept
if it raises the predictive log-likelihood, which scores each measurement before it is used, and if the
held-out drift does not rise. A learned curve and the response of a learned memory are compared with closed
forms.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from gyrocal_ros.cli.bag_runs import add_run_options, open_bag_runs, result_folder
from gyrocal_ros.cli.figures import draw_if_requested, print_if_requested
from gyrocal_ros.cli.improve import announced, as_text, files_as_text, laws_as_text
from gyrocal_ros.cli.model_options import add_model_options, read_model
from gyrocal_ros.cli.output import print_json
from gyrocal_ros.diagnose.analysis.examined import examine
from gyrocal_ros.diagnose.analysis.runs import remembered
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.json_summary import summarise_improvement
from gyrocal_ros.diagnose.laws.hypotheses import law_names
from gyrocal_ros.diagnose.laws.learned_laws import LearnedLaw, summarise_laws
from gyrocal_ros.diagnose.laws.learning import Learned, is_missing_something, learn
from gyrocal_ros.diagnose.laws.rewriting import closed_form
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.diagnose.search.improvement import improvement
from gyrocal_ros.diagnose.search.timing import timing_fault
from gyrocal_ros.effects.learned.as_effect import effect_source
from gyrocal_ros.effects.learned.events import event_of
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.files import write_text_atomic
from gyrocal_ros.report.laws import nothing_learned

EXAMPLE = """gyrocal learn my_bag -o learned
gyrocal learn my_bag --follows heading
gyrocal learn my_bag --kind memory --follows turn_side
gyrocal learn my_bag --follows battery_state.current --as-effect my_effects.py
gyrocal replay another_bag --model learned/model.yaml"""

KINDS = ('curve', 'memory', 'map', 'step', 'wave')
OF = ('bias', 'scale')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_run_options(parser)
    add_model_options(parser)
    parser.add_argument(
        '--follows',
        metavar='SIGNAL',
        help='learn only what follows rate, heading, force_y, temperature, a recorded signal, ...',
    )
    parser.add_argument('--acts-on', choices=OF, help='learn only what this follows')
    parser.add_argument('--kind', choices=KINDS, help='learn this kind only')
    parser.add_argument(
        '--as-effect', type=Path, metavar='FILE', help='write the best closed form as an effect of your own'
    )


def run(args: argparse.Namespace) -> None:
    """Search the library, learn, and write the history.

    Raises:
        GyrocalError: the bag or the model cannot be used, or OUT or FILE cannot be written.
    """
    began_s = time.perf_counter()
    model = read_model(args)
    if args.as_effect and args.as_effect.exists() and not args.overwrite:
        raise ConfigError(
            'exists already', where=str(args.as_effect), todo='name another file or --overwrite'
        )
    with result_folder(args) as folder, open_bag_runs(args, model) as runs:
        recorded = summarise_recording(runs.source)
        calibrate = remembered(announced(runs), runs.workers)
        only = requested(args, law_names(recorded.ranges))
        if only:
            searched = Search(examine(model, recorded, calibrate), ())
        else:
            searched = find_missing(model, recorded, calibrate)
        learned = learn(searched, recorded, calibrate, only)
        improved, laws = improvement(learned.searched, has_learned=True), learned.laws
        if folder is not None:
            # Only a page needs the plotting library.
            from gyrocal_ros.report.improvement import improvement_sections
            from gyrocal_ros.report.write import fill_improvement

            fill_improvement(folder, improved, runs.issues, laws)
            draw_if_requested(args.png, folder, improvement_sections(improved, laws))
            print_if_requested(args.pdf, folder)
        written = _written(args, learned, laws)
    if args.json:
        summary = summarise_improvement(improved) | {'learned': summarise_laws(laws)}
        summary |= {'given_up': learned.given_up}
        print_json(summary | {'wall_s': time.perf_counter() - began_s})
    else:
        print(
            '\n'.join(
                [
                    *as_text(improved),
                    *_laws_as_text(learned, laws),
                    *written,
                    *files_as_text(args.out, improved),
                ]
            )
        )


def requested(args: argparse.Namespace, names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the laws that are requested; empty for all.

    Args:
        args: arguments of the command.
        names: laws that the recording allows, such as `bias_curve:rate`.

    Raises:
        ConfigError: there is no such law.
    """
    if args.kind is None and args.acts_on is None and args.follows is None:
        return ()
    wanted = []
    for name in names:
        kind, _, follows = name.partition(':')
        event = event_of(follows)
        signal = follows if event is None else event.signal
        of, _, shape = kind.partition('_')
        if args.kind in (None, shape) and args.acts_on in (None, of):
            wanted.append((name, signal))
    chosen = tuple(name for name, signal in wanted if args.follows in (None, signal))
    if not chosen:
        where = ' '.join(
            f'{flag} {value}'
            for flag, value in (
                ('--kind', args.kind),
                ('--acts-on', args.acts_on),
                ('--follows', args.follows),
            )
            if value is not None
        )
        signals = list(dict.fromkeys(signal for _, signal in wanted))
        todo = did_you_mean(args.follows, signals) if signals else 'leave one of them out'
        raise ConfigError('no such law can be learned from this recording', where=where, todo=todo)
    return chosen


def _laws_as_text(learned: Learned, laws: list[LearnedLaw]) -> Iterator[str]:
    last = learned.searched.last
    if not laws and timing_fault(last) is None:  # then none was tried, and the status says why
        yield from ('', nothing_learned(is_missing_something(last)))
    if learned.given_up:
        yield from ('', f'Not needed any more: {", ".join(learned.given_up)}, which the library had added.')
    yield from laws_as_text(laws)


def _written(args: argparse.Namespace, learned: Learned, laws: list[LearnedLaw]) -> list[str]:
    """Write the best closed form as an effect, if requested."""
    if not args.as_effect:
        return []
    every = (closed_form(law, learned.searched.last) for law in laws)
    found = next((closed for closed in every if closed is not None), None)
    if found is None:
        return ['', f'{args.as_effect} was not written: no law with a closed form was learned.']
    effect, values = found
    text = effect_source(effect, values.tolist(), args.bag.name or str(args.bag))
    write_text_atomic(args.as_effect, text, overwrite=args.overwrite)
    return ['', f'Effect: {args.as_effect}; try `gyrocal improve BAG --effects-from {args.as_effect}`.']
