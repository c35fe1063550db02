"""Tables of finished runs: learning curves, final metrics by seed, their summary, and the paper's numbers beside them.

Everywhere here ``runs`` are folders of finished runs by experiment, one folder per seed, as ``experiments.finished``
and the notebooks' ``page.runs`` give them.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import pandas as pd

from qdil.evidence import corrected, paper, stats
from qdil.robots.register import PAPER_ROBOTS
from qdil.runs.experiments import COUNTED_SEEDS, finished
from qdil.runs.folder import RESULTS
from qdil.runs.studies import without_protocol

Runs = Mapping[str, Sequence[Path]]

COLUMNS = {
    "qd_score": "QD-score",
    "corrected_qd_score": "corrected QD-score",
    "coverage": "coverage",
    "corrected_coverage": "corrected coverage",
    "best": "best",
    "corrected_best": "corrected best",
    "average": "average",
    "corrected_average": "corrected average",
    "relanded": "lands in own cell",
    "relanded_near": "own or next cell",
    "million_steps": "million steps",
    "minutes": "minutes",
}
SHORT = {"standard error": "s.e."}
# The factor, format and unit of a metric in tables; other metrics are shown as whole numbers.
FORMS = {
    **dict.fromkeys(("qd_score", "corrected_qd_score"), (1, ",.0f", "")),
    **dict.fromkeys(("coverage", "corrected_coverage", *corrected.SHARES), (100, ".1f", "%")),
    "million_steps": (1, ".1f", ""),
    "minutes": (1, ".1f", ""),
}


def finished_seeds(names: Iterable[str], env: str, budget: str, root: Path = RESULTS) -> dict[str, list[Path]]:
    """``experiments.finished`` for every seed that has a run, not only for the budget's seeds."""
    names = tuple(names)
    found = {path.name for name in names for path in (root / budget / env / name).glob("seed-*")}
    seeds = sorted(int(name.removeprefix("seed-")) for name in found if name.removeprefix("seed-").isdigit())
    return finished(names, env, budget, seeds, root)


def counted_seeds(names: Iterable[str], env: str, budget: str, root: Path = RESULTS) -> dict[str, list[Path]]:
    """``finished_seeds`` without the seeds of trials: those that claims are judged from."""
    runs = finished_seeds(names, env, budget, root)
    counted = {name: [folder for folder in paths if seed_of(folder) in COUNTED_SEEDS] for name, paths in runs.items()}
    return {name: paths for name, paths in counted.items() if paths}


def read_metrics(runs: Runs) -> dict[str, list[pd.DataFrame]]:
    """The whole ``metrics.csv`` of every run, by experiment, in the order of its folders."""
    return {name: [pd.read_csv(folder / "metrics.csv") for folder in folders] for name, folders in runs.items()}


def final(runs: Runs) -> pd.DataFrame:
    """A row per experiment and seed with the run's final metrics, read from its files.

    Index ``experiment`` and ``seed``; columns ``qd_score``, ``best``, ``average`` in reward units and ``coverage`` as a
    share of the cells, each as claimed and ``corrected_`` (``qdil.qd.landing``); ``relanded`` and ``relanded_near`` as
    shares of the elites; ``million_steps`` and ``minutes``.
    """
    rows = {(name, seed_of(folder)): _last(folder) for name, folders in runs.items() for folder in folders}
    index = pd.MultiIndex.from_tuples(list(rows), names=["experiment", "seed"])
    return pd.DataFrame(list(rows.values()), index=index, columns=list(COLUMNS))


def seed_of(folder: Path) -> int:
    """The seed in the name of a run's folder."""
    return int(folder.name.removeprefix("seed-"))


def _last(folder: Path) -> dict[str, float]:
    last = pd.read_csv(folder / "metrics.csv").iloc[-1]
    return {
        **corrected.of_run(folder),
        **{name: float(last[name]) for name in corrected.METRICS},
        "million_steps": float(last["env_steps"]) / 1e6,
        "minutes": float(last["wall_seconds"]) / 60,
    }


def text(metric: str, value: float, spread: float | None = None) -> str:
    """A number as tables show it; with a ``spread`` as "mean ± standard deviation"."""
    factor, form, unit = FORMS.get(metric, (1, ".0f", ""))
    shown = format(factor * value, form)
    return f"{shown}{unit}" if spread is None else f"{shown} ± {format(factor * spread, form)}{unit}"


def summary(runs: Runs) -> pd.DataFrame:
    """A row per experiment of texts: the mean over seeds ± its standard deviation, or the number of a single seed.

    The column "seeds" is the number of seeds.
    """
    groups = final(runs).groupby(level="experiment", sort=False)
    rows = {}
    for name, group in groups:
        spreads = group.std(ddof=1) if len(group) > 1 else dict.fromkeys(COLUMNS)
        numbers = {title: text(key, group[key].mean(), spreads[key]) for key, title in COLUMNS.items()}
        rows[name] = {"seeds": str(len(group)), **numbers}
    return pd.DataFrame.from_dict(rows, orient="index", columns=["seeds", *COLUMNS.values()]).rename_axis("experiment")


