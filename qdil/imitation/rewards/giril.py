"""GIRIL (Yu et al., 2020; eqs. 9, 10): a conditional VAE of the demonstrator's transitions, its surprise as reward.

Trained on the demonstrations before the run and then left alone. The recognition network q(z|s, s') encodes backwards
what was done between two states, the prior p(z|s) what could be expected, the decoder p(s'|â, s) is a forward model.
For continuous actions the latent becomes an action by â = tanh(z), where the paper has a softmax (for discrete ones),
and the last term of eq. 9 is the divergence of two Gaussians of unit variance, ½‖â − a‖². So one minimises
½‖s' − decoder(â, s)‖² + KL(q(z|s, s') ‖ p(z|s)) + α ½‖â − a‖².

The reward (eq. 10) is ‖decoder(a, s) − s'‖² for the policy's own a: *large* where the demonstrator's model is wrong,
as the paper has it. Without actions (``giril-obs``) â is the recognition network's own guess and the α term is left
out.
"""

import jax
import jax.numpy as jnp
import optax

from qdil.config import Config
from qdil.imitation.reward_model import InputModel, Inputs
from qdil.imitation.training import AdamState, rows
from qdil.rl.networks import init_mlp, mlp
from qdil.types import Params, RewardMemory

LATENT_WITHOUT_ACTIONS = 6  # size of â where no action tells it (walker2d's and halfcheetah's own)


def _gaussian(params: Params, x: jax.Array) -> tuple[jax.Array, jax.Array]:
    mean, log_std = jnp.split(mlp(params, x), 2, axis=-1)
    return mean, jnp.clip(log_std, -5.0, 2.0)


def kl(mean: jax.Array, log_std: jax.Array, other_mean: jax.Array, other_log_std: jax.Array) -> jax.Array:
    """KL(N(mean, std²) ‖ N(other)) of diagonal Gaussians in nats, (…,)."""
    scaled = jnp.exp(2 * (log_std - other_log_std)) + jnp.square((mean - other_mean) * jnp.exp(-other_log_std))
    return 0.5 * jnp.sum(scaled - 1.0 - 2.0 * (log_std - other_log_std), axis=-1)


def _state(inputs: Inputs) -> jax.Array:
    return jnp.concatenate([inputs.obs, inputs.proxy], axis=-1)


def recognise(params: Params, inputs: Inputs) -> tuple[jax.Array, jax.Array]:
    """Mean and log deviation of q(z|s, s')."""
    return _gaussian(params["recognition"], jnp.concatenate([_state(inputs), inputs.next_obs], axis=-1))


def decode(params: Params, action: jax.Array, inputs: Inputs) -> jax.Array:
    """ŝ' (…, O), as a change from s."""
    return inputs.obs + mlp(params["decoder"], jnp.concatenate([action, _state(inputs)], axis=-1))


def reconstruction_error(params: Params, inputs: Inputs) -> jax.Array:
    """‖ŝ' − s'‖² (…,), eq. 10."""
    action = inputs.action if inputs.action.shape[-1] else jnp.tanh(recognise(params, inputs)[0])
    return jnp.sum(jnp.square(decode(params, action, inputs) - inputs.next_obs), axis=-1)


def loss(params: Params, key: jax.Array, inputs: Inputs, action_weight: float) -> jax.Array:
    """Minus eq. 9, mean over rows (N)."""
    mean, log_std = recognise(params, inputs)
    action = jnp.tanh(mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape))
    error = 0.5 * jnp.sum(jnp.square(decode(params, action, inputs) - inputs.next_obs), axis=-1)
    total = error + kl(mean, log_std, *_gaussian(params["prior"], _state(inputs)))
    if inputs.action.shape[-1]:
        total = total + action_weight * 0.5 * jnp.sum(jnp.square(action - inputs.action), axis=-1)
    return jnp.mean(total)


def giril(config: Config, widths: Inputs) -> InputModel:
    """Rewards ‖ŝ' − s'‖² ≥ 0."""
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

        def step(now: AdamState, key: jax.Array) -> tuple[AdamState, None]:
            row_key, noise_key = jax.random.split(key)
            batch = rows(row_key, expert, config.reward.reward_batch)
            grads = jax.grad(loss)(now.params, noise_key, batch, config.reward.giril_action_weight)
            change, opt_state = opt.update(grads, now.opt)
            return AdamState(optax.apply_updates(now.params, change), opt_state), None

        learned, _ = jax.lax.scan(
            step, AdamState(params, opt.init(params)), jax.random.split(keys[3], config.reward.giril_steps)
        )
        return learned.params

    def reward(state: Params, memory: RewardMemory, inputs: Inputs, ended: jax.Array) -> tuple[RewardMemory, jax.Array]:
        return memory, reconstruction_error(state, inputs)

    return InputModel(init, reward, normaliser="expert")
