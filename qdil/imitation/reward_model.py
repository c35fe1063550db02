"""Reward models as values of pure functions, the inputs that they read, and the transformations that make variants.

An author writes an ``InputModel``, a function of normalised inputs. ``over_inputs`` makes it a ``RewardModel``, which
reads transitions, and hides the inputs that a variant must not see. ``reward_model`` builds the model of a
configuration. A reward model is also known as a reward function or, in GAIL, as part of the discriminator.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdil.config import Config
from qdil.methods import parse_method
from qdil.rl.normalise import normalise_obs
from qdil.robots.environment import Environment
from qdil.types import Normaliser, RewardContext, RewardMemory, RewardState, Transitions

Info = dict[str, jax.Array]  # measurements () of one round of learning, by name


class Inputs(NamedTuple):
    """What a learned reward may read of a step; expert and policy batches have the same form.

    The same type also holds the four widths as integers, where a model is built.
    """

    obs: Any  # (…, O) s_t, normalised
    action: Any  # (…, A) a_t in [-1, 1]; width 0 for observation-only models (-obs)
    next_obs: Any  # (…, O) s_{t+1}, normalised
    proxy: Any  # (…, k) δ(s_t); width 0 without measure conditioning


class Demonstrations(NamedTuple):
    """Expert steps of all demonstrated episodes, one row per step (N); a row's fields belong to the same step t."""

    obs: jax.Array  # (N, O) s_t as the robot reported it, not normalised
    action: jax.Array  # (N, A) a_t; width 0 where the demonstrator's actions are not known
    next_obs: jax.Array  # (N, O) s_{t+1}, not normalised
    proxy: jax.Array  # (N, k) δ(s_t)


def no_memory(state: RewardState, num_envs: int) -> RewardMemory:
    """``begin`` of a model that remembers nothing within episodes: no memory."""
    return ()


def learns_nothing(key: jax.Array, state: RewardState, *data: Any) -> tuple[RewardState, Info]:
    """``update`` of a model that learns before the run or not at all: the same state, no measurements."""
    return state, {}


class RewardModel(NamedTuple):
    """r(s, a, s', δ) as a value of four pure functions; state and memory are trees of arrays.

    ``init(key, demonstrations) -> state``: before the run; demonstrations are None for a model that does not imitate;
    ``reward(state, memory, context, transitions) -> (memory, r)``: r (T, E) for transitions (T, E), without bonus;
    ``begin(state, num_envs) -> memory``: what the model remembers within episodes, axis (E) in front; () for most;
    ``update(key, state, context, demonstrations, transitions) -> (state, info)``: one round of learning.
    """

    init: Callable[[jax.Array, Demonstrations | None], RewardState]
    reward: Callable[[RewardState, RewardMemory, RewardContext, Transitions], tuple[RewardMemory, jax.Array]]
    begin: Callable[[RewardState, int], RewardMemory] = no_memory
    update: Callable[..., tuple[RewardState, Info]] = learns_nothing

    @property
    def learns(self) -> bool:
        """Whether the model learns during the run; otherwise ``update`` needs no data."""
        return self.update is not learns_nothing


class InputModel(NamedTuple):
    """A reward model as its author writes it: over ``Inputs`` alone. ``over_inputs`` makes it a ``RewardModel``.

    ``init(key, expert) -> state``: before the run, from the demonstrations' inputs (N);
    ``reward(state, memory, inputs, ended) -> (memory, r)``: r (T, E) for inputs (T, E); ``ended`` (T, E) is True on the
    last step of an episode;
    ``begin(state, num_envs) -> memory``: as in ``RewardModel``;
    ``update(key, state, expert, policy) -> (state, info)``: one round from expert inputs (N), policy inputs (T, E).
    """

    init: Callable[[jax.Array, Inputs], RewardState]
    reward: Callable[[RewardState, RewardMemory, Inputs, jax.Array], tuple[RewardMemory, jax.Array]]
    begin: Callable[[RewardState, int], RewardMemory] = no_memory
    update: Callable[..., tuple[RewardState, Info]] = learns_nothing
    # The mean and spread that normalise both expert and policy observations. "running": the policy's, which change
    # during the run. "expert": the demonstrations', which do not; for models that learn before the run or not at all.
    normaliser: str = "running"


Select = Callable[[Inputs], Inputs]


