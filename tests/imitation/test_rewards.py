"""What holds for every reward model and variant: it learns, and it sees exactly the inputs that its name allows."""

from functools import cache
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from probes import (
    ACTIONS,
    CONTEXT,
    OBS,
    PROXIES,
    STATS,
    area_under_curve,
    built,
    demos_of,
    expert_steps,
    random_steps,
    steps_of,
)

from qdil import methods
from qdil.imitation.reward_model import InputModel, Inputs, hide, over_inputs

pytestmark = pytest.mark.compiles

IMITATORS = [base.name for base in methods.bases().values() if base.imitates]
# The bonus is not the reward model's, so that mbo- and mconbo- share a model with "" and mcond-: see the test of it.
MODELS = [prefix + base + suffix for base, suffix, prefix in product(IMITATORS, ("", "-obs"), ("", "mcond-"))]
SURPRISED = ("giril",)  # rewards what the expert would not do (eq. 10), so its lower rewards are the expert's

LEARNING = {
    "reward_hidden": (32,),
    "reward_steps": 300,
    "reward_batch": 64,
    "reward_learning_rate": 3e-3,
    "gradient_penalty": 0.1,
    "vail_latent": 8,
    "giril_steps": 500,
    "giril_learning_rate": 3e-3,
}


@cache
def program(method):
    """One round of learning from nothing and the rewards of other steps: (demos, policy, steps) -> (state, rewards)."""
    model = built(method, **LEARNING)

    def learn_and_reward(demos, policy, steps):
        state = model.init(jax.random.key(1), demos)
        state, _ = model.update(jax.random.key(0), state, CONTEXT, demos, policy)
        return state.inner, model.reward(state, model.begin(state, steps.obs.shape[1]), CONTEXT, steps)[1]

    return jax.jit(learn_and_reward)


@cache
def data():
    """Demonstrations, policy steps, and steps of both kinds that nothing is learned from, side by side."""
    rng = np.random.default_rng(0)
    held_out = jax.tree.map(lambda *x: jnp.concatenate(x, axis=1), expert_steps(rng), random_steps(rng))
    return demos_of(expert_steps(rng)), random_steps(rng), held_out


@cache
def outcome(method):
    """The results of ``program`` for ``data``."""
    return program(method)(*data())


def same(some, others) -> bool:
    pairs = zip(jax.tree.leaves(some), jax.tree.leaves(others), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


def base_of(method):
    return methods.parse_method(method).base.name


# Learning


@pytest.mark.parametrize("method", MODELS)
def test_it_tells_expert_from_random_steps_that_it_has_not_seen(method):
    rewards = np.asarray(outcome(method)[1])
    expert, random = np.split(rewards, 2, axis=1)
    if base_of(method) in SURPRISED:
        expert, random = -expert, -random
    assert area_under_curve(expert, random) > 0.9


# What it sees


@pytest.mark.parametrize("method", MODELS)
def test_only_models_without_obs_in_their_names_see_actions(method):
    demos, policy, steps = data()
    state, rewards = outcome(method)
    changes = [
        (demos._replace(action=-demos.action[::-1]), policy, steps),
        (demos, policy._replace(action=-policy.action[::-1]), steps),
        (demos, policy, steps._replace(action=-steps.action[::-1])),
    ]
    learned, learned_from_policy, rewarded = (program(method)(*change) for change in changes)
    blind = method.endswith("-obs")
    learns_from_policy = built(method).learns
    assert same(state, learned[0]) == blind
    assert same(state, learned_from_policy[0]) == (blind or not learns_from_policy)
    assert same(rewards, rewarded[1]) == blind and same(state, rewarded[0])


@pytest.mark.parametrize("method", [f"{base}-obs" for base in IMITATORS])
def test_models_that_see_no_actions_need_none(method):
    demos, policy, steps = data()
    without = demos._replace(action=demos.action[:, :0])
    assert same(outcome(method), program(method)(without, policy, steps))


@pytest.mark.parametrize("method", MODELS)
def test_only_conditioned_models_see_the_proxy(method):
    demos, policy, steps = data()
    state, rewards = outcome(method)
    changes = [
        (demos._replace(proxy=demos.proxy[::-1]), policy, steps),
        (demos, policy._replace(proxy=1 - policy.proxy), steps),
        (demos, policy, steps._replace(proxy=1 - steps.proxy)),
    ]
    learned, learned_from_policy, rewarded = (program(method)(*change) for change in changes)
    blind = not method.startswith("mcond-")
    learns_from_policy = built(method).learns
    assert same(state, learned[0]) == blind
    assert same(state, learned_from_policy[0]) == (blind or not learns_from_policy)
    assert same(rewards, rewarded[1]) == blind and same(state, rewarded[0])


@pytest.mark.parametrize("method", MODELS)
def test_the_bonus_changes_no_reward_model(method):
    with_bonus = method.replace("mcond-", "mconbo-") if method.startswith("mcond-") else f"mbo-{method}"
    assert with_bonus in methods.method_names()
    plain, other = (jax.make_jaxpr(program(name))(*data()) for name in (method, with_bonus))
    assert str(plain) == str(other)


def test_no_method_is_left_out():
    seen = {name for model in MODELS for name in (model, f"mbo-{model}", model.replace("mcond-", "mconbo-"))}
    own = {base.name for base in methods.bases().values() if not base.imitates}
    assert set(methods.method_names()) <= seen | own | {f"mbo-{name}" for name in own}


@pytest.mark.parametrize("name", [base.name for base in methods.bases().values() if not base.imitates])
def test_rewards_without_demonstrations(name):
    model, steps = built(name), steps_of(np.random.default_rng(0))
    steps = steps._replace(reward=jnp.arange(steps.reward.size, dtype=jnp.float32).reshape(steps.reward.shape))
    state = model.init(jax.random.key(0), None)
    _, rewards = model.reward(state, model.begin(state, 16), CONTEXT, steps)
    np.testing.assert_array_equal(rewards, steps.reward if name == "true" else np.zeros((8, 16)))
    assert model.update(jax.random.key(0), state, CONTEXT, None, steps) == (state, {}) and not model.learns


# Odd inputs


@pytest.mark.parametrize("method", MODELS)
def test_rewards_are_finite_for_extreme_steps_and_dull_demonstrations(method):
    demos, policy, steps = data()
    sizes = np.random.default_rng(0).choice(np.float32([0, 1e30, -1e30, np.inf, -np.inf]), policy.obs.shape)
    wild = policy._replace(obs=sizes, next_obs=-sizes, action=jnp.sign(policy.action))
    both = jax.tree.map(lambda *x: jnp.concatenate(x, axis=1), wild, wild)
    dull = jax.tree.map(lambda x: jnp.broadcast_to(x[0], x.shape), demos)
    for known in (demos, dull):
        state, rewards = program(method)(known, wild, both)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((state, rewards)))


