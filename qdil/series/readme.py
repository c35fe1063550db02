"""The generated parts of the README and of pages under ``docs/``: tables of numbers, and sentences on verdicts.

``make contents`` writes each part between its markers. Notebooks come from their index, results and verdicts from the
kept runs, settings from the budgets, and speeds from the files of ``qdil bench``. None of these numbers is typed.
"""

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from qdil.config import BUDGETS, make_config
from qdil.evidence import claims, diagnosis, protocol_page, report, tables, trials
from qdil.evidence.markdown import markdown_table
from qdil.evidence.verdicts import INCONCLUSIVE, NO_RUNS, NOT_REPRODUCED, PAPER, REPRODUCED, Verdict, together
from qdil.names import title
from qdil.runs.studies import MAIN
from qdil.series import index

RESULTS = index.ROOT / "results"
ROBOT, BUDGET = "walker2d", "laptop"  # whose runs the README shows
MEASURED = ("walker2d", "halfcheetah", "humanoid")  # robots whose speed the bench measured
# What the verdict on C1 means for a reader, whichever it is.
MAIN_CLAIM = {
    REPRODUCED: "MConbo-GAIL beats GAIL on QD-score, as the paper claims",
    NOT_REPRODUCED: "MConbo-GAIL does **not** beat GAIL on QD-score, although this is the paper's main claim",
    INCONCLUSIVE: "the runs do not decide whether MConbo-GAIL beats GAIL on QD-score, the paper's main claim",
    NO_RUNS: "there are no runs yet on the paper's main claim, that MConbo-GAIL beats GAIL on QD-score",
}
PILOTS = index.ROOT / "results" / "pilots"  # tables of trials on seeds that no claim is judged from
USES = {
    "smoke": "every line runs, nothing is learned",
    "laptop": "real learning curves without a GPU",
    "desk": "the paper's units: 1000 steps, 50 × 50 cells, its networks",
    "full": "the paper's scale, for a GPU",
}
# A figure of the bench, its name with its unit, its format.
SPEEDS = (
    ("iteration_steps_per_second", "training speed (environment steps per second)", ",.0f"),
    ("iteration_over_simulator", "training speed, relative to Brax (ratio)", ".1f"),
    ("cold_start_seconds", "cold start (seconds)", ".0f"),
    ("warm_start_seconds", "warm start (seconds)", ".1f"),
    ("peak_memory_mb", "memory (MB)", ",.0f"),
)


def results(root: Path | None = None) -> str:
    """QD-score and coverage of the ``laptop`` runs, as claimed and corrected, and the share of elites that re-land.

    A row per method, mean ± standard deviation over seeds.
    """
    runs = tables.counted_seeds(MAIN, ROBOT, BUDGET, root or RESULTS)
    metrics = ("qd_score", "corrected_qd_score", "coverage", "corrected_coverage", "relanded")
    shown = tables.summary(runs)[[*(tables.COLUMNS[name] for name in metrics), "seeds"]]
    return markdown_table(shown.rename(index=title).rename_axis("method").reset_index(), right=shown.columns)


def verdicts(root: Path | None = None) -> str:
    """Sentences on ``qdil claims``: the paper's main claim, and how many of its claims have which verdict."""
    judged = claims.judge(root or RESULTS, BUDGET, [ROBOT])
    of_paper = [v for v in judged if v.env == ROBOT and v.claim.source == PAPER and v.protocol == PAPER]
    claimed = Counter(v.verdict for v in of_paper)
    corrected = Counter(together([f.verdict for f in v.corrected]) for v in of_paper if v.corrected)
    return (
        f"At the `{BUDGET}` budget, on {ROBOT}, {_main_claim([v for v in of_paper if v.claim.id == 'C1'])}.\n"
        f"Of the paper's {len(of_paper)} claims, these runs reproduce {claimed[REPRODUCED]}, do not reproduce "
        f"{claimed[NOT_REPRODUCED]}, and leave {claimed[INCONCLUSIVE]} open; {claimed[NO_RUNS]} have no runs yet. "
        f"By corrected metrics, which apply to {corrected.total()} claims, {corrected[REPRODUCED]} are reproduced, "
        f"{corrected[NOT_REPRODUCED]} are not, {corrected[INCONCLUSIVE]} are open, {corrected[NO_RUNS]} have no runs."
    )


def _main_claim(verdict: list[Verdict]) -> str:
    rows = report.table(verdict)
    if rows.empty:
        return MAIN_CLAIM[NO_RUNS]
    as_claimed, corrected = rows[report.DIFFERENCE]
    return (
        f"{MAIN_CLAIM[verdict[0].verdict]}: the difference, with its 95 % interval, is {as_claimed}; corrected, where "
        f"each elite counts as on fresh episodes, it is {corrected}"
    )