def hide(actions: bool, proxy: bool) -> Select:
    """A function that narrows hidden inputs to width 0: ``actions`` (eq. 20), ``proxy`` (no measure conditioning)."""

    def select(inputs: Inputs) -> Inputs:
        action = inputs.action[..., :0] if actions else inputs.action
        return inputs._replace(action=action, proxy=inputs.proxy[..., :0] if proxy else inputs.proxy)

    return select


def policy_inputs(transitions: Transitions, normaliser: Normaliser) -> Inputs:
    """Inputs (T, E) of policy steps."""
    obs, next_obs = normalise_obs(normaliser, transitions.obs), normalise_obs(normaliser, transitions.next_obs)
    return Inputs(obs, transitions.action, next_obs, transitions.proxy)


def expert_inputs(demos: Demonstrations, normaliser: Normaliser) -> Inputs:
    """Inputs (N) of expert steps, by the same normaliser as policy steps."""
    obs, next_obs = normalise_obs(normaliser, demos.obs), normalise_obs(normaliser, demos.next_obs)
    return Inputs(obs, demos.action, next_obs, demos.proxy)


def expert_normaliser(demos: Demonstrations) -> Normaliser:
    """The mean and spread (O,) of the demonstrations; the spread of an observation that never changes there is 1."""
    spread = jnp.std(demos.obs, axis=0)
    return Normaliser(jnp.mean(demos.obs, axis=0), jnp.where(spread < 1e-3, 1.0, spread))


class _State(NamedTuple):
    expert: Normaliser  # of the demonstrations
    inner: RewardState  # the state of the ``InputModel``


def over_inputs(model: InputModel, select: Select, raw_expert: bool = False) -> RewardModel:
    """A ``RewardModel`` from an ``InputModel``; ``select`` hides what the variant must not see, on both sides.

    ``raw_expert`` leaves expert observations as they were recorded, while policy observations are normalised: a mistake
    of the authors' released program, kept so that it can be measured (``expert_obs=raw``).
    """

    def expert_rows(demos: Demonstrations, normaliser: Normaliser) -> Inputs:
        # Raw rows bypass the normaliser. One of mean 0 and spread 1 would clip them.
        recorded = Inputs(demos.obs, demos.action, demos.next_obs, demos.proxy)
        return select(recorded if raw_expert else expert_inputs(demos, normaliser))

    def normaliser_of(state: _State, context: RewardContext) -> Normaliser:
        return state.expert if model.normaliser == "expert" else context.normaliser

    def init(key: jax.Array, demos: Demonstrations | None) -> _State:
        assert demos is not None, "a model that imitates needs demonstrations"
        normaliser = expert_normaliser(demos)
        return _State(normaliser, model.init(key, expert_rows(demos, normaliser)))

    def begin(state: _State, num_envs: int) -> RewardMemory:
        return model.begin(state.inner, num_envs)

    def reward(
        state: _State, memory: RewardMemory, context: RewardContext, transitions: Transitions
    ) -> tuple[RewardMemory, jax.Array]:
        inputs = select(policy_inputs(transitions, normaliser_of(state, context)))
        return model.reward(state.inner, memory, inputs, transitions.ended)

    def update(
        key: jax.Array, state: _State, context: RewardContext, demos: Demonstrations, transitions: Transitions
    ) -> tuple[_State, Info]:
        normaliser = normaliser_of(state, context)
        policy = select(policy_inputs(transitions, normaliser))
        inner, info = model.update(key, state.inner, expert_rows(demos, normaliser), policy)
        return state._replace(inner=inner), info

    learns = model.update is not learns_nothing
    return RewardModel(init, reward, begin, update if learns else learns_nothing)


def reward_model(config: Config, env: Environment) -> RewardModel:
    """The reward model of ``config.method`` for a robot, without the measure bonus (``qdil.imitation.fitness``).

    Raises ConfigError for an unknown method.
    """
    method = parse_method(config.method)
    if not method.base.imitates:
        return method.base.build(config)
    select = hide(actions=method.obs_only, proxy=not method.conditioned)
    widths = Inputs(
        env.obs_size,
        0 if method.obs_only else env.action_size,
        env.obs_size,
        len(env.measure_names) if method.conditioned else 0,
    )
    return over_inputs(method.base.build(config, widths), select, raw_expert=config.demos.expert_obs == "raw")


def features(inputs: Inputs) -> jax.Array:
    """(s, a, δ) joined into one vector, (…, F); hidden inputs have width 0."""
    return jnp.concatenate([inputs.obs, inputs.action, inputs.proxy], axis=-1)
