"""Train the runs that are missing, one after the other in this process, the expert and its demonstrations first."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from qdil.config import Config, make_config
from qdil.methods import parse_method
from qdil.runs.demos import make_demos
from qdil.runs.experiments import EXPERT_SEED, SEEDS
from qdil.runs.folder import RESULTS, demos_path, folder_of, is_finished
from qdil.runs.report import Report
from qdil.runs.studies import config_of
from qdil.runs.train import train

Say = Callable[[str], object]
MakeReport = Callable[[Config], Report | None]


def train_missing(
    experiments: Iterable[str],
    env: str,
    budget: str,
    seeds: Sequence[int] | None = None,
    root: Path = RESULTS,
    say: Say = print,
    report: MakeReport = lambda config: None,
) -> None:
    """Train the runs of ``experiments`` that are not finished (``seeds`` None: the budget's seeds).

    Where demonstrations are missing, the expert is trained first and its episodes are recorded. ``say`` is called with
    a line of text per run. ``report`` makes the ``Report`` of a run from its configuration. Raises ConfigError as
    ``train`` does.
    """
    for experiment in experiments:
        for seed in SEEDS[budget] if seeds is None else seeds:
            config = config_of(experiment, env, budget, seed)
            demos = _demonstrations(config, root, say, report) if parse_method(config.method).base.imitates else None
            _train(config, folder_of(experiment, env, budget, seed, root), demos, say, report)


def _demonstrations(config: Config, root: Path, say: Say, report: MakeReport) -> Path:
    """The file of demonstrations that ``config`` learns from; recorded first if it is missing."""
    path = demos_path(config.budget, config.env, config.demos.demo_episodes, root)
    if not path.is_file():
        expert = make_config(config.env, "true", config.budget, EXPERT_SEED)
        folder = folder_of("true", config.env, config.budget, EXPERT_SEED, root)
        _train(expert, folder, None, say, report)
        make_demos(config.env, config.budget, config.demos.demo_episodes, EXPERT_SEED, folder, path)
        say(f"recorded {path}")
    return path


def _train(config: Config, folder: Path, demos: Path | None, say: Say, report: MakeReport) -> None:
    if not is_finished(folder):
        say(f"training {folder}")
        train(config, folder, demos, report(config))
