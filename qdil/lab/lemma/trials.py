"""Many random problems, each improved once: does P(m ∈ A_e | π) rise whenever the objective does, and if not, why?"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from qdil.imitation.bonus import is_empty
from qdil.lab.lemma import ppo
from qdil.lab.lemma.mdp import Mdp, bonus_return, mean_length, probability, random_mdp, sample
from qdil.lab.lemma.ppo import STATIC, TabularPPO
from qdil.lab.lemma.results import ROUNDING

CELLS = 5  # per measure of the archive
FILLED = 0.5  # probability that a cell of the archive is filled


class LemmaProblem(NamedTuple):
    """The start of a trial."""

    mdp: Mdp
    theta: jax.Array  # (S, A) logits of the old policy
    occupied: jax.Array  # (CELLS, …) bool, an axis per measure


class Improvements(NamedTuple):
    """N trials, before and after one improvement each; exact values."""

    probability_old: np.ndarray  # (N,) P(m ∈ A_e | π_old)
    probability_new: np.ndarray  # (N,)
    objective_old: np.ndarray  # (N,) h(θ_old, A_e) of eq. 17
    objective_new: np.ndarray  # (N,)

    @property
    def change(self) -> np.ndarray:
        """(N,) change of P(m ∈ A_e | π); inequality (2) of Lemma 1 states that it is ≥ 0."""
        return self.probability_new - self.probability_old

    @property
    def objective_change(self) -> np.ndarray:
        """(N,) change of h; the lemma assumes that it is ≥ 0."""
        return self.objective_new - self.objective_old

    @property
    def posterior(self) -> np.ndarray:
        """(N,) P(π_new | m ∈ A_e) by Bayes' rule, both policies equally likely; inequality (1) states that it is ≥ 1/2.

        One half if neither policy ever finds an empty cell.
        """
        both = self.probability_old + self.probability_new
        return np.where(both > 0, self.probability_new / np.maximum(both, 1e-30), 0.5)


@partial(jax.jit, static_argnames=("count", "k"))
def problems(seed: int, count: int, falls: float, filled: float = FILLED, k: int = 2) -> LemmaProblem:
    """``count`` random problems of ``k`` measures, axis (N) in front: an MDP, a policy and an archive each.

    ``falls`` as in ``random_mdp``; ``filled`` is the probability that a cell of an archive is filled.
    """

    def one(key: jax.Array) -> LemmaProblem:
        mdp_key, theta_key, archive_key = jax.random.split(key, 3)
        mdp = random_mdp(mdp_key, falls=falls, k=k)
        theta = jax.random.normal(theta_key, mdp.fall.shape)
        return LemmaProblem(mdp, theta, jax.random.bernoulli(archive_key, filled, (CELLS,) * k))

    return jax.vmap(one)(jax.random.split(jax.random.key(seed), count))


def by_ppo(seed: int, count: int, settings: TabularPPO, falls: float = 0.0, filled: float = FILLED) -> Improvements:
    """One iteration of sampled PPO on ``count`` random problems."""
    given = problems(seed, count, falls, filled)
    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), 1), count)
    return _before_and_after(given, _improved(keys, given, _static(settings), _traced(settings)), settings)


def by_gradient(seed: int, count: int, size: float, settings: TabularPPO, falls: float = 0.0) -> Improvements:
    """One step of ``size`` along the exact gradient on the same random problems."""
    given = problems(seed, count, falls)
    return _before_and_after(given, _ascended(given, size, settings.horizon, settings.gamma), settings)


@partial(jax.jit, static_argnames="horizon")
def _ascended(given: LemmaProblem, size: float, horizon: int, gamma: float) -> jax.Array:
    return jax.vmap(lambda one: ppo.ascend(one.mdp, one.theta, one.occupied, horizon, gamma, size))(given)


def _static(settings: TabularPPO) -> tuple[int, ...]:
    """The settings that a program is compiled for."""
    return tuple(getattr(settings, name) for name in STATIC)


def _traced(settings: TabularPPO) -> dict[str, jax.Array]:
    """The settings that a program takes as arguments, so that a sweep over them compiles nothing anew."""
    return {name: jnp.float32(value) for name, value in settings._asdict().items() if name not in STATIC}


@partial(jax.jit, static_argnames="static")
def _improved(keys: jax.Array, given: LemmaProblem, static: tuple[int, ...], traced: dict[str, jax.Array]) -> jax.Array:
    settings = TabularPPO(**dict(zip(STATIC, static, strict=True)), **traced)  # type: ignore[arg-type] # traced floats

    def one(key: jax.Array, problem: LemmaProblem) -> jax.Array:
        return ppo.improve(key, problem.mdp, problem.theta, problem.occupied, settings)

    return jax.vmap(one)(keys, given)


def _before_and_after(given: LemmaProblem, theta: jax.Array, settings: TabularPPO) -> Improvements:
    """Exact values of the old policies and of the new ones, ``theta`` (N, S, A), in double precision."""
    (p_old, h_old, _), (p_new, h_new, _) = (values(given, logits, settings) for logits in (given.theta, theta))
    return Improvements(p_old, p_new, h_old, h_new)


def values(given: LemmaProblem, theta: jax.Array, settings: TabularPPO) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """P(m ∈ A_e | π), h and the expected length, (N,) each, of policies ``theta`` (N, S, A), in double precision."""
    with jax.enable_x64(True):
        # In single precision, rounding would hide small changes of P.
        wide = jax.tree.map(lambda x: x.astype(jnp.float64) if x.dtype == jnp.float32 else x, (given, theta))
        return jax.device_get(_values(*wide, settings.horizon, float(settings.gamma)))


@partial(jax.jit, static_argnames="horizon")
def _values(
    given: LemmaProblem, theta: jax.Array, horizon: int, gamma: float
) -> tuple[jax.Array, jax.Array, jax.Array]:
    def one(problem: LemmaProblem, theta: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        mdp, _, occupied = problem
        chance = probability(mdp, theta, occupied, horizon)
        return chance, bonus_return(mdp, theta, occupied, horizon, gamma), mean_length(mdp, theta, horizon)

    return jax.vmap(one)(given, theta)


GROUPS = ("both rose", "both fell", "objective rose, P fell", "objective fell, P rose")


def group(trials: Improvements) -> np.ndarray:
    """(N,) every trial's number in ``GROUPS``; an unchanged value counts as risen, as in the lemma's ≥."""
    objective_rose, p_rose = trials.objective_change >= -ROUNDING, trials.change >= -ROUNDING
    cases = [objective_rose & p_rose, ~objective_rose & ~p_rose, objective_rose & ~p_rose]
    return np.select(cases, [0, 1, 2], 3)


def tally(trials: Improvements) -> pd.Series:
    """The shares of the ``GROUPS`` in percent, and the median change of P(m ∈ A_e | π)."""
    shares = 100 * np.bincount(group(trials), minlength=len(GROUPS)) / len(trials.change)
    return pd.Series({**dict(zip(GROUPS, shares, strict=True)), "median change of P": np.median(trials.change)})


class Learning(NamedTuple):
    """Many problems over several iterations of PPO, the archive unchanged; row 0 is before the first."""

    probability: np.ndarray  # (updates + 1, N) P(m ∈ A_e | π)
    length: np.ndarray  # (updates + 1, N) expected steps of an episode
    theta: jax.Array  # (N, S, A) the last policies


def learning(seed: int, count: int, updates: int, settings: TabularPPO, falls: float = 0.0) -> Learning:
    """``updates`` iterations of PPO on ``count`` random problems."""
    given = problems(seed, count, falls)
    theta, rows = given.theta, [values(given, given.theta, settings)]
    for update in range(1, updates + 1):
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), update), count)
        theta = _improved(keys, given._replace(theta=theta), _static(settings), _traced(settings))
        rows.append(values(given, theta, settings))
    chances, _, lengths = zip(*rows, strict=True)
    return Learning(np.array(chances), np.array(lengths), theta)


def by_counting(given: LemmaProblem, theta: jax.Array, settings: TabularPPO, seed: int, episodes: int) -> np.ndarray:
    """(N,) the share of sampled episodes with m ∈ A_e, of policies ``theta`` (N, S, A)."""
    return np.asarray(_counted(given, theta, seed, episodes, settings.horizon)).mean(axis=1)


@partial(jax.jit, static_argnames=("episodes", "horizon"))
def _counted(given: LemmaProblem, theta: jax.Array, seed: int, episodes: int, horizon: int) -> jax.Array:
    """(N, episodes) 1[m ∈ A_e] of sampled episodes."""

    def one(key: jax.Array, problem: LemmaProblem, theta: jax.Array) -> jax.Array:
        return is_empty(problem.occupied, sample(key, problem.mdp, theta, horizon, episodes).measures)

    keys = jax.random.split(jax.random.key(seed), theta.shape[0])
    return jax.vmap(one)(keys, given, theta)


def bayes_by_sampling(seed: int, count: int, updates: int, episodes: int, settings: TabularPPO) -> pd.DataFrame:
    """Inequality (1) taken literally: which policy produced the episodes that landed in A_e?

    For each of ``count`` problems and each of ``episodes`` episodes a fair coin chooses the old policy or the new one,
    which is the old one after ``updates`` iterations of PPO. Columns: ``exact`` (``Improvements.posterior``),
    ``landed``, the number of episodes with m ∈ A_e, and ``by_new``, how many of these the new policy produced.
    """
    given = problems(seed, count, 0.0)
    theta = learning(seed, count, updates, settings).theta
    coin = np.random.default_rng(seed).random((count, episodes)) < 0.5
    by_old, by_new = (
        np.asarray(_counted(given, policy, 2 * seed + which, episodes, settings.horizon), bool)
        for which, policy in enumerate((given.theta, theta))
    )
    landed = np.where(coin, by_new, by_old).sum(axis=1)
    exact = _before_and_after(given, theta, settings).posterior
    return pd.DataFrame({"exact": exact, "landed": landed, "by_new": (coin & by_new).sum(axis=1)})
