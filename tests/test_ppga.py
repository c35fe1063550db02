"""Algorithm 1 as a whole on dials, whose archive is known; and each of its steps by itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dial import LENGTH, config_of, demonstrations, dial

from qdil import ppga
from qdil.config import change
from qdil.engine.engine import Engine
from qdil.imitation.recording import record
from qdil.imitation.reward_model import Demonstrations
from qdil.imitation.selection import select
from qdil.qd import archive
from qdil.rl import networks

CELLS = 25  # of the grid on two dials, all of which can be filled


def trained(config, iterations, demonstrated=None):
    """A run after some iterations, and its coverage and QD-score after each of them."""
    search, rows = ppga.begin(config, demonstrated), []
    for _ in range(iterations):
        search, _ = ppga.iteration(search)
        metrics = archive.metrics(archive.elite_arrays(search.archives), int(search.archives.result.cells))
        rows.append((metrics["coverage"], metrics["qd_score"]))
    return search, np.array(rows)


@pytest.fixture(scope="module")
def expert():
    return trained(config_of("true"), 60)


@pytest.fixture(scope="module")
def imitator():
    """An imitator on dials after one iteration."""
    return trained(config_of("mconbo-gail"), 1, demonstrations())[0]


# The whole algorithm


def test_the_expert_fills_what_can_be_filled_with_what_can_be_earned(expert):
    coverage, qd_score = expert[1].T
    most = CELLS * LENGTH  # a policy earns 1 per step at most, in every cell
    assert coverage[0] < 0.6 and coverage[-1] >= 0.95
    assert qd_score[-1] >= 0.93 * most
    assert (np.diff(coverage) >= 0).all()
    assert (np.diff(qd_score[[0, 4, 14, -1]]) > 0.05 * most).all()


@pytest.mark.compiles
@pytest.mark.parametrize(("k", "cells"), [(1, 10), (3, 3)])
def test_one_dial_and_three_are_filled_too(k, cells):
    _, rows = trained(config_of("true", k, cells=cells), 50)
    assert rows[-1, 0] >= 0.85 and rows[0, 0] < 0.7
    assert rows[-1, 1] >= 0.85 * rows[-1, 0] * cells**k * LENGTH


def test_with_the_bonus_the_search_reaches_cells_that_it_does_not_reach_without():
    """Without any reward nothing but the bonus moves the walk; candidates stay near θ_μ, so the walk decides."""
    changes = {"threshold_min": -1.0, "walk_weights": "fitness", "sigma0": 0.2, "cells": 10, "walk_updates": 6}
    filled = {
        method: [len(trained(config_of(method, seed=seed, **changes), 16)[0].archives.result) for seed in range(1, 6)]
        for method in ("zero", "mbo-zero")
    }
    assert np.mean(filled["mbo-zero"]) > 1.25 * np.mean(filled["zero"])
    assert sum(a > b for a, b in zip(filled["mbo-zero"], filled["zero"], strict=True)) >= 4


def test_an_imitator_of_the_expert_comes_near_it(expert):
    search = expert[0]
    elites = archive.elite_arrays(search.archives)
    rows = select(elites["true_return"], elites["measures"], CELLS, 4)
    chosen = {name: elites[name][rows] for name in ("solution", "obs_mean", "obs_std", "measures")}
    recorded = record(dial(), search.engine.search.template, chosen, jax.random.key(0), LENGTH, False)
    shown = Demonstrations(*(jnp.asarray(recorded[name]) for name in Demonstrations._fields))
    score = {
        m: np.median([trained(config_of(m, seed=seed), 60, shown)[1][-1, 1] for seed in (1, 2, 3)])
        for m in ("gail", "zero")
    }
    assert score["gail"] >= 0.7 * expert[1][-1, 1]
    assert score["gail"] > score["zero"] + 0.1 * expert[1][-1, 1]


def test_a_permutation_of_candidates_permutes_their_results(expert):
    search = expert[0]
    batch = jax.tree.map(np.asarray, ppga.batch_of_elites(search, 0))
    order = np.random.default_rng(0).permutation(len(batch.theta))
    permuted = search.engine.place(jax.tree.map(lambda x: jnp.asarray(x[order]), batch))
    one = ppga.evaluate(search, search.engine.place(jax.tree.map(jnp.asarray, batch)), jax.random.key(0))
    other = ppga.evaluate(search, permuted, jax.random.key(0))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a[order], b, rtol=1e-5, atol=1e-6), one, other)
    archives, improvement, _ = archive.add(search.archives, one)
    again, permuted_improvement, _ = archive.add(search.archives, other)
    np.testing.assert_array_equal(archive.occupied(archives), archive.occupied(again))


def test_the_same_search_goes_on_the_same_way_twice(expert):
    """A search is a value: an iteration leaves it as it is."""
    search = expert[0]
    before = archive.elite_arrays(search.archives)
    one, info = ppga.iteration(search)
    other, again = ppga.iteration(search)
    jax.tree.map(np.testing.assert_array_equal, info, again)
    for result in (one, other):
        jax.tree.map(
            np.testing.assert_array_equal, archive.elite_arrays(result.archives), archive.elite_arrays(one.archives)
        )
    jax.tree.map(np.testing.assert_array_equal, archive.elite_arrays(search.archives), before)


# Gradients and branching


def test_a_candidate_along_a_measures_gradient_raises_that_measure(expert):
    """Jacobian's row j must be that of measure j, and gradients must not be tied to one objective."""
    search = ppga.begin(config_of("true", gradient_updates=8), None)
    engine, occupied = search.engine, jnp.asarray(archive.occupied(search.archives))
    copies = engine.train_copies(search.state, occupied, 8)
    coefficients = np.zeros((search.config.ppga.candidates, 3))
    coefficients[1:4] = 2.0 * np.eye(3)
    policies, jacobian = engine.branch(search.state, copies.theta, coefficients)
    np.testing.assert_allclose(np.linalg.norm(jacobian, axis=1), 1.0, rtol=1e-4)
    scored = ppga.evaluate(search, policies, jax.random.key(0))
    still, fitness, first, second = (scored.measures[i] for i in range(4))
    assert first[0] > still[0] + 0.2 and second[1] > still[1] + 0.2
    assert first[0] - still[0] > first[1] - still[1] + 0.1
    assert second[1] - still[1] > second[0] - still[0] + 0.1
    assert scored.true_return[1] > scored.true_return[0]


