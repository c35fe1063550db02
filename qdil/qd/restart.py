"""Restart (Algorithm 1, lines 19-22): if an iteration added nothing, the search continues from a random elite."""

import jax
import jax.numpy as jnp

from qdil.config import PPO
from qdil.rl import networks, vppo
from qdil.types import ObsStats, Params


def restart_at(
    ppo: PPO,
    template: Params,
    train_state: vppo.TrainState,
    stats: ObsStats,
    theta: jax.Array,
    obs_mean: jax.Array,
    obs_std: jax.Array,
) -> tuple[vppo.TrainState, ObsStats]:
    """θ_μ becomes the elite ``theta`` (P,) with that elite's own observation statistics (O,).

    The optimisers start afresh and the critic stays. The statistics keep their weight of past data, so that the elite's
    normaliser moves no faster than the search's did. ``template`` is a policy of the same structure.
    """
    opt, policy = vppo.optimiser(ppo), networks.unflatten(theta, template)
    train_state = train_state._replace(
        policy=policy, policy_opt=opt.init(policy), critic_opt=opt.init(train_state.critic)
    )
    return train_state, ObsStats(obs_mean, obs_std, jnp.square(obs_std) * stats.seen, stats.seen)
