"""PPGA on real physics at a tiny size: PPO improves, nothing compiles twice, Algorithm 1's steps do what they say."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdil import ppga
from qdil.config import make_config
from qdil.imitation.reward_model import Demonstrations
from qdil.qd import archive
from qdil.rl import networks

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


def begin(method: str) -> ppga.Search:
    """A smoke run before anything was called; imitators learn from made-up demonstrations."""
    config = make_config("walker2d", method, "smoke")
    rng = np.random.default_rng(0)
    shapes = {"obs": 17, "action": 6, "next_obs": 17, "proxy": 2}
    demos = Demonstrations(*(jnp.asarray(rng.normal(size=(60, width)), jnp.float32) for width in shapes.values()))
    return ppga.begin(config, None if method == "true" else demos)


def begun(method: str) -> ppga.Search:
    """A smoke run after its warm-up and first iteration."""
    search = begin(method)
    search, *_ = ppga.warm_up(search, search.config.ppga.warmup_updates)
    return ppga.iteration(search)[0]


@pytest.fixture(scope="module")
def search():
    return begun("true")


@pytest.fixture(scope="module")
def imitator():
    return begun("mconbo-gail")


@pytest.mark.parametrize("name", ["search", "imitator"])
def test_no_compilation_after_the_first_iteration(name, request, compilations, monkeypatch):
    search = request.getfixturevalue(name)
    compilations.clear()
    search, *_ = ppga.warm_up(search, 2)
    for _ in range(2):
        search, _ = ppga.iteration(search)
    with monkeypatch.context() as patch:  # an iteration that restarts
        patch.setattr(archive, "add", lambda archives, candidates: np.zeros(len(candidates.fitness)))
        search, info = ppga.iteration(search)
    assert info["restarts"] == 1
    ppga.evaluate(search, ppga.batch_of_elites(search, 0), search.state.key)
    assert compilations == []


@pytest.mark.parametrize("method", ["true", "mconbo-gail"])
def test_a_run_compiles_all_its_programs_before_it_calls_one(method, compilations):
    """What is compiled ahead must be what the calls look for, or everything would be compiled twice."""
    jax.clear_caches()
    search = begin(method)
    ahead = set(compilations)
    compilations.clear()
    search, *_ = ppga.warm_up(search, 1)
    search, _ = ppga.iteration(search)
    simulate = ["init", "begin", "collect", "advance", "finish"]
    programs = [*simulate, "fork", "learn", "unfork", "branch", "jump", "give_up", "pay", "pay_episodes"]
    programs += ["update"] if search.engine.model.learns else []
    assert {f"jit({name})" for name in programs} <= ahead
    assert [name for name in programs if f"jit({name})" in compilations] == []


def spied(search: ppga.Search) -> tuple[ppga.Search, list]:
    """The same run, keeping a list of what VPPO is asked for."""
    calls = []

    def train(state, occupied, weights, tied, num_updates, epochs):
        calls.append((state, np.asarray(occupied), np.asarray(weights), tied, num_updates, epochs))
        return search.engine.train(state, occupied, weights, tied, num_updates, epochs)

    return search._replace(compiled=search.engine._replace(train=train)), calls


def test_an_iteration_asks_for_gradients_walk_and_fresh_rollouts_in_that_order(imitator):
    watched, calls = spied(imitator)
    before = archive.occupied(imitator.archives)
    after, info = ppga.iteration(watched)
    gradients, walk, fresh = calls
    np.testing.assert_array_equal(gradients[2], np.eye(3))
    assert gradients[3:] == (False, 1, 2) and walk[3:] == (True, 1, 2) and fresh[3:] == (True, 1, 0)
    # The copies' learning is thrown away: the walk begins at the very θ_μ and critic that the gradients began at.
    for one, other in zip(jax.tree.leaves(gradients[0].train_state), jax.tree.leaves(walk[0].train_state), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(gradients[1], before)
    np.testing.assert_array_equal(walk[1], archive.occupied(imitator.archives))
    weighting = [info["c0"], info["c1"], info["c2"]]
    np.testing.assert_allclose(walk[2], np.tile(weighting, (3, 1)), rtol=1e-6)
    if not info["restarts"]:
        np.testing.assert_allclose(np.abs(weighting), np.abs(imitator.xnes.mean), rtol=1e-5)
    assert info["c0"] >= 0


@pytest.mark.parametrize("added", [True, False])
def test_restart_exactly_when_nothing_was_added(search, monkeypatch, added):
    improvement = np.arange(search.config.ppga.candidates) * float(added)
    monkeypatch.setattr(archive, "add", lambda archives, candidates: improvement)
    after, info = ppga.iteration(search)
    assert info["restarts"] == float(not added)
    theta = np.asarray(networks.flatten(after.state.train_state.policy))
    is_elite = (archive.elite_arrays(search.archives)["solution"] == theta).all(axis=1).any()
    assert is_elite == (not added)
    assert np.any(search.xnes.mean) == added


def test_the_bonus_is_paid_while_training_and_depends_on_the_archive(imitator):
    """Same robots, same reward model: an empty archive pays q more per step than a full one."""
    shape = archive.occupied(imitator.archives).shape
    rewards = [
        float(
            imitator.compiled.train(imitator.state, jnp.full(shape, full), jnp.eye(3), True, 1, 0).info[
                "fitness_reward"
            ]
        )
        for full in (False, True)
    ]
    assert rewards[0] - rewards[1] == pytest.approx(imitator.config.bonus.bonus_q, abs=1e-4)
    assert rewards[1] > imitator.config.bonus.bonus_p  # GAIL's own reward is positive


def test_selection_decides_what_fills_the_archive(imitator):
    batch, key = ppga.batch_of_elites(imitator, 0), jax.random.key(2)
    learned = ppga.evaluate(imitator, batch, key)
    true = ppga.evaluate(imitator._replace(config=replace(imitator.config, selection="true")), batch, key)
    np.testing.assert_array_equal(true.fitness, true.true_return)
    np.testing.assert_array_equal(true.true_return, learned.true_return)
    assert not np.allclose(learned.fitness, learned.true_return)
    bonus = ppga.evaluate(imitator._replace(config=replace(imitator.config, bonus_in_fitness=True)), batch, key)
    assert (bonus.fitness >= learned.fitness + imitator.config.bonus.bonus_p * learned.length - 1e-3).all()


def test_before_anything_is_accepted_the_walk_follows_fitness_alone():
    config = make_config("walker2d", "true", "smoke", threshold_min=1e9)
    watched, calls = spied(ppga.begin(config, None))
    after, info = ppga.iteration(watched)
    np.testing.assert_array_equal(calls[1][2], np.tile([1.0, 0, 0], (3, 1)))
    assert info["restarts"] == 1 and archive.random_elite(after.archives, after.rng) is None


def test_the_released_walk_follows_fitness_alone(imitator):
    released = imitator._replace(config=replace(imitator.config, walk_weights="fitness"))
    watched, calls = spied(released)
    assert not released.archives.soft.empty
    ppga.iteration(watched)
    np.testing.assert_array_equal(calls[1][2], np.tile([1.0, 0, 0], (3, 1)))


def test_ppo_on_the_true_reward_improves(search):
    """A few hundred tied updates on the fitness alone: the reward per step under π_θ clearly rises.

    That many programs one after the other also find out whether devices can end up waiting for each other for ever.
    """
    compiled = search.engine
    state = compiled.init(jax.random.key(3), None)
    occupied = jnp.asarray(archive.occupied(search.archives))
    weights = jnp.tile(jnp.array([1.0, 0.0, 0.0]), (3, 1))
    rewards = []
    for _ in range(2):
        watched = compiled.train(state, occupied, weights, True, 1, 0)
        rewards.append(float(watched.info["true_reward"]))
        state = compiled.train(watched.state, occupied, weights, True, 300, 4).state
    assert rewards[1] > rewards[0] + 0.3  # m/s, or shares of steps upright
    print(rewards)


def test_gradients_and_walk_share_one_program_and_differ_as_they_should(search):
    compiled, state = search.engine, search.state
    occupied = jnp.asarray(archive.occupied(search.archives))
    forked = compiled.train(state, occupied, jnp.eye(3), False, 2, 2)
    assert len(np.unique(np.asarray(forked.theta), axis=0)) == 3
    tied = compiled.train(state, occupied, jnp.tile(jnp.array([1.0, 0.5, -0.5]), (3, 1)), True, 2, 2)
    np.testing.assert_array_equal(tied.theta[0], tied.theta[1])
    np.testing.assert_array_equal(tied.theta[0], tied.theta[2])
    assert not np.array_equal(tied.theta[0], networks.flatten(state.train_state.policy))


@pytest.mark.skipif(jax.local_device_count() < 2, reason="one device only")
def test_one_device_does_what_two_do(search):
    """Up to rounding, which physics amplifies: the learned parameters, the statistics, the scores."""
    occupied = jnp.asarray(archive.occupied(search.archives))
    done = []
    for devices in (1, 2):
        run = ppga.begin(replace(search.config, devices=devices), None)
        trained = run.compiled.train(run.state, occupied, jnp.eye(3), False, 1, 2)
        policies, _ = run.compiled.branch(run.state, trained.theta, jnp.ones((run.config.ppga.candidates, 3)))
        scores = ppga.evaluate(run, policies, jax.random.key(4))
        done.append((np.asarray(trained.theta), np.asarray(trained.state.stats.mean), scores))
    np.testing.assert_allclose(done[0][0], done[1][0], atol=2e-3)
    np.testing.assert_allclose(done[0][1], done[1][1], atol=1e-3)
    np.testing.assert_allclose(done[0][2].true_return, done[1][2].true_return, rtol=0.05, atol=1.0)
    np.testing.assert_allclose(done[0][2].measures, done[1][2].measures, atol=0.05)


def test_zero_epochs_collect_data_and_leave_the_policy_alone(search):
    compiled, state = search.engine, search.state
    occupied = jnp.asarray(archive.occupied(search.archives))
    fresh = compiled.train(state, occupied, jnp.eye(3), True, 1, 0)
    np.testing.assert_array_equal(fresh.theta[0], networks.flatten(state.train_state.policy))
    assert float(fresh.state.stats.seen) > float(state.stats.seen)


def test_branching_follows_unit_gradients_and_never_minimises_fitness(search):
    compiled, state = search.engine, search.state
    mu = np.asarray(networks.flatten(state.train_state.policy))
    theta = np.stack([mu + np.eye(1, len(mu), i)[0] * (i + 1) for i in range(3)])  # three orthogonal differences
    coefficients = np.zeros((search.config.ppga.candidates, 3), np.float32)
    coefficients[0] = [-2.0, 0.5, -1.0]
    candidates, jacobian = compiled.branch(state, jnp.asarray(theta, jnp.float32), jnp.asarray(coefficients))
    np.testing.assert_allclose(np.linalg.norm(jacobian, axis=1), 1.0, rtol=1e-4)
    np.testing.assert_allclose(np.asarray(candidates.theta[0])[:3] - mu[:3], [2.0, 0.5, -1.0], atol=1e-5)
    np.testing.assert_allclose(candidates.theta[1], mu)


def test_restart_takes_an_elite_with_its_own_statistics(search):
    compiled = search.engine
    elite = archive.random_elite(search.archives, np.random.default_rng(0))
    state = compiled.restart_at(search.state, elite["solution"], elite["obs_mean"], elite["obs_std"])
    np.testing.assert_array_equal(networks.flatten(state.train_state.policy), elite["solution"])
    np.testing.assert_array_equal(state.stats.mean, elite["obs_mean"])
    np.testing.assert_array_equal(state.stats.std, elite["obs_std"])
    assert all(not np.any(leaf) for leaf in jax.tree.leaves(state.train_state.policy_opt))


def test_elites_score_again_much_as_they_did(search):
    elites = archive.elite_arrays(search.archives)
    again = ppga.reevaluate(search, jax.random.key(5))
    assert len(again["rescored_return"]) == len(elites["index"])
    assert again["rescored_measures"].shape == elites["measures"].shape
    assert np.abs(again["rescored_return"] - elites["true_return"]).mean() < 0.5 * elites["true_return"].mean()
