"""Whole-episode evaluation against a plain Python loop on the counter robot."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from probes import counter

from qdil.config import Evaluation
from qdil.imitation.fitness import begin_scoring, score_chunk
from qdil.imitation.reward_model import RewardModel
from qdil.rl import evaluate, networks
from qdil.rl.evaluate import Policies
from qdil.rl.rollout import start
from qdil.types import RewardContext

BOUND, LIMIT, CHUNK, EPISODES, CANDIDATES = 2.0, 10, 4, 3, 5
TEMPLATE = networks.init_policy(jax.random.key(0), 1, 1, (3,), 1e-6)


def fitness(steps):
    """A made-up fitness that reads the state, the action and the proxy."""
    return (steps.obs[..., 0] - 0.5) / 2 + 3 * steps.action[..., 0] + steps.proxy[..., 1]


def evaluated(env, policies, key, score, so_far, sample_actions=False, limit=LIMIT, chunk=CHUNK, chunks=1, batch=1000):
    """The whole loop over episodes; ``score(so_far, steps, counted)`` adds rewards to what an episode has so far."""
    evaluation = Evaluation(
        episodes=key.shape[1],
        sample_actions=sample_actions,
        eval_chunk_steps=chunk,
        eval_chunks_per_sync=chunks,
        eval_batch_size=batch,
    )
    advance = jax.jit(lambda *state: evaluate.advance(env, TEMPLATE, evaluation, *state))
    envs, tally = evaluate.begin(env, key, limit)
    while np.asarray(tally.unfinished).any():
        envs, tally, steps, counted = advance(policies, envs, tally)
        so_far = score(so_far, steps, counted)
    return jax.tree.map(np.asarray, evaluate.finish(tally, so_far.fitness, key.shape[1]))


def scored(env, policies, key, rewards=fitness, **settings):
    """Scores as arrays; ``rewards`` is called once for every sync."""

    def score(so_far, steps, counted):
        return so_far._replace(fitness=so_far.fitness + jnp.sum(jnp.where(counted, rewards(steps), 0.0), axis=(0, 1)))

    return evaluated(env, policies, key, score, evaluate.RewardSum((), jnp.zeros(key.size)), **settings)


@pytest.fixture(scope="module")
def policies():
    """Policies that walk forward, backward or hardly at all, each with its own observation normaliser."""
    rng = np.random.default_rng(0)
    theta = rng.normal(size=(CANDIDATES, networks.flat_size(TEMPLATE))).astype(np.float32)
    theta[:, np.asarray(networks.flatten(TEMPLATE)) == np.log(np.float32(1e-6))] = np.log(1e-6)
    return Policies(
        jnp.asarray(theta),
        jnp.asarray(rng.normal(size=(CANDIDATES, 1)), jnp.float32),
        jnp.asarray(rng.uniform(0.5, 2, size=(CANDIDATES, 1)), jnp.float32),
    )


@pytest.fixture(scope="module")
def keys():
    return jax.random.split(jax.random.key(7), (CANDIDATES, EPISODES))


def mean_action(policies, i, position):
    """The policy's mean, clipped as a robot's actions are: a one-layer tanh network written out."""
    first, last = (jax.tree.map(np.asarray, layer) for layer in networks.unflatten(policies.theta[i], TEMPLATE)["mean"])
    x = np.clip((position - policies.obs_mean[i]) / policies.obs_std[i], -10, 10)
    return float(np.clip(np.tanh(x @ first["w"] + first["b"]) @ last["w"] + last["b"], -1, 1)[0])


def episode_by_hand(policies, i, position):
    """One episode: sum of fitness, return, mean of δ, length."""
    total, true, proxies, length = 0.0, 0.0, [], 0
    while length < LIMIT and position < BOUND:
        action = mean_action(policies, i, position)
        proxies.append([position >= 1, position >= 2])
        total += (position - 0.5) / 2 + 3 * action + proxies[-1][1]
        position += action
        true += position + action / 4
        length += 1
    return total, true, np.mean(proxies, axis=0), length


@pytest.mark.parametrize("chunks", [1, pytest.param(2, marks=pytest.mark.compiles), 7])
@pytest.mark.parametrize("batch", [1, 4, pytest.param(5, marks=pytest.mark.compiles), 1000])
def test_scores_equal_a_plain_loop_over_every_episode(policies, keys, batch, chunks):
    scores = scored(counter(BOUND), policies, keys, batch=batch, chunks=chunks)
    starts = np.asarray(start(counter(BOUND), keys.reshape(-1), 1).robot.physics).reshape(CANDIDATES, EPISODES)
    lengths = []
    for i in range(CANDIDATES):
        episodes = [episode_by_hand(policies, i, float(starts[i, n])) for n in range(EPISODES)]
        by_hand = [np.mean(part, axis=0) for part in zip(*episodes, strict=True)]
        for score, expected in zip(scores[:4], by_hand, strict=True):
            np.testing.assert_allclose(score[i], expected, rtol=1e-4, atol=1e-4)
        lengths += [episode[3] for episode in episodes]
    assert scores.finite.all()
    assert min(lengths) < CHUNK < LIMIT == max(lengths)


def test_permuting_candidates_permutes_scores(policies, keys):
    order = np.array([3, 1, 4, 0, 2])
    env = counter(BOUND)
    plain, permuted = scored(env, policies, keys), scored(env, jax.tree.map(lambda x: x[order], policies), keys[order])
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a[order], b, rtol=1e-6), plain, permuted)


def always(actions):
    """Policies that take the same action wherever they are."""
    zero = jax.tree.map(jnp.zeros_like, TEMPLATE)

    def one(action):
        last = {**zero["mean"][-1], "b": jnp.array([action])}
        return networks.flatten({"mean": [zero["mean"][0], last], "log_std": TEMPLATE["log_std"]})

    theta = jnp.stack([one(a) for a in actions])
    return Policies(theta, jnp.zeros((len(actions), 1)), jnp.ones((len(actions), 1)))


def test_only_the_diverging_candidate_is_not_finite():
    scores = scored(
        counter(1e3, diverges_above=2.5), always([0.0, 0.9, -0.9]), jax.random.split(jax.random.key(0), (3, 4))
    )
    assert scores.finite.tolist() == [True, False, True]
    assert np.isfinite(scores.fitness).all()


def watched(actions, bound):
    """Scores of such policies, and the observations (T, E) of every chunk that was simulated."""
    chunks = []

    def watching(steps):
        chunks.append(np.asarray(steps.obs[..., 0]))
        return steps.reward

    scores = scored(counter(bound), always(actions), jax.random.split(jax.random.key(0), (len(actions), 2)), watching)
    return scores, chunks


def test_the_loop_ends_with_the_last_episode():
    scores, chunks = watched([1.0, 0.5], 3.0)
    assert scores.length[0] == 3 and CHUNK < scores.length[1] <= 6
    assert len(chunks) == 2


def test_a_robot_that_fell_is_driven_no_further():
    scores, chunks = watched([0.8, 0.0], 1.5)
    assert scores.length[0] <= 2 and scores.length[1] == LIMIT
    assert np.max(chunks) < 1.5


def test_finished_episodes_leave_their_batch_to_others():
    """One robot of four lasts: from the second chunk on only its batch is simulated; other data stays zero."""
    driven = []

    def watching(steps):
        driven.append(simulated(steps).sum())
        return steps.reward

    keys = jax.random.split(jax.random.key(0), (4, 1))
    scores = scored(counter(1.5), always([0.9, 0.9, 0.01, 0.9]), keys, watching, batch=2)
    assert np.argmax(scores.length) == 2 and scores.length[2] == LIMIT
    assert driven == [4, 2, 2]


def simulated(steps):
    """Which robots (E,) were driven at all: the data of the others stays zero."""
    return np.any(np.asarray(steps.next_obs[..., 0]) != 0, axis=(0, 1))


def test_robots_that_do_not_fill_a_batch_wait_and_go_first_next_time():
    chunks = []

    def watching(steps):
        chunks.append(np.flatnonzero(simulated(steps)).tolist())
        return steps.reward

    keys = jax.random.split(jax.random.key(0), (4, 1))
    scores = scored(counter(1.5), always([0.01, 0.9, 0.01, 0.01]), keys, watching, batch=2)
    assert scores.length.tolist()[::2] == [LIMIT, LIMIT] and scores.length[3] == LIMIT and scores.length[1] < CHUNK
    assert chunks[:3] == [[0, 1, 2, 3], [0, 2], [0, 3]]
    assert [sum(robot in chunk for chunk in chunks) for robot in (0, 2, 3)] == [3, 3, 3]  # LIMIT steps, CHUNK at a time


@pytest.mark.parametrize("chunks", [1, 3])
def test_a_robot_skipped_in_a_chunk_keeps_its_reward_memory(chunks):
    """The reward of step t is t, so an episode of L steps is worth 0 + 1 + … + (L - 1)."""

    def reward(state, memory, context, transitions):
        length = len(transitions.reward)
        return memory + length, memory + jnp.arange(float(length))[:, None]

    model = RewardModel(lambda *_: (), reward, begin=lambda _, count: jnp.zeros(count))
    context = RewardContext(None, None)
    score = jax.jit(lambda so_far, steps, counted: score_chunk(model, (), so_far, context, steps, counted))
    policies, keys = always([0.01, 0.9, 0.01, 0.2, 0.01, 0.1]), jax.random.split(jax.random.key(0), (6, 1))
    scores = evaluated(counter(1.5), policies, keys, score, begin_scoring(model, (), 6), chunks=chunks, batch=2)
    length = np.asarray(scores.length)
    assert len(set(length)) >= 3
    np.testing.assert_allclose(scores.fitness, length * (length - 1) / 2)


def test_sampled_actions_have_the_policys_mean_and_spread():
    policies = jax.tree.map(lambda x: jnp.repeat(x, 4000, axis=0), always([0.1]))
    theta = networks.unflatten(policies.theta[0], TEMPLATE) | {"log_std": jnp.log(jnp.array([0.2]))}
    policies = policies._replace(theta=jnp.tile(networks.flatten(theta), (4000, 1)))
    keys = jax.random.split(jax.random.key(0), (4000, 1))

    def first_action(steps):
        return steps.action[..., 0]

    actions = scored(counter(BOUND), policies, keys, first_action, sample_actions=True, limit=1, chunk=1).fitness
    assert actions.mean() == pytest.approx(0.1, abs=4 * 0.2 / np.sqrt(4000))
    assert actions.std() == pytest.approx(0.2, rel=0.05)
