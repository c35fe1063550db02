"""Problems that are measured with noise, as a policy's return and measures are from a few episodes."""

import numpy as np
from ribs.archives import GridArchive

from qdil.lab.background.problems import Problem


def noisy(problem: Problem, objective_sd: float, measure_sd: float, seed: int) -> Problem:
    """``problem`` with normal noise on every evaluation; its gradients stay exact.

    ``objective_sd`` is in units of the objective, ``measure_sd`` a share of each measure's range; measures are clipped
    to their ranges. The noise is a stream of its own that goes on from call to call, so make a new one for every run.
    """
    rng = np.random.default_rng(seed)
    low, high = np.array(problem.measure_ranges).T

    def evaluate(solutions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        objective, measures = problem.evaluate(solutions)
        said = objective + objective_sd * rng.standard_normal(objective.shape)
        where = measures + measure_sd * (high - low) * rng.standard_normal(measures.shape)
        return said, np.clip(where, low, high)

    return problem._replace(name=f"noisy {problem.name}", evaluate=evaluate)


def judged(problem: Problem, archive: GridArchive) -> GridArchive:
    """The elites of ``archive`` put where they belong, by what ``problem`` without noise says of them.

    An elite that noise had carried into a foreign cell moves home, where it may meet a better one: so the result never
    holds more elites than ``archive``, and its QD-score is what that archive is really worth.
    """
    home = GridArchive(solution_dim=problem.solution_dim, dims=list(archive.dims), ranges=problem.measure_ranges)
    stored = archive.data(["index", "solution"], return_type="dict")
    if len(stored["index"]):
        solutions = stored["solution"][np.argsort(stored["index"])]
        home.add(solutions, *problem.evaluate(solutions))
    return home
