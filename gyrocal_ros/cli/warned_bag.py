"""A bag that is checked while it is read, whose warnings are printed whatever happens."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gyrocal_ros.bag.check import Checked, checked_bag
from gyrocal_ros.cli.output import print_message
from gyrocal_ros.config.sections import Config
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.msgs.issues import BagIssue, Severity, worst_per_kind


@contextmanager
def warned_bag(path: Path, config: Config, *, with_covariates: bool, **options: Any) -> Iterator[Checked]:
    """Provide a bag, and print its issues when the block ends; the arguments are those of `checked_bag`.

    Where the block ends in an error, the warnings may name its cause.

    Raises:
        GyrocalError: the bag cannot be read, or calibrated from.
    """
    seen: list[Checked] = []
    try:
        with checked_bag(path, config, with_covariates=with_covariates, **options) as checked:
            seen.append(checked)
            yield checked
    except GyrocalError:
        _print(
            [issue for checked in seen for issue in checked.issues if issue.severity is not Severity.ERROR]
        )
        raise
    _print(checked.issues)


def _print(issues: Sequence[BagIssue]) -> None:
    for issue in worst_per_kind(issues):
        print_message(f'{issue.severity}: {issue}')
