"""Finds the finished runs of experiments. Does not import JAX.

The folder of experiment ``mconbo-gail+bonus_q=1.0`` is ``results/<budget>/<env>/mconbo-gail+bonus_q=1.0/seed-<n>/``.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

from qdil.runs.folder import RESULTS, folder_of, is_finished

FIRST_SEEDS = (1, 2, 3, 4, 5)  # of the runs that claims are judged from
RESERVE_SEEDS = (11, 12, 13, 14, 15)  # for comparisons that stay inconclusive after five seeds
COUNTED_SEEDS = FIRST_SEEDS + RESERVE_SEEDS  # any other seed is a trial, for example to choose settings
SEEDS = {"smoke": (1,), "laptop": (1, 2, 3), "desk": (1, 2, 3), "full": (1, 2, 3)}  # the paper: three


def finished(
    experiments: Iterable[str], env: str, budget: str, seeds: Sequence[int] | None = None, root: Path = RESULTS
) -> dict[str, list[Path]]:
    """Folders of finished runs by experiment, in the order of ``seeds`` (None: the budget's seeds).

    Experiments without a finished run are left out.
    """
    seeds = SEEDS[budget] if seeds is None else seeds
    folders = {e: [folder_of(e, env, budget, seed, root) for seed in seeds] for e in experiments}
    finished = {e: [folder for folder in paths if is_finished(folder)] for e, paths in folders.items()}
    return {e: paths for e, paths in finished.items() if paths}
