"""Programs: each is compiled once, before it is called, for any number of devices."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dial import config_of, demonstrations

from qdil import ppga
from qdil.engine import aot
from qdil.engine.engine import Engine
from qdil.engine.program import programs_of
from qdil.engine.programs import reward_programs, search_programs
from qdil.qd import archive

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


SCHEDULES = [("true", "iteration", 0.0), ("mconbo-gail", "iteration", 0.5), ("mconbo-gail", "update", 0.0)]


@pytest.mark.parametrize(("method", "schedule", "share"), SCHEDULES)
def test_every_program_is_compiled_before_it_is_called_and_never_again(
    method, schedule, share, compilations, monkeypatch
):
    """What is compiled ahead of time must be what the calls look for, or everything would be compiled twice."""
    search_programs.cache_clear(), reward_programs.cache_clear(), jax.clear_caches()
    config = config_of(method, reward_schedule=schedule, restart_rounds=1, replay_share=share)
    search = ppga.begin(config, None if method == "true" else demonstrations())
    declared = {*programs_of(search.engine.search), *programs_of(search.engine.reward)}
    unused = set() if search.engine.model.learns else {"update"}
    unused |= {"steps_of_first_copy"} if schedule == "iteration" else set()
    unused |= {"keep_steps"} if share == 0 else set()
    assert {f"jit({name})" for name in declared - unused} <= set(compilations)
    compilations.clear()

    search, *_ = ppga.warm_up(search, 1)
    search, _ = ppga.iteration(search)
    assert {f"jit({name})" for name in declared}.isdisjoint(compilations)
    compilations.clear()

    search, *_ = ppga.warm_up(search, 2)
    for _ in range(2):
        search, _ = ppga.iteration(search)
    with monkeypatch.context() as patch:  # an iteration that restarts
        nothing = np.zeros(config.ppga.candidates)
        patch.setattr(archive, "add", lambda archives, *more: archive.Added(archives, nothing, nothing > 0))
        search, info = ppga.iteration(search)
    assert info.restarts == 1
    ppga.evaluate(search, ppga.batch_of_elites(search, 0), search.state.key)
    assert compilations == []


def test_ahead_of_time_compilation_names_every_declared_program():
    engine, demos = Engine(config_of("mconbo-gail", reward_schedule="update", replay_share=0.5)), demonstrations()
    names = aot.compile_all(engine.search, engine.reward, engine.config, jax.random.key(0), demos)
    assert sorted(names) == sorted([*programs_of(engine.search), *programs_of(engine.reward)])


def test_results_lie_as_declared():
    """The layout that a program is declared with is the one that its results have."""
    search = ppga.begin(config_of("true"), None)
    programs, state = search.engine.search, search.state
    copies = programs.replicate(state.train_state)
    _, expected = programs.collect.lower(copies, state.stats, state.envs)
    actual = programs.collect(copies, state.stats, state.envs)

    def same(shape, array):
        assert (shape.shape, shape.dtype) == (array.shape, array.dtype)
        assert array.sharding.is_equivalent_to(shape.sharding, array.ndim)

    jax.tree.map(same, expected, actual)


def test_equal_settings_share_programs_and_others_do_not():
    one, other = Engine(config_of("true")), Engine(config_of("mconbo-gail", seed=3))
    assert one.search is other.search
    assert Engine(config_of("mbo-true")).reward is one.reward
    assert Engine(config_of("true", gamma=0.5)).search is not one.search


@pytest.mark.skipif(jax.local_device_count() < 2, reason="one device only")
def test_one_device_does_what_two_do():
    """Up to rounding: the copies' parameters, the statistics, the scores."""
    done = []
    for devices in (1, 2):
        engine = Engine(config_of("true", devices=devices))
        assert engine.num_devices == devices
        state, occupied = engine.init(jax.random.key(0), None), jnp.zeros((5, 5), bool)
        trained = engine.train_copies(state, occupied, 2)
        policies, _ = engine.branch(state, trained.theta, np.ones((engine.config.ppga.candidates, 3)))
        scores = engine.score(state, occupied, policies, jax.random.key(4))
        done.append(jax.tree.map(np.asarray, (trained.theta, trained.state.stats.mean, scores)))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-3), *done)


def test_a_rollout_collects_data_and_leaves_the_policy_alone():
    search = ppga.begin(config_of("true"), None)
    fresh = search.engine.rollout(search.state, jnp.zeros((5, 5), bool))
    np.testing.assert_array_equal(fresh.theta[0], search.engine.theta_mu(search.state))
    jax.tree.map(np.testing.assert_array_equal, fresh.state.train_state.critic, search.state.train_state.critic)
    assert float(fresh.state.stats.seen) > float(search.state.stats.seen)


def test_copies_part_and_a_tied_policy_stays_one():
    search = ppga.begin(config_of("true"), None)
    engine, occupied = search.engine, jnp.zeros((5, 5), bool)
    copies = engine.train_copies(search.state, occupied, 2)
    assert len(np.unique(np.asarray(copies.theta), axis=0)) == 3
    tied = engine.train_policy(search.state, occupied, np.array([1.0, 0.5, -0.5]), 2)
    np.testing.assert_array_equal(tied.theta[0], tied.theta[1])
    np.testing.assert_array_equal(tied.theta[0], tied.theta[2])
    assert not np.array_equal(tied.theta[0], engine.theta_mu(search.state))


def test_a_phase_that_is_not_finite_is_discarded_whole():
    search = ppga.begin(config_of("true"), None)
    broken = jax.tree.map(lambda x: x.at[...].set(np.nan), search.state.train_state.policy["log_std"])
    policy = search.state.train_state.policy | {"log_std": broken}
    state = search.state._replace(train_state=search.state.train_state._replace(policy=policy))
    trained = search.engine.train_copies(state, jnp.zeros((5, 5), bool), 1)
    assert float(trained.rolled_back) == 1.0
    jax.tree.map(np.testing.assert_array_equal, trained.state.stats, state.stats)
