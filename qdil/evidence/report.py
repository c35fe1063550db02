"""Verdicts as tables: a row per claim, a row per comparison."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from qdil.evidence import paper, stats, tables
from qdil.evidence.arms import seeds_text
from qdil.evidence.readings import NAMES
from qdil.evidence.verdicts import KINDS, LATER, NO_RUNS, OURS, Claim, Finding, Part, Verdict, together
from qdil.lab.lemma.results import ROUNDING
from qdil.names import label
from qdil.runs.studies import PROTOCOL_NAMES, budget_of, under, without_protocol

UNCLAIMED = "†"  # marks a robot, or a problem of Lemma 1, for which the paper does not make the claim
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
