"""Each choice in which the released program departs from Algorithm 1, seen at work on dials."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dial import config_of, demonstrations

from qdil import ppga
from qdil.config import PROTOCOLS, change, make_config, value_of
from qdil.engine.engine import Engine
from qdil.qd import archive
from qdil.rl import networks
from qdil.runs.studies import STUDIES, name_of
from qdil.runs.studies import config_of as experiment_config

pytestmark = pytest.mark.compiles


class Watched(Engine):
    """An engine that keeps what it was asked for: (step, state before it, what else matters)."""

    def __init__(self, engine):
        self.__dict__.update(vars(engine))
        self.calls = []

    def train_policy(self, state, occupied, weights, *more, **options):
        self.calls.append(("walk", state, np.asarray(weights)))
        return Engine.train_policy(self, state, occupied, weights, *more, **options)

    def rollout(self, state, occupied):
        self.calls.append(("rollout", state, None))
        return Engine.rollout(self, state, occupied)

    def update_reward(self, state, occupied, demos, transitions):
        self.calls.append(("update", state, jax.tree.map(np.asarray, transitions)))
        return Engine.update_reward(self, state, occupied, demos, transitions)

    def restart_at(self, state, elite):
        self.calls.append(("restart", state, elite))
        return Engine.restart_at(self, state, elite)


def begun(method, **changes):
    search = ppga.begin(config_of(method, **changes), None if method == "true" else demonstrations())
    search, _ = ppga.iteration(search)
    return search._replace(engine=Watched(search.engine))


def names(search):
    return [call[0] for call in search.engine.calls]


@pytest.fixture
def nothing_added(monkeypatch):
    """Every iteration adds nothing, so it restarts."""

    def add(archives, candidates, rejects="zero"):
        none = np.zeros(len(candidates.fitness))
        return archive.Added(archives, none, none > 0)

    return lambda: monkeypatch.setattr(archive, "add", add)


def policy(state):
    return np.asarray(networks.flatten(state.train_state.policy))


@pytest.mark.parametrize(
    ("order", "expected"),
    [("last", ["walk", "rollout", "update", "restart"]), ("before-walk", ["restart", "walk", "rollout", "update"])],
)
def test_a_restart_comes_last_or_before_the_walk(order, expected, nothing_added):
    search = begun("gail", restart_order=order)
    nothing_added()
    after, info = ppga.iteration(search)
    assert names(search) == expected and info.restarts == 1
    walk = next(state for name, state, _ in search.engine.calls if name == "walk")
    elite = next(what["solution"] for name, _, what in search.engine.calls if name == "restart")
    assert (policy(walk) == elite).all() == (order == "before-walk")
    assert (policy(after.state) == elite).all() == (order == "last")  # its walk is lost, or trains the new elite


def test_the_reward_model_meets_a_restarts_elite_before_it_scores_anything(nothing_added):
    search = begun("gail", restart_rounds=2)
    nothing_added()
    after, info = ppga.iteration(search)
    assert names(search) == ["walk", "rollout", "update", "restart", *["rollout", "update"] * 2]
    elite = search.engine.calls[3][2]["solution"]
    assert all((policy(state) == elite).all() for _, state, _ in search.engine.calls[4:])
    usual = change(search.config, restart_rounds=0)
    _, fewer = ppga.iteration(search._replace(config=usual))
    steps = search.config.ppo.rollout_length * search.config.ppo.num_envs
    assert info.steps == fewer.steps + 2 * steps
    empty = archive.make(5, 2, 1, 1, 1.0, 0.0)
    assert ppga.restart(search._replace(archives=empty))[1] == []  # no elite, no rollouts to count


def test_a_restart_may_take_the_statistics_of_another_elite(nothing_added):
    search = begun("true", restart_statistics="other", iterations=5)
    for _ in range(3):
        search, _ = ppga.iteration(search)
    nothing_added()
    others = 0
    for seed in range(5):
        after, _ = ppga.restart(search._replace(rng=np.random.default_rng(seed)))
        elites = archive.elite_arrays(search.archives)
        row = np.flatnonzero((elites["solution"] == policy(after.state)).all(axis=1))[0]
        mean = np.asarray(after.state.stats.mean)
        assert (elites["obs_mean"] == mean).all(axis=1).any()
        others += not (elites["obs_mean"][row] == mean).all()
    assert others >= 2


def test_xnes_starts_where_and_with_what_the_protocol_says(nothing_added):
    usual = begun("true")
    np.testing.assert_array_equal(ppga.begin(usual.config, None).xnes.mean, 0)
    changed = ppga.begin(config_of("true", xnes_center="random", restart_samples="same"), None)
    assert changed.xnes.mean.all()
    first = changed.xnes.ask() - changed.xnes.mean
    again, _ = ppga.restart(changed)
    assert (again.xnes.mean != changed.xnes.mean).all()
    np.testing.assert_allclose(np.abs(again.xnes.ask() - again.xnes.mean)[:, 1:], np.abs(first)[:, 1:])


def test_signed_coefficients_may_minimise_fitness():
    folded, signed = (ppga.begin(config_of("true", fitness_coefficient=c), None) for c in ("folded", "signed"))
    assert (folded.xnes.ask()[:, 0] >= 0).all() and (signed.xnes.ask()[:, 0] < 0).any()
    search = begun("true", fitness_coefficient="signed")
    search.xnes.mean = np.array([-1.0, 0.5, 0.2])
    np.testing.assert_allclose(ppga.walk_weights(search), [-1.0, 0.5, 0.2])


def test_with_a_schedule_per_update_the_reward_model_learns_in_both_phases():
    """N1 rounds from the fitness copy's robots alone, then N2 from all robots, and none after the walk."""
    search = begun("gail", reward_schedule="update")
    ppga.iteration(search)
    n1, n2 = search.config.ppga.gradient_updates, search.config.ppga.walk_updates
    assert names(search) == ["update"] * n1 + ["walk"] + ["update"] * n2
    states = [state for name, state, _ in search.engine.calls if name == "update"]
    learned = [np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(state.reward)]) for state in states]
    assert all((one != other).any() for one, other in zip(learned, learned[1:], strict=False))
    seen = [what for name, _, what in search.engine.calls if name == "update"]
    distinct = [len(np.unique(rows.action.reshape(-1, rows.action.shape[-1]), axis=0)) for rows in seen]
    robots = search.config.ppo.rollout_length * search.config.ppo.num_envs
    assert distinct[:n1] == [robots // 3] * n1 and distinct[n1:] == [robots] * n2


def test_the_first_copys_steps_are_those_of_every_third_robot():
    from qdil.rl import vppo

    steps = jnp.arange(5 * 6 * 2.0).reshape(5, 6, 2)
    own = np.asarray(vppo.steps_of_first_copy({"x": steps}, 3)["x"])
    assert own.shape == (5, 6, 2)
    expected = np.asarray(steps[:, ::3]).reshape(-1, 2)
    assert {tuple(row) for row in own.reshape(-1, 2)} == {tuple(row) for row in expected}


def test_a_warm_up_gets_no_bonus():
    """Bonus or not, the same policy comes out of it."""
    plain, bonus = (ppga.warmed_up(ppga.begin(config_of(m), None), 2) for m in ("true", "mbo-true"))
    np.testing.assert_array_equal(policy(plain.state), policy(bonus.state))
    once = [ppga.iteration(search)[0] for search in (plain, bonus)]
    assert (policy(once[0].state) != policy(once[1].state)).any()


def test_a_departure_from_a_protocol_shows_in_the_experiments_name():
    assert name_of("gail", protocol="released", selection="true") == "gail+protocol=released"
    departure = name_of("gail", protocol="released", selection="learned")
    assert departure == "gail+protocol=released+selection=learned"
    config = experiment_config(departure, "walker2d", "smoke")
    assert (config.protocol, config.ppga.selection, config.ppga.rejects) == ("released", "learned", "difference")
    assert name_of("gail", protocol="paper", selection="true") == "gail+selection=true"


def test_every_choice_of_the_released_program_is_studied_by_itself():
    alone = {name: value for e in STUDIES["released"] for name, value in (part.split("=") for part in e.split("+")[1:])}
    for name, value in PROTOCOLS["released"].items():
        assert alone[name] == str(value) and value != value_of(make_config("walker2d", "mconbo-gail", "laptop"), name)
