"""Registering robots: what is refused and in which words, and what an own environment brings with it."""

import jax.numpy as jnp
import numpy as np
import pytest
from probes import counter

from qdil.config import BUDGETS, make_config
from qdil.errors import ConfigError
from qdil.robots import register
from qdil.robots.environment import Environment, Outcome
from qdil.robots.register import register_robot


@pytest.fixture(autouse=True)
def fresh(monkeypatch):
    """The known robots, with whatever the test adds forgotten afterwards."""
    register.robot_names()
    monkeypatch.setattr(register, "_ROBOTS", dict(register._ROBOTS))


def refused(call, *args, **options) -> str:
    with pytest.raises(ConfigError) as error:
        call(*args, **options)
    sentence = str(error.value)
    assert "\n" not in sentence and sentence.endswith(".")
    return sentence


def of_measures(k: int) -> Environment:
    """The counter with its first proxy k times."""
    env = counter(4.0)

    def again(state):
        return state._replace(proxy=jnp.repeat(state.proxy[:1], k))

    def step(state, action):
        after, outcome = env.step(state, action)
        return again(after), outcome

    names = tuple(f"m{i}" for i in range(k))
    return env._replace(measure_names=names, reset=lambda key: again(env.reset(key)), step=step)


@pytest.mark.parametrize("name", ["", "two words", "a/b", "../up", "Dog", "1st", "dög"])
def test_names_that_cannot_name_a_folder_are_refused(name):
    assert f"'{name}' cannot name a robot" in refused(register_robot, name, environment=of_measures(1))


@pytest.mark.parametrize("name", ["walker2d", "ant"])
def test_names_that_are_taken_are_refused(name):
    assert f"already a robot called '{name}'" in refused(register_robot, name, environment=of_measures(1))
    assert f"already a robot called '{name}'" in refused(register_robot, name, brax_env="hopper", feet=["foot"])


def test_the_same_robot_again_does_no_harm():
    env = of_measures(1)
    for _ in range(2):
        register_robot("dog", environment=env)
    register_robot("hopper", brax_env="hopper", feet=["foot"])
    assert register.robot_names().count("dog") == register.robot_names().count("hopper") == 1


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"brax_env": "ant"}, "has 0 feet; it needs between 1 and 6"),
        ({"brax_env": "ant", "feet": [f"foot{i}" for i in range(7)]}, "has 7 feet; it needs between 1 and 6"),
        ({"brax_env": "ant", "feet": ["a", "b", "a"]}, "names a foot twice: a, b, a"),
        ({"brax_env": "ant", "feet": "torso"}, "feet='torso' must be a list"),
        ({}, "either brax_env with feet, or an environment"),
        ({"feet": ["foot"]}, "either brax_env with feet, or an environment"),
        ({"brax_env": "ant", "feet": ["torso"], "environment": of_measures(1)}, "either brax_env"),
        ({"environment": of_measures(0)}, "has 0 measure_names; it needs between 1 and 6"),
        ({"environment": of_measures(7)}, "has 7 measure_names; it needs between 1 and 6"),
        ({"environment": counter(4.0)._replace(measure_names=("a", "a"))}, "names a foot twice: a, a"),
    ],
)
def test_what_cannot_be_a_robot_is_refused(options, named):
    sentence = refused(register_robot, "dog", **options)
    assert "'dog'" in sentence and named in sentence
    assert "dog" not in register.robot_names()


def test_an_unknown_robot_is_refused_with_those_there_are():
    for call in (register.find, register.make, register.count_measures, register.backends_of):
        sentence = refused(call, "dog")
        assert "'dog'" in sentence and "walker2d" in sentence and "ant" in sentence


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"obs_size": 3}, "obs of reset has shape (1,) and type float32; it needs shape (3,)"),
        ({"measure_names": ("a", "b")}, "proxy of reset has shape (1,) and type float32; it needs shape (2,)"),
        ({"measure_names": "ab"}, "measure_names must be a tuple of names"),
        ({"step": lambda state, action: 3}, "reset or step cannot be traced by JAX (TypeError"),
        ({"step": lambda state, action: (state, Outcome(action, action[0] > 0, action[0] > 0))}, "reward of step"),
    ],
)
def test_an_environment_whose_functions_do_not_fit_is_refused(changes, named):
    assert named in refused(register_robot, "dog", environment=of_measures(1)._replace(**changes))
    assert "must be a qdil.robots.environment.Environment" in refused(register_robot, "dog", environment=3)


def test_an_environment_made_anew_takes_its_predecessors_place():
    for _ in range(2):  # as a notebook's cell that is executed twice
        env = of_measures(2)
        register_robot("dog", environment=env)
        assert register.make("dog").step is env.step


@pytest.mark.parametrize("k", range(1, 7))
def test_an_environment_of_ones_own_is_known_by_its_new_name(k):
    env = of_measures(k)
    register_robot("dog", environment=env)
    made = register.make("dog")
    assert made == env._replace(name="dog") and register.make("dog", "probe") == made
    assert register.count_measures("dog") == k and register.backends_of("dog") == ("probe",)
    assert "probe" in refused(register.make, "dog", "spring")
    for budget in BUDGETS:
        config = make_config("dog", "mconbo-gail", budget)
        assert config.simulation.backend == "probe" and config.ppo.num_envs % (1 + k) == 0
    assert "backend=spring must be one of probe" in refused(make_config, "dog", "true", "smoke", backend="spring")


@pytest.mark.parametrize("budget", BUDGETS)
def test_counts_of_three_measures_stay_near_the_budgets(budget):
    register_robot("dog", environment=of_measures(3))
    usual, config = make_config("walker2d", "true", budget), make_config("dog", "true", budget)
    assert config.ppo.num_envs % 4 == 0
    assert usual.ppo.num_envs <= config.ppo.num_envs < usual.ppo.num_envs + 16
    assert 0.5 < config.ppga.cells**3 / usual.ppga.cells**2 < 2


# Robots of Brax


@pytest.mark.physics
@pytest.mark.parametrize(
    ("feet", "named"),
    [
        (["foot", "paw"], "has no foot 'paw'; choose among"),
        (["claw", "paw"], "has no foot 'claw' and no foot 'paw'; choose among"),
        (["thigh", "thigh_geom"], "(thigh, thigh_geom) are on the same link"),
        (["floor"], "has no foot 'floor'"),
        ([""], "has no foot ''"),
    ],
)
def test_feet_that_are_no_links_are_refused_with_the_links_there_are(feet, named):
    register_robot("dog", brax_env="walker2d", feet=feet)
    assert register.count_measures("dog") == len(feet)  # known before the robot is built
    sentence = refused(register.make, "dog")
    assert "'dog'" in sentence and named in sentence
    assert "choose" not in named or all(link in sentence for link in ("foot", "foot_left", "leg_left", "torso"))


@pytest.mark.physics
def test_an_environment_that_brax_does_not_have_is_refused():
    register_robot("dog", brax_env="labrador", feet=["paw"])
    assert "'dog'" in refused(register.make, "dog") and "'labrador'" in refused(register.make, "dog")


@pytest.mark.physics
def test_a_robot_of_brax_with_other_feet_has_its_measures():
    import jax

    register_robot("dog", brax_env="walker2d", feet=["leg_left", "foot", "torso"])
    env = register.make("dog")
    state = jax.eval_shape(env.reset, jax.random.key(0))
    assert env.measure_names == ("leg_left", "foot", "torso") and state.proxy.shape == (3,)
    assert np.isclose(env.step_seconds, register.make("walker2d").step_seconds) and env.name == "dog"
