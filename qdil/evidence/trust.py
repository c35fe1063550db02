"""How far intervals over few seeds can be trusted: a simulation of paired runs, and of looking more than once."""

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd

from qdil.evidence import stats, student

SEEDS = (2, 3, 4, 5, 10)  # the numbers of paired seeds to simulate
LOOKS = ((5,), (3, 5), (5, 10), (3, 5, 10))  # numbers of seeds at which a study may stop
RESAMPLES = 400  # of each simulated bootstrap
Noise = Callable[[np.random.Generator, int], np.ndarray]  # independent errors of a number of runs, mean 0

NOISES: dict[str, Noise] = {
    "normal": lambda rng, n: rng.standard_normal(n),
    "skewed": lambda rng, n: rng.gamma(2.0, size=n) - 2.0,  # a long upper tail
    "heavy": lambda rng, n: rng.standard_t(3, n),  # outliers on both sides
    "two groups": lambda rng, n: rng.choice([-1.0, 1.0], n) + 0.3 * rng.standard_normal(n),  # some runs fail
}


def paired_runs(rng: np.random.Generator, noise: Noise, seeds: int) -> tuple[dict[int, float], dict[int, float]]:
    """Two arms without a true difference, values by seed; a seed's expert moves both of its runs alike."""
    expert = rng.standard_normal(seeds)
    arms = (expert + noise(rng, seeds) for _ in range(2))
    first, second = (dict(enumerate(map(float, arm))) for arm in arms)
    return first, second


def coverage(method: str, noise: Noise, seeds: int, trials: int = 1000, seed: int = 0) -> float:
    """The share of simulated 95 % intervals that contain the true difference, which is 0.

    ``method``: "student" or "bootstrap", both paired by seed.
    """
    rng, hits = np.random.default_rng(seed), 0
    for trial in range(trials):
        arms = paired_runs(rng, noise, seeds)
        if method == "student":
            found = student.paired(*arms).interval()
        else:
            found = stats.paired_bootstrap(*arms, seed=trial, resamples=RESAMPLES)
        hits += found.low <= 0 <= found.high
    return hits / trials


def table(trials: int = 1000) -> pd.DataFrame:
    """Coverage by number of seeds: the bootstrap and Student's t of normal noise, and Student's worst noise here."""
    rows = []
    for seeds in SEEDS:
        by_noise = {name: coverage("student", noise, seeds, trials) for name, noise in NOISES.items()}
        rows.append(
            {
                "paired seeds": str(seeds),
                "bootstrap": f"{coverage('bootstrap', NOISES['normal'], seeds, trials):.0%}",
                "Student's t": f"{by_noise['normal']:.0%}",
                "Student's t, other noise": f"{min(by_noise.values()):.0%} to {max(by_noise.values()):.0%}",
            }
        )
    return pd.DataFrame(rows)


def called_by_chance(looks: tuple[int, ...], trials: int = 20_000, seed: int = 0) -> float:
    """The share of comparisons without a true difference that are called, either way, by one of several looks.

    A look judges the first so many seeds by Student's 95 % interval, and the study stops when the interval excludes 0.
    """
    runs = np.random.default_rng(seed).standard_normal((trials, max(looks)))
    called = np.zeros(trials, bool)
    for count in looks:
        seen = runs[:, :count]
        half = student.Estimate(0.0, 1.0, count - 1.0).interval().high * seen.std(axis=1, ddof=1) / np.sqrt(count)
        called |= np.abs(seen.mean(axis=1)) > half
    return float(called.mean())


def looks_table(looks: Sequence[tuple[int, ...]] = LOOKS) -> pd.DataFrame:
    """``called_by_chance`` for the ways in which seeds may be added, as texts."""
    rows = [", ".join(map(str, counts)) for counts in looks]
    return pd.DataFrame(
        {"judged after (seeds)": rows, "called by chance": [f"{called_by_chance(c):.0%}" for c in looks]}
    )
