"""Novelty search with local competition (section 2.1; Lehman & Stanley, 2011), on pyribs' archive and ranker.

Novelty is the mean distance of a solution's measures from its nearest neighbours in an archive without cells. Local
competition is the number of those neighbours whose objective is lower. The ranker sorts a generation by both, as
NSGA-II does: first the front of solutions that no other one dominates (is as good in both, and better in one), then
those that only the first front dominates, and so on. Within a front, solutions far from the others come first.

Departures: the parents of a generation are the better half of the last one, where NSGA-II lets parents and children
compete. Lehman & Stanley add a third objective, genotypic diversity, instead of NSGA-II's distances.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from ribs.archives import ProximityArchive
from ribs.emitters import EmitterBase
from ribs.emitters.rankers import NSLCRanker

from qdil.lab.background.problems import Problem

NEIGHBOURS = 15  # a usual number in novelty search


def novelty_archive(problem: Problem, cells: int, seed: int) -> ProximityArchive:
    """An archive that accepts what is novel, or better than its nearest neighbour.

    "Novel" is a novelty of at least the width of a cell of a grid with ``cells`` per measure. Distances are in the
    measures' own units.
    """
    width = min(highest - lowest for lowest, highest in problem.measure_ranges) / cells
    return ProximityArchive(
        solution_dim=problem.solution_dim,
        measure_dim=len(problem.measure_ranges),
        k_neighbors=NEIGHBOURS,
        novelty_threshold=width,
        local_competition=True,
        seed=seed,
    )


class Generations(EmitterBase):
    """A population whose better half, by novelty and local competition, has two children each."""

    def __init__(self, archive: ProximityArchive, sigma: float, start: np.ndarray, seed: int) -> None:
        """``start`` (N, d) is the first generation; children are their parents plus normal noise of ``sigma``."""
        super().__init__(archive, solution_dim=archive.solution_dim, bounds=None, lower_bounds=None, upper_bounds=None)
        self.sigma, self.generation, self.rng = sigma, start, np.random.default_rng(seed)
        self.ranker = NSLCRanker()

    def ask(self) -> np.ndarray:
        """The present generation (N, d)."""
        return self.generation

    def tell(
        self, solution: ArrayLike, objective: ArrayLike, measures: ArrayLike, add_info: Any, **fields: ArrayLike
    ) -> None:
        """Make the next generation; ``add_info`` is what the archive found of this one, before it was added."""
        order, _ = self.ranker.rank(self, self.archive, {}, add_info)
        better_half = np.asarray(solution)[order[: -(-len(order) // 2)]]
        parents = np.resize(better_half, self.generation.shape)
        self.generation = parents + self.sigma * self.rng.standard_normal(parents.shape)
