"""DiffAIL: GAIL whose discriminator is a diffusion model's loss, D = exp(−loss). A base of the paper's later version.

A diffusion model learns to find the noise ε in a noisy row x_t = √ᾱ_t x + √(1−ᾱ_t) ε of x = (s, a, δ). Its error
e_t = mean over elements of (ε − ε_ψ(x_t, t))² is small where x resembles the rows that it knows, so
D_ψ(x, ε, t) = exp(−e_t) ∈ (0, 1]. Unlike a plain diffusion model, this one learns from the policy's rows, too.

Signs: D is the probability that a step is the *expert's*. The model minimises E_D[−log D] + E_π[−log(1−D)], with ε and
t drawn anew for every row. Since −log D = e_t, the first term is the usual loss of a diffusion model. The reward of a
step is −log(1−D) ≥ 0 with D averaged over noise levels: higher for steps that look like the expert's, and never
negative. With ``diffail_steps=100`` an average over all levels would make runs several times as slow, so it is over
``diffail_levels`` of them.

The reward must not depend on the chunk or the device that computes it. So all rows share one ε per noise level, which
is drawn again after every round of learning. Wang et al. draw ε for every row. The ε of each second level is minus that
of the level before: a shared ε favours some direction of x, and its opposite takes most of that back.

As in the program of Wang et al., β_t rises linearly from 1e-4 to 0.02 in T = 10 steps. They have three layers of 128
Mish units, a small network for t, and a step size of 3e-5. Here network and step size are those of the other reward
models (``reward_hidden``, ``reward_learning_rate``), and sines and cosines of t are inputs. Without actions, they see
(s, s'); ``diffail-obs`` sees s alone.
The program that the authors of QD-IL released has T = 100 and ``diffail_penalty=10``. It takes D for a logit
(``diffail_loss``) and averages exp(−error) over elements in the reward (``diffail_reward``), as Wang et al. do. Both
programs mix the points of the gradient penalty per sample, whatever ``penalty_mixing`` says.

References
- B. Wang, G. Wu, T. Pang, Y. Zhang, Y. Yin, 2024. DiffAIL: Diffusion Adversarial Imitation Learning. AAAI.
  arXiv:2312.06348.
- J. Ho, A. Jain, P. Abbeel, 2020. Denoising Diffusion Probabilistic Models. arXiv:2006.11239 (the noise levels).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdil.config import Config
from qdil.imitation.reward_model import Info, InputModel, Inputs, features
from qdil.imitation.rewards.gail import gradient_penalty, mixing_weights
from qdil.imitation.training import AdamState, by_adam
from qdil.rl.networks import init_mlp, mlp
from qdil.types import Params, RewardMemory

FIRST_BETA, LAST_BETA = 1e-4, 0.02  # variance that a step of the diffusion adds (Ho et al., 2020)
TIME_INPUTS = 16  # sines and cosines of t (Wang et al., 2024)
LEAST = 1e-8  # the smallest 1 − D, so that no reward exceeds 18.4 (the authors' released program)


class Levels(NamedTuple):
    """Noise levels, axis (T) in front, or one of them."""

    signal: jax.Array  # (T,) √ᾱ_t, the share of x in x_t
    noise: jax.Array  # (T,) √(1−ᾱ_t), the share of ε
    time: jax.Array  # (T, TIME_INPUTS) sines and cosines of t


class DiffailState(NamedTuple):
    """The diffusion model, its optimiser's state, and the noise of the reward."""

    learner: AdamState
    noise: jax.Array  # (L, F) ε of every noise level that the reward uses


