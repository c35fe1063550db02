"""Bootstrap intervals over seeds, for statistics that are not means: each arm or stratum is resampled separately.

An arm is the runs of one experiment on one robot, a number per seed. The resampling is seeded, so equal runs always
give equal intervals. With three to five seeds a bootstrap underestimates the spread (``trust`` shows by how much):
verdicts use Student's intervals (``student``) instead.

``scipy.stats`` has the same estimates, and the tests compare with it. It is not used here because importing it takes
longer than judging all claims.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

RESAMPLES = 9999
CONFIDENCE = 0.95
SEED = 0  # of the resampling
FEWEST = 2  # seeds in each arm, below which there is no interval


class Interval(NamedTuple):
    """An estimate and its interval, whose ends are not-a-number if an arm has too few seeds."""

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
    ascending = np.moveaxis(np.sort(values, axis=axis), axis, -1)
    cut = ascending.shape[-1] // 4
    return ascending[..., cut : ascending.shape[-1] - cut].mean(axis=-1)


def contrast(
    arms: Sequence[Sequence[float]], statistic: Callable[..., Any], seed: int = SEED, resamples: int = RESAMPLES
) -> Interval:
    """``statistic(*arms, axis)`` with its 95 % percentile bootstrap interval; each arm is resampled separately.

    ``statistic`` takes arrays of any shape and reduces ``axis`` of each. There is no interval if an arm has fewer than
    two seeds, and no estimate either if an arm is empty or has a value that is not finite.
    """
    samples = [np.asarray(arm, float) for arm in arms]
    if not samples or any(len(sample) == 0 or not np.isfinite(sample).all() for sample in samples):
        return Interval(np.nan, np.nan, np.nan)
    estimate = float(statistic(*samples, axis=-1))
    if min(map(len, samples)) < FEWEST:
        return Interval(estimate, np.nan, np.nan)
    rng = np.random.default_rng(seed)
    resampled = [sample[rng.integers(0, len(sample), (resamples, len(sample)))] for sample in samples]
    tail = 100 * (1 - CONFIDENCE) / 2
    low, high = np.percentile(statistic(*resampled, axis=-1), [tail, 100 - tail])
    return Interval(estimate, float(low), float(high))


def paired_bootstrap(
    ours: Mapping[int, float], reference: Mapping[int, float], seed: int = SEED, resamples: int = RESAMPLES
) -> Interval:
    """The mean over shared seeds of ours minus the reference (values by seed), with its bootstrap interval.

    Seeds are resampled, and the two runs of a seed stay together. No verdict uses this interval: ``trust`` compares it
    with Student's.
    """
    shared = sorted(set(ours) & set(reference))
    return contrast([[ours[s] - reference[s] for s in shared]], mean, seed, resamples)


def stratified(strata: Sequence[Sequence[float]], statistic: Callable[..., Any] = iqm, seed: int = SEED) -> Interval:
    """A statistic of the values of all strata, such as robots, each resampled separately; see ``contrast``."""

    def of_all(*samples: Any, axis: int) -> Any:
        return statistic(np.concatenate(samples, axis=axis), axis=axis)

    return contrast(strata, of_all, seed)
