"""The command `gyrocal`: finds the module of a command, runs it, and reports an error in one line.

A command is a module of this folder with the same name. It has

    the module's docstring               shown by --help
    EXAMPLE: str                         a few lines to copy, shown below it
    add_arguments(parser) -> None        declares its arguments
    run(args) -> None                    does the work; raises GyrocalError for every error a user can fix

A command's module is imported only when the command runs, so no command pays for the imports of another.
"""

from __future__ import annotations

import argparse
import importlib
import io
import os
import signal
import sys
import textwrap
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, NoReturn

from gyrocal_ros import __version__
from gyrocal_ros.errors import GyrocalError, nearest

COMMANDS = {
    'demo': 'calibrate on the bag that comes with the package and show the result',
    'simulate': 'write a bag of a simulated robot',
    'check': 'report the contents of a bag and its problems',
    'replay': 'calibrate the gyro from a bag',
    'diagnose': 'find the physical effect that the sensor model lacks',
    'compare': 'compare sensor models on a bag: errors, and where each fails',
    'effects': 'list the physical effects of the library, or explain one',
    'add': 'add an effect to a sensor model',
    'improve': 'add missing effects while the held-out error falls',
    'learn': 'learn a law that no effect of the library has',
    'fleet': 'calibrate many robots: spread, ageing, what all lack, a prior for the next one',
    'studio': 'do all this on a web page',
    'reveal': 'open the sealed answer of a simulated bag',
    'reproduce': 'reproduce the figures of the paper',
    'bench': 'measure speed and accuracy',
    'completion': 'complete commands and options with the Tab key, in bash or zsh',
}
"""Names and descriptions of the commands, in the order of `gyrocal --help`."""


class ArgumentParser(argparse.ArgumentParser):
    """An argparse parser that raises GyrocalError, so that a wrong argument is reported in one line."""

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse arguments; for an unknown option, suggest the one that resembles it."""
        parsed, unknown = self.parse_known_args(args, namespace)
        if not unknown:
            return parsed
        name, _, _ = unknown[0].partition('=')
        flags = [flag for action in self._actions for flag in action.option_strings]
        near = nearest(name, flags) if name.startswith('-') else None
        hint = f'did you mean {near}? ' if near else ''
        raise GyrocalError(f'unknown argument {unknown[0]!r}', todo=f'{hint}see {self.prog} --help')

    def error(self, message: str) -> NoReturn:
        """Raise an error of argparse as a GyrocalError."""
        raise GyrocalError(message, todo=f'see {self.prog} --help')


def main(argv: Sequence[str] | None = None) -> int:
    """Run `gyrocal` and return its exit status."""
    if '_ARGCOMPLETE' in os.environ:  # the shell asks what may come next
        importlib.import_module('gyrocal_ros.cli.completion').complete(os.environ['COMP_LINE'], COMMANDS)
    arguments = sys.argv[1:] if argv is None else list(argv)
    return run_program('gyrocal', lambda: _run(arguments))


def run_program(program: str, work: Callable[[], None]) -> int:
    """Do the work of a program, and report an error in one line.

    Args:
        program: name of the program, for the message.
        work: the work.

    Returns:
        Exit status: 0 done, 2 an error that the user can fix, 130 interrupted, 141 the reader of the
        output has ended.
    """
    for name in ('stdout', 'stderr'):
        if getattr(sys, name) is None:  # it is closed
            setattr(sys, name, open(os.devnull, 'w', encoding='utf-8'))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors='replace')  # a terminal without UTF-8 must not end the work
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')  # the filter's matrices are too small for threads
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that half-written results are removed
    try:
        work()
        sys.stdout.flush()
    except GyrocalError as error:
        _print_error(program, f'error: {error}')
        return 2
    except KeyboardInterrupt:
        _print_error(program, 'interrupted')
        return 130
    except BrokenPipeError:  # the reader, for example `head`, has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as error:
        place = f'{error.filename}: ' if error.filename else ''
        _print_error(
            program, f'error: {place}{error.strerror or error}; check paths, permissions and free space'
        )
        return 2
    except MemoryError:
        _print_error(program, 'error: not enough memory; use a shorter recording, or close other programs')
        return 2
    return 0


def _print_error(program: str, text: str) -> None:
    """Print an error, after which standard output or standard error may be unusable."""
    for stream, message in ((sys.stderr, f'{program}: {text}\n'), (sys.stdout, '')):
        try:
            stream.write(message)
            stream.flush()
        except OSError:  # it is full: let the interpreter flush into nothing at its end
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def command_parser(name: str) -> ArgumentParser:
    """Return the parser of one command.

    Args:
        name: one of `COMMANDS`.
    """
    return make_parser(f'gyrocal {name}', importlib.import_module(f'gyrocal_ros.cli.{name}'))


def make_parser(program: str, module: ModuleType) -> ArgumentParser:
    """Return the parser of a command, or of a program with the same structure.

    Args:
        program: name of the program.
        module: module of the program, with the contents of a command's module.
    """
    parser = ArgumentParser(
        prog=program,
        description=module.__doc__,
        epilog='example:\n' + textwrap.indent(module.EXAMPLE, '  '),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(parser)
    return parser


def _run(arguments: list[str]) -> None:
    if not arguments:
        _main_parser().print_help()
        return
    name: str = _main_parser().parse_args(arguments[:1]).command
    if name not in COMMANDS:
        near = nearest(name, COMMANDS)
        hint = f'did you mean gyrocal {near}? ' if near else ''
        raise GyrocalError(f'there is no command {name!r}', todo=f'{hint}see gyrocal --help')
    args = command_parser(name).parse_args(arguments[1:])
    importlib.import_module(f'gyrocal_ros.cli.{name}').run(args)


def _main_parser() -> ArgumentParser:
    width = max(map(len, COMMANDS))
    parser = ArgumentParser(
        prog='gyrocal',
        usage='gyrocal COMMAND ...',
        description='Calibrates the gyro of an indoor robot from its ceiling camera.',
        epilog='\n'.join(
            [
                'commands:',
                *(f'  {name:{width}}  {meaning}' for name, meaning in COMMANDS.items()),
                '',
                'example:',
                '  gyrocal demo',
                '  gyrocal COMMAND --help',
            ]
        ),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('--version', action='version', version=f'gyrocal {__version__}')
    parser.add_argument('command', nargs='?', metavar='COMMAND', help='what to do, see below')
    return parser


if __name__ == '__main__':
    sys.exit(main())
