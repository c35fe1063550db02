"""Every setting of a run, in typed groups, and the ways to reach a setting by its flat name.

A compiled program depends on the groups that it receives and on nothing else, so every recorded setting has its effect.
Users know settings by flat names: ``--set gamma=0.99`` on the command line, ``"gamma"`` in ``config.json`` and
``make_config(..., gamma=0.99)`` all mean ``config.ppo.gamma``.
"""

import dataclasses
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BeforeValidator, ConfigDict, Field
from pydantic.dataclasses import dataclass
from pydantic.fields import FieldInfo

IDENTITY = ("env", "method", "budget", "seed")  # they name a run; each has its own option instead of --set


def _as_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value  # JSON has no tuples


AtLeastOne = Annotated[int, Field(ge=1)]
Count = Annotated[int, Field(ge=0)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]
Widths = Annotated[tuple[AtLeastOne, ...], Field(min_length=1), BeforeValidator(_as_tuple)]

STRICT = ConfigDict(strict=True)  # the text "7" is not an integer, and True is not a number


def setting(default: Any, what: str) -> Any:
    """A setting and its default for the ``full`` budget; ``what`` gives meaning, unit and the default's source."""
    return Field(default, description=what)


@dataclass(frozen=True, config=STRICT)
class Simulation:
    """The robot's physics and the length of an episode."""

    backend: str = setting("spring", "Brax backend (paper: the ancestor of spring)")
    episode_length: AtLeastOne = setting(1000, "time limit, steps (paper)")


@dataclass(frozen=True, config=STRICT)
class PPGA:
    """The search for an archive (Algorithm 1)."""

    iterations: AtLeastOne = setting(2000, "QD iterations N_Q (paper, Fig. 5)")
    warmup_updates: Count = setting(
        0, "plain PPO updates on the method's own reward before iteration 1 (ours; 0 in the paper)"
    )
    gradient_updates: AtLeastOne = setting(
        10, "N1, VPPO updates before each Jacobian (authors; the paper's Table 4 is not in the copy at hand)"
    )
    walk_updates: AtLeastOne = setting(
        10, "N2, VPPO updates of the walk (authors; the paper's Table 4 is not in the copy at hand)"
    )
    candidates: AtLeastOne = setting(300, "λ, branched policies an iteration (authors)")
    cells: AtLeastOne = setting(50, "grid cells per measure (paper: 50x50)")
    sigma0: Positive = setting(1.0, "xNES initial step σ_g, in unit-length gradient rows (authors: 1; humanoid 0.5)")
    archive_learning_rate: Share = setting(0.5, "α of the soft archive, 0 < α ≤ 1 (authors: 0.5; humanoid 0.1)")
    threshold_min: Number = setting(200.0, "soft archive's threshold of an empty cell, return units (authors)")
    selection: Literal["learned", "true"] = setting(
        "learned", "the return that archives compare: learned (Definition 1) or true (released program)"
    )
    walk_weights: Literal["xnes", "fitness"] = setting(
        "xnes", "the walk's objective: weighted by xnes (Algorithm 1) or fitness alone (released program)"
    )
    fitness_coefficient: Literal["folded", "signed"] = setting(
        "folded", "c_0 of a candidate and the walk: |c_0|, from which xNES learns (section 4.1), or signed (released)"
    )
    xnes_center: Literal["zero", "random"] = setting(
        "zero", "xNES starts at 0 (Algorithm 1), or at a point drawn from [0,2] × [-2,2]^k (released program)"
    )
    rejects: Literal["zero", "difference"] = setting(
        "zero", "Δ of a candidate that the soft archive rejects: 0 (Algorithm 2) or f - t_e < 0 (released program)"
    )
    restart_order: Literal["last", "before-walk"] = setting(
        "last", "a restart ends the iteration (Algorithm 1) or comes before its walk (released program)"
    )
    restart_statistics: Literal["own", "other"] = setting(
        "own", "observation statistics after a restart: the elite's own, or another elite's (released program)"
    )
    restart_samples: Literal["fresh", "same"] = setting(
        "fresh", "random numbers of a restarted xNES: fresh, or those of its first start again (released program)"
    )
    restart_rounds: Count = setting(
        0, "rollouts of a restart's elite that the reward model learns from before it scores anything (ours)"
    )


@dataclass(frozen=True, config=STRICT)
class Evaluation:
    """How candidates are scored over whole episodes."""

    episodes: AtLeastOne = setting(10, "whole episodes per candidate (authors)")
    rescore_episodes: AtLeastOne = setting(
        20, "fresh episodes per elite of the finished archive, at least; a multiple of episodes is taken (ours)"
    )
    sample_actions: bool = setting(
        True, "candidates and demonstrators sample actions from π_θ (true) or take its mean (false)"
    )
    eval_chunk_steps: AtLeastOne = setting(
        50, "steps of a chunk, after which unfinished episodes replace finished ones in the batch"
    )
    eval_chunks_per_sync: AtLeastOne = setting(
        1, "chunks run before the host checks whether any episode is unfinished; memory grows with it"
    )
    eval_batch_size: AtLeastOne = setting(1000, "the most unfinished episodes that a device simulates together")


