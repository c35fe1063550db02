"""GAIL (Ho & Ermon, 2016; eq. 7) and, with δ(s) among its inputs, measure-conditioned GAIL (eq. 3).

Signs: D_ψ = sigmoid(logit) is the probability of *expert*. The discriminator lowers
E_D[−log D] + E_π[−log(1−D)], the policy is paid −log(1−D) = softplus(logit) ≥ 0, so every step alive pays.

Departures from the authors' released program: expert and policy rows share one normaliser and random rows
(there: raw expert rows, always the first batch); the penalty's mixing weight is drawn per sample
(``gradient_penalty``; there: per element).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from qdil.imitation.reward_model import (
    Demonstrations,
    Inputs,
    RewardModel,
    Select,
    expert_inputs,
    policy_inputs,
    rows,
)
from qdil.search.networks import init_mlp, mlp
from qdil.types import Params, RewardContext, Transitions


class GailState(NamedTuple):
    """The discriminator and its optimiser."""

    params: Params
    opt: optax.OptState


def features(inputs: Inputs) -> jax.Array:
    """(s, a, δ) side by side, (…, F); what was hidden has width 0."""
    return jnp.concatenate([inputs.obs, inputs.action, inputs.proxy], axis=-1)


def logits(params: Params, x: jax.Array) -> jax.Array:
    """log D − log(1−D), (…,), of features (…, F)."""
    return mlp(params, x)[..., 0]


def gradient_penalty(params: Params, expert: jax.Array, policy: jax.Array, mix: jax.Array) -> jax.Array:
    """Mean (‖∇_x logit(x̂)‖ − 1)² at x̂ = mix·expert + (1−mix)·policy, ``mix`` (N, 1) (Gulrajani et al., 2017)."""
    between = mix * expert + (1.0 - mix) * policy
    slopes = jax.vmap(jax.grad(lambda x: logits(params, x)))(between)
    return jnp.mean(jnp.square(jnp.sqrt(jnp.sum(jnp.square(slopes), axis=-1) + 1e-12) - 1.0))


def discriminator_loss(
    params: Params, expert: jax.Array, policy: jax.Array, mix: jax.Array, penalty: float
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Eq. 3's inner objective plus ``penalty`` times the gradient penalty; features (N, F) each."""
    expert_logit, policy_logit = logits(params, expert), logits(params, policy)
    cross_entropy = jnp.mean(jax.nn.softplus(-expert_logit)) + jnp.mean(jax.nn.softplus(policy_logit))
    info = {
        "discriminator_loss": cross_entropy,
        "expert_accuracy": jnp.mean(expert_logit > 0),
        "policy_accuracy": jnp.mean(policy_logit <= 0),
    }
    return cross_entropy + penalty * gradient_penalty(params, expert, policy, mix), info


def gail(
    input_size: int,
    select: Select,
    hidden: Sequence[int] = (100, 100),
    learning_rate: float = 3e-4,
    penalty: float = 10.0,
    steps: int = 10,
    batch_size: int = 512,
) -> RewardModel:
    """A GAIL reward over the inputs that ``select`` lets through, ``input_size`` numbers in all.

    One ``update`` takes ``steps`` Adam steps, each on ``batch_size`` expert and as many policy rows.
    """
    opt = optax.adam(learning_rate)

    def init(key: jax.Array, demos: Demonstrations | None) -> GailState:
        params = init_mlp(key, (input_size, *hidden, 1))
        return GailState(params, opt.init(params))

    def reward(state: GailState, carry: Any, context: RewardContext, transitions: Transitions) -> tuple[Any, jax.Array]:
        seen = features(select(policy_inputs(transitions, context.obs_stats)))
        return carry, jax.nn.softplus(logits(state.params, seen))

    def update(
        key: jax.Array, state: GailState, context: RewardContext, demos: Demonstrations, transitions: Transitions
    ) -> tuple[GailState, dict[str, jax.Array]]:
        expert = select(expert_inputs(demos, context.obs_stats))
        policy = select(policy_inputs(transitions, context.obs_stats))

        def step(state: GailState, key: jax.Array):
            expert_key, policy_key, mix_key = jax.random.split(key, 3)
            x_expert = features(rows(expert_key, expert, batch_size))
            x_policy = features(rows(policy_key, policy, batch_size))
            mix = jax.random.uniform(mix_key, (batch_size, 1))
            grads, info = jax.grad(discriminator_loss, has_aux=True)(state.params, x_expert, x_policy, mix, penalty)
            change, opt_state = opt.update(grads, state.opt)
            return GailState(optax.apply_updates(state.params, change), opt_state), info

        state, info = jax.lax.scan(step, state, jax.random.split(key, steps))
        return state, jax.tree.map(lambda x: x[-1], info)

    return RewardModel(init, lambda state, num_envs: (), reward, update, learns=True)
