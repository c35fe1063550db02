"""Tables of finished runs: learning curves, final metrics by seed, their summary, and the paper's numbers beside them.

Everywhere here ``runs`` are folders of finished runs by experiment, one folder per seed, as ``experiments.finished``
and the notebooks' ``page.runs`` give them.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from qdil import run
from qdil.evidence import paper

Runs = Mapping[str, Sequence[Path]]

COLUMNS = {
    "qd_score": "QD-score",
    "coverage": "coverage",
    "best": "best",
    "average": "average",
    "rescored_average": "average, scored again",
    "million_steps": "million steps",
    "minutes": "minutes",
}


def read_metrics(runs: Runs) -> dict[str, list[pd.DataFrame]]:
    """The whole ``metrics.csv`` of every run, by experiment, in the order of its folders."""
    return {name: [pd.read_csv(folder / "metrics.csv") for folder in folders] for name, folders in runs.items()}


def final(runs: Runs) -> pd.DataFrame:
    """A row per experiment and seed with its final metrics, from the run's own files alone.

    Index ``experiment`` and ``seed``; columns ``qd_score``, ``best``, ``average`` in reward units, ``coverage`` as a
    share of the cells, ``rescored_average`` (the elites over fresh episodes, free of the luck that won them their
    cells), ``million_steps`` and ``minutes``.
    """
    rows = {(name, _seed(folder)): _last(folder) for name, folders in runs.items() for folder in folders}
    index = pd.MultiIndex.from_tuples(list(rows), names=["experiment", "seed"])
    return pd.DataFrame(list(rows.values()), index=index, columns=list(COLUMNS))


def _seed(folder: Path) -> int:
    return int(folder.name.removeprefix("seed-"))


def _last(folder: Path) -> dict[str, float]:
    last = pd.read_csv(folder / "metrics.csv").iloc[-1]
    return {
        **{name: float(last[name]) for name in ("qd_score", "coverage", "best", "average")},
        "rescored_average": float(run.read_archive(folder)["rescored_return"].mean()),
        "million_steps": float(last["env_steps"]) / 1e6,
        "minutes": float(last["wall_seconds"]) / 60,
    }


def text(metric: str, value: float, spread: float | None = None) -> str:
    """A number as tables show it, "mean ± standard deviation" where there is a spread."""
    scale, digits, unit = {"coverage": (100, 1, "%"), "million_steps": (1, 1, ""), "minutes": (1, 1, "")}.get(
        metric, (1, 0, "")
    )
    shown = f"{scale * value:,.{digits}f}"
    return f"{shown}{unit}" if spread is None else f"{shown} ± {scale * spread:,.{digits}f}{unit}"


def summary(runs: Runs) -> pd.DataFrame:
    """A row per experiment, texts: the mean over seeds ± its standard deviation; of a single seed the number alone.

    The column "seeds" counts them.
    """
    groups = final(runs).groupby(level="experiment", sort=False)
    rows = {}
    for name, group in groups:
        spreads = group.std(ddof=1) if len(group) > 1 else dict.fromkeys(COLUMNS)
        numbers = {title: text(key, group[key].mean(), spreads[key]) for key, title in COLUMNS.items()}
        rows[name] = {"seeds": str(len(group)), **numbers}
    return pd.DataFrame.from_dict(rows, orient="index", columns=["seeds", *COLUMNS.values()]).rename_axis("experiment")


def beside_paper(runs: Runs, env: str) -> pd.DataFrame:
    """``summary``'s four metrics, each with the paper's number beside ours; texts, "not recoverable" where it is lost.

    An experiment with settings that the paper did not report, other numbers of demonstrations aside, has no number of
    the paper's to stand beside.
    """
    ours = summary(runs)
    table = {}
    for key in paper.METRICS:
        title = COLUMNS[key]
        table[title, "ours"] = ours[title].to_dict()
        table[title, "paper"] = {name: of_paper(env, name, key) for name in ours.index}
    return pd.DataFrame(table, index=ours.index)


def of_paper(env: str, experiment: str, metric: str) -> str:
    """The paper's number for an experiment as a text, or "not recoverable"."""
    number = paper_value(env, experiment, metric)
    return paper.NOT_RECOVERABLE if number is None else text(metric, number)


def paper_value(env: str, experiment: str, metric: str, origin: str = paper.PAPER) -> float | None:
    """The paper's number for an experiment; None where it is lost or the experiment is not one of the paper's."""
    method, *settings = experiment.split("+")
    demos = [setting.removeprefix("demo_episodes=") for setting in settings if setting.startswith("demo_episodes=")]
    if len(demos) < len(settings):
        return None
    return paper.value(env, method, metric, int(demos[0]) if demos else 4, origin)