@dataclass(frozen=True, config=STRICT)
class PPO:
    """The policy, its critic, and how VPPO trains them."""

    actor_hidden: Widths = setting((128, 128), "tanh layers of the policy (authors)")
    critic_hidden: Widths = setting((256, 256), "tanh layers of the critic (authors)")
    initial_std: Positive = setting(
        1.0, "initial standard deviation of the action distribution, action units (authors)"
    )
    num_envs: AtLeastOne = setting(3000, "robots simulated side by side (authors)")
    rollout_length: AtLeastOne = setting(128, "steps per robot and VPPO update (authors)")
    minibatches: AtLeastOne = setting(8, "minibatches per epoch (authors)")
    epochs: AtLeastOne = setting(4, "passes over a rollout (authors)")
    gamma: Share = setting(0.99, "discount γ (authors)")
    gae_lambda: Share = setting(0.95, "λ of GAE (authors)")
    clip: Positive = setting(0.2, "PPO's ratio and value clip (authors)")
    value_coef: NotNegative = setting(2.0, "weight of the value loss (authors)")
    entropy_coef: NotNegative = setting(0.0, "weight of the entropy bonus (authors)")
    max_grad_norm: Positive = setting(1.0, "largest norm of a gradient (authors)")
    learning_rate: Positive = setting(1e-3, "Adam's step size (authors: 1e-3; humanoid 3e-4)")
    target_kl: Positive = setting(
        0.008, "the most KL divergence, nats; a copy that exceeds it stops its epochs (authors)"
    )
    copies_scaled: Literal["each", "together"] = setting(
        "each", "advantages normalised and gradients clipped per copy, or over all copies (released program)"
    )


@dataclass(frozen=True, config=STRICT)
class Demos:
    """The demonstrations that imitation learns from."""

    demo_episodes: AtLeastOne = setting(4, "demonstrations (paper, section 5.2)")
    demo_attempts: AtLeastOne = setting(
        16, "episodes simulated per demonstrator, of which the one nearest to its measures is recorded (ours)"
    )
    expert_seed: Count = setting(
        0, "seed of the expert that demonstrates; 0: the run's own seed (ours; in the paper, all runs have one expert)"
    )
    expert_alignment: Literal["aligned", "shifted"] = setting(
        "aligned", "aligned: (s_t, a_t); shifted: (s_{t+1+j}, a_t) with j = 0-19 per episode (released program)"
    )
    expert_obs: Literal["normalised", "raw"] = setting(
        "normalised", "expert observations: normalised as the policy's are, or raw (released program)"
    )
    expert_batches: Literal["random", "first"] = setting(
        "random", "expert rows of a learning step: drawn at random, or always every 20th row (released program)"
    )


@dataclass(frozen=True, config=STRICT)
class Bonus:
    """The measure bonus (eq. 2)."""

    bonus_scope: Literal["episode", "rollout", "step"] = setting(
        "episode",
        "what the bonus reads: the measure of a step's episode, that of its rollout (released program), or how often "
        "the step's own δ was visited (WQDIL)",
    )
    bonus_p: NotNegative = setting(0.5, "p of eq. 2, reward per step (paper)")
    bonus_q: NotNegative = setting(0.5, "q of eq. 2, reward per step (paper; its own study prefers 1)")
    bonus_in_fitness: bool = setting(False, "add the bonus to the fitness that fills the archive, too")


