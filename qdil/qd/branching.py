"""Branching (eq. 16; Algorithm 1, lines 5-10): candidates along combinations of unit-length gradients of θ_μ."""

import jax
import jax.numpy as jnp

from qdil.rl import networks
from qdil.rl.evaluate import Policies
from qdil.types import Normaliser, Params

SHORTEST = 1e-12  # a difference shorter than this is no direction; its row of the Jacobian is zero, not NaN


def branch(
    policy: Params, normaliser: Normaliser, theta: jax.Array, coefficients: jax.Array
) -> tuple[Policies, jax.Array]:
    """The candidates θ_μ + c_0 ∇f + Σ_j c_j ∇m_j (eq. 16) and the Jacobian (1+k, P) of their directions.

    ``policy`` is θ_μ; ``theta`` (1+k, P) are its copies after N1 updates, the first on the fitness reward, copy j on
    δ_j. A copy's difference to θ_μ, scaled to unit length, is its row of the Jacobian. ``coefficients`` (λ, 1+k) are
    xNES' samples; unless they are signed, their c_0 ≥ 0, since fitness is never minimised (section 4.1). Every
    candidate keeps a copy of the search's ``normaliser``.
    """
    theta_mu = networks.flatten(policy)
    difference = theta - theta_mu
    jacobian = difference / jnp.maximum(jnp.linalg.norm(difference, axis=1, keepdims=True), SHORTEST)
    candidates = theta_mu + coefficients @ jacobian
    shape = (len(candidates), normaliser.mean.shape[0])
    mean, std = (jnp.broadcast_to(x, shape) for x in normaliser)
    return Policies(candidates, mean, std), jacobian
