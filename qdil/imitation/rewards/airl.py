"""AIRL (Fu et al., 2017) as the paper uses it: a discriminator of (s, a, s'), its log-odds as reward (Appendix C).

r = log D(s, a, s') − log(1 − D(s, a, s')), which is the discriminator's logit: of either sign, without bound.
Fu et al. give D the form exp(f)/(exp(f) + π); the paper's is logistic regression, and its text mentions no penalty.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from qdil.config import Config
from qdil.imitation.registry import register
from qdil.imitation.reward_model import InputModel, Inputs, features, in_minibatches
from qdil.imitation.rewards.gail import cross_entropy, logits
from qdil.search.networks import init_mlp
from qdil.types import Params


class AirlState(NamedTuple):
    """The discriminator and its optimiser."""

    params: Params
    opt: optax.OptState


def transition_features(inputs: Inputs) -> jax.Array:
    """(s, a, δ, s') side by side."""
    return jnp.concatenate([features(inputs), inputs.next_obs], axis=-1)


@register("airl", "log D − log(1−D) of a discriminator of (s, a, s')", signed=True)
def airl(config: Config, widths: Inputs) -> InputModel:
    """Rewards log D − log(1−D)."""
    opt = optax.adam(config.reward_learning_rate)

    def init(key: jax.Array, expert: Inputs) -> AirlState:
        params = init_mlp(key, (sum(widths), *config.reward_hidden, 1))
        return AirlState(params, opt.init(params))

    def reward(state: AirlState, carry: Any, inputs: Inputs, ended: jax.Array) -> tuple[Any, jax.Array]:
        return carry, logits(state.params, transition_features(inputs))

    def loss(params: Params, expert: Inputs, policy: Inputs):
        return cross_entropy(logits(params, transition_features(expert)), logits(params, transition_features(policy)))

    def step(key: jax.Array, state: AirlState, expert: Inputs, policy: Inputs):
        grads, info = jax.grad(loss, has_aux=True)(state.params, expert, policy)
        change, opt_state = opt.update(grads, state.opt)
        return AirlState(optax.apply_updates(state.params, change), opt_state), info

    update = in_minibatches(step, config.reward_steps, config.reward_batch)
    return InputModel(init, lambda state, num_envs: (), reward, update)
