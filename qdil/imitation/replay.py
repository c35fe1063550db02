"""A store of candidates' steps, from which the reward model learns beside the rollouts of θ_μ (ours, not the paper's).

By Algorithm 1 a discriminator sees the steps of one policy, θ_μ. It learns what separates this policy from the
demonstrations, and forgets the policies before. So a fitness computed now and one computed a few iterations ago
measure different things, although the archive compares them. Candidates spread over the archive, and their episodes are
simulated anyway. With a store of their steps, the discriminator learns what separates all recent policies from the
demonstrations, and its reward changes slowly.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdil.types import Transitions


class Picks(NamedTuple):
    """Which steps of candidates take which places of the store (M)."""

    place: jax.Array  # (M,) of the T·E places, each at most once
    episode: jax.Array  # (M,) of the scored episodes
    step: jax.Array  # (M,) of that episode


def pick(key: jax.Array, share: float, places: int, episodes: int, episode_length: int) -> Picks:
    """Draw which steps a scoring of ``episodes`` keeps: for ``share`` of the ``places``, a random step of a random one.

    A step after the end of its episode is never simulated, and its place keeps what it holds. So all simulated steps
    have the same chance, and long episodes leave more steps than short ones.
    """
    place_key, episode_key, step_key = jax.random.split(key, 3)
    count = round(share * places)
    return Picks(
        jax.random.permutation(place_key, places)[:count],
        jax.random.randint(episode_key, (count,), 0, episodes),
        jax.random.randint(step_key, (count,), 0, episode_length),
    )


def keep(
    store: Transitions, picks: Picks, before: jax.Array, transitions: Transitions, counted: jax.Array
) -> Transitions:
    """The ``store`` (T, E) with the picked steps that C chunks of an evaluation have simulated.

    ``before`` (N,) is the number of steps that each of N episodes had before them. ``transitions`` and ``counted``
    (C, T', N) are as ``rl.evaluate.advance`` returns them. Every step is kept or not whatever the chunks are, so that
    settings of speed do not change results.
    """
    lengths = jnp.sum(counted, axis=1)
    starts = before + jnp.cumsum(lengths, axis=0) - lengths  # (C, N) steps before each chunk
    offset = picks.step - starts[:, picks.episode].astype(jnp.int32)  # (C, M) of the picked step in the chunk
    inside = jnp.clip(offset, 0, counted.shape[1] - 1)
    chunks = jnp.arange(len(counted))[:, None]
    found = (offset == inside) & counted[chunks, inside, picks.episode]  # in one chunk at most
    chunk = jnp.argmax(found, axis=0)
    at = chunk, inside[chunk, jnp.arange(len(chunk))], picks.episode
    place = jnp.where(found.any(axis=0), picks.place, store.reward.size)  # a place that does not exist is dropped

    def put(held: jax.Array, steps: jax.Array) -> jax.Array:
        rows = held.reshape(-1, *held.shape[2:])
        return rows.at[place].set(steps[at], mode="drop").reshape(held.shape)

    return jax.tree.map(put, store, transitions)
