"""Verdicts as tables to show and to print, and as the page ``claims.md``."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from qdil.evidence import paper, provenance, stats, tables
from qdil.evidence.markdown import markdown_table
from qdil.evidence.readings import NAMES
from qdil.evidence.verdicts import KINDS, NO_RUNS, Finding, Part, Verdict
from qdil.files import replace_file
from qdil.lab.lemma.results import ROUNDING
from qdil.names import label
from qdil.robots.register import PAPER_ROBOTS
from qdil.runs.folder import RESULTS
from qdil.runs.studies import STUDIES

HOW_TO_READ = """\
*Reproduced*: the whole 95 % stratified bootstrap interval over seeds agrees with the claim. *Not reproduced*: all of it
contradicts the claim. *Inconclusive*: only part of it agrees, or an arm has fewer than two seeds. *No runs*: an
experiment that the claim compares has none. A claim with several comparisons needs all of them, and fails if one fails.
Our own questions (Q) are answered with yes and no. `docs/claims.md` explains how far intervals over few seeds can be
trusted."""
SCALE = {
    "smoke": "Nothing is learned at this budget: it tests that every line runs, and its verdicts mean nothing.",
    "laptop": "Our numbers and the paper's differ in scale (cells, episodes, training): compare order, not size.",
    "desk": "Our numbers and the paper's have the same units; our searches are far shorter: compare order, not size.",
    "full": "Our numbers and the paper's are of the same scale.",
}
UNCLAIMED = "†"  # marks a robot, or a problem of Lemma 1, for which the paper does not make the claim
NOTE = f"{UNCLAIMED} The paper does not make the claim of this robot or problem."
NO_NUMBER = "no number"  # for what the paper shows without a number
ANSWERS = {"reproduced": "yes", "not reproduced": "no"}  # verdicts on our own questions


def words(verdict: Verdict, status: str) -> str:
    """``status``, a verdict on a claim or on a part of it, in words: for our own questions, yes or no."""
    return ANSWERS.get(status, status) if verdict.claim.where == "ours" else status


def overview(verdicts: Sequence[Verdict]) -> pd.DataFrame:
    """A row per claim, a column per robot (and per small problem of Lemma 1): the verdict alone."""
    envs = sorted({v.env for v in verdicts}, key=lambda env: ([*PAPER_ROBOTS, env].index(env), env))
    rows: dict[str, dict[str, str]] = {}
    for v in verdicts:
        row = rows.setdefault(v.claim.id, {"claim": v.claim.sentence, "where": v.claim.where} | dict.fromkeys(envs, ""))
        row[v.env] = words(v, v.verdict) + (f" {UNCLAIMED}" if v.unclaimed else "")
    return pd.DataFrame.from_dict(rows, orient="index", columns=["claim", "where", *envs]).rename_axis("id")


def table(verdicts: Sequence[Verdict], all_rows: bool = False) -> pd.DataFrame:
    """A row per comparison: the paper's numbers, ours, the difference with its interval, the seeds and the verdict.

    A comparison without runs has no row, unless ``all_rows``.
    """
    rows = [
        {
            "id": v.claim.id,
            "robot": v.env + (f" {UNCLAIMED}" if v.unclaimed else ""),
            "comparison": comparison(finding.part),
            "paper": of_paper(v.env, finding.part, v.claim.where == "ours"),
            "ours": _numbers(finding.part.reading, finding.means) + _fallen(finding.trials),
            "difference [95 % interval]": _difference(finding),
            "seeds": _seeds(finding.seeds),
            "verdict": words(v, finding.verdict),
        }
        for v in verdicts
        for finding in v.findings
        if all_rows or finding.verdict != NO_RUNS
    ]
    columns = ["id", "robot", "comparison", "paper", "ours", "difference [95 % interval]", "seeds", "verdict"]
    return pd.DataFrame(rows, columns=columns)


def _fallen(trials: Sequence[float]) -> str:
    """The share of Lemma 1's single trials in which the probability fell."""
    return f" (fell in {np.mean(np.asarray(trials) < -ROUNDING):.0%} of {len(trials)} trials)" if trials else ""


def _seeds(counts: Sequence[int]) -> str:
    """The number of our runs and of the reference's, or the fewest and the most of several references."""
    others = [str(count) for count in dict.fromkeys((min(counts[1:]), max(counts[1:])))] if counts[1:] else []
    return " / ".join([str(counts[0]), *([" to ".join(others)] if others else [])])


def comparison(part: Part) -> str:
    """A comparison in words."""
    name, kind = NAMES[part.reading], KINDS[part.kind].words
    if part.kind == "not below" and part.number:
        kind += f" ({part.number:.0%} margin)"
    if not part.against:
        against = _number(part.reading, part.number)
    elif len(part.against) == 1:
        against = label(part.against[0])
    else:
        against = f"{len(part.against)} others"
    return f"{name}: {label(part.ours)} {kind} {against}"


