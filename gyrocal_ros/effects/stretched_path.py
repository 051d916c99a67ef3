"""What the camera sees stretches the path along one direction of the room: no fault of any sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, Place, TypicalRange


@dataclass(frozen=True)
class StretchedPath:
    """`(a, b; b, -a)` times the path: longer along one direction of the room, shorter across it."""

    about: ClassVar[Explanation] = Explanation(
        physics='Where the edge of a near beam hides an edge of the ceiling behind it, the corner that both '
        'make is no point: it moves with the near edge across it, and with the far one along it. Seen while '
        'the robot drives, it has one depth in one direction and another in the other, so that the path '
        'seems longer or shorter than the wheels say, by the direction.',
        equation='p = p_odometry + (a, b; b, -a) p_odometry in the world',
        usual_size='some percent',
        best_motion='lanes in two directions of the room',
        source='Shi and Tomasi 1994, Good features to track: occlusion boundaries',
        example=(0.03, 0.0),
        shown_against='distance',
        disturbs=('wheels', 'ground', 'camera'),
        in_short='corners at which edges of different depths cross stretch the path along one direction',
    )
    acts_on: ClassVar[Place] = 'ground'
    name: str = 'stretched_path'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('a', '1', prior_std=0.05, typical=TypicalRange(0.01, 0.1)),
        Coefficient('b', '1', prior_std=0.05, typical=TypicalRange(0.01, 0.1)),
    )

    def contribute(self, block: MotionBlock, values: Array) -> tuple[Array, Array]:
        """Return the displacement (3,) over the block and its derivative (3, 2)."""
        assert block.heading_rad is not None
        x = float(block.distance_m @ np.cos(block.heading_rad))
        y = float(block.distance_m @ np.sin(block.heading_rad))
        by_values = np.array([[x, y], [-y, x], [0.0, 0.0]])
        return by_values @ values, by_values
