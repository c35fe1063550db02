"""Lemma 1 on a robot: a few PPO updates on 1[m ∈ A_e] alone, and P(m ∈ A_e | π) counted over episodes before and after.

Three things differ from the lemma. The probability is estimated. A robot that falls has a shorter episode and is paid
fewer bonuses. And PPO sees windows of episodes, so the step of an unfinished episode is paid for the measures so far.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import binomtest

from qdil import ppga
from qdil.config import Config, make_config
from qdil.imitation.bonus import is_empty
from qdil.ppga import Search
from qdil.qd.archive import EDGE


class Size(NamedTuple):
    """How much is done with each seed."""

    seeds: int
    warmup: int  # PPO updates on the true reward that make the old policy
    known: tuple[float, ...]  # shares of the old policy's episodes whose cells an archive has already; one archive each
    updates: int  # PPO updates on the bonus alone
    rounds: int  # times that each policy plays ``num_envs`` episodes


SIZES = {
    "smoke": Size(seeds=2, warmup=2, known=(0.5, 0.9), updates=1, rounds=1),
    "laptop": Size(seeds=4, warmup=60, known=(0.5, 0.9), updates=15, rounds=3),
    "full": Size(seeds=5, warmup=200, known=(0.5, 0.9), updates=15, rounds=1),
}


class Sample(NamedTuple):
    """Episodes of one policy."""

    measures: np.ndarray  # (N, k)
    length: np.ndarray  # (N,) steps


class Trial(NamedTuple):
    """One policy and one archive, before and after."""

    seed: int
    known: float  # share of episodes in filled cells that the archive was made for
    episodes: int  # played by either policy
    found_old: int  # of these, with m ∈ A_e
    found_new: int
    return_old: float  # mean sum of bonuses per episode: what PPO maximises, but for the discount
    return_new: float
    length_old: float  # mean steps per episode
    length_new: float

    @property
    def change(self) -> float:
        """Of the estimated P(m ∈ A_e | π)."""
        return (self.found_new - self.found_old) / self.episodes


def interval(found: int, episodes: int) -> tuple[float, float]:
    """95 % Clopper-Pearson interval of a probability that ``found`` of ``episodes`` trials estimate."""
    low, high = binomtest(found, episodes).proportion_ci(0.95, method="exact")
    return float(low), float(high)


def run(env: str, budget: str, say: Callable[[str], object] = print, size: Size | None = None) -> list[Trial]:
    """Every seed and archive of ``size`` (None: the budget's). ``say`` hears a line per seed."""
    size = size or SIZES[budget]
    trials: list[Trial] = []
    for seed in range(1, size.seeds + 1):
        say(f"{env}, seed {seed} of {size.seeds}: {size.warmup} updates to make a policy, {size.updates} on the bonus")
        trials += _seed(_config(env, "mbo-zero", budget, seed), size)
    return trials


def _config(env: str, method: str, budget: str, seed: int) -> Config:
    """The budget's own, but evaluated one sampled episode per robot, so that episodes can be counted."""
    robots = make_config(env, method, budget, seed).ppo.num_envs
    changes = {"sample_actions": True, "episodes": 1, "candidates": robots, "bonus_p": 0.0, "bonus_q": 1.0}
    return make_config(env, method, budget, seed, **changes)


def _seed(config: Config, size: Size) -> list[Trial]:
    old = _with_policy_of(_warmed(config, size.warmup), ppga.begin(config, None))
    seen = play(old, size.rounds, stream=0)
    before = play(old, size.rounds, stream=1)  # not the episodes that chose the archive
    return [_trial(old, before, make_archive(seen, config.ppga.cells, known), known, size) for known in size.known]


def _trial(old: Search, before: Sample, occupied: np.ndarray, known: float, size: Size) -> Trial:
    new = improve(old, occupied, size.updates)
    after = play(new, size.rounds, stream=2)
    found_old, found_new = (_found(occupied, episodes) for episodes in (before, after))
    return Trial(
        old.config.seed, known, len(found_old), int(found_old.sum()), int(found_new.sum()),
        float(np.mean(found_old * before.length)), float(np.mean(found_new * after.length)),
        float(before.length.mean()), float(after.length.mean()),
    )  # fmt: skip


def _found(occupied: np.ndarray, episodes: Sample) -> np.ndarray:
    """(N,) 1.0 for every episode with m ∈ A_e."""
    return np.asarray(is_empty(jnp.asarray(occupied), jnp.asarray(episodes.measures)))


def _warmed(config: Config, updates: int) -> Search:
    """A search after plain PPO on the true reward."""
    return ppga.warmed_up(ppga.begin(_config(config.env, "true", config.budget, config.seed), None), updates)


def _with_policy_of(teacher: Search, search: Search) -> Search:
    """``search`` with the policy, statistics and robots of ``teacher``; its critic knows nothing of the true reward."""
    own, taught = search.state, teacher.state
    train_state = own.train_state._replace(policy=taught.train_state.policy)
    return search._replace(state=own._replace(train_state=train_state, stats=taught.stats, envs=taught.envs))


def improve(search: Search, occupied: np.ndarray, updates: int) -> Search:
    """``updates`` VPPO updates of θ_μ on the search's fitness reward with its bonus (Algorithm 1's walk, c = c_0)."""
    fitness_alone = np.eye(search.engine.objectives)[0]
    trained = search.engine.train_policy(search.state, jnp.asarray(occupied), fitness_alone, updates)
    return search._replace(state=trained.state)


def play(search: Search, rounds: int, stream: int) -> Sample:
    """Whole episodes of θ_μ with sampled actions, ``rounds`` times as many as there are candidates."""
    config, stats = search.config, search.state.stats
    theta = jnp.tile(search.engine.theta_mu(search.state), (config.ppga.candidates, 1))
    policies = search.engine.all_with_normaliser(theta, stats)
    key = jax.random.fold_in(jax.random.key(config.seed), stream)
    played = [ppga.evaluate(search, policies, jax.random.fold_in(key, i)) for i in range(rounds)]
    finite = [candidates.finite for candidates in played]
    measures, length = (
        np.concatenate([getattr(c, name)[ok] for c, ok in zip(played, finite, strict=True)])
        for name in ("measures", "length")
    )
    return Sample(measures, length)


def make_archive(seen: Sample, cells: int, known: float) -> np.ndarray:
    """Which cells of a grid are filled, (cells, …) bool: those visited most, until they hold ``known`` of the episodes.

    So the old policy finds an empty cell in about 1 - ``known`` of its episodes, as a search does that has been at it
    for a while.
    """
    k = seen.measures.shape[1]
    index = np.clip((cells * seen.measures + EDGE).astype(int), 0, cells - 1)
    visits = np.zeros((cells,) * k, int)
    np.add.at(visits, tuple(index.T), 1)
    order = np.argsort(-visits.reshape(-1), kind="stable")
    held_before = np.cumsum(visits.reshape(-1)[order]) - visits.reshape(-1)[order]
    filled = np.zeros(visits.size, bool)
    filled[order[held_before < known * len(index)]] = True
    return (filled & (visits.reshape(-1) > 0)).reshape(visits.shape)
