"""Where the runs of experiments lie, which are finished, and training those that are missing.

The experiment ``mconbo-gail+bonus_q=1.0`` lies in ``results/<budget>/<env>/mconbo-gail+bonus_q=1.0/seed-<n>/``.
"""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from qdil import run
from qdil.config import Config, make_config
from qdil.evidence.studies import config_of
from qdil.registry import bases, parse_method

SEEDS = {"smoke": (1,), "laptop": (1, 2, 3), "full": (1, 2, 3)}  # the paper: three
EXPERT_SEED = 1  # one expert gives the demonstrations, as in the paper


def folder_of(experiment: str, env: str, budget: str, seed: int, root: Path = run.RESULTS) -> Path:
    """Where an experiment's run lies."""
    return root / budget / env / experiment / f"seed-{seed}"


def finished(
    experiments: Iterable[str], env: str, budget: str, seeds: Sequence[int] | None = None, root: Path = run.RESULTS
) -> dict[str, list[Path]]:
    """Folders of the finished runs, in the order of ``seeds`` (None: the budget's), of experiments that have any."""
    seeds = SEEDS[budget] if seeds is None else seeds
    folders = {e: [folder_of(e, env, budget, seed, root) for seed in seeds] for e in experiments}
    there = {e: [folder for folder in paths if run.is_finished(folder)] for e, paths in folders.items()}
    return {e: paths for e, paths in there.items() if paths}


def train_missing(
    experiments: Iterable[str],
    env: str,
    budget: str,
    seeds: Sequence[int] | None = None,
    root: Path = run.RESULTS,
    say: Callable[[str], object] = print,
    report: Callable[[Config], run.Report | None] = lambda config: None,
) -> None:
    """Train, one after the other in this process, what is not finished yet, with the expert and demonstrations first.

    ``say`` hears a line for each run that is trained; ``report`` gives what each run reports its iterations to.
    Raises ConfigError as training does.
    """
    for experiment in experiments:
        for seed in SEEDS[budget] if seeds is None else seeds:
            config = config_of(experiment, env, budget, seed)
            demos = _demonstrations(config, root, say, report) if _imitates(config.method) else None
            _train(config, folder_of(experiment, env, budget, seed, root), demos, say, report)


def _imitates(method: str) -> bool:
    return bases()[parse_method(method).base].imitates


def _demonstrations(config: Config, root: Path, say: Callable, report: Callable) -> Path:
    """The demonstrations that ``config`` learns from, recorded from an expert trained first, if need be."""
    path = run.demos_path(config.budget, config.env, config.demo_episodes, root)
    if not path.is_file():
        expert = make_config(config.env, "true", config.budget, EXPERT_SEED)
        folder = run.folder_of(expert, root)
        _train(expert, folder, None, say, report)
        run.make_demos(config.env, config.budget, config.demo_episodes, EXPERT_SEED, folder, path)
        say(f"recorded {path}")
    return path


def _train(config: Config, folder: Path, demos: Path | None, say: Callable, report: Callable) -> None:
    if not run.is_finished(folder):
        say(f"training {folder}")
        run.train(config, folder, demos, report(config))
