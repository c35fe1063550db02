"""AIRL (Fu et al., 2017) as the paper uses it: a discriminator of (s, a, s'), its log-odds as reward (Appendix C).

r = log D(s, a, s') − log(1 − D(s, a, s')), which is the discriminator's logit: of either sign, without bound.
Fu et al. give D the form exp(f)/(exp(f) + π); the paper's is logistic regression, and its text mentions no penalty.
"""

import jax
import jax.numpy as jnp

from qdil.config import Config
from qdil.imitation.reward_model import InputModel, Inputs, features
from qdil.imitation.rewards.gail import cross_entropy, logits
from qdil.imitation.training import AdamState, by_adam
from qdil.rl.networks import init_mlp
from qdil.types import Params, RewardMemory


def transition_features(inputs: Inputs) -> jax.Array:
    """(s, a, δ, s') side by side."""
    return jnp.concatenate([features(inputs), inputs.next_obs], axis=-1)


def airl(config: Config, widths: Inputs) -> InputModel:
    """Rewards log D − log(1−D)."""

    def loss(params: Params, key: jax.Array, expert: Inputs, policy: Inputs) -> tuple[jax.Array, dict[str, jax.Array]]:
        return cross_entropy(logits(params, transition_features(expert)), logits(params, transition_features(policy)))

    begin, update = by_adam(config, loss)

    def init(key: jax.Array, expert: Inputs) -> AdamState:
        return begin(init_mlp(key, (sum(widths), *config.reward.reward_hidden, 1)))

    def reward(
        state: AdamState, memory: RewardMemory, inputs: Inputs, ended: jax.Array
    ) -> tuple[RewardMemory, jax.Array]:
        return memory, logits(state.params, transition_features(inputs))

    return InputModel(init, reward, update=update)
