"""The experiments of the reproduction by name, in the order of the paper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from gyrocal_ros.bench.paper.at_rest import figure_9
from gyrocal_ros.bench.paper.convergence import figure_10
from gyrocal_ros.bench.paper.experiment import Claim, Mapper
from gyrocal_ros.bench.paper.landmark import figure_14, figure_15
from gyrocal_ros.bench.paper.mapping import figure_7
from gyrocal_ros.bench.paper.rate_table import figure_8
from gyrocal_ros.bench.paper.tracks import figure_12, figure_13
from gyrocal_ros.bench.paper.without_camera import figure_11, table_1


class PaperResult(Protocol):
    """Result of an experiment: numbers, and the assessment of the paper's claims."""

    @property
    def claims(self) -> tuple[Claim, ...]: ...


@dataclass(frozen=True, slots=True)
class Experiment:
    """One figure or table of the paper."""

    title: str
    make: Callable[[Mapper, int], PaperResult]
    seeds: int
    """Default number of seeds."""
    least: int = 1
    most: int | None = None
    """Bounds of the number of seeds; None for no upper bound."""

    def count(self, requested: int | None) -> int:
        """Return the number of seeds for a requested number; None requests the default."""
        count = max(requested or self.seeds, self.least)
        return count if self.most is None else min(count, self.most)


EXPERIMENTS = {
    'fig7': Experiment('Fig. 7: the feature map', figure_7, 12),
    'fig8': Experiment('Fig. 8: the scale factor on a rate table', figure_8, 4, least=4, most=4),
    'fig9': Experiment('Fig. 9: the gyro at rest', figure_9, 12),
    'fig10': Experiment('Fig. 10: convergence of the scale factor', figure_10, 24),
    'table1': Experiment('Table 1: heading after ten rotations', table_1, 20, least=10),
    'fig11': Experiment('Fig. 11: heading after ten minutes of cleaning', figure_11, 12, least=12, most=12),
    'fig12': Experiment('Fig. 12: dead reckoning, calibrated and not', figure_12, 12),
    'fig13': Experiment('Fig. 13: SLAM and dead reckoning', figure_13, 12),
    'fig14': Experiment('Fig. 14: landmark error without noise', figure_14, 1, most=1),
    'fig15': Experiment('Fig. 15: landmark error with noise of half a pixel', figure_15, 200),
}
