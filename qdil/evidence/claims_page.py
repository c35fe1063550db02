"""Verdicts as a text for the terminal and as the page ``claims.md``."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from qdil.evidence import provenance, tables
from qdil.evidence.arms import UNPAIRED
from qdil.evidence.markdown import markdown_table
from qdil.evidence.readings import READINGS
from qdil.evidence.report import DIFFERENCE, UNCLAIMED, overview, table
from qdil.evidence.verdicts import NO_RUNS, Verdict
from qdil.files import replace_file
from qdil.robots.register import PAPER_ROBOTS
from qdil.runs.folder import RESULTS
from qdil.runs.studies import STUDIES, budget_of

HOW_TO_READ = """\
*Reproduced*: the whole 95 % interval of the difference agrees with the claim. *Not reproduced*: all of it contradicts
the claim. *Inconclusive*: only part of it agrees, or fewer than two seeds can be compared. *No runs*: an experiment
that the claim compares has none. A claim with several comparisons needs all of them, and fails if one fails. Our own
questions (Q) are answered with yes and no.

*As claimed*: by the paper's metrics, which keep the best score that a candidate ever had. *Corrected*: every elite is
evaluated again on fresh episodes and counts in the cell where it lands. *Holm*: what is left of both verdicts if the
claim's comparisons are corrected for their number. Runs are paired by seed: a seed's runs learned from one expert. More
in [how claims are judged](DOCS/claims.md) and in [the protocol](DOCS/protocol.md), which has the exact rules."""
SCALE = {
    "smoke": "Nothing is learned at this budget: it tests that every line runs, and its verdicts mean nothing.",
    "desk": "Our numbers and the paper's have the same units; our searches are far shorter: compare order, not size.",
    "full": "Our numbers and the paper's are of the same scale.",
}
SMALLER = "Our numbers and the paper's differ in scale (cells, episodes, training): compare order, not size."
NOTE = f"{UNCLAIMED} The paper does not make the claim of this robot or problem."
UNPAIRED_NOTE = (
    f"{UNPAIRED} Some of these runs did not learn from the expert of their own seed, so they are not paired by seed "
    "(Welch's interval). Where all learned from one expert, the interval leaves out the luck of its demonstrations."
)


def verdicts_on(verdicts: Sequence[Verdict], env: str, leave_out: Sequence[str] = ()) -> str:
    """``overview`` in Markdown without the columns ``leave_out``; claims without runs are listed below it."""
    rows = overview(verdicts, env).drop(columns=list(leave_out))
    without = rows["as claimed"] == NO_RUNS
    missing = ", ".join(rows["id"][without].str.removesuffix(f" {UNCLAIMED}"))
    shown = [markdown_table(rows[~without])] if not without.all() else []
    return "\n\n".join([*shown, *([f"No runs yet: {missing}."] if missing else [])])


def plain(verdicts: Sequence[Verdict]) -> str:
    """Verdicts for a terminal: a table per robot, then every comparison that has runs."""
    lines = []
    for env in _envs(verdicts):
        lines += [env, verdicts_on(verdicts, env, ["where"]), ""]
    rows = table(verdicts)
    lines += _notes(rows)
    lines += [
        f"{row['id']} {row['robot']} ({row['protocol']}): {row['comparison']}: {row['verdict']}\n"
        f"    ours {row['ours']}; difference {row[DIFFERENCE]}; seeds {row['seeds']}; after Holm {row['Holm']}\n"
        f"    paper {row['paper']}"
        for row in rows.to_dict("records")
    ]
    return "\n".join([*lines, *([] if len(rows) else ["There are no runs to compare."])])


def _notes(rows: pd.DataFrame) -> list[str]:
    """The notes that tables need: the second only if a difference is not paired."""
    return [NOTE, *([UNPAIRED_NOTE] if rows["seeds"].str.contains(UNPAIRED).any() else []), ""]


def markdown(verdicts: Sequence[Verdict], budget: str, root: Path = RESULTS) -> str:
    """The page ``claims.md``: verdicts, comparisons, the runs behind them, and every claim's rule."""
    details, claims, envs = table(verdicts), dict.fromkeys(v.claim for v in verdicts), _envs(verdicts)
    docs = "../" * (len(page_of(budget, RESULTS).parts) - 1) + "docs"
    parts = [
        f"# The paper's claims, judged from runs at the {budget} budget",
        f"Written by `qdil claims --budget {budget}`, from finished runs alone.\n{HOW_TO_READ.replace('DOCS', docs)}",
        "## Verdicts",
        *(part for env in envs for part in (f"### {env}", verdicts_on(verdicts, env))),
        *_notes(details)[:-1],
        "## Comparisons",
        markdown_table(details) if len(details) else "There are no runs.",
        SCALE.get(budget, SMALLER),
        "## Over all robots",
        over_robots(envs, budget, root),
        "## Runs",
        f"The protocol is [`docs/protocol.md`]({docs}/protocol.md) of commit {provenance.protocol_commit()}. "
        "Runs made at an earlier commit are older than it.",
        _provenance(verdicts, envs, budget, root),
        "## Rules",
        "\n".join(f"* **{claim.id}** {claim.sentence} ({claim.where}). {claim.rule}" for claim in claims),
    ]
    return "\n\n".join(parts) + "\n"


