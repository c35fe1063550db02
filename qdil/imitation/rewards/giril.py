"""GIRIL (eqs. 9, 10): a model of the demonstrator's transitions, whose prediction error is the reward.

The model is a conditional variational autoencoder with three networks. The recognition network q(z|s, s') infers the
action between two states, the prior p(z|s) predicts it from the first state alone, and the decoder p(s'|â, s) predicts
the next state. It is trained on the demonstrations before the run and never changes after that. The loss is
½‖s' − decoder(â, s)‖² + KL(q(z|s, s') ‖ p(z|s)) + α ½‖â − a‖².
The paper writes it for discrete actions, with a softmax of z. For continuous actions we take â = tanh(z), and the
divergence of two Gaussians of unit variance, ½‖â − a‖², for the last term of eq. 9.

The reward (eq. 10) is ‖decoder(a, s) − s'‖² ≥ 0 for the policy's own action a. As in the paper it is *large* where the
model predicts badly, that is, away from the demonstrations. Without actions (``giril-obs``), the recognition network's
â replaces a, and the loss has no α term.

Reference
- X. Yu, Y. Lyu, I. W. Tsang, 2020. Intrinsic Reward Driven Imitation Learning via Generative Model. arXiv:2006.15061.
"""

import jax
import jax.numpy as jnp
import optax

from qdil.config import Config
from qdil.imitation.reward_model import InputModel, Inputs
from qdil.imitation.training import AdamState, sample_rows
from qdil.rl.networks import init_mlp, mlp
from qdil.types import Params, RewardMemory

LATENT_WITHOUT_ACTIONS = 6  # size of â in -obs variants, which do not know A (6 on walker2d and halfcheetah)


def _gaussian(params: Params, x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Mean and log deviation, both (…, Z), that a network gives for inputs (…, F)."""
    mean, log_std = jnp.split(mlp(params, x), 2, axis=-1)
    return mean, jnp.clip(log_std, -5.0, 2.0)


def kl(mean: jax.Array, log_std: jax.Array, other_mean: jax.Array, other_log_std: jax.Array) -> jax.Array:
    """KL(N(mean, std²) ‖ N(other_mean, other_std²)) (…,) of diagonal Gaussians (…, Z), in nats."""
    scaled = jnp.exp(2 * (log_std - other_log_std)) + jnp.square((mean - other_mean) * jnp.exp(-other_log_std))
    return 0.5 * jnp.sum(scaled - 1.0 - 2.0 * (log_std - other_log_std), axis=-1)


def _state(inputs: Inputs) -> jax.Array:
    """(s, δ(s)) joined into one vector, (…, O + k)."""
    return jnp.concatenate([inputs.obs, inputs.proxy], axis=-1)


def recognise(params: Params, inputs: Inputs) -> tuple[jax.Array, jax.Array]:
    """Mean and log deviation, both (…, Z), of q(z|s, s')."""
    return _gaussian(params["recognition"], jnp.concatenate([_state(inputs), inputs.next_obs], axis=-1))


def decode(params: Params, action: jax.Array, inputs: Inputs) -> jax.Array:
    """The predicted next state ŝ' (…, O); the network predicts the change from s. ``action`` is (…, Z)."""
    return inputs.obs + mlp(params["decoder"], jnp.concatenate([action, _state(inputs)], axis=-1))


def reconstruction_error(params: Params, inputs: Inputs) -> jax.Array:
    """‖ŝ' − s'‖² (…,) of eq. 10."""
    action = inputs.action if inputs.action.shape[-1] else jnp.tanh(recognise(params, inputs)[0])
    return jnp.sum(jnp.square(decode(params, action, inputs) - inputs.next_obs), axis=-1)


def loss(params: Params, key: jax.Array, inputs: Inputs, action_weight: float) -> jax.Array:
    """Minus the objective of eq. 9 (), mean over rows (N); ``action_weight`` is α."""
    mean, log_std = recognise(params, inputs)
    action = jnp.tanh(mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape))
    error = 0.5 * jnp.sum(jnp.square(decode(params, action, inputs) - inputs.next_obs), axis=-1)
    total = error + kl(mean, log_std, *_gaussian(params["prior"], _state(inputs)))
    if inputs.action.shape[-1]:
        total = total + action_weight * 0.5 * jnp.sum(jnp.square(action - inputs.action), axis=-1)
    return jnp.mean(total)


def giril(config: Config, widths: Inputs) -> InputModel:
    """The reward ‖ŝ' − s'‖² ≥ 0 (eq. 10)."""
    opt = optax.adam(config.reward.giril_learning_rate)
    state_size, latent = widths.obs + widths.proxy, widths.action or LATENT_WITHOUT_ACTIONS
    hidden = config.reward.reward_hidden

    def init(key: jax.Array, expert: Inputs) -> Params:
        keys = jax.random.split(key, 4)
        params = {
            "recognition": init_mlp(keys[0], (state_size + widths.next_obs, *hidden, 2 * latent)),
            "prior": init_mlp(keys[1], (state_size, *hidden, 2 * latent)),
            "decoder": init_mlp(keys[2], (latent + state_size, *hidden, widths.next_obs)),
        }

        def step(current: AdamState, key: jax.Array) -> tuple[AdamState, None]:
            row_key, noise_key = jax.random.split(key)
            batch = sample_rows(row_key, expert, config.reward.reward_batch)
            grads = jax.grad(loss)(current.params, noise_key, batch, config.reward.giril_action_weight)
            change, opt_state = opt.update(grads, current.opt)
            return AdamState(optax.apply_updates(current.params, change), opt_state), None

        learned, _ = jax.lax.scan(
            step, AdamState(params, opt.init(params)), jax.random.split(keys[3], config.reward.giril_steps)
        )
        return learned.params

    def reward(state: Params, memory: RewardMemory, inputs: Inputs, ended: jax.Array) -> tuple[RewardMemory, jax.Array]:
        return memory, reconstruction_error(state, inputs)

    return InputModel(init, reward, normaliser="expert")
