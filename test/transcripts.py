"""Runs the transcripts of the documentation and compares what the commands print: `make transcripts`.

A transcript is a fenced block of the language `text` with lines `$ gyrocal ...`, each followed by its output,
in which `...` stands for any lines. All transcripts of a page run in one empty folder, in order. This takes
minutes, so the test suite only runs the first example.
"""

from __future__ import annotations

import difflib
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(r'^```text\n(.*?)^```', re.DOTALL | re.MULTILINE)
OMITTED = '...'
NUMBER = re.compile(r'[-+]?\d+\.?\d*(?:e[-+]?\d+)?')
CLOSE = 0.8
"""Similarity from which a printed line is taken for a line of the page whose words have changed."""
RELATIVE = 0.02
"""Tolerance of a number, with two units of its last digit: another processor rounds differently."""


@dataclass(frozen=True, slots=True)
class Step:
    """A command of a transcript and the lines that it prints."""

    command: str
    output: tuple[str, ...]


def steps(text: str) -> Iterator[Step]:
    """Yield the commands of a page with their output."""
    for block in BLOCK.findall(text):
        command, output = '', []
        for line in [*block.splitlines(), '$ ']:
            if not line.startswith('$ '):
                output.append(line)
                continue
            if command.startswith('gyrocal '):
                yield Step(command, tuple(output))
            command, output = line.removeprefix('$ '), []


def agree(expected: Sequence[str], printed: Sequence[str]) -> bool:
    """Return True if the printed lines are the expected ones, where `...` stands for any lines."""
    if not expected:
        return not printed
    if expected[0] == OMITTED:
        return any(agree(expected[1:], printed[start:]) for start in range(len(printed) + 1))
    return bool(printed) and same_line(expected[0], printed[0]) and agree(expected[1:], printed[1:])


def same_line(expected: str, printed: str) -> bool:
    """Return True if two lines have the same words, and numbers that differ by rounding only."""
    if blank(expected) != blank(printed):
        return False
    pairs = zip(NUMBER.findall(expected), NUMBER.findall(printed), strict=True)
    return all(abs(float(a) - float(b)) <= RELATIVE * abs(float(a)) + last_digit(a) for a, b in pairs)


def last_digit(number: str) -> float:
    """Return twice the value of the last digit of a number."""
    mantissa, _, exponent = number.partition('e')
    return 2.0 * 10.0 ** (int(exponent or 0) - len(mantissa.partition('.')[2]))


def run(step: Step, folder: Path) -> list[str]:
    """Run the command of a step in a folder, and return the lines that it prints on standard output."""
    words = step.command.removeprefix('gyrocal ')
    code = 'import sys; from gyrocal_ros.cli.main import main; sys.exit(main())'
    done = subprocess.run(
        f'{sys.executable} -c "{code}" {words}', shell=True, cwd=folder, capture_output=True, text=True
    )
    if done.returncode:
        return [done.stderr]
    return done.stdout.replace(str(folder.resolve()), OMITTED).rstrip().splitlines()


def renewed(expected: Sequence[str], printed: Sequence[str]) -> list[str]:
    """Return the lines of a transcript as the command prints them now, omitting what was omitted.

    As many lines as before stand at the beginning and at the end; in between, lines with the same words.
    """
    if OMITTED not in expected:
        return list(printed)
    first = expected.index(OMITTED)
    last = len(expected) - 1 - expected[::-1].index(OMITTED)
    after = len(expected) - 1 - last
    lines, rest = list(printed[:first]), printed[first : len(printed) - after]
    start = 0
    for line in expected[first : last + 1]:
        close = difflib.get_close_matches(blank(line), map(blank, rest[start:]), n=1, cutoff=CLOSE)
        if line != OMITTED and line and close:
            place = next(i for i in range(start, len(rest)) if blank(rest[i]) == close[0])
            line, start = rest[place], place + 1
        lines.append(line)
    return lines + list(printed[len(printed) - after :])


def blank(line: str) -> str:
    """Return a line with a sign in place of each number."""
    return NUMBER.sub('#', ' '.join(line.split()))


def check(page: Path, update: bool) -> int:
    """Run the transcripts of a page, print the differences and return their number."""
    text, failures = page.read_text(encoding='utf-8'), 0
    with tempfile.TemporaryDirectory() as folder:
        for step in steps(text):
            printed = run(step, Path(folder))
            is_same = agree(step.output, printed)
            print(f'{page.name}: {"same" if is_same else "DIFFERS"}: {step.command}', flush=True)
            if not is_same:
                failures += 1
                changes = difflib.unified_diff(step.output, printed, 'page', 'printed', lineterm='')
                print('\n'.join(changes), flush=True)
                old, new = (
                    '\n'.join([f'$ {step.command}', *lines])
                    for lines in (step.output, renewed(step.output, printed))
                )
                text = text.replace(old, new, 1)
    if update:
        page.write_text(text, encoding='utf-8')
    return failures


def main(arguments: Sequence[str]) -> int:
    """Check some pages, or all; with `--update`, write what the commands print into them."""
    names = [name for name in arguments if name != '--update']
    pages = [Path(name) for name in names] or sorted([ROOT / 'README.md', *ROOT.glob('docs/*.md')])
    return min(sum(check(page, '--update' in arguments) for page in pages), 1)


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