@dataclass(frozen=True, config=STRICT)
class Reward:
    """The reward models. Each reads the settings that bear its name and those of ``reward_``."""

    reward_hidden: Widths = setting(
        (100, 100), "tanh layers of reward networks (authors; the paper's Table 5 is not in the copy at hand)"
    )
    reward_learning_rate: Positive = setting(
        3e-4, "Adam's step size (authors; the paper's Table 5 is not in the copy at hand)"
    )
    reward_steps: AtLeastOne = setting(100, "discriminator steps per QD iteration (ours)")
    reward_schedule: Literal["iteration", "update"] = setting(
        "iteration", "a reward model learns after the walk (Algorithm 1) or after every VPPO update (released program)"
    )
    replay_share: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = setting(
        0.0, "share of a store of candidates' steps renewed an iteration; half of policy rows are its; 0: none (paper)"
    )
    reward_batch: AtLeastOne = setting(512, "expert rows, and as many policy rows, per discriminator step (ours)")
    gradient_penalty: NotNegative = setting(
        10.0, "weight λ of GAIL's and VAIL's gradient penalty (authors; the paper does not mention it)"
    )
    penalty_mixing: Literal["sample", "element"] = setting(
        "sample", "one mixing weight of the penalty per sample (Gulrajani et al.) or per element (released program)"
    )
    vail_beta: Literal["adaptive", "fixed"] = setting(
        "adaptive", "adaptive: dual ascent and a sampled latent (paper); fixed: 1 and the mean (released program)"
    )
    vail_information: NotNegative = setting(
        0.5, "I_c, the most information that VAIL's bottleneck should let through, nats (Peng et al., 2018)"
    )
    vail_beta_rate: Positive = setting(1e-5, "dual ascent's step size (Peng et al., 2018)")
    vail_latent: AtLeastOne = setting(128, "size of VAIL's latent z (Peng et al., 2018)")
    vail_encoder: Literal["linear", "squashed"] = setting(
        "linear", "VAIL's μ and log σ: linear, or halves of the last hidden layer, σ < 1 (released program)"
    )
    vail_visits: bool = setting(
        False, "add a bonus for rarely visited δ to measure-conditioned VAIL's reward (released program)"
    )
    giril_steps: AtLeastOne = setting(5000, "steps of GIRIL's training before the run (ours)")
    giril_learning_rate: Positive = setting(3e-4, "Adam's step size for GIRIL (ours; as the other reward models')")
    giril_action_weight: NotNegative = setting(1.0, "α of eq. 9 (ours; the paper's Table 7 is not in the copy at hand)")
    pwil_alpha: Positive = setting(
        5.0, "α of PWIL: the largest reward per step (Dadashi et al., 2021; released program: 1)"
    )
    pwil_beta: Positive = setting(
        5.0, "β of PWIL: how fast the reward falls with the cost (Dadashi et al., 2021; released program: 1)"
    )
    pwil_coupling: Literal["episode", "step"] = setting(
        "episode", "expert mass is used up over an episode, or restored at each step (released program)"
    )
    diffail_steps: AtLeastOne = setting(
        10, "T, noise levels of DiffAIL's diffusion (Wang et al., 2024; released program: 100)"
    )
    diffail_levels: AtLeastOne = setting(
        10, "the most noise levels, evenly spread over T, that DiffAIL's reward averages over (ours; all elsewhere)"
    )
    diffail_penalty: NotNegative = setting(
        0.1, "weight of DiffAIL's gradient penalty (Wang et al., 2024: 0.001 to 0.5 by robot; released program: 10)"
    )
    diffail_loss: Literal["probability", "logit"] = setting(
        "probability", "the cross entropy takes DiffAIL's D for a probability, or for a logit (released program)"
    )
    diffail_reward: Literal["row", "element"] = setting(
        "row", "D in DiffAIL's reward: exp(-error) of the whole row, or its mean over the elements (released program)"
    )


@dataclass(frozen=True, config=STRICT)
class Config:
    """All settings of a run. Defaults are the ``full`` budget: the paper's and its authors' settings."""

    env: str
    method: str
    budget: str
    seed: Count = 1
    protocol: Literal["paper", "released", "improved"] = setting(
        "paper", "a named set of choices: paper, released (the authors' program) or improved (ours)"
    )
    devices: Count = setting(0, "local devices to shard over; 0: as many as divide the counts")
    simulation: Simulation = Simulation()
    ppga: PPGA = PPGA()
    evaluation: Evaluation = Evaluation()
    ppo: PPO = PPO()
    demos: Demos = Demos()
    bonus: Bonus = Bonus()
    reward: Reward = Reward()


GROUPS = ("simulation", "ppga", "evaluation", "ppo", "demos", "bonus", "reward")
GROUP_TYPES: dict[str, type] = {field.name: field.type for field in dataclasses.fields(Config) if field.name in GROUPS}  # type: ignore[misc]
# The group of every setting by its flat name; None for the settings of ``Config`` itself.
GROUP_OF: dict[str, str | None] = {f.name: None for f in dataclasses.fields(Config) if f.name not in GROUPS} | {
    field.name: group for group, kind in GROUP_TYPES.items() for field in dataclasses.fields(kind)
}

# Settings that change the speed of a run but not its results.
SPEED_ONLY = ("eval_chunk_steps", "eval_chunks_per_sync", "eval_batch_size", "devices")


def flat(config: Config) -> dict[str, Any]:
    """Every setting by its flat name, in the order of the groups."""
    return {name: value_of(config, name) for name in GROUP_OF}


def value_of(config: Config, name: str) -> Any:
    """The value of the setting with this flat name. Raises KeyError if there is none."""
    group = GROUP_OF[name]
    return getattr(config if group is None else getattr(config, group), name)


def changeable() -> dict[str, FieldInfo]:
    """Every setting that ``--set`` changes, by flat name: all but ``IDENTITY``."""
    found: dict[str, FieldInfo] = {}
    for holder in (Config, *GROUP_TYPES.values()):
        found |= holder.__pydantic_fields__  # type: ignore[attr-defined]
    return {name: field for name, field in found.items() if name not in (*IDENTITY, *GROUPS)}


def type_of(name: str) -> Any:
    """The type of a setting without its limits: int, float, bool, str, a Literal, or tuple[...]."""
    if name in IDENTITY:
        return int if name == "seed" else str
    return changeable()[name].annotation


def choices(name: str) -> tuple[str, ...]:
    """The values of a setting that is one of a few words; empty for other settings and unknown names."""
    kind = type_of(name) if name in GROUP_OF else None
    return get_args(kind) if get_origin(kind) is Literal else ()


def descriptions() -> dict[str, str]:
    """The meaning of every setting by flat name, with its unit and the source of its ``full`` default."""
    return {name: field.description or "" for name, field in changeable().items()}
