"""PWIL (eqs. 11-15): the reward is high where a step is close to demonstrated steps that are not used up yet.

Each of the N expert rows begins an episode with mass 1/N, and each step of the policy has mass 1/T, T the time limit.
A step takes its mass from the nearest expert rows that have some left (eqs. 13, 14). Mass that was taken is not
available again until the episode ends. The cost c of a step is the sum of distance times mass taken, and
r = α exp(−β T c / √F) ∈ (0, α] with F the number of inputs and α = β = 5: the decreasing f of eq. 15, from Dadashi et
al. The sum of the costs bounds the Wasserstein distance between the episode and the demonstrations from above.

Distances are Euclidean over (s, a, δ), each input divided by its spread over the demonstrations, as in Dadashi et al.
Masses are integers, in units of 1/(N T), so that rounding loses none.
Departure from the authors' released program: mass stays taken for the rest of the episode. ``pwil_coupling=step``
restores it after every step, as the program does; the reward then depends only on the distance to the nearest rows.

Reference
- R. Dadashi, L. Hussenot, M. Geist, O. Pietquin, 2020. Primal Wasserstein Imitation Learning. arXiv:2006.04678.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdil.config import Config
from qdil.imitation.reward_model import InputModel, Inputs, features


class PwilState(NamedTuple):
    """The expert's features in units of their spread. They are constant during a run."""

    atoms: jax.Array  # (N, F)
    spread: jax.Array  # (F,) the divisor of each feature


def distances(x: jax.Array, atoms: jax.Array) -> jax.Array:
    """Euclidean distances (E, N) between each of ``x`` (E, F) and each of ``atoms`` (N, F)."""
    products = jnp.matmul(x, atoms.T, precision="highest")
    squares = jnp.sum(jnp.square(x), axis=-1)[:, None] + jnp.sum(jnp.square(atoms), axis=-1) - 2.0 * products
    return jnp.sqrt(jnp.maximum(squares, 0.0))


def couple(distance: jax.Array, mass: jax.Array, amount: int) -> tuple[jax.Array, jax.Array]:
    """Couple one step of each of E robots with N expert rows, greedily (eqs. 13, 14).

    ``distance`` (E, N); ``mass`` (E, N) int32 is the mass left in each row. Every robot takes ``amount`` of mass from
    its nearest rows that have some; if less than ``amount`` is left, it takes all. Returns the remaining mass (E, N)
    and the cost (E,): the sum of distance times mass taken.
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
    """The reward f(c) ∈ (0, α] of eq. 15."""
    steps, size = config.simulation.episode_length, widths.obs + widths.action + widths.proxy

    def init(key: jax.Array, expert: Inputs) -> PwilState:
        x = features(expert)
        spread = jnp.std(x, axis=0)
        spread = jnp.where(spread < 1e-3, 1.0, spread)  # features that are constant over the rows are not divided
        return PwilState(x / spread, spread)

    def begin(state: PwilState, num_envs: int) -> jax.Array:
        """Mass (E, N) before an episode: each row holds T units of 1/(N T)."""
        return jnp.full((num_envs, len(state.atoms)), steps, jnp.int32)

    def reward(state: PwilState, mass: jax.Array, inputs: Inputs, ended: jax.Array) -> tuple[Any, jax.Array]:
        count = len(state.atoms)

        def one_step(mass: jax.Array, step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            x, ended = step
            left, cost = couple(distances(x, state.atoms), mass, count)
            restored = ended[:, None] if config.reward.pwil_coupling == "episode" else jnp.ones_like(ended)[:, None]
            return jnp.where(restored, steps, left), cost / (count * steps)

        mass, cost = jax.lax.scan(one_step, mass, (features(inputs) / state.spread, ended))
        return mass, config.reward.pwil_alpha * jnp.exp(-config.reward.pwil_beta * steps * cost / jnp.sqrt(size))

    return InputModel(init, reward, begin, normaliser="expert")
