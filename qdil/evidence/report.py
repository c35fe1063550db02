"""Verdicts as tables to show and to print, and as the page ``claims.md``."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from qdil.evidence import paper, provenance, stats, tables
from qdil.evidence.arms import UNPAIRED, seeds_text
from qdil.evidence.markdown import markdown_table
from qdil.evidence.readings import NAMES, READINGS
from qdil.evidence.verdicts import KINDS, LATER, NO_RUNS, OURS, Claim, Finding, Part, Verdict, together
from qdil.files import replace_file
from qdil.lab.lemma.results import ROUNDING
from qdil.names import label
from qdil.robots.register import PAPER_ROBOTS
from qdil.runs.folder import RESULTS
from qdil.runs.studies import PROTOCOL_NAMES, STUDIES, budget_of, under, without_protocol

HOW_TO_READ = """\
*Reproduced*: the whole 95 % interval of the difference agrees with the claim. *Not reproduced*: all of it contradicts
the claim. *Inconclusive*: only part of it agrees, or fewer than two seeds can be compared. *No runs*: an experiment
that the claim compares has none. A claim with several comparisons needs all of them, and fails if one fails. Our own
questions (Q) are answered with yes and no.

*As claimed*: by the paper's metrics, which keep the best score that a candidate ever had. *Corrected*: every elite is
evaluated again on fresh episodes and counts in the cell where it lands. *Holm*: what is left of both verdicts if the
claim's comparisons are corrected for their number. Runs are paired by seed: a seed's runs learned from one expert. More
in [how claims are judged](../docs/claims.md) and in [the protocol](../docs/protocol.md), which has the exact rules."""
SCALE = {
    "smoke": "Nothing is learned at this budget: it tests that every line runs, and its verdicts mean nothing.",
    "desk": "Our numbers and the paper's have the same units; our searches are far shorter: compare order, not size.",
    "full": "Our numbers and the paper's are of the same scale.",
}
SMALLER = "Our numbers and the paper's differ in scale (cells, episodes, training): compare order, not size."
UNCLAIMED = "†"  # marks a robot, or a problem of Lemma 1, for which the paper does not make the claim
NOTE = f"{UNCLAIMED} The paper does not make the claim of this robot or problem."
UNPAIRED_NOTE = (
    f"{UNPAIRED} Some of these runs did not learn from the expert of their own seed, so they are not paired by seed "
    "(Welch's interval). Where all learned from one expert, the interval leaves out the luck of its demonstrations."
)
NO_NUMBER = "no number"  # for what the paper shows without a number
NOTHING = "–"  # where there is nothing to show
ANSWERS = {"reproduced": "yes", "not reproduced": "no"}  # verdicts on our own questions
DIFFERENCE = "difference [95 % interval]"


def words(claim: Claim, status: str) -> str:
    """``status``, a verdict on a claim or on a part of it, in words: for our own questions, yes or no."""
    return ANSWERS.get(status, status) if claim.source == OURS else status


def overview(verdicts: Sequence[Verdict], env: str) -> pd.DataFrame:
    """A row per claim and protocol that was judged on a robot, or on a small problem of Lemma 1: the verdicts alone.

    Columns: ``id``, ``claim``, ``where``, ``protocol``, ``as claimed``, ``corrected`` ("–" where the claim is not about
    the four metrics), and ``Holm``, both verdicts after Holm's correction.
    """
    rows = [
        {
            "id": v.claim.id + (f" {UNCLAIMED}" if v.unclaimed else ""),
            "claim": v.claim.sentence,
            "where": v.claim.where,
            "protocol": v.protocol,
            "as claimed": words(v.claim, v.verdict),
            "corrected": _verdict(v.claim, [finding.verdict for finding in v.corrected]),
            "Holm": _holm(v),
        }
        for v in verdicts
        if v.env == env
    ]
    return pd.DataFrame(rows, columns=["id", "claim", "where", "protocol", "as claimed", "corrected", "Holm"])


def _verdict(claim: Claim, findings: Sequence[str]) -> str:
    return words(claim, together(findings)) if findings else NOTHING


def _holm(v: Verdict) -> str:
    """Both verdicts after Holm's correction, "unchanged" if it changes neither, "–" without runs."""
    if {f.verdict for f in v.findings} == {NO_RUNS}:
        return NOTHING
    after = [_verdict(v.claim, [f.after_holm for f in findings]) for findings in (v.findings, v.corrected)]
    before = [_verdict(v.claim, [f.verdict for f in findings]) for findings in (v.findings, v.corrected)]
    if after == before:
        return "unchanged"
    return " / ".join(text for text in after if text != NOTHING)


def table(verdicts: Sequence[Verdict], all_rows: bool = False) -> pd.DataFrame:
    """A row per comparison and reading: the paper's numbers, ours, the difference with its interval, the verdict.

    A comparison without runs has no row, unless ``all_rows``. The corrected row follows the row as claimed.
    """
    rows = [
        _row(v, finding)
        for v in verdicts
        for both in zip(v.findings, v.corrected or [None] * len(v.findings), strict=True)
        for finding in both
        if finding is not None and (all_rows or finding.verdict != NO_RUNS)
    ]
    columns = ["id", "robot", "protocol", "comparison", "paper", "ours", DIFFERENCE, "seeds", "verdict", "Holm"]
    return pd.DataFrame(rows, columns=columns)


