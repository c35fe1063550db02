"""PPGA on real physics at a tiny size: PPO improves, nothing compiles twice, Algorithm 1's steps do what they say."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdil import ppga
from qdil.config import make_config
from qdil.search import archive, networks

COMPILED = "/jax/core/compile/backend_compile_duration"


@pytest.fixture
def compilations():
    """Names of the programs compiled (or fetched from the cache) since the test began."""
    seen: list[str] = []

    def listen(event: str, duration: float, **kwargs) -> None:
        if event == COMPILED:
            seen.append(kwargs.get("fun_name", "?"))

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield seen
    jax.monitoring.unregister_event_duration_listener(listen)


@pytest.fixture(scope="module")
def search():
    """Two iterations into a smoke run of the expert."""
    search = ppga.begin(make_config("walker2d", "true", "smoke"), None)
    for _ in range(2):
        search, _ = ppga.iteration(search)
    return search


def test_no_compilation_after_the_first_iteration(search, compilations):
    for _ in range(3):
        search, _ = ppga.iteration(search)
    assert compilations == []


def test_ppo_on_the_true_reward_improves(search):
    """A few hundred tied updates on the fitness alone: the robot's return per episode clearly rises."""
    compiled, config = search.compiled, search.config
    state = compiled.init(jax.random.key(3), None)
    occupied = jnp.asarray(archive.occupied(search.archives))
    weights = jnp.tile(jnp.array([1.0, 0.0, 0.0]), (3, 1))

    def mean_return(state):
        theta = jnp.tile(networks.flatten(state.learner.policy), (config.candidates, 1))
        every = (config.candidates, compiled.parts.env.obs_size)
        stats = jnp.broadcast_to(state.stats.mean, every), jnp.broadcast_to(state.stats.std, every)
        policies = compiled.place(ppga.Policies(theta, *stats))
        return ppga.evaluate(search._replace(state=state), policies, jax.random.key(9)).true_return.mean()

    before = mean_return(state)
    state = compiled.train(state, occupied, weights, True, 150, 4).state
    assert mean_return(state) > 1.2 * before


def test_gradients_and_walk_share_one_program_and_differ_as_they_should(search):
    compiled, state = search.compiled, search.state
    occupied = jnp.asarray(archive.occupied(search.archives))
    forked = compiled.train(state, occupied, jnp.eye(3), False, 2, 2)
    assert len(np.unique(np.asarray(forked.theta), axis=0)) == 3
    tied = compiled.train(state, occupied, jnp.tile(jnp.array([1.0, 0.5, -0.5]), (3, 1)), True, 2, 2)
    np.testing.assert_array_equal(tied.theta[0], tied.theta[1])
    np.testing.assert_array_equal(tied.theta[0], tied.theta[2])
    assert not np.array_equal(tied.theta[0], networks.flatten(state.learner.policy))


def test_zero_epochs_collect_data_and_leave_the_policy_alone(search):
    compiled, state = search.compiled, search.state
    occupied = jnp.asarray(archive.occupied(search.archives))
    fresh = compiled.train(state, occupied, jnp.eye(3), True, 1, 0)
    np.testing.assert_array_equal(fresh.theta[0], networks.flatten(state.learner.policy))
    assert float(fresh.state.stats.seen) > float(state.stats.seen)


def test_branching_follows_unit_gradients_and_never_minimises_fitness(search):
    compiled, state = search.compiled, search.state
    mu = np.asarray(networks.flatten(state.learner.policy))
    theta = np.stack([mu + np.eye(1, len(mu), i)[0] * (i + 1) for i in range(3)])  # three orthogonal differences
    coefficients = np.zeros((search.config.candidates, 3), np.float32)
    coefficients[0] = [-2.0, 0.5, -1.0]
    candidates, jacobian = compiled.branch(state, jnp.asarray(theta, jnp.float32), jnp.asarray(coefficients))
    np.testing.assert_allclose(np.linalg.norm(jacobian, axis=1), 1.0, rtol=1e-4)
    np.testing.assert_allclose(np.asarray(candidates.theta[0])[:3] - mu[:3], [2.0, 0.5, -1.0], atol=1e-5)
    np.testing.assert_allclose(candidates.theta[1], mu)


def test_restart_takes_an_elite_with_its_own_statistics(search):
    compiled = search.compiled
    elite = archive.random_elite(search.archives, np.random.default_rng(0))
    state = compiled.jump(search.state, elite["solution"], elite["obs_mean"], elite["obs_std"])
    np.testing.assert_array_equal(networks.flatten(state.learner.policy), elite["solution"])
    np.testing.assert_array_equal(state.stats.mean, elite["obs_mean"])
    np.testing.assert_array_equal(state.stats.std, elite["obs_std"])
    assert all(not np.any(leaf) for leaf in jax.tree.leaves(state.learner.policy_opt))


def test_elites_score_again_much_as_they_did(search):
    elites = archive.elite_arrays(search.archives)
    again = ppga.reevaluate(search, jax.random.key(5))
    assert len(again["rescored_return"]) == len(elites["index"])
    assert again["rescored_measures"].shape == elites["measures"].shape
    assert np.abs(again["rescored_return"] - elites["true_return"]).mean() < 0.5 * elites["true_return"].mean()
