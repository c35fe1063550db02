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
from qdil.lab.lemma.ppo import STATIC, Settings

CELLS = 5  # per measure of the archive
FILLED = 0.5  # probability that a cell of the archive is filled


class Problem(NamedTuple):
    """What one trial starts from."""

    mdp: Mdp
    theta: jax.Array  # (S, A) logits of the old policy
    occupied: jax.Array  # (CELLS, CELLS) bool


class Trials(NamedTuple):
    """N trials before and after one improvement, exact values."""

    probability_old: np.ndarray  # (N,) P(m ∈ A_e | π_old)
    probability_new: np.ndarray  # (N,)
    objective_old: np.ndarray  # (N,) h(θ_old, A_e) of eq. 17
    objective_new: np.ndarray  # (N,)

    @property
    def change(self) -> np.ndarray:
        """(N,) of P(m ∈ A_e | π); inequality (2) of Lemma 1 says ≥ 0."""
        return self.probability_new - self.probability_old

    @property
    def objective_change(self) -> np.ndarray:
        """(N,) of h; the lemma assumes ≥ 0."""
        return self.objective_new - self.objective_old

    @property
    def posterior(self) -> np.ndarray:
        """(N,) P(π_new | m ∈ A_e) by Bayes' rule with a uniform prior over the two policies; (1) says ≥ 1/2.

        One half where neither policy ever finds an empty cell.
        """
        both = self.probability_old + self.probability_new
        return np.where(both > 0, self.probability_new / np.maximum(both, 1e-30), 0.5)


@partial(jax.jit, static_argnames="count")
def problems(seed: int, count: int, falls: float, filled: float = FILLED) -> Problem:
    """``count`` random problems, axis (N) in front: an MDP, a policy and an archive each.

    ``falls`` as in ``random_mdp``; ``filled`` is the probability that a cell of an archive is filled.
    """

    def one(key: jax.Array) -> Problem:
        mdp_key, theta_key, archive_key = jax.random.split(key, 3)
        mdp = random_mdp(mdp_key, falls=falls)
        theta = jax.random.normal(theta_key, mdp.fall.shape)
        return Problem(mdp, theta, jax.random.bernoulli(archive_key, filled, (CELLS, CELLS)))

    return jax.vmap(one)(jax.random.split(jax.random.key(seed), count))


def by_ppo(seed: int, count: int, settings: Settings, falls: float = 0.0, filled: float = FILLED) -> Trials:
    """One iteration of sampled PPO on ``count`` random problems."""
    given = problems(seed, count, falls, filled)
    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), 1), count)
    return _judged(given, _improved(keys, given, _fixed(settings), _loose(settings)), settings)


def by_gradient(seed: int, count: int, size: float, settings: Settings, falls: float = 0.0) -> Trials:
    """One step of ``size`` along the exact gradient on the same random problems."""
    given = problems(seed, count, falls)
    return _judged(given, _climbed(given, size, settings.horizon, settings.gamma), settings)


@partial(jax.jit, static_argnames="horizon")
def _climbed(given: Problem, size: float, horizon: int, gamma: float) -> jax.Array:
    return jax.vmap(lambda one: ppo.ascend(one.mdp, one.theta, one.occupied, horizon, gamma, size))(given)


def _fixed(settings: Settings) -> tuple[int, ...]:
    return tuple(getattr(settings, name) for name in STATIC)


def _loose(settings: Settings) -> dict[str, jax.Array]:
    """The settings that programs take as arguments, so that a sweep over them compiles nothing anew."""
    return {name: jnp.float32(value) for name, value in settings._asdict().items() if name not in STATIC}


@partial(jax.jit, static_argnames="fixed")
def _improved(keys: jax.Array, given: Problem, fixed: tuple[int, ...], loose: dict[str, jax.Array]) -> jax.Array:
    settings = Settings(**dict(zip(STATIC, fixed, strict=True)), **loose)  # type: ignore[arg-type] # traced floats

    def one(key: jax.Array, problem: Problem) -> jax.Array:
        return ppo.improve(key, problem.mdp, problem.theta, problem.occupied, settings)

    return jax.vmap(one)(keys, given)


def _judged(given: Problem, theta: jax.Array, settings: Settings) -> Trials:
    """Values of the old policies and of the new ones, ``theta`` (N, S, A), in double precision."""
    (p_old, h_old, _), (p_new, h_new, _) = (values(given, logits, settings) for logits in (given.theta, theta))
    return Trials(p_old, p_new, h_old, h_new)


