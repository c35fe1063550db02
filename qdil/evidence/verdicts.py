"""How a claim is judged: the verdict on one comparison from its interval, and the verdict on several together."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from qdil.evidence import arms, student
from qdil.evidence.arms import Arm, Compared
from qdil.evidence.stats import CONFIDENCE, Interval
from qdil.evidence.student import Estimate

REPRODUCED, NOT_REPRODUCED = "reproduced", "not reproduced"
INCONCLUSIVE, NO_RUNS = "inconclusive", "no runs"
SMALL_MDP = "mdp"  # the problem of Lemma 1, with episodes of equal length, as its proof assumes
PAPER, LATER, OURS = "paper", "later paper", "ours"  # whose sentence a claim is


class Part(NamedTuple):
    """One comparison of a claim: runs of ``ours`` with those of other experiments, or with a number."""

    kind: str  # of comparison: a key of KINDS
    ours: str  # experiment
    against: tuple[str, ...]  # experiments; empty if ``ours`` is compared with ``number``
    reading: str  # what is compared, one number per run: a key of readings.READINGS, or "probability" (Lemma 1)
    number: float = 0.0  # the margin, as a share of the reference; "at least", "more than": the number itself


class Claim(NamedTuple):
    """A claim of a paper, or a question of our own put as a sentence."""

    id: str
    sentence: str
    where: str  # in the paper; "ours" for questions
    robots: tuple[str, ...]  # for which the claim is made; verdicts on other robots are marked
    parts: tuple[Part, ...]  # all must hold
    rule: str  # what exactly the sentence means here
    protocols: tuple[str, ...]  # under which the claim is judged
    source: str = PAPER


class Finding(NamedTuple):
    """The result of one comparison."""

    part: Part
    means: tuple[float, ...]  # of ours and of every experiment against it, over ``seeds``; not-a-number without runs
    seeds: tuple[tuple[int, ...], ...]  # of ours and of every experiment against it: those that were compared
    difference: Interval  # ours minus the reference, or minus the number
    verdict: str
    p_value: float = 1.0  # two-sided, of the hypothesis that the difference equals the bar
    paired: bool = True  # False: some run learned from another seed's expert, so runs are not paired by seed
    after_holm: str = ""  # the verdict with Holm's correction over the claim's comparisons
    trials: tuple[float, ...] = ()  # the changes in Lemma 1's single trials; the verdict is on their mean alone


class Verdict(NamedTuple):
    """A claim judged on one robot under one protocol, or on Lemma 1's small problem."""

    claim: Claim
    env: str
    protocol: str
    findings: tuple[Finding, ...]  # by the metrics as claimed
    corrected: tuple[Finding, ...] = ()  # by the corrected metrics; empty if the claim compares something else

    @property
    def verdict(self) -> str:
        """The verdict on all comparisons together, by the metrics as claimed."""
        return together([finding.verdict for finding in self.findings])

    @property
    def unclaimed(self) -> bool:
        """True if the paper does not make the claim for this robot, or the lemma for this problem."""
        return self.env not in (SMALL_MDP, *self.claim.robots)


class Kind(NamedTuple):
    """One way to compare: a difference, and the bar that it must pass."""

    words: str  # between ours and the others, in tables
    compare: Callable[[Part, Sequence[Arm]], Compared]  # (part, ours and the others)
    bar: Callable[[Part, Sequence[float]], float] = lambda part, means: 0.0  # (part, their means)
    sign: float = 1.0  # -1: the claim is that ours is lower
    inclusive: bool = False  # True: a difference equal to the bar is enough
    two_sided: bool = False  # True: the claim is that there is a difference, whichever its sign


def _minus(part: Part, given: Sequence[Arm]) -> Compared:
    return arms.difference(*given)


def _over_number(part: Part, given: Sequence[Arm]) -> Compared:
    found = student.mean([*given[0].values.values()])
    return Compared(found._replace(value=found.value - part.number), tuple(given))


def _gain(part: Part, given: Sequence[Arm]) -> Compared:
    """The gain of ours over its reference, as a share of that reference's mean, minus the gain of another such pair.

    A gain is paired by seed, and there is none where runs of a seed may not be paired. Two gains are paired by seed if
    both are of one budget, since the experts of two budgets differ.
    """
    one_budget = len({name.rpartition("/")[0] for name in (part.ours, *part.against)}) == 1
    groups = [given] if one_budget else [given[:2], given[2:]]
    if not all(map(arms.pairable, groups)):
        return Compared(Estimate(np.nan), tuple(given), paired=False)
    used = tuple(arm for group in groups for arm in arms.shared(group))
    gains = [_relative(ours.values, reference.values) for ours, reference in (used[:2], used[2:])]
    if one_budget:
        return Compared(student.paired(*gains), used)
    return Compared(student.unpaired([*gains[0].values()], [*gains[1].values()]), used)


