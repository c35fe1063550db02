"""Student's t: means over few seeds with honest intervals, differences paired by seed, and Holm's correction.

A bootstrap of three to five seeds gives intervals that are much too narrow; ``trust`` shows by how much. Student's
intervals have the promised coverage if the values (or, of paired runs, their differences) are normal, and nearly so for
the other shapes of noise in ``trust``. Verdicts therefore use these intervals, and the bootstrap of ``stats`` serves
only statistics that are no means.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr, stdtrit  # scipy.stats has the same functions, but takes a second to import

from qdil.evidence.stats import CONFIDENCE, FEWEST, Interval


class Estimate(NamedTuple):
    """A mean, or a difference of means, with its standard error."""

    value: float
    error: float = np.nan  # standard error; not-a-number if there are too few seeds
    freedom: float = np.nan  # degrees of freedom of Student's t

    def interval(self, confidence: float = CONFIDENCE) -> Interval:
        """The central interval of that confidence; its ends are not-a-number without a standard error."""
        half = float(stdtrit(self.freedom, (1 + confidence) / 2)) * self.error
        return Interval(self.value, self.value - half, self.value + half)

    def p_value(self, bar: float = 0.0) -> float:
        """The two-sided p-value of the hypothesis that the true value is ``bar``.

        1 without a standard error. If all seeds agree exactly, the error is 0: then 1 at the bar and 0 elsewhere.
        """
        if not np.isfinite(self.error):
            return 1.0
        if self.error == 0:
            return 1.0 if self.value == bar else 0.0
        return float(2 * stdtr(self.freedom, -abs(self.value - bar) / self.error))


def mean(values: Sequence[float]) -> Estimate:
    """The mean over independent seeds. No standard error below two seeds, no value for none or one that is not finite.

    A value that is not finite makes the mean unknown; it is never left out.
    """
    sample = np.asarray(values, float)
    if len(sample) == 0 or not np.isfinite(sample).all():
        return Estimate(np.nan)
    if len(sample) < FEWEST:
        return Estimate(float(sample.mean()))
    return Estimate(float(sample.mean()), float(sample.std(ddof=1)) / np.sqrt(len(sample)), len(sample) - 1.0)


def shared_seeds(*arms: Mapping[int, float]) -> tuple[int, ...]:
    """The seeds that all arms have, in ascending order."""
    return tuple(sorted(set.intersection(*(set(arm) for arm in arms))))


def paired(ours: Mapping[int, float], reference: Mapping[int, float]) -> Estimate:
    """The mean over shared seeds of ours minus the reference's value of the same seed (values by seed)."""
    return mean([ours[seed] - reference[seed] for seed in shared_seeds(ours, reference)])


def unpaired(ours: Sequence[float], reference: Sequence[float]) -> Estimate:
    """The difference of the means of two independent arms, by Welch: their variances may differ."""
    first, second = mean(ours), mean(reference)
    value = first.value - second.value
    if not np.isfinite([first.error, second.error]).all():
        return Estimate(value)
    squares = np.array([first.error, second.error]) ** 2
    total, freedoms = squares.sum(), np.array([first.freedom, second.freedom])
    freedom = total**2 / (squares**2 / freedoms).sum() if total > 0 else freedoms.sum()
    return Estimate(value, float(np.sqrt(total)), float(freedom))


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's adjusted p-values, in the order given.

    If every comparison with an adjusted p-value of at most 5 % is called, the probability that any of these calls is
    wrong is at most 5 %. The smallest of m p-values is multiplied by m, the next by m − 1, and so on, and no adjusted
    value is below that of a smaller p-value (Holm, 1979).
    """
    adjusted, highest, count = [1.0] * len(p_values), 0.0, len(p_values)
    for rank, index in enumerate(np.argsort(p_values, kind="stable")):
        highest = max(highest, min(1.0, (count - rank) * p_values[index]))
        adjusted[int(index)] = highest
    return adjusted
