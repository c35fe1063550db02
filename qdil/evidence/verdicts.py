"""How a claim is judged: what one comparison says, what an interval makes of it, and several comparisons together."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from qdil.evidence import stats
from qdil.evidence.stats import Interval

REPRODUCED, NOT_REPRODUCED = "reproduced", "not reproduced"
INCONCLUSIVE, NO_RUNS = "inconclusive", "no runs"
SMALL_MDP = "mdp"  # the problem of Lemma 1, with episodes of equal length, as its proof assumes


class Part(NamedTuple):
    """One comparison of a claim: runs of ``ours`` against those of other experiments, in one number per run."""

    kind: str  # of comparison: a key of KINDS
    ours: str  # experiment
    against: tuple[str, ...]  # experiments; none where ``ours`` is held against a number
    reading: str  # the number of a run: a key of readings.READINGS, or "probability" (of the lemma's file)
    number: float = 0.0  # "not below": tolerated loss as a share of the reference; "at least": the number itself


class Claim(NamedTuple):
    """A claim of the paper, or a question of our own put as a sentence."""

    id: str
    sentence: str
    where: str  # in the paper; "ours" for questions
    robots: tuple[str, ...]  # those it is about; others are judged too, and marked
    parts: tuple[Part, ...]  # all must hold
    rule: str  # how the sentence is made exact


class Finding(NamedTuple):
    """What the runs say of one comparison."""

    part: Part
    means: tuple[float, ...]  # of ours and of every experiment against it; not-a-number without runs
    seeds: tuple[int, ...]  # runs of each
    difference: Interval  # ours minus reference, or minus the number it is held against
    verdict: str
    trials: tuple[float, ...] = ()  # single ones of Lemma 1, whose mean alone the verdict speaks of


class Verdict(NamedTuple):
    """A claim judged on one robot, or on Lemma 1's small problem."""

    claim: Claim
    env: str
    findings: tuple[Finding, ...]

    @property
    def verdict(self) -> str:
        """All comparisons together."""
        return together([finding.verdict for finding in self.findings])

    @property
    def beyond(self) -> bool:
        """Whether the paper does not claim this of this robot, or the lemma of this problem."""
        return self.env not in (SMALL_MDP, *self.claim.robots)


class Kind(NamedTuple):
    """One way to compare: how far ours is ahead, and from where on that counts."""

    words: str  # between ours and the others, in tables
    ahead: Callable[[Part, Sequence[Sequence[float]]], Interval]  # (part, values of ours and the others)
    bar: Callable[[Part, Sequence[float]], float]  # (part, their means): the claim holds above it
    sign: float = 1.0  # -1: ours is claimed to be lower
    inclusive: bool = False  # whether exactly at the bar is enough


def _minus(part: Part, values: Sequence[Sequence[float]]) -> Interval:
    return stats.difference(values[0], values[1])


def _over_best(part: Part, values: Sequence[Sequence[float]]) -> Interval:
    return stats.above_best(values[0], values[1:])


def _over_number(part: Part, values: Sequence[Sequence[float]]) -> Interval:
    return Interval(*(end - part.number for end in stats.bootstrap_interval(values[0])))


def _nought(part: Part, means: Sequence[float]) -> float:
    return 0.0


KINDS = {
    "above": Kind("above", _minus, _nought),
    "below": Kind("below", _minus, _nought, sign=-1.0),
    "not below": Kind("not below", _minus, lambda part, means: -part.number * abs(means[1]), inclusive=True),
    "best of": Kind("above the best of", _over_best, _nought),
    "at least": Kind("at least", _over_number, _nought, inclusive=True),
    "more than": Kind("more than", _over_number, _nought),
}


def decide(difference: Interval, bar: float = 0.0, sign: float = 1.0, inclusive: bool = False) -> str:
    """A claim that ``difference`` (times ``sign``) is above ``bar``: reproduced where its whole interval is, not
    reproduced where none of it is, inconclusive where it has both or there is no interval.
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
    """Judge one comparison; ``values`` are a reading's numbers by experiment, one per seed, none for what was not run.

    "no runs" where one of its experiments has none; inconclusive where one has fewer than two seeds.
    """
    kind = KINDS[part.kind]
    arms = [list(values.get(name, ())) for name in (part.ours, *part.against)]
    means = tuple(float(np.mean(arm)) if arm else float("nan") for arm in arms)
    if not all(arms):
        nothing = Interval(np.nan, np.nan, np.nan)
        return Finding(part, means, tuple(map(len, arms)), nothing, NO_RUNS)
    difference = kind.ahead(part, arms)
    verdict = decide(difference, kind.bar(part, means), kind.sign, kind.inclusive)
    return Finding(part, means, tuple(map(len, arms)), difference, verdict)


def together(verdicts: Sequence[str]) -> str:
    """Several comparisons as one claim: reproduced if all are, not reproduced if one is not, else inconclusive."""
    said = set(verdicts)
    if said == {NO_RUNS}:
        return NO_RUNS
    if NOT_REPRODUCED in said:
        return NOT_REPRODUCED
    return REPRODUCED if said == {REPRODUCED} else INCONCLUSIVE