def ends(runs: Runs, iterations: int = 10) -> pd.DataFrame:
    """Mean ± standard deviation of the four metrics over the last ``iterations`` of all seeds, as in Table 9."""
    rows = {}
    for name, seeds in read_metrics(runs).items():
        last = pd.concat([seed.tail(iterations) for seed in seeds])
        rows[name] = {COLUMNS[key]: text(key, last[key].mean(), last[key].std()) for key in paper.METRICS}
    columns = [COLUMNS[key] for key in paper.METRICS]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("experiment")


def beside_paper(runs: Runs, env: str) -> pd.DataFrame:
    """``summary``'s four metrics: ours as claimed and corrected, and the paper's, as texts; see ``of_paper``."""
    ours = summary(runs)
    table = {}
    for key in paper.METRICS:
        title = COLUMNS[key]
        table[title, "ours"] = ours[title].to_dict()
        table[title, "corrected"] = ours[COLUMNS[f"corrected_{key}"]].to_dict()
        table[title, "paper"] = {name: of_paper(env, name, key) for name in ours.index}
    return pd.DataFrame(table, index=ours.index)


def of_paper(env: str, experiment: str, metric: str) -> str:
    """The paper's number for an experiment as a text, with its spread if that is known: "1,429 ± 42 (s.e.)".

    "not recoverable" if the copy at hand does not have it, "not in the paper" if there never was one.
    """
    number = paper_value(env, experiment, metric)
    if number is None:
        return paper.NOT_RECOVERABLE if paper.has(env, without_protocol(experiment)) else paper.NOT_IN_PAPER
    method, demos = _method_and_demos(experiment)
    spread = paper.spread(env, method, metric, demos)
    if spread is None:
        return text(metric, number)
    return f"{text(metric, number, spread.value)} ({SHORT.get(spread.kind, spread.kind)})"


def paper_value(env: str, experiment: str, metric: str, origin: str = paper.PAPER) -> float | None:
    """The paper's number for an experiment; None if it is not in the copy at hand, or not in the paper.

    The number of demonstrations is the only varied setting for which the paper gives numbers. A protocol is a reading
    of the paper, so all protocols have the same number beside them.
    """
    method, demos = _method_and_demos(experiment)
    return paper.value(env, method, metric, demos, origin) if demos else None


def _method_and_demos(experiment: str) -> tuple[str, int]:
    """An experiment's method and number of demonstrations, 4 unless named; 0 if a setting but the protocol differs."""
    method, *settings = without_protocol(experiment).split("+")
    demos = [setting.removeprefix("demo_episodes=") for setting in settings if setting.startswith("demo_episodes=")]
    if len(demos) < len(settings):
        return method, 0
    return method, int(demos[0]) if demos else 4


def share_of_expert(runs: Mapping[str, Runs], metric: str = "qd_score") -> pd.DataFrame:
    """A metric as a share of the expert's, over robots: a row per experiment with its interquartile mean.

    ``runs`` by robot. Each run is divided by the mean of the same robot's ``true`` runs; a robot without such runs is
    left out. ``low`` and ``high`` bound the 95 % bootstrap interval, resampled within each robot. ``robots`` and
    ``seeds`` are the numbers of robots and of seeds over all robots.
    """
    by_experiment: dict[str, list[list[float]]] = {}
    for by_name in runs.values():
        if "true" in by_name:
            values = final(by_name)[metric]
            shares = values / values.xs("true", level="experiment").mean()
            for name, group in shares.groupby(level="experiment", sort=False):
                by_experiment.setdefault(str(name), []).append(group.to_list())
    rows = {
        name: {"robots": len(strata), "seeds": sum(map(len, strata)), **stats.stratified(strata)._asdict()}
        for name, strata in by_experiment.items()
    }
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["robots", "seeds", *stats.Interval._fields])
    return table.rename(columns={"estimate": "share"}).rename_axis("experiment")


def later_paper(envs: Sequence[str] = PAPER_ROBOTS, methods: Sequence[str] | None = None) -> pd.DataFrame:
    """The table of the paper's later version as texts: a row per robot and method (of ``methods``; None: of all)."""
    found = paper.numbers()
    found = found[(found["origin"] == paper.LATER) & found["environment"].isin(envs)]
    if methods is not None:
        found = found[found["method"].isin(methods)]
    return published(found).rename_axis(["robot", "method"])


def published(numbers: pd.DataFrame, index: Sequence[str] = ("environment", "method")) -> pd.DataFrame:
    """Rows of ``paper.numbers()`` as texts, a column per metric; ``index`` names the columns that identify a row."""
    values = numbers.pivot_table(index=list(index), columns="metric", values="value", sort=False)
    values = values.rename(columns={"coverage_pct": "coverage"})[list(paper.METRICS)]
    values["coverage"] /= 100.0
    return pd.DataFrame({COLUMNS[key]: [text(key, x) for x in values[key]] for key in paper.METRICS}, values.index)