def noise_levels(steps: int) -> Levels:
    """The ``steps`` noise levels of the forward process: ᾱ_t is the product of 1 − β up to t."""
    kept = np.cumprod(1.0 - np.linspace(FIRST_BETA, LAST_BETA, steps))
    waves = np.arange(steps)[:, None] * 10000.0 ** -np.linspace(0.0, 1.0, TIME_INPUTS // 2)
    time = np.concatenate([np.sin(waves), np.cos(waves)], axis=1)
    return Levels(*(jnp.asarray(x, jnp.float32) for x in (np.sqrt(kept), np.sqrt(1.0 - kept), time)))


def spread_levels(steps: int, count: int) -> Levels:
    """``count`` of the ``steps`` noise levels, evenly spread; all of them if ``count`` is not smaller."""
    count = min(steps, count)
    return jax.tree.map(lambda x: x[(2 * np.arange(count) + 1) * steps // (2 * count)], noise_levels(steps))


def draw_noise(key: jax.Array, shape: tuple[int, int]) -> jax.Array:
    """Standard normal ε (L, F), in pairs of opposite sign."""
    half = jax.random.normal(key, (-(-shape[0] // 2), shape[1]))
    return jnp.stack([half, -half], axis=1).reshape(-1, shape[1])[: shape[0]]


def errors(params: Params, x: jax.Array, noise: jax.Array, level: Levels) -> jax.Array:
    """(ε − ε_ψ(x_t, t))² (…, F) for rows ``x`` and ``noise`` ε (…, F); ``level`` is one level, or one for each row."""
    noisy = level.signal[..., None] * x + level.noise[..., None] * noise
    time = jnp.broadcast_to(level.time, (*noisy.shape[:-1], TIME_INPUTS))
    return jnp.square(noise - mlp(params, jnp.concatenate([noisy, time], axis=-1)))


def loss(
    params: Params, expert: jax.Array, policy: jax.Array, key: jax.Array, config: Config
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """The discriminator's loss () on features (N, F) of expert and policy rows, plus the gradient penalty."""
    level_key, noise_key, mix_key = jax.random.split(key, 3)
    levels, settings = noise_levels(config.reward.diffail_steps), config.reward
    t = jax.random.randint(level_key, (3, len(expert)), 0, settings.diffail_steps)
    of_expert, of_policy, of_mixed = (jax.tree.map(lambda x, i=i: x[t[i]], levels) for i in range(3))
    noise = jax.random.normal(noise_key, (3, *expert.shape))

    expert_error = jnp.mean(errors(params, expert, noise[0], of_expert), axis=-1)
    policy_error = jnp.mean(errors(params, policy, noise[1], of_policy), axis=-1)
    total, info = cross_entropy(expert_error, policy_error, settings.diffail_loss)

    def discriminator(row: jax.Array, noise: jax.Array, level: Levels) -> jax.Array:
        return jnp.exp(-jnp.mean(errors(params, row, noise, level)))

    mix = mixing_weights(mix_key, expert, "sample")
    penalty = gradient_penalty(discriminator, expert, policy, mix, noise[2], of_mixed)
    return total + settings.diffail_penalty * penalty, info


def cross_entropy(expert_error: jax.Array, policy_error: jax.Array, how: str) -> tuple[jax.Array, dict[str, jax.Array]]:
    """E_D[−log D] + E_π[−log(1−D)] from errors e (N,) with D = exp(−e); also the shares that D gets right.

    ``how`` "logit" takes D for the logit of a probability, which then is never below ½.
    Noise of a low level cannot be found in any row, so errors near 1 and D near 0.4 are usual on expert rows, too, and
    ``expert_accuracy`` may stay below ½ in a run that learns well.
    """
    expert, policy = jnp.exp(-expert_error), jnp.exp(-policy_error)
    if how == "logit":
        total = jnp.mean(jax.nn.softplus(-expert)) + jnp.mean(jax.nn.softplus(policy))
    else:
        total = jnp.mean(expert_error) - jnp.mean(jnp.log(jnp.maximum(-jnp.expm1(-policy_error), LEAST)))
    info = {
        "discriminator_loss": total,
        "diffusion_loss": jnp.mean(expert_error),
        "expert_accuracy": jnp.mean(expert > 0.5),
        "policy_accuracy": jnp.mean(policy <= 0.5),
    }
    return total, info


def rewards_of(params: Params, noise: jax.Array, levels: Levels, x: jax.Array, how: str) -> jax.Array:
    """−log(1−D) ≥ 0 (…,) of features (…, F), D averaged over ``levels`` (L), with ``noise`` (L, F) for all rows.

    ``how`` "row": D = exp(−mean over elements of the error); "element": D = mean over elements of exp(−error).
    """

    def add_level(total: jax.Array, one: tuple[jax.Array, Levels]) -> tuple[jax.Array, None]:
        error = errors(params, x, jnp.broadcast_to(one[0], x.shape), one[1])
        error = jnp.mean(error, axis=-1, keepdims=True) if how == "row" else error
        return total - jnp.mean(jnp.expm1(-error), axis=-1), None  # the sum of 1 − D keeps its digits where D is near 1

    total, _ = jax.lax.scan(add_level, jnp.zeros(x.shape[:-1]), (noise, levels))  # one level after another: memory
    return -jnp.log(jnp.maximum(total / len(noise), LEAST))


def diffail(config: Config, widths: Inputs) -> InputModel:
    """The reward −log(1−D(s, a, δ)) ≥ 0 with D = exp(−diffusion loss)."""
    size = widths.obs + widths.action + widths.proxy
    levels = spread_levels(config.reward.diffail_steps, config.reward.diffail_levels)

    def by_features(params: Params, key: jax.Array, expert: Inputs, policy: Inputs) -> tuple[jax.Array, Info]:
        return loss(params, features(expert), features(policy), key, config)

    begin, learn = by_adam(config, by_features)

    def draw(key: jax.Array) -> jax.Array:
        return draw_noise(key, (len(levels.signal), size))

    def init(key: jax.Array, expert: Inputs) -> DiffailState:
        network_key, noise_key = jax.random.split(key)
        params = init_mlp(network_key, (size + TIME_INPUTS, *config.reward.reward_hidden, size))
        return DiffailState(begin(params), draw(noise_key))

    def reward(
        state: DiffailState, memory: RewardMemory, inputs: Inputs, ended: jax.Array
    ) -> tuple[RewardMemory, jax.Array]:
        x, how = features(inputs), config.reward.diffail_reward
        return memory, rewards_of(state.learner.params, state.noise, levels, x, how)

    def update(key: jax.Array, state: DiffailState, expert: Inputs, policy: Inputs) -> tuple[DiffailState, Info]:
        learn_key, noise_key = jax.random.split(key)
        learner, info = learn(learn_key, state.learner, expert, policy)
        return DiffailState(learner, draw(noise_key)), info

    return InputModel(init, reward, update=update)
