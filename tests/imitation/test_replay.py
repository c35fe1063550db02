"""The store of candidates' steps against a slow loop; and a search that learns from it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dial import config_of, demonstrations
from hypothesis import given, settings
from hypothesis import strategies as st

from qdil import ppga
from qdil.imitation import replay
from qdil.types import Transitions

N, LONGEST, PLACES = 6, 23, (4, 5)


def numbered(episode, step):
    """A step that says whose it is: every field holds 100·episode + step."""
    number = 100.0 * np.asarray(episode) + np.asarray(step)
    wide = np.repeat(number[..., None], 2, axis=-1)
    return Transitions(wide, wide, wide, wide, number, number < 0, number < 0, wide)


def chunks_of(lengths, chunk, together, rng):
    """An evaluation of episodes of ``lengths``, chunk by chunk; in each, some unfinished episodes wait."""
    done = np.zeros(N, int)
    while (done < lengths).any():
        before, parts, counts = done.copy(), [], []
        for _ in range(together):
            waits = rng.random(N) < 0.3
            steps = done[None] + np.arange(chunk)[:, None]
            counted = (steps < lengths) & ~waits
            parts.append(numbered(np.broadcast_to(np.arange(N), steps.shape), np.where(counted, steps, -7)))
            counts.append(counted)
            done = done + counted.sum(axis=0)
        yield before, jax.tree.map(lambda *x: np.stack(x), *parts), np.stack(counts)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**31 - 1), st.integers(1, 9), st.integers(1, 4), st.sampled_from([0.1, 0.5, 1.0]))
def test_the_store_keeps_the_picked_steps_whatever_the_chunks_are(seed, chunk, together, share):
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, LONGEST + 1, N)
    empty = jax.tree.map(lambda x: np.full((*PLACES, *x.shape[2:]), -1).astype(x.dtype), numbered(np.zeros((1, 1)), 0))
    picks = replay.pick(jax.random.key(seed), share, np.prod(PLACES), N, LONGEST)
    store = jax.tree.map(jnp.asarray, empty)
    for before, transitions, counted in chunks_of(lengths, chunk, together, rng):
        store = replay.keep(store, picks, jnp.asarray(before), jax.tree.map(jnp.asarray, transitions), counted)
    expected = -np.ones(np.prod(PLACES))
    for place, episode, step in zip(*map(np.asarray, picks), strict=True):
        if step < lengths[episode]:
            expected[place] = 100 * episode + step
    np.testing.assert_array_equal(np.ravel(store.reward), expected)
    np.testing.assert_array_equal(np.asarray(store.obs)[..., 1].ravel(), expected)


def test_picks_are_of_different_places_and_of_any_step():
    picks = [replay.pick(jax.random.key(i), 0.25, 40, 3, 5) for i in range(300)]
    assert all(len(set(np.asarray(one.place).tolist())) == 10 for one in picks)
    counts = np.zeros((3, 5))
    for one in picks:
        np.add.at(counts, (np.asarray(one.episode), np.asarray(one.step)), 1)
    np.testing.assert_allclose(counts, 200, atol=5 * np.sqrt(200))


@pytest.mark.compiles
def test_the_reward_model_learns_from_rollout_and_store_in_equal_parts():
    """A store of which everything is renewed holds the candidates' steps; learning reads both halves."""
    config = config_of("gail", replay_share=1.0, eval_chunk_steps=7, eval_chunks_per_sync=2)
    search = ppga.begin(config, demonstrations())
    first = np.asarray(search.state.store.obs)
    after, _ = ppga.iteration(search)
    assert after.state.store.obs.shape == first.shape == (20, 24, 2)
    assert (np.asarray(after.state.store.obs) != first).any()

    model = search.engine.reward.model
    watched = model._replace(update=lambda key, state, context, demos, steps: (state, {"seen": steps.action}))
    rollout = search.engine.rollout(after.state, ppga.filled(after)).transitions
    search.engine.reward.__dict__["model"] = watched
    search.engine.reward.__dict__.pop("update", None)
    try:
        _, info = search.engine.update_reward(after.state, ppga.filled(after), search.demos, rollout)
    finally:
        search.engine.reward.__dict__["model"] = model
        search.engine.reward.__dict__.pop("update", None)
    np.testing.assert_array_equal(info["seen"][:20], rollout.action)
    np.testing.assert_array_equal(info["seen"][20:], after.state.store.action)
    assert (np.asarray(rollout.action) != np.asarray(after.state.store.action)).any()


@pytest.mark.compiles
def test_in_the_warm_up_the_store_is_the_rounds_rollout():
    """Nothing is evaluated yet, so a store that stayed as it was would keep the steps of θ_0."""
    search = ppga.begin(config_of("gail", replay_share=0.1, walk_updates=2), demonstrations())
    after, _, _ = ppga.warm_up(search, 2)
    assert (np.asarray(after.state.store.action) != np.asarray(search.state.store.action)).any()
    trained = search.engine.train_policy(search.state, ppga.filled(search), np.eye(3)[0], 2, search.demos, bonus=False)
    np.testing.assert_array_equal(after.state.store.action, trained.transitions.action)


@pytest.mark.compiles
def test_speed_settings_leave_the_store_alone():
    stores = []
    for chunk, together in ((20, 1), (5, 3)):
        config = config_of("gail", replay_share=0.5, eval_chunk_steps=chunk, eval_chunks_per_sync=together)
        search, _ = ppga.iteration(ppga.begin(config, demonstrations()))
        stores.append(search.state.store)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5), *stores)
