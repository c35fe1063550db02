"""Problems with noisy evaluations, like a policy's return and measures from a few episodes."""

import numpy as np
from ribs.archives import GridArchive

from qdil.lab.background.problems import Problem


def noisy(problem: Problem, objective_sd: float, measure_sd: float, seed: int) -> Problem:
    """``problem`` with normal noise on every evaluation; its gradients stay exact.

    ``objective_sd`` is in units of the objective, ``measure_sd`` a share of each measure's range; measures are clipped
    to their ranges. Every call draws new noise from one generator, so make a new problem for every run.
    """
    rng = np.random.default_rng(seed)
    low, high = np.array(problem.measure_ranges).T

    def evaluate(solutions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        objective, measures = problem.evaluate(solutions)
        noisy_objective = objective + objective_sd * rng.standard_normal(objective.shape)
        noisy_measures = measures + measure_sd * (high - low) * rng.standard_normal(measures.shape)
        return noisy_objective, np.clip(noisy_measures, low, high)

    return problem._replace(name=f"noisy {problem.name}", evaluate=evaluate)


def rescored(problem: Problem, archive: GridArchive) -> GridArchive:
    """A new archive with the elites of ``archive`` evaluated on ``problem``, which has no noise.

    An elite that noise had put into a wrong cell moves to its own, where a better elite may replace it. So the result
    never holds more elites than ``archive``, and its metrics are the true ones.
    """
    home = GridArchive(solution_dim=problem.solution_dim, dims=list(archive.dims), ranges=problem.measure_ranges)
    stored = archive.data(["index", "solution"], return_type="dict")
    if len(stored["index"]):
        solutions = stored["solution"][np.argsort(stored["index"])]
        home.add(solutions, *problem.evaluate(solutions))
    return home
