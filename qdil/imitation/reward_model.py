"""What a reward model is: a value of pure functions; over what inputs; and the transformations that make variants."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdil.search.normalise import normalise_obs
from qdil.types import ObsStats, RewardContext, Transitions


class Inputs(NamedTuple):
    """What a learned reward may read of a step; expert and policy batches take the same form."""

    obs: Any  # (…, O) s_t, normalised
    action: Any  # (…, A) a_t in [-1, 1]; width 0 for observation-only models
    next_obs: Any  # (…, O) s_{t+1}, normalised
    proxy: Any  # (…, k) δ(s_t); width 0 without measure conditioning


class Demonstrations(NamedTuple):
    """Expert steps, rows (N): state, action, next state and proxy of the same step."""

    obs: jax.Array  # (N, O) raw
    action: jax.Array  # (N, A); width 0 where the demonstrator's actions are not known
    next_obs: jax.Array  # (N, O) raw
    proxy: jax.Array  # (N, k)


class RewardModel(NamedTuple):
    """r(s, a, s', δ) as a value. State and carry are pytrees of arrays; every function is pure.

    ``init(key, demonstrations) -> state``;
    ``begin(state, num_envs) -> carry``, what a reward must remember within episodes (nothing for most);
    ``reward(state, carry, context, transitions) -> (carry, r)``, r (T, E) for transitions (T, E), without bonus;
    ``update(key, state, context, demonstrations, transitions) -> (state, info)``, one round of learning.
    """

    init: Callable[[jax.Array, Demonstrations | None], Any]
    begin: Callable[[Any, int], Any]
    reward: Callable[[Any, Any, RewardContext, Transitions], tuple[Any, jax.Array]]
    update: Callable[..., tuple[Any, dict[str, jax.Array]]]
    learns: bool  # False: ``update`` does nothing and needs no data


class InputModel(NamedTuple):
    """A reward model as its author writes it: over ``Inputs`` alone. ``over_inputs`` makes it a ``RewardModel``.

    ``init(key, expert) -> state`` with the demonstrations' rows (N);
    ``begin(state, num_envs) -> carry``;
    ``reward(state, carry, inputs, ended) -> (carry, r)``, inputs (T, E), ``ended`` (T, E) True where an episode ends;
    ``update(key, state, expert, policy) -> (state, info)`` with expert rows (N) and policy steps (T, E).
    """

    init: Callable[[jax.Array, Inputs], Any]
    begin: Callable[[Any, int], Any]
    reward: Callable[[Any, Any, Inputs, jax.Array], tuple[Any, jax.Array]]
    update: Callable[[jax.Array, Any, Inputs, Inputs], tuple[Any, dict[str, jax.Array]]]
    learns: bool = True
    # Whose mean and spread normalise observations, expert's and policy's alike: "running", the policy's own normaliser,
    # which moves; or "expert", the demonstrations', which stays, for models that learn before the run or not at all.
    normaliser: str = "running"


Select = Callable[[Inputs], Inputs]


def hide(actions: bool, proxy: bool) -> Select:
    """What a variant may see: without ``actions`` (eq. 20), without the ``proxy`` δ(s) (no measure conditioning)."""

    def select(inputs: Inputs) -> Inputs:
        action = inputs.action[..., :0] if actions else inputs.action
        return inputs._replace(action=action, proxy=inputs.proxy[..., :0] if proxy else inputs.proxy)

    return select


def policy_inputs(transitions: Transitions, stats: ObsStats) -> Inputs:
    """Inputs of policy steps."""
    obs, next_obs = normalise_obs(stats, transitions.obs), normalise_obs(stats, transitions.next_obs)
    return Inputs(obs, transitions.action, next_obs, transitions.proxy)


def expert_inputs(demos: Demonstrations, stats: ObsStats) -> Inputs:
    """Inputs of expert steps, through the very normaliser that policy steps go through."""
    return Inputs(normalise_obs(stats, demos.obs), demos.action, normalise_obs(stats, demos.next_obs), demos.proxy)


def expert_stats(demos: Demonstrations) -> ObsStats:
    """The demonstrations' own mean and spread; an observation that never moves there counts as it is (spread 1)."""
    spread = jnp.std(demos.obs, axis=0)
    zeros = jnp.zeros_like(spread)
    return ObsStats(jnp.mean(demos.obs, axis=0), jnp.where(spread < 1e-3, 1.0, spread), zeros, jnp.zeros(()))


class _OverInputs(NamedTuple):
    expert_stats: ObsStats
    inner: Any


def over_inputs(model: InputModel, select: Select, raw_expert: bool = False) -> RewardModel:
    """A ``RewardModel`` from one over inputs; ``select`` is what both expert and policy batches may show it.

    ``raw_expert`` leaves expert observations as they were recorded, against normalised policy observations: a mistake
    of the authors' released program (``expert_obs=raw``), for whoever wants to measure it.
    """

    def expert_rows(demos: Demonstrations, stats: ObsStats) -> Inputs:
        # Inputs of the recorded numbers themselves, which the normaliser would cut.
        recorded = Inputs(demos.obs, demos.action, demos.next_obs, demos.proxy)
        return select(recorded if raw_expert else expert_inputs(demos, stats))

    def stats_of(state: _OverInputs, context: RewardContext) -> ObsStats:
        return state.expert_stats if model.normaliser == "expert" else context.obs_stats

    def init(key: jax.Array, demos: Demonstrations | None) -> _OverInputs:
        assert demos is not None, "a model that imitates needs demonstrations"
        stats = expert_stats(demos)
        return _OverInputs(stats, model.init(key, expert_rows(demos, stats)))

    def begin(state: _OverInputs, num_envs: int) -> Any:
        return model.begin(state.inner, num_envs)

    def reward(state: _OverInputs, carry: Any, context: RewardContext, transitions: Transitions) -> Any:
        inputs = select(policy_inputs(transitions, stats_of(state, context)))
        return model.reward(state.inner, carry, inputs, transitions.ended)

    def update(
        key: jax.Array, state: _OverInputs, context: RewardContext, demos: Demonstrations, transitions: Transitions
    ) -> Any:
        stats = stats_of(state, context)
        policy = select(policy_inputs(transitions, stats))
        inner, info = model.update(key, state.inner, expert_rows(demos, stats), policy)
        return state._replace(inner=inner), info

    return RewardModel(init, begin, reward, update, model.learns)


def features(inputs: Inputs) -> jax.Array:
    """(s, a, δ) side by side, (…, F); what is hidden has width 0."""
    return jnp.concatenate([inputs.obs, inputs.action, inputs.proxy], axis=-1)
