"""AIRL as the paper uses it (Appendix C): a discriminator D(s, a, s') trained as GAIL's, its log-odds as the reward.

r = log D(s, a, s') − log(1 − D(s, a, s')), which is the discriminator's logit: either sign, no bound.
This is not the AIRL of Fu et al., whose discriminator has the form exp(f)/(exp(f) + π(a|s)) with
f(s, s') = g(s) + γh(s') − h(s), so that g recovers a reward. It is not GAIL either, whose reward −log(1−D) is never
negative.
The paper's discriminator is plain logistic regression, and its text mentions no gradient penalty, so there is none.

Reference
- J. Fu, K. Luo, S. Levine, 2017. Learning Robust Rewards with Adversarial Inverse Reinforcement Learning.
  arXiv:1710.11248.
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
    """(s, a, δ, s') joined into one vector, (…, F)."""
    return jnp.concatenate([features(inputs), inputs.next_obs], axis=-1)


def airl(config: Config, widths: Inputs) -> InputModel:
    """The reward log D − log(1−D), of either sign."""

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
