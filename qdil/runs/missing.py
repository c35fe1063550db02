"""Train the runs that are missing, one after the other in this process, the expert and its demonstrations first."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from qdil.config import Config, make_config
from qdil.files import read_npz
from qdil.imitation.demo_report import report as demos_report
from qdil.methods import parse_method
from qdil.runs import summary
from qdil.runs.demos import make_demos
from qdil.runs.experiments import SEEDS
from qdil.runs.folder import RESULTS, demos_of, expert_seed_of, folder_of, is_finished
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

    A run of seed s learns from the expert of seed s, unless its experiment sets ``expert_seed``. Where demonstrations
    are missing, their expert is trained first and its episodes are recorded. ``say`` is called with a line of text per
    run, and with a table per file of demonstrations. ``report`` makes the ``Report`` of a run from its configuration.
    Raises ConfigError as ``train`` does.
    """
    for experiment in experiments:
        for seed in SEEDS[budget] if seeds is None else seeds:
            config = config_of(experiment, env, budget, seed)
            demos = _demonstrations(config, root, say, report) if parse_method(config.method).base.imitates else None
            _train(config, folder_of(experiment, env, budget, seed, root), demos, say, report)


def _demonstrations(config: Config, root: Path, say: Say, report: MakeReport) -> Path:
    """The file of demonstrations that ``config`` learns from; recorded first if it is missing."""
    path = demos_of(config, root)
    if not path.is_file():
        seed, demos = expert_seed_of(config), config.demos
        folder = folder_of("true", config.env, config.budget, seed, root)
        _train(make_config(config.env, "true", config.budget, seed), folder, None, say, report)
        make_demos(config.env, config.budget, demos.demo_episodes, seed, folder, path, demos.demo_attempts)
        say(f"recorded {path}\n{demos_report(read_npz(path))}")
    return path


def _train(config: Config, folder: Path, demos: Path | None, say: Say, report: MakeReport) -> None:
    if not is_finished(folder):
        say(f"training {folder}")
        train(config, folder, demos, report(config))
        say(summary.sentences(summary.read(folder)))
