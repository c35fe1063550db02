"""PWIL (Dadashi et al., 2021; eqs. 11-15): a reward from a greedy coupling of the episode with the demonstrations.

Every expert row has mass 1/N, every step of an episode mass 1/T (T the time limit). A step is coupled with the nearest
expert rows that have mass left, nearest first, until its own is spent (eqs. 13, 14); what it takes is gone for the
rest of the episode, and all of it is back in the next. With c the cost of the step's coupling (distance times mass),
r = α exp(−β T c / √F) ≥ 0, F the number of inputs, α = β = 5: the original's decreasing f of eq. 15.

Distances are Euclidean over (s, a, δ), each input divided by its spread over the demonstrations, as in the original.
Masses are counted in units of 1/(N T), so that they are integers and no rounding can lose any.
Departure from the authors' released program: the coupling is carried through the episode (``pwil_coupling=step``
restores all mass at every step, as there, which makes the reward a plain distance to the nearest rows).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdil.config import Config
from qdil.imitation.reward_model import InputModel, Inputs, features


class PwilState(NamedTuple):
    """The expert's rows, in the units in which distances are measured."""

    atoms: jax.Array  # (N, F)
    spread: jax.Array  # (F,) what inputs are divided by


def distances(x: jax.Array, atoms: jax.Array) -> jax.Array:
    """Euclidean distances (E, N) of rows (E, F) and (N, F)."""
    products = jnp.matmul(x, atoms.T, precision="highest")
    squares = jnp.sum(jnp.square(x), axis=-1)[:, None] + jnp.sum(jnp.square(atoms), axis=-1) - 2.0 * products
    return jnp.sqrt(jnp.maximum(squares, 0.0))


def couple(distance: jax.Array, mass: jax.Array, amount: int) -> tuple[jax.Array, jax.Array]:
    """Greedy couplings of one step of every robot (eqs. 13, 14): ``distance`` (E, N), ``mass`` (E, N) left, integer.

    Takes ``amount`` of mass from the nearest rows that have some. Returns the mass left and the cost (E,), distance
    times mass taken; if less mass is left than asked for, all of it is taken.
    """
    robots = jnp.arange(len(distance))

    def unspent(carry):
        mass, need, _ = carry
        return jnp.any((need > 0) & jnp.any(mass > 0, axis=1))

    def take_nearest(carry):
        mass, need, cost = carry
        nearest = jnp.argmin(jnp.where(mass > 0, distance, jnp.inf), axis=1)
        taken = jnp.minimum(need, mass[robots, nearest])
        cost = cost + taken * distance[robots, nearest]
        return mass.at[robots, nearest].add(-taken), need - taken, cost

    need = jnp.full(len(distance), amount, jnp.int32)
    mass, _, cost = jax.lax.while_loop(unspent, take_nearest, (mass, need, jnp.zeros(len(distance))))
    return mass, cost


def pwil(config: Config, widths: Inputs) -> InputModel:
    """Rewards f(c) ∈ (0, α]."""
    steps, size = config.simulation.episode_length, widths.obs + widths.action + widths.proxy

    def init(key: jax.Array, expert: Inputs) -> PwilState:
        x = features(expert)
        spread = jnp.std(x, axis=0)
        spread = jnp.where(spread < 1e-3, 1.0, spread)  # what never moves in the demonstrations counts as it is
        return PwilState(x / spread, spread)

    def begin(state: PwilState, num_envs: int) -> jax.Array:
        """Mass left (E, N): each row holds T units of 1/(N T)."""
        return jnp.full((num_envs, len(state.atoms)), steps, jnp.int32)

    def reward(state: PwilState, mass: jax.Array, inputs: Inputs, ended: jax.Array) -> tuple[Any, jax.Array]:
        count = len(state.atoms)

        def one_step(mass: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            x, ended = now
            left, cost = couple(distances(x, state.atoms), mass, count)
            restored = ended[:, None] if config.reward.pwil_coupling == "episode" else jnp.ones_like(ended)[:, None]
            return jnp.where(restored, steps, left), cost / (count * steps)

        mass, cost = jax.lax.scan(one_step, mass, (features(inputs) / state.spread, ended))
        return mass, config.reward.pwil_alpha * jnp.exp(-config.reward.pwil_beta * steps * cost / jnp.sqrt(size))

    return InputModel(init, reward, begin, normaliser="expert")