# Normalisers


def spy(normaliser):
    """A model that keeps what it is shown: at its beginning, in learning, and in rewarding."""
    return InputModel(
        init=lambda key, expert: {"begun": expert},
        reward=lambda state, memory, inputs, ended: (inputs, ended),
        update=lambda key, state, expert, policy: ({**state, "expert": expert, "policy": policy}, {}),
        normaliser=normaliser,
    )


def shown(normaliser, select, raw_expert=False, demos=None):
    """Inputs at the beginning, of expert and policy in learning, and of the rewarded steps."""
    steps = expert_steps(np.random.default_rng(0))
    demos = demos_of(steps) if demos is None else demos
    model = over_inputs(spy(normaliser), select, raw_expert)
    state = model.init(jax.random.key(0), demos)
    state, _ = model.update(jax.random.key(0), state, CONTEXT, demos, steps)
    rewarded, _ = model.reward(state, (), CONTEXT, steps)
    return state.inner["begun"], state.inner["expert"], state.inner["policy"], rewarded


@pytest.mark.parametrize("normaliser", ["running", "expert"])
@pytest.mark.parametrize(("actions", "proxy"), list(product([True, False], repeat=2)))
def test_the_same_raw_numbers_become_the_same_inputs(normaliser, actions, proxy):
    steps = expert_steps(np.random.default_rng(0))
    begun, expert, policy, rewarded = shown(normaliser, hide(actions, proxy))
    raw = np.asarray(steps.obs, float).reshape(-1, OBS)
    mean, std = (raw.mean(0), raw.std(0)) if normaliser == "expert" else (STATS.mean, STATS.std)
    np.testing.assert_allclose(expert.obs, (raw - mean) / std, rtol=1e-3, atol=1e-4)
    next_raw = np.asarray(steps.next_obs, float).reshape(-1, OBS)
    np.testing.assert_allclose(expert.next_obs, (next_raw - mean) / std, rtol=1e-3, atol=1e-4)
    assert expert.action.shape[-1] == (0 if actions else ACTIONS)
    assert expert.proxy.shape[-1] == (0 if proxy else PROXIES)
    for name in Inputs._fields:
        of_expert, of_policy, of_rewarded = (np.asarray(getattr(x, name)) for x in (expert, policy, rewarded))
        np.testing.assert_array_equal(of_expert, of_policy.reshape(of_expert.shape))
        np.testing.assert_array_equal(of_policy, of_rewarded)
        if normaliser == "expert":
            np.testing.assert_array_equal(of_expert, getattr(begun, name))


@pytest.mark.parametrize("normaliser", ["running", "expert"])
def test_raw_expert_rows_are_as_they_were_recorded(normaliser):
    # With observations beyond the ±10 at which normalised ones are cut, as humanoid's are.
    demos = demos_of(expert_steps(np.random.default_rng(0)))
    demos = demos._replace(obs=demos.obs * 100, next_obs=demos.next_obs * 100)
    begun, expert, policy, rewarded = shown(normaliser, hide(False, False), True, demos)
    for rows in (begun, expert):
        for name in Inputs._fields:
            np.testing.assert_array_equal(getattr(rows, name), getattr(demos, name))
    assert np.abs(policy.obs).max() <= 10 and same(policy, rewarded)


@pytest.mark.parametrize(("how", "raw"), [("raw", True), ("normalised", False)])
def test_the_setting_for_raw_expert_rows_reaches_the_models(monkeypatch, how, raw):
    base = methods.Base("spy", "keeps what it is shown", lambda config, widths: spy("running"), True, False)
    monkeypatch.setitem(methods._BASES, "spy", base)
    steps = expert_steps(np.random.default_rng(0))
    model, demos = built("mcond-spy", expert_obs=how), demos_of(steps)
    state = model.init(jax.random.key(0), demos)
    inner = model.update(jax.random.key(0), state, CONTEXT, demos, steps)[0].inner
    for rows in (inner["begun"], inner["expert"]):
        assert np.array_equal(rows.obs, demos.obs) == raw
    np.testing.assert_array_equal(inner["expert"].proxy, demos.proxy)
