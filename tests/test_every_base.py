"""Whole iterations with every base reward model and some variants, and a table of what each method's name means."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dial import config_of, demonstrations

from qdil import ppga
from qdil.engine.engine import Engine
from qdil.imitation.demos import made_up
from qdil.methods import bases, method_names, name_of, parse_method
from qdil.qd import archive

VARIANTS = ("mconbo-gail-obs", "mcond-vail", "mbo-true")


@pytest.mark.compiles
@pytest.mark.parametrize("name", [*bases(), *VARIANTS])
def test_a_base_trains(name):
    config = config_of(name, iterations=1, giril_steps=20, reward_steps=2, vail_latent=8)
    demos = demonstrations(count=1)
    demos = demos._replace(action=demos.action[:, :0]) if name.endswith("-obs") else demos
    search = ppga.begin(config, demos if parse_method(name).base.imitates else None)
    search, done, info = ppga.warm_up(search, 2)
    assert (done, info) == (2, {"steps": 2 * config.ppo.rollout_length * config.ppo.num_envs, "rolled_back": 0.0})
    search, info = ppga.iteration(search)
    elites = archive.elite_arrays(search.archives)
    assert len(elites["index"]) > 0 and np.isfinite(elites["fitness"]).all()
    assert info.rolled_back == info.reward.get("reward_rolled_back", 0.0) == info.not_finite == 0.0
    base = name.removeprefix("mbo-")
    if base == "true":
        np.testing.assert_allclose(elites["fitness"], elites["true_return"], rtol=1e-5)
    elif base == "zero":
        assert not elites["fitness"].any()
    else:
        assert not np.allclose(elites["fitness"], elites["true_return"])


@pytest.mark.compiles
@pytest.mark.parametrize("changes", [{"bonus_scope": "step"}, {"vail_visits": True}])
def test_visits_are_counted_in_every_training_step_of_a_run(changes):
    config = config_of("mconbo-vail", iterations=1, reward_steps=2, vail_latent=8, **changes)
    search = ppga.begin(config, demonstrations(count=1))
    search, _, _ = ppga.warm_up(search, 2)
    assert search.state.memory.visits.sum() == 2 * config.ppo.rollout_length * config.ppo.num_envs
    search, info = ppga.iteration(search)
    visits = np.asarray(search.state.memory.visits)
    assert visits.shape == (config.ppo.num_envs, 4) and info.rolled_back == 0
    updates = 2 + config.ppga.gradient_updates + config.ppga.walk_updates + 1  # and the rollout that VAIL learns from
    assert (visits.sum(axis=1) == updates * config.ppo.rollout_length).all()
    assert (visits.sum(axis=0) > 0).sum() > 1  # the dials' contacts vary


@pytest.mark.parametrize("name", method_names())
def test_a_methods_name_says_what_it_does(name):
    """Prefixes and suffix, one by one: what the reward model sees, and whether the bonus is added."""
    method = parse_method(name)
    assert name_of(method) == name
    assert method.conditioned == name.startswith(("mcond-", "mconbo-"))
    assert method.bonus == name.startswith(("mbo-", "mconbo-"))
    assert method.obs_only == name.endswith("-obs")
    engine = Engine(config_of(name))
    assert engine.bonus == ((0.5, 0.5) if method.bonus else (0.0, 0.0))
    seen = inputs_seen(name) if method.base.imitates else None
    assert seen is None or seen == (0 if method.obs_only else 3, 2 if method.conditioned else 0)


def inputs_seen(name):
    """Widths of the actions and proxies that the method's reward model is built for."""
    from qdil.imitation import reward_model

    widths = []

    def build(config, inputs):
        widths.append((inputs.action, inputs.proxy))
        return parse_method(name).base.build(config, inputs)

    method = parse_method(name)
    with pytest.MonkeyPatch.context() as patch:
        stand_in = method._replace(base=method.base._replace(function=build))
        patch.setattr(reward_model, "parse_method", lambda _: stand_in)
        reward_model.reward_model(config_of(name), Engine(config_of(name)).env)
    return widths[0]


# Physics


@pytest.mark.physics
@pytest.mark.parametrize(("robot", "method"), [("hopper", "true"), ("ant", "mconbo-gail"), ("walker2d", "gail")])
def test_a_robot_of_k_feet_trains(robot, method):
    from qdil.config import make_config
    from qdil.robots import register

    config = make_config(robot, method, "smoke")
    k = register.count_measures(robot)
    demos = None if method == "true" else made_up(register.make(robot), 50)
    search = ppga.begin(config, demos)
    search, info = ppga.iteration(search)
    elites = archive.elite_arrays(search.archives)
    assert len(elites["index"]) > 0 and elites["measures"].shape[1] == k
    assert archive.occupied(search.archives).shape == (config.ppga.cells,) * k
    assert len(info.coefficients) == 1 + k and info.not_finite == 0.0
    assert ppga.reevaluate(search, search.state.key)["rescored_measures"].shape == elites["measures"].shape


@pytest.mark.physics
def test_ppo_on_walker2ds_true_reward_improves():
    """A few hundred updates on the fitness alone: the reward per step under π_θ clearly rises.

    So many programs in a row also show whether devices can end up waiting for each other for ever.
    """
    from qdil.config import make_config

    search = ppga.begin(make_config("walker2d", "true", "smoke"), None)
    engine, occupied = search.engine, jnp.zeros((5, 5), bool)
    state = engine.init(jax.random.key(3), None)
    before = float(engine.rollout(state, occupied).info.true_reward)
    state = engine.train_policy(state, occupied, np.eye(3)[0], 300).state
    after = float(engine.rollout(state, occupied).info.true_reward)
    assert after > before + 0.3  # m/s, or shares of steps upright