def test_branching_is_equation_16(expert):
    search = expert[0]
    mu = np.asarray(search.engine.theta_mu(search.state))
    theta = np.stack([mu + np.eye(1, len(mu), i)[0] * (i + 1) for i in range(3)])  # three orthogonal differences
    coefficients = np.zeros((search.config.ppga.candidates, 3), np.float32)
    coefficients[0] = [2.0, 0.5, -1.0]
    candidates, _ = search.engine.branch(search.state, jnp.asarray(theta, jnp.float32), coefficients)
    np.testing.assert_allclose(np.asarray(candidates.theta[0])[:3] - mu[:3], [2.0, 0.5, -1.0], atol=1e-5)
    np.testing.assert_allclose(candidates.theta[1], mu)


# Order of an iteration


class Spy(Engine):
    """An engine that keeps a list of the training phases it is asked for."""

    def __init__(self, engine):
        self.__dict__.update(vars(engine))
        self.phases = []

    def train_copies(self, state, occupied, updates, *more):
        self.phases.append(("gradients", state, np.asarray(occupied), None, updates))
        return Engine.train_copies(self, state, occupied, updates, *more)

    def train_policy(self, state, occupied, weights, updates, *more):
        self.phases.append(("walk", state, np.asarray(occupied), np.asarray(weights), updates))
        return Engine.train_policy(self, state, occupied, weights, updates, *more)

    def rollout(self, state, occupied):
        self.phases.append(("rollout", state, np.asarray(occupied), None, 1))
        return Engine.rollout(self, state, occupied)