def _provenance(verdicts: Sequence[Verdict], envs: Sequence[str], budget: str, root: Path) -> str:
    """The runs behind the verdicts, at the page's budget and then at every other one that an experiment names."""
    compared = [f.part for v in verdicts for f in v.findings if f.part.reading in READINGS]
    by_budget: dict[str, dict[str, None]] = {budget: {}}
    for name in (name for part in compared for name in (part.ours, *part.against)):
        of_budget, experiment = budget_of(name)
        by_budget.setdefault(of_budget or budget, {})[experiment] = None
    texts = [provenance.sentences(envs, tuple(names), at, root) for at, names in by_budget.items()]
    others = [
        f"At `{at}`:\n\n{text}" for at, text in list(zip(by_budget, texts, strict=True))[1:] if text != provenance.NONE
    ]
    lemma = provenance.lemma_sentence(budget, root)
    return "\n\n".join(["\n".join([texts[0], *lemma]), *others])


def _envs(verdicts: Sequence[Verdict]) -> list[str]:
    """The robots, in the paper's order, and the small problems of Lemma 1 that were judged, each once."""
    envs = dict.fromkeys(v.env for v in verdicts)
    return sorted(envs, key=lambda env: ([*PAPER_ROBOTS, env].index(env), env))


def over_robots(envs: Iterable[str], budget: str, root: Path) -> str:
    """QD-score as a share of the expert's, over robots and seeds, for the methods of Table 1 that have runs."""
    runs = {env: tables.counted_seeds(STUDIES["baselines"], env, budget, root) for env in envs}
    shares = tables.share_of_expert(runs)
    if shares.empty:
        return "There are no runs of an expert to compare with."
    shown = {
        "method": [f"`{name}`" for name in shares.index],
        "robots": shares["robots"],
        "seeds": shares["seeds"],
        "QD-score, share of the expert's": [f"{share:.0%}" for share in shares["share"]],
        "95 % interval": [
            "none" if np.isnan(low) else f"[{low:.0%}, {high:.0%}]" for low, high in shares[["low", "high"]].values
        ],
    }
    note = (
        "Interquartile means over robots and seeds, as claimed. Each run is divided by the mean of its robot's expert. "
        "Intervals are stratified bootstrap intervals, which are too narrow for few seeds."
    )
    return f"{note}\n\n{markdown_table(pd.DataFrame(shown))}"


def page_of(budget: str, root: Path = RESULTS) -> Path:
    """Where a budget's verdicts are kept: the laptop's at the top of ``root``, others beside their own runs."""
    return root / "claims.md" if budget == "laptop" else root / budget / "claims.md"


def write(verdicts: Sequence[Verdict], budget: str, root: Path = RESULTS) -> Path:
    """Write ``markdown`` to ``page_of`` the budget and return its path."""
    path, content = page_of(budget, root), markdown(verdicts, budget, root).encode()
    replace_file(path, lambda file: file.write(content))
    return path