def _relative(ours: Mapping[int, float], reference: Mapping[int, float]) -> dict[int, float]:
    """The gain of each shared seed as a share of the reference's mean; not-a-number if that is 0."""
    seeds = student.shared_seeds(ours, reference)
    size = abs(float(np.mean([reference[seed] for seed in seeds]))) if seeds else 0.0
    return {seed: (ours[seed] - reference[seed]) / size if size else np.nan for seed in seeds}


KINDS = {
    "above": Kind("above", _minus),
    "below": Kind("below", _minus, sign=-1.0),
    "not below": Kind("not below", _minus, lambda part, means: -part.number * abs(means[1]), inclusive=True),
    "at least": Kind("at least", _over_number, inclusive=True),
    "more than": Kind("more than", _over_number),
    "gain differs": Kind("has another gain than", _gain, lambda part, means: part.number, two_sided=True),
}


def decide(difference: Interval, bar: float = 0.0, sign: float = 1.0, inclusive: bool = False) -> str:
    """The verdict on the claim that ``difference`` (times ``sign``) is above ``bar``.

    Reproduced if its whole interval lies above, not reproduced if none of it does, inconclusive if part of it does or
    if there is no interval. ``inclusive``: a value equal to ``bar`` counts as above.
    """
    if not difference.known():
        return INCONCLUSIVE
    low, high = sorted((sign * difference.low, sign * difference.high))
    if low > bar or (inclusive and low == bar):
        return REPRODUCED
    if high < bar or (high == bar and not inclusive):
        return NOT_REPRODUCED
    return INCONCLUSIVE


def decide_two_sided(difference: Interval, margin: float) -> str:
    """The verdict on the claim that there is a difference, whichever its sign.

    Reproduced if the interval excludes 0, not reproduced if it holds 0 and no value larger than ``margin``,
    inconclusive otherwise.
    """
    if not difference.known():
        return INCONCLUSIVE
    if difference.low > 0 or difference.high < 0:
        return REPRODUCED
    return NOT_REPRODUCED if max(-difference.low, difference.high) <= margin else INCONCLUSIVE


def find(part: Part, by_name: Mapping[str, Arm]) -> Finding:
    """Judge one comparison; ``by_name`` are a reading's numbers by experiment.

    "no runs" if one of its experiments has none; inconclusive if fewer than two seeds can be compared.
    """
    kind = KINDS[part.kind]
    given = [by_name.get(name, Arm({})) for name in (part.ours, *part.against)]
    if not all(arm.values for arm in given):
        nothing = Compared(Estimate(np.nan), tuple(given))
        return Finding(part, _means(given), nothing.seeds(), nothing.difference.interval(), NO_RUNS, after_holm=NO_RUNS)
    found = kind.compare(part, given)
    means, interval = _means(found.arms), found.difference.interval()
    bar = kind.bar(part, means)
    if kind.two_sided:
        verdict, p_value = decide_two_sided(interval, bar), found.difference.p_value()
    else:
        verdict = decide(interval, bar, kind.sign, kind.inclusive)
        p_value = found.difference.p_value(kind.sign * bar)
    return Finding(part, means, found.seeds(), interval, verdict, p_value, found.paired, verdict)


def _means(given: Sequence[Arm]) -> tuple[float, ...]:
    return tuple(float(np.mean([*arm.values.values()])) if arm.values else float("nan") for arm in given)


def with_holm(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """A claim's comparisons with the verdict that is left of each after Holm's correction over all of them.

    A comparison keeps its verdict if its adjusted p-value is at most 5 %, and is inconclusive otherwise. Comparisons
    without an interval count with p = 1. A claim of one comparison keeps its verdict: there is nothing to correct.
    """
    adjusted = student.holm([finding.p_value for finding in findings])
    kept = [len(findings) == 1 or p <= 1 - CONFIDENCE or f.verdict == NO_RUNS
            for p, f in zip(adjusted, findings, strict=True)]  # fmt: skip
    return tuple(f._replace(after_holm=f.verdict if k else INCONCLUSIVE) for f, k in zip(findings, kept, strict=True))


def together(verdicts: Sequence[str]) -> str:
    """The verdict on a claim: reproduced if all its comparisons are, not reproduced if one is not, else inconclusive.

    "no runs" if none of the comparisons has runs.
    """
    distinct = set(verdicts)
    if distinct == {NO_RUNS}:
        return NO_RUNS
    if NOT_REPRODUCED in distinct:
        return NOT_REPRODUCED
    return REPRODUCED if distinct == {REPRODUCED} else INCONCLUSIVE