def test_an_iteration_is_gradients_then_walk_then_a_fresh_rollout(imitator):
    watched = imitator._replace(engine=Spy(imitator.engine))
    after, info = ppga.iteration(watched)
    gradients, walk, fresh = watched.engine.phases
    assert [phase[0] for phase in watched.engine.phases] == ["gradients", "walk", "rollout"]
    assert (gradients[4], walk[4]) == (3, 2)
    # The copies' learning is discarded: the walk begins at the very θ_μ and critic that the gradients began at.
    jax.tree.map(np.testing.assert_array_equal, gradients[1].train_state, walk[1].train_state)
    assert float(walk[1].stats.seen) > float(gradients[1].stats.seen)
    np.testing.assert_array_equal(gradients[2], archive.occupied(imitator.archives))
    np.testing.assert_array_equal(walk[2], archive.occupied(after.archives))
    np.testing.assert_allclose(walk[3], info.coefficients if info.coefficients.any() else [1, 0, 0], rtol=1e-6)
    assert info.coefficients[0] >= 0
    if not info.restarts:
        np.testing.assert_allclose(np.abs(info.coefficients), np.abs(after.xnes.mean), rtol=1e-5)


@pytest.mark.parametrize("added", [True, False])
def test_restart_exactly_when_nothing_was_added(expert, monkeypatch, added):
    search = expert[0]
    improvement = np.arange(search.config.ppga.candidates) * float(added)
    result = archive.Added(search.archives, improvement, improvement > 0)
    monkeypatch.setattr(archive, "add", lambda *arguments: result)
    after, info = ppga.iteration(search)
    assert info.restarts == float(not added)
    theta = np.asarray(networks.flatten(after.state.train_state.policy))
    is_elite = (archive.elite_arrays(search.archives)["solution"] == theta).all(axis=1).any()
    assert is_elite == (not added)
    assert np.any(after.xnes.mean) == added


def test_restart_takes_an_elite_with_its_own_statistics(expert):
    search = expert[0]
    elite = archive.random_elite(search.archives, np.random.default_rng(0))
    state = search.engine.restart_at(search.state, elite)
    np.testing.assert_array_equal(networks.flatten(state.train_state.policy), elite["solution"])
    np.testing.assert_array_equal(state.stats.mean, elite["obs_mean"])
    np.testing.assert_array_equal(state.stats.std, elite["obs_std"])
    assert all(not np.any(leaf) for leaf in jax.tree.leaves(state.train_state.policy_opt))
    jax.tree.map(np.testing.assert_array_equal, state.train_state.critic, search.state.train_state.critic)


def test_before_anything_is_accepted_the_walk_follows_fitness_alone():
    search = ppga.begin(config_of("true", threshold_min=1e9), None)
    after, info = ppga.iteration(search)
    np.testing.assert_array_equal(info.coefficients, 0)
    np.testing.assert_array_equal(ppga.walk_weights(search), [1.0, 0, 0])
    assert info.restarts == 1 and archive.random_elite(after.archives, after.rng) is None


def test_the_released_walk_follows_fitness_alone(imitator):
    released = imitator._replace(config=change(imitator.config, walk_weights="fitness"))
    assert not released.archives.soft.empty
    np.testing.assert_array_equal(ppga.walk_weights(released), [1.0, 0, 0])
    assert (ppga.walk_weights(imitator) != [1.0, 0, 0]).any()


# Bonus and fitness


def test_the_bonus_is_part_of_the_training_reward_and_depends_on_the_archive(imitator):
    """Same robots, same reward model: an empty archive gives q more per step than a full one."""
    shape = archive.occupied(imitator.archives).shape
    empty, full = (
        float(imitator.engine.rollout(imitator.state, jnp.full(shape, filled)).info.fitness_reward)
        for filled in (False, True)
    )
    assert empty - full == pytest.approx(imitator.config.bonus.bonus_q, abs=1e-4)
    assert full > imitator.config.bonus.bonus_p  # GAIL's own reward is positive


def test_selection_decides_what_fills_the_archive(imitator):
    batch, key = ppga.batch_of_elites(imitator, 0), jax.random.key(2)

    def scored(**changes):
        return ppga.evaluate(imitator._replace(config=change(imitator.config, **changes)), batch, key)

    learned, true, bonus = scored(), scored(selection="true"), scored(bonus_in_fitness=True)
    np.testing.assert_array_equal(true.fitness, true.true_return)
    np.testing.assert_array_equal(true.true_return, learned.true_return)
    assert not np.allclose(learned.fitness, learned.true_return)
    assert (bonus.fitness >= learned.fitness + imitator.config.bonus.bonus_p * learned.length - 1e-3).all()