def values(given: Problem, theta: jax.Array, settings: Settings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """P(m ∈ A_e | π), h and the expected length, (N,) each, of policies ``theta`` (N, S, A), in double precision."""
    with jax.enable_x64(True):
        # Single precision would make small changes of P a matter of rounding.
        wide = jax.tree.map(lambda x: x.astype(jnp.float64) if x.dtype == jnp.float32 else x, (given, theta))
        return jax.device_get(_values(*wide, settings.horizon, float(settings.gamma)))


@partial(jax.jit, static_argnames="horizon")
def _values(given: Problem, theta: jax.Array, horizon: int, gamma: float) -> tuple[jax.Array, jax.Array, jax.Array]:
    def one(problem: Problem, theta: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        mdp, _, occupied = problem
        chance = probability(mdp, theta, occupied, horizon)
        return chance, bonus_return(mdp, theta, occupied, horizon, gamma), mean_length(mdp, theta, horizon)

    return jax.vmap(one)(given, theta)


GROUPS = ("both rose", "both fell", "objective rose, P fell", "objective fell, P rose")
ROUNDING = 1e-9  # a change that is no smaller than minus this is none


def group(trials: Trials) -> np.ndarray:
    """(N,) the number in ``GROUPS`` of every trial; what stays the same counts as risen, as the lemma's ≥ does."""
    rose, held = trials.objective_change >= -ROUNDING, trials.change >= -ROUNDING
    return np.select([rose & held, ~rose & ~held, rose & ~held], [0, 1, 2], 3)


def tally(trials: Trials) -> pd.Series:
    """The shares of the ``GROUPS`` in percent, and the median change of P(m ∈ A_e | π)."""
    shares = 100 * np.bincount(group(trials), minlength=len(GROUPS)) / len(trials.change)
    return pd.Series({**dict(zip(GROUPS, shares, strict=True)), "median change of P": np.median(trials.change)})


class Learning(NamedTuple):
    """Many problems over several iterations of PPO, the archive unchanged; row 0 is before the first."""

    probability: np.ndarray  # (updates + 1, N) P(m ∈ A_e | π)
    length: np.ndarray  # (updates + 1, N) expected steps of an episode
    theta: jax.Array  # (N, S, A) the last policies


def learning(seed: int, count: int, updates: int, settings: Settings, falls: float = 0.0) -> Learning:
    """``updates`` iterations of PPO on ``count`` random problems."""
    given = problems(seed, count, falls)
    theta, rows = given.theta, [values(given, given.theta, settings)]
    for update in range(1, updates + 1):
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), update), count)
        theta = _improved(keys, given._replace(theta=theta), _fixed(settings), _loose(settings))
        rows.append(values(given, theta, settings))
    chances, _, lengths = zip(*rows, strict=True)
    return Learning(np.array(chances), np.array(lengths), theta)


def by_counting(given: Problem, theta: jax.Array, settings: Settings, seed: int, episodes: int) -> np.ndarray:
    """(N,) the share of sampled episodes with m ∈ A_e, of policies ``theta`` (N, S, A)."""
    return np.asarray(_counted(given, theta, seed, episodes, settings.horizon)).mean(axis=1)


@partial(jax.jit, static_argnames=("episodes", "horizon"))
def _counted(given: Problem, theta: jax.Array, seed: int, episodes: int, horizon: int) -> jax.Array:
    """(N, episodes) 1[m ∈ A_e] of sampled episodes."""

    def one(key: jax.Array, problem: Problem, theta: jax.Array) -> jax.Array:
        return is_empty(problem.occupied, sample(key, problem.mdp, theta, horizon, episodes).measures)

    keys = jax.random.split(jax.random.key(seed), theta.shape[0])
    return jax.vmap(one)(keys, given, theta)


def bayes_by_sampling(seed: int, count: int, updates: int, episodes: int, settings: Settings) -> pd.DataFrame:
    """Inequality (1) read literally: who produced the episodes that landed in A_e?

    For each of ``count`` problems a fair coin chooses the old policy or the new one, after ``updates`` iterations of
    PPO, for each of ``episodes`` episodes, and among those with m ∈ A_e the new policy's are counted. Columns:
    ``exact`` (``Trials.posterior``), ``landed``, and ``by_new``, how many of these are the new policy's.
    """
    given = problems(seed, count, 0.0)
    theta = learning(seed, count, updates, settings).theta
    coin = np.random.default_rng(seed).random((count, episodes)) < 0.5
    by_old, by_new = (
        np.asarray(_counted(given, policy, 2 * seed + which, episodes, settings.horizon), bool)
        for which, policy in enumerate((given.theta, theta))
    )
    landed = np.where(coin, by_new, by_old).sum(axis=1)
    exact = _judged(given, theta, settings).posterior
    return pd.DataFrame({"exact": exact, "landed": landed, "by_new": (coin & by_new).sum(axis=1)})
