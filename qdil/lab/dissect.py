"""An iteration of PPGA taken apart, for whoever wants to watch: a search warmed up, policies compared, θ_μ's path."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from qdil import ppga
from qdil.config import Config
from qdil.qd import archive
from qdil.qd.xnes import XNES


class Trials(NamedTuple):
    """Policies over whole episodes, axes (n, r): policy, repetition, each a mean over a candidate's episodes."""

    fitness: np.ndarray  # (n, r) return
    measures: np.ndarray  # (n, r, k)


def warmed(config: Config, updates: int) -> ppga.Search:
    """A search just begun, after ``updates`` of plain PPO on its own reward; needs no demonstrations.

    ``config.method`` must be of a base that does not imitate.
    """
    return ppga.warmed_up(ppga.begin(config, None), updates)


def try_out(search: ppga.Search, theta: jax.Array, seed: int) -> Trials:
    """Score each of n policies ``theta`` (n, P), under the search's normaliser, as often as candidates are scored.

    Every policy takes an equal share of the λ candidates' places: r = λ // n repetitions, so n may be λ at most.
    """
    config, stats = search.config, search.state.stats
    n, repetitions = len(theta), config.ppga.candidates // len(theta)
    order = np.minimum(np.arange(config.ppga.candidates) // repetitions, n - 1)
    policies = search.engine.all_with_normaliser(jnp.asarray(theta)[order], stats)
    scores = ppga.evaluate(search, policies, jax.random.key(seed))
    used = n * repetitions
    fitness = np.asarray(scores.fitness)[:used].reshape(n, repetitions)
    return Trials(fitness, np.asarray(scores.measures)[:used].reshape(n, repetitions, -1))


def search_policy(search: ppga.Search) -> jax.Array:
    """θ_μ (P,)."""
    return search.engine.theta_mu(search.state)


def episode(search: ppga.Search) -> np.ndarray:
    """δ (T, k) of one whole episode of θ_μ as PPO sees it: actions sampled, the first robot's first whole episode.

    The search goes nowhere: it plays, with the programs that it has compiled, and learns nothing.
    """
    config, state = search.config, search.state
    occupied = jnp.asarray(archive.occupied(search.archives))
    proxy, ended = [], []
    for _ in range(2 * config.simulation.episode_length // config.ppo.rollout_length + 1):  # long enough for two ends
        played = search.engine.rollout(state, occupied)
        state = played.state
        proxy.append(np.asarray(played.transitions.proxy[:, 0]))
        ended.append(np.asarray(played.transitions.ended[:, 0]))
    return np.concatenate(proxy)[first_whole(np.concatenate(ended))]


def first_whole(ended: np.ndarray) -> slice:
    """Rows of the first whole episode, where ``ended`` (T,) marks last steps. Raises ValueError without two ends."""
    ends = np.flatnonzero(ended)
    if len(ends) < 2:
        raise ValueError("there is no whole episode between two ends.")
    return slice(int(ends[0]) + 1, int(ends[1]) + 1)


def distribution(xnes: XNES) -> tuple[np.ndarray, np.ndarray]:
    """Mean (1+k,) and covariance (1+k, 1+k) of the coefficients that xNES samples, as they are now."""
    return xnes.mean.copy(), xnes.sigma**2 * xnes.shape @ xnes.shape.T


def compare(trials: Trials, names: list[str], feet: tuple[str, ...]) -> pd.DataFrame:
    """A row per policy: means of return and measures over the repetitions, and their standard errors.

    Columns (what, "mean") and (what, "error"). Errors are not-a-number where there is one repetition.
    """
    values = {"return": trials.fitness, **{f"{foot} down": trials.measures[..., j] for j, foot in enumerate(feet)}}
    table = {}
    for what, numbers in values.items():
        table[what, "mean"] = numbers.mean(axis=1)
        table[what, "error"] = _standard_error(numbers)
    return pd.DataFrame(table, index=names)


def _standard_error(numbers: np.ndarray) -> np.ndarray:
    count = numbers.shape[1]
    return numbers.std(axis=1, ddof=1) / np.sqrt(count) if count > 1 else np.full(len(numbers), np.nan)


def follow(search: ppga.Search, iterations: int) -> tuple[ppga.Search, pd.DataFrame]:
    """Go on for some QD iterations; a row for each: θ_μ's own measures m1, m2, … and c_0, c_1, … that it walked by.

    Row 0 is θ_μ before them, its coefficients not-a-number. ``restart`` is True where θ_μ jumped in the end.
    """
    rows = [{**_where(search, 0), "restart": False}]
    for i in range(iterations):
        search, info = ppga.iteration(search)
        walked = {f"c{j}": float(c) for j, c in enumerate(info.coefficients)}
        rows.append({**_where(search, i + 1), **walked, "restart": bool(info.restarts)})
    return search, pd.DataFrame(rows).rename_axis("iteration")


def _where(search: ppga.Search, seed: int) -> dict[str, float]:
    trials = try_out(search, search_policy(search)[None], seed)
    measures = {f"m{j + 1}": float(m) for j, m in enumerate(trials.measures[0].mean(axis=0))}
    return {**measures, "return": float(trials.fitness.mean())}