def test_elites_score_again_exactly_where_nothing_is_random(expert):
    search = expert[0]
    elites, again = archive.elite_arrays(search.archives), ppga.reevaluate(search, jax.random.key(5))
    np.testing.assert_allclose(again["rescored_return"], elites["true_return"], rtol=1e-5)
    np.testing.assert_allclose(again["rescored_measures"], elites["measures"], atol=1e-6)


def test_fresh_scores_are_means_over_rounds_of_episodes_with_keys_of_their_own(expert, monkeypatch):
    """At least 5 episodes in rounds of 2 are 3 rounds. A round in which the physics diverged does not count."""
    search = expert[0]._replace(config=change(expert[0].config, rescore_episodes=5, episodes=2))
    elites = archive.elite_arrays(search.archives)
    count, size = len(elites["index"]), search.config.ppga.candidates
    given, keys = [], []

    def scored(search, policies, key):
        draw = np.random.default_rng(len(given))
        finite = np.ones(size, bool)
        finite[2] = len(given) % 3 != 1  # the second round of a batch
        finite[3] = False
        lengths, measures = draw.integers(1, 20, size).astype(float), draw.uniform(size=(size, 2))
        scores = (draw.normal(size=size), draw.normal(size=size), measures, lengths, finite)
        given.append(archive.Candidates(*(np.asarray(x) for x in policies), *scores))
        keys.append(jax.random.key_data(key).tolist())
        return given[-1]

    monkeypatch.setattr(ppga, "evaluate", scored)
    again = ppga.reevaluate(search, jax.random.key(3))
    batches = -(-count // size)
    assert len(given) == 3 * batches and len({tuple(key) for key in keys}) == len(keys)
    for row in range(count):
        rounds = [one for one in given[3 * (row // size) :][:3] if one.finite[row % size]]
        assert again["rescored_episodes"][row] == 2 * len(rounds)
        np.testing.assert_array_equal(given[3 * (row // size)].theta[row % size], elites["solution"][row])
        for name, field in (("rescored_return", "true_return"), ("rescored_fitness", "fitness"),
                            ("rescored_measures", "measures"), ("rescored_length", "length")):  # fmt: skip
            values = [getattr(one, field)[row % size] for one in rounds]
            expected = np.mean(values, axis=0) if rounds else np.nan * again[name][row]
            np.testing.assert_allclose(again[name][row], expected, rtol=1e-6)
    assert set(again["rescored_episodes"].tolist()) == {0, 4, 6}


def test_scoring_elites_again_compiles_nothing(expert):
    """However many rounds: the programs that scored the candidates serve."""
    search = expert[0]._replace(config=change(expert[0].config, rescore_episodes=3))
    ppga.reevaluate(search, jax.random.key(5))  # a key's first use compiles what JAX's own functions need
    compiled = []

    def listen(name, seconds, **_):
        compiled.extend([name] if name.endswith("backend_compile_duration") else [])

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        more = search._replace(config=change(search.config, rescore_episodes=7))
        again = ppga.reevaluate(more, jax.random.key(6))
        before = list(compiled)
        jax.jit(lambda x: x * 3 + 0.123)(jnp.ones(7))  # what the listener hears
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    assert before == [] and len(compiled) > 0
    assert set(again["rescored_episodes"].tolist()) == {7}


def test_an_empty_archive_is_scored_again_in_no_time():
    search = ppga.begin(config_of("true"), None)
    again = ppga.reevaluate(search, jax.random.key(0))
    assert {name: values.shape for name, values in again.items()} == {
        "rescored_fitness": (0,), "rescored_return": (0,), "rescored_measures": (0, 2), "rescored_length": (0,),
        "rescored_episodes": (0,),
    }  # fmt: skip


def test_a_warm_up_is_plain_ppo_on_fitness(expert):
    """A hundred updates on the true reward alone: the skill is learned."""
    search = ppga.begin(config_of("true"), None)
    rewards = []
    for _ in range(2):
        rewards.append(float(search.engine.rollout(search.state, jnp.zeros((5, 5), bool)).info.true_reward))
        search = ppga.warmed_up(search, 100)
    assert rewards[1] > rewards[0] + 0.1 and rewards[1] > 0.9