def budgets() -> str:
    """The budgets and their sizes on ``ROBOT``: a row per budget."""
    rows = []
    for name in BUDGETS:
        of = make_config(ROBOT, "mconbo-gail", name)
        layers = dict.fromkeys("-".join(map(str, hidden)) for hidden in (of.ppo.actor_hidden, of.ppo.critic_hidden))
        rows.append(
            {
                "budget": f"`{name}`",
                "for": USES[name],
                "environments": of.ppo.num_envs,
                "networks": ", ".join(layers),
                "episode (steps)": of.simulation.episode_length,
                "archive (cells)": f"{of.ppga.cells} × {of.ppga.cells}",
                "candidates × episodes": f"{of.ppga.candidates} × {of.evaluation.episodes}",
                "iterations": of.ppga.iterations,
            }
        )
    numbers = [name for name in rows[0] if name not in ("budget", "for")]
    return markdown_table(pd.DataFrame(rows), right=numbers)


def runs(env: str) -> str:
    """The table of one robot's kept runs that ``qdil figures`` wrote."""
    return (RESULTS / "figures" / f"{BUDGET}-{env}-summary.md").read_text().strip()


def measured(folder: Path | None = None) -> dict[str, dict[str, float]]:
    """The figures that ``qdil bench --json`` measured at ``laptop`` (None: the kept ones), by robot."""
    files = {env: (folder or RESULTS / "bench") / f"{BUDGET}-{env}.json" for env in MEASURED}
    return {env: json.loads(file.read_text())[env] for env, file in files.items()}


def speeds(folder: Path | None = None) -> str:
    """Five figures of the bench with their units: a row per figure, a column per robot."""
    rows = measured(folder)
    shown = [{"": name} | {env: format(row[key], form) for env, row in rows.items()} for key, name, form in SPEEDS]
    return markdown_table(pd.DataFrame(shown), right=MEASURED)


def all_speeds(folder: Path | None = None) -> str:
    """Everything that the bench measured: a row per figure, a column per robot."""
    shown = pd.DataFrame(measured(folder)).map(_speed).rename(index=lambda name: name.replace("_", " "))
    return markdown_table(shown.rename_axis(f"`{BUDGET}`").reset_index(), right=MEASURED)


def _speed(value: float) -> str:
    if pd.isna(value):
        return ""
    return f"{value:,.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"


def budget_trials() -> str:
    """The runs by which the budgets were chosen."""
    settings = {
        "env": "robot",
        "iterations": "iterations",
        "warmup_updates": "warm-up",
        "gamma": "γ",
        "candidates": "candidates",
        "episodes": "episodes",
        "cells": "cells",
        "fitness_coefficient": "c₀",
        "rejects": "Δ of rejects",
    }
    columns = [name for name in trials.SHOWN if name not in ("stored_over_fresh", "corrected_average")]
    return trials.shown(PILOTS / "budgets.csv", settings, columns)


def improved_trials() -> str:
    """The runs by which ``improved`` was chosen."""
    settings = {"method": "method", "seed": "seed", "replay_share": "replay_share"}
    columns = [name for name in trials.SHOWN if name not in ("million_steps", "corrected_average")]
    return trials.shown(PILOTS / "improved.csv", settings, columns)


PARTS: dict[tuple[str, str], Callable[[], str]] = {  # by page and name
    ("README.md", "results"): lambda: f"{results()}\n\n{verdicts()}",
    ("README.md", "budgets"): budgets,
    ("README.md", "notebooks"): index.contents,
    ("docs/running.md", "notebooks"): lambda: index.table(folder="../notebooks/"),
    ("docs/claims.md", "few seeds"): protocol_page.few_seeds,
    ("docs/protocol.md", "claims"): protocol_page.claims,
    ("docs/protocol.md", "runs"): protocol_page.runs,
    ("docs/protocol.md", "budgets"): protocol_page.budgets,
    ("docs/protocol.md", "chance"): protocol_page.chance,
    ("docs/diagnose.md", "checks"): diagnosis.guide,
    ("docs/laptop-budget.md", "walker2d's runs"): lambda: runs("walker2d"),
    ("docs/laptop-budget.md", "halfcheetah's runs"): lambda: runs("halfcheetah"),
    ("docs/notes/budgets.md", "trials"): budget_trials,
    ("docs/notes/improved.md", "improved"): improved_trials,
    ("docs/performance.md", "speeds"): speeds,
    ("docs/notes/performance-log.md", "all speeds"): all_speeds,
}


def part_in(text: str, name: str) -> str:
    """What stands between the markers of a page's part. Raises ValueError where it has none."""
    begin, end = _markers(name)
    if begin not in text or end not in text:
        raise ValueError(f"the page has no '{begin}' … '{end}'.")
    return text.split(begin, 1)[1].split(end, 1)[0].strip()


def put_part(text: str, name: str, content: str) -> str:
    """A page with a part replaced by ``content``. Raises ValueError where it has no such markers."""
    part_in(text, name)
    begin, end = _markers(name)
    before, rest = text.split(begin, 1)
    return f"{before}{begin}\n{content}\n{end}{rest.split(end, 1)[1]}"


def _markers(name: str) -> tuple[str, str]:
    return f"<!-- generated: {name} -->", f"<!-- end: {name} -->"


def main() -> None:
    """Write all parts into their pages."""
    for (page, name), content in PARTS.items():
        path = index.ROOT / page
        path.write_text(put_part(path.read_text(), name, content()))


if __name__ == "__main__":
    main()
