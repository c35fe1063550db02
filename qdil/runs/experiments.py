"""Which runs of experiments are finished. Does not import JAX.

The experiment ``mconbo-gail+bonus_q=1.0`` lies in ``results/<budget>/<env>/mconbo-gail+bonus_q=1.0/seed-<n>/``.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

from qdil.runs.folder import RESULTS, folder_of, is_finished

SEEDS = {"smoke": (1,), "laptop": (1, 2, 3), "full": (1, 2, 3)}  # the paper: three
EXPERT_SEED = 1  # one expert gives the demonstrations, as in the paper


def finished(
    experiments: Iterable[str], env: str, budget: str, seeds: Sequence[int] | None = None, root: Path = RESULTS
) -> dict[str, list[Path]]:
    """Folders of the finished runs, in the order of ``seeds`` (None: the budget's), of experiments that have any."""
    seeds = SEEDS[budget] if seeds is None else seeds
    folders = {e: [folder_of(e, env, budget, seed, root) for seed in seeds] for e in experiments}
    there = {e: [folder for folder in paths if is_finished(folder)] for e, paths in folders.items()}
    return {e: paths for e, paths in there.items() if paths}
