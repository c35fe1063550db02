"""How a claim is judged: the verdict on one comparison from its interval, and the verdict on several together."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from qdil.evidence import stats
from qdil.evidence.stats import Interval

REPRODUCED, NOT_REPRODUCED = "reproduced", "not reproduced"
INCONCLUSIVE, NO_RUNS = "inconclusive", "no runs"
SMALL_MDP = "mdp"  # the problem of Lemma 1, with episodes of equal length, as its proof assumes


class Part(NamedTuple):
    """One comparison of a claim: runs of ``ours`` with those of other experiments, or with a number."""

    kind: str  # of comparison: a key of KINDS
    ours: str  # experiment
    against: tuple[str, ...]  # experiments; empty if ``ours`` is compared with ``number``
    reading: str  # what is compared, one number per run: a key of readings.READINGS, or "probability" (Lemma 1)
    number: float = 0.0  # "not below": tolerated loss as a share of the reference; "at least": the number itself


class Claim(NamedTuple):
    """A claim of the paper, or a question of our own put as a sentence."""

    id: str
    sentence: str
    where: str  # in the paper; "ours" for questions
    robots: tuple[str, ...]  # for which the paper makes the claim; verdicts on other robots are marked
    parts: tuple[Part, ...]  # all must hold
    rule: str  # what exactly the sentence means here


class Finding(NamedTuple):
    """The result of one comparison."""

    part: Part
    means: tuple[float, ...]  # of ours and of every experiment against it; not-a-number without runs
    seeds: tuple[int, ...]  # the number of runs of each
    difference: Interval  # ours minus the reference, or minus the number
    verdict: str
    trials: tuple[float, ...] = ()  # the changes in Lemma 1's single trials; the verdict is on their mean alone


class Verdict(NamedTuple):
    """A claim judged on one robot, or on Lemma 1's small problem."""

    claim: Claim
    env: str
    findings: tuple[Finding, ...]

    @property
    def verdict(self) -> str:
        """The verdict on all comparisons together."""
        return together([finding.verdict for finding in self.findings])

    @property
    def unclaimed(self) -> bool:
        """True if the paper does not make the claim for this robot, or the lemma for this problem."""
        return self.env not in (SMALL_MDP, *self.claim.robots)


class Kind(NamedTuple):
    """One way to compare: a difference, and the bar that it must pass."""

    words: str  # between ours and the others, in tables
    difference: Callable[[Part, Sequence[Sequence[float]]], Interval]  # (part, values of ours and the others)
    bar: Callable[[Part, Sequence[float]], float]  # (part, their means): the difference must lie above it
    sign: float = 1.0  # -1: the claim is that ours is lower
    inclusive: bool = False  # True: a difference equal to the bar is enough


def _minus(part: Part, values: Sequence[Sequence[float]]) -> Interval:
    return stats.difference(values[0], values[1])


def _over_best(part: Part, values: Sequence[Sequence[float]]) -> Interval:
    return stats.above_best(values[0], values[1:])


def _over_number(part: Part, values: Sequence[Sequence[float]]) -> Interval:
    return Interval(*(end - part.number for end in stats.bootstrap_interval(values[0])))


def _zero(part: Part, means: Sequence[float]) -> float:
    return 0.0


KINDS = {
    "above": Kind("above", _minus, _zero),
    "below": Kind("below", _minus, _zero, sign=-1.0),
    "not below": Kind("not below", _minus, lambda part, means: -part.number * abs(means[1]), inclusive=True),
    "best of": Kind("above the best of", _over_best, _zero),
    "at least": Kind("at least", _over_number, _zero, inclusive=True),
    "more than": Kind("more than", _over_number, _zero),
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


def find(part: Part, values: Mapping[str, Sequence[float]]) -> Finding:
    """Judge one comparison; ``values`` are a reading's numbers by experiment, one per seed.

    "no runs" if one of its experiments has none; inconclusive if one has fewer than two seeds.
    """
    kind = KINDS[part.kind]
    arms = [list(values.get(name, ())) for name in (part.ours, *part.against)]
    means = tuple(float(np.mean(arm)) if arm else float("nan") for arm in arms)
    if not all(arms):
        unknown = Interval(np.nan, np.nan, np.nan)
        return Finding(part, means, tuple(map(len, arms)), unknown, NO_RUNS)
    difference = kind.difference(part, arms)
    verdict = decide(difference, kind.bar(part, means), kind.sign, kind.inclusive)
    return Finding(part, means, tuple(map(len, arms)), difference, verdict)


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