def of_paper(env: str, part: Part, ours: bool = False) -> str:
    """The paper's numbers for a comparison, as a text.

    A lost number is "not recoverable"; the later version's numbers are then added if it has all of them. ``ours``: the
    comparison belongs to one of our own questions.
    """
    if ours or part.reading not in paper.METRICS:
        return "–" if ours else NO_NUMBER
    names = (part.ours, *part.against) if len(part.against) < 2 else (part.ours,)
    numbers = [tables.paper_value(env, name, part.reading) for name in names]
    known = [number is not None for number in numbers]
    later = [tables.paper_value(env, name, part.reading, paper.LATER) for name in names]
    text = _numbers(part.reading, [np.nan if n is None else n for n in numbers], paper.NOT_RECOVERABLE)
    if not any(known):
        text = paper.NOT_RECOVERABLE
    if not all(known) and all(number is not None for number in later):
        text += f" (later version: {_numbers(part.reading, [float(n) for n in later if n is not None])})"
    return text


def _number(reading: str, value: float) -> str:
    if not np.isfinite(value):
        return "none"
    return tables.text(reading, value) if reading in tables.COLUMNS else f"{value:.3g}"


def _numbers(reading: str, values: Sequence[float], missing: str = "none") -> str:
    """Our number against the reference's; of several references, the highest alone."""
    shown = [values[0], np.nanmax([-np.inf, *values[1:]])] if len(values) > 1 else [values[0]]
    return " against ".join(_number(reading, value) if np.isfinite(value) else missing for value in shown)


def _difference(finding: Finding) -> str:
    reading, (estimate, low, high) = finding.part.reading, finding.difference
    if not np.isfinite(estimate):
        return "none"
    reference = finding.means[0] - estimate
    share = f" ({_signed('coverage', estimate / abs(reference))})" if finding.part.against and reference else ""
    if not finding.difference.known():
        return f"{_signed(reading, estimate)}{share}, fewer than {stats.FEWEST} seeds in an arm"
    return f"{_signed(reading, estimate)}{share} [{_signed(reading, low)}, {_signed(reading, high)}]"


def _signed(reading: str, value: float) -> str:
    return ("+" if value >= 0 else "−") + _number(reading, abs(value))


def plain(verdicts: Sequence[Verdict]) -> str:
    """Verdicts for a terminal: a line per claim, then every comparison that has runs."""
    short = overview(verdicts).drop(columns="where").reset_index()
    short = short[[name for name in short if name != "claim"] + ["claim"]]
    rows = table(verdicts).to_dict("records")
    lines = [
        f"{row['id']} {row['robot']}: {row['comparison']}: {row['verdict']}\n"
        f"    ours {row['ours']}; difference {row['difference [95 % interval]']}; seeds {row['seeds']}\n"
        f"    paper {row['paper']}"
        for row in rows
    ]
    return "\n".join([markdown_table(short), NOTE, "", *(lines or ["There are no runs to compare."])])


def markdown(verdicts: Sequence[Verdict], budget: str, root: Path = RESULTS) -> str:
    """The page ``claims.md``: verdicts, comparisons, the runs behind them, and every claim's rule."""
    details, claims, envs = table(verdicts), dict.fromkeys(v.claim for v in verdicts), _envs(verdicts)
    names = dict.fromkeys(n for claim in claims for part in claim.parts for n in (part.ours, *part.against))
    parts = [
        f"# The paper's claims, judged from runs at the {budget} budget",
        f"Written by `qdil claims --budget {budget}`, from finished runs alone.\n{HOW_TO_READ}",
        "## Verdicts",
        markdown_table(overview(verdicts).reset_index()),
        NOTE,
        "## Comparisons",
        markdown_table(details) if len(details) else "There are no runs.",
        SCALE[budget],
        "## Over all robots",
        over_robots(envs, budget, root),
        "## Runs",
        provenance.sentences(envs, tuple(names), budget, root),
        "## Rules",
        "\n".join(f"* **{claim.id}** {claim.sentence} ({claim.where}). {claim.rule}" for claim in claims),
    ]
    return "\n\n".join(parts) + "\n"


def _envs(verdicts: Sequence[Verdict]) -> list[str]:
    """The robots (and the small problems of Lemma 1) that were judged, each once."""
    return list(dict.fromkeys(v.env for v in verdicts))


def over_robots(envs: Iterable[str], budget: str, root: Path) -> str:
    """QD-score as a share of the expert's, over robots and seeds, for the methods of Table 1 that have runs."""
    runs = {env: tables.finished_seeds(STUDIES["baselines"], env, budget, root) for env in envs}
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
    note = "Interquartile means over robots and seeds. Each run is divided by the mean of its robot's expert."
    return f"{note}\n\n{markdown_table(pd.DataFrame(shown))}"


def page_of(budget: str, root: Path = RESULTS) -> Path:
    """Where a budget's verdicts are kept: the laptop's at the top of ``root``, others beside their own runs."""
    return root / "claims.md" if budget == "laptop" else root / budget / "claims.md"


def write(verdicts: Sequence[Verdict], budget: str, root: Path = RESULTS) -> Path:
    """Write ``markdown`` to ``page_of`` the budget and return its path."""
    path, content = page_of(budget, root), markdown(verdicts, budget, root).encode()
    replace_file(path, lambda file: file.write(content))
    return path
