"""Protocols: named sets of choices where the paper can be read in several ways, or could be improved on.

Every choice is a setting of its own, and its description says what each value means.
"""

from typing import Any

# The choices of the authors' released program where they differ from the paper's (p and q: from its shipped runners).
RELEASED: dict[str, Any] = {
    # What fills the archive, and where the search goes
    "selection": "true",
    "walk_weights": "fitness",
    "fitness_coefficient": "signed",
    "xnes_center": "random",
    "rejects": "difference",
    "restart_order": "before-walk",
    "restart_statistics": "other",
    "restart_samples": "same",
    "copies_scaled": "together",
    # The measure bonus
    "bonus_scope": "rollout",
    "bonus_p": 0.0,
    "bonus_q": 2.0,
    # What reward models learn, and from what
    "expert_alignment": "shifted",
    "expert_obs": "raw",
    "expert_batches": "first",
    "reward_schedule": "update",
    "reward_steps": 1,
    "penalty_mixing": "element",
    "vail_beta": "fixed",
    "vail_encoder": "squashed",
    "vail_visits": True,
    "pwil_coupling": "step",
    "pwil_alpha": 1.0,
    "pwil_beta": 1.0,
    "diffail_steps": 100,
    "diffail_penalty": 10.0,
    "diffail_loss": "logit",
    "diffail_reward": "element",
}

# Imitation that never reads the true reward (ours). The reward model learns from the steps of recent candidates beside
# those of the present policy, so that its reward changes more slowly (docs/notes/improved.md).
IMPROVED: dict[str, Any] = {"replay_share": 0.05}

# The settings in which each protocol differs from the paper's.
PROTOCOLS: dict[str, dict[str, Any]] = {"paper": {}, "released": RELEASED, "improved": IMPROVED}