def _row(v: Verdict, finding: Finding) -> dict[str, str]:
    return {
        "id": v.claim.id,
        "robot": v.env + (f" {UNCLAIMED}" if v.unclaimed else ""),
        "protocol": v.protocol,
        "comparison": comparison(finding.part, v.protocol),
        "paper": of_paper(v.env, finding.part, v.claim.source),
        "ours": _numbers(finding.part.reading, finding.means[:2]) + _fallen(finding.trials),
        DIFFERENCE: _difference(finding),
        "seeds": _seeds(finding),
        "verdict": words(v.claim, finding.verdict),
        "Holm": words(v.claim, finding.after_holm),
    }


def _fallen(trials: Sequence[float]) -> str:
    """The share of Lemma 1's single trials in which the probability fell."""
    return f" (fell in {np.mean(np.asarray(trials) < -ROUNDING):.0%} of {len(trials)} trials)" if trials else ""


def _seeds(finding: Finding) -> str:
    """The seeds that were compared; of Lemma 1 only how many problems or seeds there are."""
    return str(len(finding.seeds[0])) if finding.trials else seeds_text(finding.seeds, finding.paired)


def comparison(part: Part, protocol: str = "paper") -> str:
    """A comparison in words; a protocol is named where it is not ``protocol``."""
    name, kind = NAMES[part.reading], KINDS[part.kind]
    ours, *against = (_label(experiment, protocol) for experiment in (part.ours, *part.against))
    if kind.two_sided:
        return f"{name}: gain of {ours} over {against[0]}, minus that of {against[1]} over {against[2]}"
    margin = f" ({part.number:.0%} margin)" if part.kind == "not below" and part.number else ""
    return f"{name}: {ours} {kind.words}{margin} {against[0] if against else _number(part.reading, part.number)}"


def _label(name: str, protocol: str) -> str:
    """An experiment in words: its budget in brackets if ``name`` has one, its protocol if that is not ``protocol``."""
    budget, experiment = budget_of(name)
    plain = without_protocol(experiment)
    own = next(one for one in PROTOCOL_NAMES if under(plain, one) == under(experiment, PROTOCOL_NAMES[0]))
    remarks = [*([f"{own} protocol"] if own != protocol else []), *([budget] if budget else [])]
    return label(plain) + (f" ({', '.join(remarks)})" if remarks else "")


def of_paper(env: str, part: Part, source: str = paper.PAPER) -> str:
    """The paper's numbers for a comparison, as a text: of the later version for its own claims, none for questions.

    A number that the copy at hand does not have is "not recoverable".
    """
    if source == OURS or part.reading not in paper.METRICS:
        return NO_NUMBER if source != OURS and not part.reading.startswith("corrected") else NOTHING
    origin = paper.LATER if source == LATER else paper.PAPER
    numbers = [
        tables.paper_value(env, name, part.reading, _origin(name, origin)) for name in (part.ours, *part.against)
    ]
    if all(number is None for number in numbers):
        return paper.NOT_RECOVERABLE
    return _numbers(part.reading, [np.nan if n is None else n for n in numbers], paper.NOT_RECOVERABLE)


def _origin(experiment: str, origin: str) -> str:
    """Where an experiment's number is from: of the expert, only the first version's authors released one."""
    return paper.PAPER if under(experiment, "paper") == "true" else origin


def _number(reading: str, value: float) -> str:
    if not np.isfinite(value):
        return "none"
    return tables.text(reading, value) if reading in tables.COLUMNS else f"{value:.3g}"


def _numbers(reading: str, values: Sequence[float], missing: str = "none") -> str:
    """Our number against the reference's."""
    return " against ".join(_number(reading, value) if np.isfinite(value) else missing for value in values)


def _difference(finding: Finding) -> str:
    (estimate, low, high), share = finding.difference, KINDS[finding.part.kind].two_sided
    reading = "coverage" if share else finding.part.reading
    if not np.isfinite(estimate):
        return "none"
    reference = finding.means[0] - estimate
    relative = f" ({_signed('coverage', estimate / abs(reference))})" if _has_reference(finding, reference) else ""
    if not finding.difference.known():
        return f"{_signed(reading, estimate)}{relative}, fewer than {stats.FEWEST} seeds to compare"
    return f"{_signed(reading, estimate)}{relative} [{_signed(reading, low)}, {_signed(reading, high)}]"


def _has_reference(finding: Finding, reference: float) -> bool:
    return bool(finding.part.against and reference) and not KINDS[finding.part.kind].two_sided


def _signed(reading: str, value: float) -> str:
    return ("+" if value >= 0 else "−") + _number(reading, abs(value))


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
    parts = [
        f"# The paper's claims, judged from runs at the {budget} budget",
        f"Written by `qdil claims --budget {budget}`, from finished runs alone.\n{HOW_TO_READ}",
        "## Verdicts",
        *(part for env in envs for part in (f"### {env}", verdicts_on(verdicts, env))),
        *_notes(details)[:-1],
        "## Comparisons",
        markdown_table(details) if len(details) else "There are no runs.",
        SCALE.get(budget, SMALLER),
        "## Over all robots",
        over_robots(envs, budget, root),
        "## Runs",
        f"The protocol is [`docs/protocol.md`](../docs/protocol.md) of commit {provenance.protocol_commit()}. "
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
