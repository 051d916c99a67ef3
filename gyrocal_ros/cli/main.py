"""The command `gyrocal`: finds the command's module, runs it, and turns errors into one clear line.

A command is a module of this folder named after it, with

    the module's docstring               shown by --help
    EXAMPLE: str                         a line or two to copy, shown below it
    add_arguments(parser) -> None        declares its arguments
    run(args) -> None                    does the work; raises GyrocalError for all that a user can mend

It is imported only when it is asked for, so no command pays for the imports of another.
"""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
import textwrap
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import NoReturn

from gyrocal_ros import __version__
from gyrocal_ros.errors import GyrocalError

COMMANDS = {
    'demo': 'calibrate on the bag that comes with the package and show the result',
    'simulate': 'write a bag of a simulated robot',
    'check': 'say what is in a bag, and what is wrong with it',
    'replay': 'calibrate the gyro from a bag',
    'diagnose': 'say which physical effect the sensor model lacks',
    'compare': 'hold sensor models against a bag: errors, and where each fails',
    'effects': 'list the physical effects of the library, or explain one',
    'add': 'put an effect into a sensor model',
    'improve': 'add what is missing while the held-out error falls',
    'studio': 'do all that on a web page',
    'reveal': 'open the sealed answer of a simulated bag',
    'reproduce': 'make the figures of the paper anew',
    'bench': 'measure speed and accuracy',
}
"""Name and meaning of every command, in the order of `gyrocal --help`."""


class ArgumentParser(argparse.ArgumentParser):
    """An argparse parser whose complaints are errors like any other: one line."""

    def error(self, message: str) -> NoReturn:
        """Raise what argparse has to complain about."""
        raise GyrocalError(message, todo=f'see {self.prog} --help')


def main(argv: Sequence[str] | None = None) -> int:
    """Run `gyrocal` and return its exit status."""
    arguments = sys.argv[1:] if argv is None else list(argv)
    return guarded('gyrocal', lambda: _run(arguments))


def guarded(program: str, work: Callable[[], None]) -> int:
    """Do the work of a program, and tell what went wrong in one line.

    Returns:
        Exit status: 0 done, 2 the user can mend it, 130 interrupted.
    """
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')  # the filter's matrices are too small to share
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that half-written results are removed
    try:
        work()
        sys.stdout.flush()
    except GyrocalError as error:
        print(f'{program}: error: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f'{program}: interrupted', file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader, `head` for one, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    return 0


def parser_of(name: str) -> ArgumentParser:
    """The parser of one command.

    Args:
        name: one of `COMMANDS`.
    """
    return make_parser(f'gyrocal {name}', importlib.import_module(f'gyrocal_ros.cli.{name}'))


def make_parser(program: str, module: ModuleType) -> ArgumentParser:
    """The parser of a command, or of a program that is made like one."""
    parser = ArgumentParser(
        prog=program,
        description=module.__doc__,
        epilog='example:\n' + textwrap.indent(module.EXAMPLE, '  '),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(parser)
    return parser


def _run(arguments: list[str]) -> None:
    name = _overview().parse_args(arguments[:1]).command
    args = parser_of(name).parse_args(arguments[1:])
    importlib.import_module(f'gyrocal_ros.cli.{name}').run(args)


def _overview() -> ArgumentParser:
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
    parser.add_argument('command', choices=COMMANDS, metavar='COMMAND', help='what to do, see below')
    return parser


if __name__ == '__main__':
    sys.exit(main())
