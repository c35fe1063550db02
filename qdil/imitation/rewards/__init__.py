"""The paper's reward models, one file each; importing this registers them, in the order of its Table 1."""

from qdil.imitation.rewards import plain, gail, vail, airl, giril, pwil, maxent  # noqa: F401, I001 (the order matters)
