"""Interval estimates over seeds: a bootstrap that resamples every arm on its own, and interquartile means.

An arm is the runs of one experiment on one robot, a number per seed. Seeds of different arms are no pairs: equal seeds
draw other numbers in other methods. Everything is seeded and has no state.

With three seeds an arm, resampling underestimates how far means spread: ``docs/claims.md`` says by how much.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

RESAMPLES = 9999
CONFIDENCE = 0.95
SEED = 0  # of the resampling: the same runs always give the same interval
FEWEST = 2  # seeds in each arm, below which there is no interval


class Interval(NamedTuple):
    """An estimate and its bootstrap interval, whose ends are not-a-number where there are too few seeds."""

    estimate: float
    low: float
    high: float

    def known(self) -> bool:
        """Whether there is an interval and not the estimate alone."""
        return bool(np.isfinite([self.low, self.high]).all())


def mean(values: Any, axis: int = -1) -> Any:
    """The plain mean, in the form that the intervals here take."""
    return np.mean(values, axis=axis)


def iqm(values: Any, axis: int = -1) -> Any:
    """The interquartile mean: the mean without the lowest and highest quarter, both rounded down to whole values.

    Of three values that is the mean of all three.
    """
    return stats.trim_mean(values, 0.25, axis=axis)


def contrast(arms: Sequence[Sequence[float]], statistic: Callable[..., Any], seed: int = SEED) -> Interval:
    """``statistic(*arms, axis)`` with its 95 % percentile bootstrap interval, every arm resampled on its own.

    ``statistic`` takes arrays of any shape and reduces ``axis`` of each. No interval where an arm has fewer than two
    seeds or a value that is not finite; no estimate either where an arm is empty or not finite.
    """
    samples = [np.asarray(arm, float) for arm in arms]
    if not samples or any(len(sample) == 0 or not np.isfinite(sample).all() for sample in samples):
        return Interval(np.nan, np.nan, np.nan)
    estimate = float(statistic(*samples, axis=-1))
    if min(map(len, samples)) < FEWEST:
        return Interval(estimate, np.nan, np.nan)
    found = stats.bootstrap(
        samples, statistic, n_resamples=RESAMPLES, confidence_level=CONFIDENCE, method="percentile", vectorized=True,
        rng=np.random.default_rng(seed),
    ).confidence_interval  # fmt: skip
    return Interval(estimate, float(found.low), float(found.high))


def bootstrap_interval(values: Sequence[float], statistic: Callable[..., Any] = mean, seed: int = SEED) -> Interval:
    """A statistic of one arm with its interval; see ``contrast``."""
    return contrast([values], statistic, seed)


def difference(
    ours: Sequence[float], reference: Sequence[float], statistic: Callable[..., Any] = mean, seed: int = SEED
) -> Interval:
    """How far ``statistic`` of ``ours`` is above that of ``reference``, with its interval; see ``contrast``.

    Swapping arms that differ changes the sign and nothing else.
    """
    if tuple(ours) < tuple(reference):  # drawn in an order of their own, so that resamples do not depend on the roles
        swapped = difference(reference, ours, statistic, seed)
        return Interval(-swapped.estimate, -swapped.high, -swapped.low)
    return contrast([ours, reference], lambda a, b, axis: statistic(a, axis) - statistic(b, axis), seed)


def above_best(ours: Sequence[float], others: Sequence[Sequence[float]], seed: int = SEED) -> Interval:
    """How far the mean of ``ours`` is above the highest mean among ``others``, with its interval; see ``contrast``.

    The highest of several resampled means is high by luck, so the interval lies rather too low than too high.
    """

    def above(mine: Any, *rest: Any, axis: int) -> Any:
        return np.mean(mine, axis=axis) - np.max([np.mean(other, axis=axis) for other in rest], axis=0)

    return contrast([ours, *others], above, seed)


def stratified(strata: Sequence[Sequence[float]], statistic: Callable[..., Any] = iqm, seed: int = SEED) -> Interval:
    """A statistic of all values together, e.g. over robots, resampled within each stratum; see ``contrast``."""

    def together(*samples: Any, axis: int) -> Any:
        return statistic(np.concatenate(samples, axis=axis), axis=axis)

    return contrast(strata, together, seed)
