"""The bags of a fleet in the order in which a person should look at them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gyrocal_ros.fleet.findings import Findings, find
from gyrocal_ros.fleet.table import read_fleet

MOST = 200
"""Number of bags that a list shows."""


def bags_to_examine(folder: Path) -> list[tuple[str, Path]]:
    """Return titles and paths of the calibrated bags on this machine, at most `MOST`.

    The bags of the robot farthest from the fleet come first.

    Raises:
        GyrocalError: the folder holds no finished fleet.
    """
    found = find(read_fleet([folder]))
    table, distance = found.table, _distance(found)
    rows = [
        (-distance[str(robot)], str(robot), Path(bag))
        for robot, bag, good in zip(
            table.columns['robot'], table.columns['bag'], table.calibrated.tolist(), strict=True
        )
        if good and '://' not in bag and Path(bag).exists()
    ]
    return [(f'{robot}-{path.name}', path) for _, robot, path in sorted(rows)[:MOST]]


def _distance(found: Findings) -> dict[str, float]:
    """Return the largest distance of each robot from the fleet, in standard deviations."""
    largest = np.zeros(len(found.robots))
    for item in found.coefficients.values():
        known = len(item.robot_z)
        largest[:known] = np.maximum(largest[:known], np.nan_to_num(np.abs(item.robot_z)))
    return dict(zip(found.robots, largest.tolist(), strict=True))
