"""Print what bash or zsh needs to complete the commands, options and names of `gyrocal` with the Tab key.

Evaluate it in the shell, or add the line to ~/.bashrc or ~/.zshrc. Files are completed where a file is
expected, and effects, scenarios and figures of the paper by their names.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from importlib import import_module

import argcomplete
from argcomplete.shell_integration import shellcode

EXAMPLE = """gyrocal completion bash
gyrocal completion zsh"""
SHELLS = ('bash', 'zsh')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        'shell',
        choices=SHELLS,
        metavar='SHELL',
        help='bash or zsh: write `eval "$(gyrocal completion bash)"` into ~/.bashrc, or the same with zsh '
        'into ~/.zshrc',
    )


def run(args: argparse.Namespace) -> None:
    """Print the code for the shell."""
    print(shellcode(['gyrocal'], shell=args.shell))


def complete(line: str, commands: Iterable[str]) -> None:
    """Print the possible next words of a command line for the shell, and exit.

    Only the command that the line names is imported, because the user waits.

    Args:
        line: the command line so far.
        commands: names of the commands.
    """
    parser = argparse.ArgumentParser(prog='gyrocal')
    parser.add_argument('--version', action='store_true')
    subparsers = parser.add_subparsers()
    for name in commands:
        command = subparsers.add_parser(name)
        if name in line.split()[1:2]:
            import_module(f'gyrocal_ros.cli.{name}').add_arguments(command)
    argcomplete.autocomplete(parser)
