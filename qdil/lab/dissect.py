"""The parts of a QD iteration of PPGA: a search after its warm-up, policies compared, the path of θ_μ."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from qdil import ppga
from qdil.config import Config
from qdil.qd import archive
from qdil.qd.xnes import XNES


class RepeatedScores(NamedTuple):
    """n policies scored r times each over whole episodes; a score is a mean over a candidate's episodes."""

    fitness: np.ndarray  # (n, r) return
    measures: np.ndarray  # (n, r, k)


def warmed(config: Config, updates: int) -> ppga.Search:
    """A new search after ``updates`` of plain PPO on its own reward.

    It has no demonstrations, so the base of ``config.method`` must not imitate.
    """
    return ppga.warmed_up(ppga.begin(config, None), updates)


def try_out(search: ppga.Search, theta: jax.Array, seed: int) -> RepeatedScores:
    """Score n policies ``theta`` (n, P) side by side, under the search's normaliser, as candidates are scored.

    The policies share the places of the λ candidates equally: r = λ // n repetitions each, so n is at most λ.
    """
    config, stats = search.config, search.state.stats
    n, repetitions = len(theta), config.ppga.candidates // len(theta)
    order = np.minimum(np.arange(config.ppga.candidates) // repetitions, n - 1)
    policies = search.engine.all_with_normaliser(jnp.asarray(theta)[order], stats)
    scores = ppga.evaluate(search, policies, jax.random.key(seed))
    used = n * repetitions
    fitness = np.asarray(scores.fitness)[:used].reshape(n, repetitions)
    return RepeatedScores(fitness, np.asarray(scores.measures)[:used].reshape(n, repetitions, -1))


def search_policy(search: ppga.Search) -> jax.Array:
    """θ_μ (P,)."""
    return search.engine.theta_mu(search.state)


def episode(search: ppga.Search) -> np.ndarray:
    """δ (T, k) of one whole episode of θ_μ as PPO sees it, with sampled actions: the first robot's first whole one.

    ``search`` stays as it is, and its compiled programs are used.
    """
    config, state = search.config, search.state
    occupied = jnp.asarray(archive.occupied(search.archives))
    proxy, ended = [], []
    for _ in range(2 * config.simulation.episode_length // config.ppo.rollout_length + 1):  # long enough for two ends
        rolled = search.engine.rollout(state, occupied)
        state = rolled.state
        proxy.append(np.asarray(rolled.transitions.proxy[:, 0]))
        ended.append(np.asarray(rolled.transitions.ended[:, 0]))
    return np.concatenate(proxy)[first_whole(np.concatenate(ended))]


def first_whole(ended: np.ndarray) -> slice:
    """The rows of the first whole episode; ``ended`` (T,) marks last steps. Raises ValueError with fewer than two."""
    ends = np.flatnonzero(ended)
    if len(ends) < 2:
        raise ValueError("no whole episode lies between two ends.")
    return slice(int(ends[0]) + 1, int(ends[1]) + 1)


def distribution(xnes: XNES) -> tuple[np.ndarray, np.ndarray]:
    """Mean (1+k,) and covariance (1+k, 1+k) of the coefficients that xNES samples."""
    return xnes.mean.copy(), xnes.sigma**2 * xnes.shape @ xnes.shape.T


def compare(scores: RepeatedScores, names: list[str], feet: tuple[str, ...]) -> pd.DataFrame:
    """A row per policy: means of return and measures over the repetitions, and their standard errors.

    Columns (quantity, "mean") and (quantity, "error"). The error of a single repetition is not-a-number.
    """
    values = {"return": scores.fitness, **{f"{foot} down": scores.measures[..., j] for j, foot in enumerate(feet)}}
    table = {}
    for quantity, numbers in values.items():
        table[quantity, "mean"] = numbers.mean(axis=1)
        table[quantity, "error"] = _standard_error(numbers)
    return pd.DataFrame(table, index=names)


def _standard_error(numbers: np.ndarray) -> np.ndarray:
    count = numbers.shape[1]
    return numbers.std(axis=1, ddof=1) / np.sqrt(count) if count > 1 else np.full(len(numbers), np.nan)


def follow(search: ppga.Search, iterations: int) -> tuple[ppga.Search, pd.DataFrame]:
    """Run some QD iterations. A row for each: θ_μ's return, its measures m1, …, mk and its walk's weights c0, …, ck.

    Row 0 is θ_μ before the first iteration, without weights (not-a-number). ``restart`` is True if the iteration ended
    in a restart, which moves θ_μ to an elite.
    """
    rows = [{**_position(search, 0), "restart": False}]
    for i in range(iterations):
        search, info = ppga.iteration(search)
        weights = {f"c{j}": float(c) for j, c in enumerate(info.coefficients)}
        rows.append({**_position(search, i + 1), **weights, "restart": bool(info.restarts)})
    return search, pd.DataFrame(rows).rename_axis("iteration")


def _position(search: ppga.Search, seed: int) -> dict[str, float]:
    """The measures and the return of θ_μ."""
    scores = try_out(search, search_policy(search)[None], seed)
    measures = {f"m{j + 1}": float(m) for j, m in enumerate(scores.measures[0].mean(axis=0))}
    return {**measures, "return": float(scores.fitness.mean())}
