"""What a reward model is: a value of pure functions; over what inputs; and the transformations that make variants."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdil.config import Config
from qdil.methods import parse_method
from qdil.rl.normalise import normalise_obs
from qdil.robots.environment import Environment
from qdil.types import Normaliser, RewardContext, RewardMemory, RewardState, Transitions

Info = dict[str, jax.Array]  # measurements of a round of learning, by name


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


def no_memory(state: RewardState, num_envs: int) -> RewardMemory:
    """The memory of a model that remembers nothing within episodes."""
    return ()


def learns_nothing(key: jax.Array, state: RewardState, *data: Any) -> tuple[RewardState, Info]:
    """The update of a model that learns before the run or not at all."""
    return state, {}


class RewardModel(NamedTuple):
    """r(s, a, s', δ) as a value. State and memory are pytrees of arrays; every function is pure.

    ``init(key, demonstrations) -> state``;
    ``reward(state, memory, context, transitions) -> (memory, r)``, r (T, E) for transitions (T, E), without bonus;
    ``begin(state, num_envs) -> memory``, what the model remembers within episodes (nothing for most);
    ``update(key, state, context, demonstrations, transitions) -> (state, info)``, one round of learning.
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

    ``init(key, expert) -> state`` with the demonstrations' rows (N);
    ``reward(state, memory, inputs, ended) -> (memory, r)``, inputs (T, E), ``ended`` (T, E) True on an episode's last
    step;
    ``begin(state, num_envs) -> memory``;
    ``update(key, state, expert, policy) -> (state, info)`` with expert rows (N) and policy steps (T, E).
    """

    init: Callable[[jax.Array, Inputs], RewardState]
    reward: Callable[[RewardState, RewardMemory, Inputs, jax.Array], tuple[RewardMemory, jax.Array]]
    begin: Callable[[RewardState, int], RewardMemory] = no_memory
    update: Callable[..., tuple[RewardState, Info]] = learns_nothing
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


def policy_inputs(transitions: Transitions, normaliser: Normaliser) -> Inputs:
    """Inputs of policy steps."""
    obs, next_obs = normalise_obs(normaliser, transitions.obs), normalise_obs(normaliser, transitions.next_obs)
    return Inputs(obs, transitions.action, next_obs, transitions.proxy)


def expert_inputs(demos: Demonstrations, normaliser: Normaliser) -> Inputs:
    """Inputs of expert steps, through the same normaliser as policy steps."""
    obs, next_obs = normalise_obs(normaliser, demos.obs), normalise_obs(normaliser, demos.next_obs)
    return Inputs(obs, demos.action, next_obs, demos.proxy)


def expert_normaliser(demos: Demonstrations) -> Normaliser:
    """The demonstrations' own mean and spread; an observation that never changes there keeps a spread of 1."""
    spread = jnp.std(demos.obs, axis=0)
    return Normaliser(jnp.mean(demos.obs, axis=0), jnp.where(spread < 1e-3, 1.0, spread))


class _State(NamedTuple):
    expert: Normaliser
    inner: RewardState


def over_inputs(model: InputModel, select: Select, raw_expert: bool = False) -> RewardModel:
    """A ``RewardModel`` from one over inputs; ``select`` is what both expert and policy batches may show it.

    ``raw_expert`` leaves expert observations as they were recorded, against normalised policy observations: a mistake
    of the authors' released program (``expert_obs=raw``), for whoever wants to measure it.
    """

    def expert_rows(demos: Demonstrations, normaliser: Normaliser) -> Inputs:
        # Inputs of the recorded numbers themselves, which the normaliser would clip.
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
    """The reward model of ``config.method`` for a robot, without the measure bonus (``qdil.imitation.fitness``)."""
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
    """(s, a, δ) side by side, (…, F); what is hidden has width 0."""
    return jnp.concatenate([inputs.obs, inputs.action, inputs.proxy], axis=-1)
