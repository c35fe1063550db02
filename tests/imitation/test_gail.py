"""GAIL: penalty, loss and its gradient against NumPy, what it learns, and what it may and may not see."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from probes import ACTIONS, CONTEXT, OBS, PROXIES, STATS, built, demos_of, steps_of

from qdil.imitation.reward_model import expert_inputs, features, policy_inputs
from qdil.imitation.rewards.gail import discriminator_loss, gradient_penalty, logits, mixing_weights
from qdil.imitation.training import AdamState
from qdil.rl import networks

# The loss


def loss_in_numpy(params, expert, policy, mix, penalty):
    """Eq. 3's inner objective by loops over rows, for one hidden tanh layer."""
    (first, last) = params
    total = 0.0
    for x, y, share in zip(expert, policy, mix[:, 0], strict=True):
        for row, is_expert in ((x, True), (y, False)):
            logit = (np.tanh(row @ first["w"] + first["b"]) @ last["w"] + last["b"])[0]
            d = 1 / (1 + np.exp(-logit))
            total -= np.log(d) if is_expert else np.log(1 - d)
        hidden = np.tanh((share * x + (1 - share) * y) @ first["w"] + first["b"])
        slope = first["w"] @ ((1 - hidden**2) * last["w"][:, 0])
        total += penalty * (np.linalg.norm(slope) - 1) ** 2
    return total / len(expert)


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    params = [
        {"w": rng.normal(size=(4, 5)), "b": rng.normal(size=5)},
        {"w": rng.normal(size=(5, 1)), "b": rng.normal(size=1)},
    ]
    expert, policy = rng.normal(size=(2, 6, 4))
    return params, expert, policy, rng.random((6, 1))


def test_penalty_of_a_linear_discriminator():
    w = np.array([[3.0], [-4.0]])
    x, y, mix = np.random.default_rng(0).random((3, 5, 2))
    params = [{"w": w, "b": np.ones(1)}]
    penalty = gradient_penalty(lambda row: logits(params, row), x, y, mix[:, :1])
    assert penalty == pytest.approx((5 - 1) ** 2, rel=1e-5)


def test_mixing_is_per_sample_or_per_element():
    x = np.zeros((50, 4))
    sample, element = (np.asarray(mixing_weights(jax.random.key(0), x, how)) for how in ("sample", "element"))
    assert sample.shape == (50, 1) and element.shape == (50, 4)
    assert len(np.unique(element)) == 200 and 0 <= element.min() and element.max() < 1


def test_loss_is_the_papers(problem):
    total, info = discriminator_loss(*problem, 10.0)
    assert total == pytest.approx(loss_in_numpy(*problem, 10.0), rel=1e-5)
    assert info["discriminator_loss"] == pytest.approx(loss_in_numpy(*problem, 0.0), rel=1e-5)


def test_accuracies_by_hand():
    identity = [{"w": np.ones((1, 1)), "b": np.zeros(1)}]
    expert, policy = np.array([[2.0], [1.0], [-1.0], [3.0]]), np.array([[-1.0], [-2.0], [5.0], [1.0]])
    info = discriminator_loss(identity, expert, policy, np.zeros((4, 1)), 0.0)[1]
    assert (info["expert_accuracy"], info["policy_accuracy"]) == (0.75, 0.5)


def test_gradient_agrees_with_finite_differences(problem):
    params, *data = problem
    slopes = jax.jit(jax.grad(discriminator_loss, has_aux=True))(params, *data, 10.0)[0]
    leaves, tree = jax.tree.flatten(params)
    for which, (leaf, slope) in enumerate(zip(leaves, jax.tree.leaves(slopes), strict=True)):
        for at in np.ndindex(leaf.shape):
            values = []
            for move in (1e-5, -1e-5):
                moved = leaf.copy()
                moved[at] += move
                others = [*leaves[:which], moved, *leaves[which + 1 :]]
                values.append(loss_in_numpy(jax.tree.unflatten(tree, others), *data, 10.0))
            assert slope[at] == pytest.approx((values[0] - values[1]) / 2e-5, rel=2e-3, abs=2e-3)


# The reward


def test_reward_is_minus_log_of_one_minus_d():
    model = built("gail", reward_hidden=(6,))
    steps = steps_of(np.random.default_rng(1))
    state = model.init(jax.random.key(0), demos_of(steps))
    _, reward = model.reward(state, (), CONTEXT, steps)
    (first, last) = jax.tree.map(lambda leaf: np.asarray(leaf, float), state.inner.params)
    for t, e in np.ndindex(*reward.shape):
        x = np.concatenate([(steps.obs[t, e] - STATS.mean) / STATS.std, steps.action[t, e]])
        logit = (np.tanh(x @ first["w"] + first["b"]) @ last["w"] + last["b"])[0]
        assert reward[t, e] == pytest.approx(-np.log(1 - 1 / (1 + np.exp(-logit))), rel=1e-3)


def test_reward_stays_finite_however_sure_the_discriminator():
    model = built("gail", reward_hidden=(6,))
    steps = steps_of(np.random.default_rng(1))
    state = model.init(jax.random.key(0), demos_of(steps))
    for bias in (-1e4, 1e4):
        first, last = state.inner.params
        sure = state._replace(inner=AdamState([first, {**last, "b": jnp.array([bias])}], ()))
        _, reward = model.reward(sure, (), CONTEXT, steps)
        np.testing.assert_allclose(reward, max(bias, 0.0), rtol=1e-3)


# Learning


def test_learns_to_tell_expert_from_policy():
    rng = np.random.default_rng(0)
    model = built(
        "gail", reward_hidden=(32,), reward_learning_rate=3e-3, gradient_penalty=1.0, reward_steps=200, reward_batch=64
    )
    expert, policy = steps_of(rng, shift=2.0), steps_of(rng)
    held_out_expert, held_out_policy = steps_of(rng, shift=2.0), steps_of(rng)
    state, info = jax.jit(model.update)(
        jax.random.key(0), model.init(jax.random.key(1), demos_of(expert)), CONTEXT, demos_of(expert), policy
    )
    assert info["expert_accuracy"] > 0.85 and info["policy_accuracy"] > 0.85
    on_expert, on_policy = (
        np.ravel(model.reward(state, (), CONTEXT, s)[1]) for s in (held_out_expert, held_out_policy)
    )
    area_under_curve = np.mean(on_expert[:, None] > on_policy[None])
    assert area_under_curve > 0.9


def test_rows_that_are_the_same_raw_numbers_cannot_be_told_apart():
    # One row, given both as demonstration and as policy data: any difference would come from the normaliser.
    one = steps_of(np.random.default_rng(0), time=1, envs=1)
    model = built("gail", reward_hidden=(32,), reward_learning_rate=3e-2, reward_steps=50, reward_batch=8)
    begun = model.init(jax.random.key(1), demos_of(one))
    _, info = jax.jit(model.update)(jax.random.key(0), begun, CONTEXT, demos_of(one), one)
    assert info["discriminator_loss"] >= 2 * np.log(2) - 1e-5
    assert info["expert_accuracy"] + info["policy_accuracy"] == 1


def test_expert_and_policy_rows_become_the_same_inputs():
    steps = steps_of(np.random.default_rng(0))
    expert, policy = expert_inputs(demos_of(steps), STATS), policy_inputs(steps, STATS)
    for of_expert, of_policy in zip(expert, policy, strict=True):
        np.testing.assert_array_equal(of_expert, of_policy.reshape(of_expert.shape))
    by_hand = (np.asarray(steps.obs).reshape(-1, OBS) - np.asarray(STATS.mean)) / np.asarray(STATS.std)
    np.testing.assert_allclose(expert.obs, by_hand, rtol=1e-5)


# Measure conditioning


@pytest.mark.parametrize(
    ("method", "seen"), [("gail", 0), ("mbo-gail", 0), ("mcond-gail", PROXIES), ("mconbo-gail", PROXIES)]
)
def test_methods_with_mcond_have_inputs_for_the_proxy(method, seen):
    state = built(method).init(jax.random.key(1), demos_of(steps_of(np.random.default_rng(0))))
    assert len(state.inner.params[0]["w"]) == OBS + ACTIONS + seen


@pytest.mark.parametrize(("method", "conditioned"), [("gail", False), ("mcond-gail", True)])
def test_only_conditioned_models_see_the_proxy(method, conditioned):
    model = built(method)
    rng = np.random.default_rng(0)
    steps, demos = steps_of(rng), demos_of(steps_of(rng))
    other_steps, other_demos = steps._replace(proxy=1 - steps.proxy), demos._replace(proxy=1 - demos.proxy)

    @jax.jit
    def learn_and_reward(demos, steps):
        state = model.update(jax.random.key(0), model.init(jax.random.key(1), demos), CONTEXT, demos, steps)[0]
        return state.inner.params, model.reward(state, (), CONTEXT, steps)[1]

    def same(some, others):
        pairs = zip(jax.tree.leaves(some), jax.tree.leaves(others), strict=True)
        return all(np.array_equal(a, b) for a, b in pairs)

    plain = learn_and_reward(demos, steps)
    assert same(plain, learn_and_reward(demos, other_steps)) != conditioned
    assert same(plain, learn_and_reward(other_demos, steps)) != conditioned


def test_inputs_are_state_action_and_proxy_side_by_side():
    steps = steps_of(np.random.default_rng(0))
    x = features(policy_inputs(steps, STATS))
    np.testing.assert_array_equal(x[..., OBS : OBS + ACTIONS], steps.action)
    np.testing.assert_array_equal(x[..., OBS + ACTIONS :], steps.proxy)
    params = networks.init_mlp(jax.random.key(0), (x.shape[-1], 4, 1))
    assert logits(params, x).shape == steps.reward.shape
