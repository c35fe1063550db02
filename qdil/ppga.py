"""PPGA with MConbo-IRL: Algorithm 1 of the paper, one QD iteration a page."""

import copy
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdil.config import Config
from qdil.devices.hosts import to_host
from qdil.engine.engine import Engine, State, Trained
from qdil.imitation.bonus import is_empty
from qdil.imitation.demos import check_fits
from qdil.imitation.reward_model import Demonstrations
from qdil.methods import parse_method
from qdil.qd import archive
from qdil.qd.archive import Archives, Candidates
from qdil.qd.xnes import XNES, draw_center
from qdil.rl import networks
from qdil.rl.evaluate import Policies, Scores
from qdil.types import Transitions

# Fields of ``Candidates`` that ``reevaluate`` averages, and their names in ``archive.npz``.
RESCORED = {"fitness": "rescored_fitness", "true_return": "rescored_return", "measures": "rescored_measures",
            "length": "rescored_length"}  # fmt: skip


class Search(NamedTuple):
    """A run in progress, as a value: functions that continue it return a new ``Search`` and leave this one as it is."""

    config: Config
    engine: Engine
    archives: Archives
    xnes: XNES
    rng: np.random.Generator  # draws where the search starts and restarts
    demos: Demonstrations | None
    state: State


class Info(NamedTuple):
    """Measurements of one QD iteration; with those of the reward model, a row of ``metrics.csv``."""

    restarts: float  # 1.0 if it ended in a restart
    steps: float  # environment steps
    coefficients: np.ndarray  # (1+k,) the mean of xNES before the walk; all 0 if it has learned nothing
    added: float  # candidates that improved the soft archive
    not_finite: float  # candidates left out because their physics diverged
    walk_reward: float  # fitness reward per step of the walk
    walk_learned: float  # the reward model's own part of it, without the measure bonus
    walk_q_share: float  # share of the walk's steps that get q of the bonus (or would, with a bonus)
    gradient_q_share: float  # the same of the gradient phase, for the copy that is trained on fitness
    true_reward: float  # the environment's own, per step of the walk
    rolled_back: float  # training phases discarded because a number was not finite
    approx_kl: float  # nats, of the walk's last update
    action_std: float
    reward: dict[str, float]  # the reward model's own measurements of its learning

    def columns(self) -> dict[str, float]:
        """The columns of ``metrics.csv`` that it fills; each coefficient has its own."""
        named = {f"c{i}": float(c) for i, c in enumerate(self.coefficients)}
        plain = {n: v for n, v in self._asdict().items() if n not in ("restarts", "steps", "coefficients", "reward")}
        return {**named, **plain, **self.reward}


def begin(config: Config, demos: Demonstrations | None, heldout: Demonstrations | None = None) -> Search:
    """Algorithm 1, lines 1-2: θ_μ = θ_0, xNES at its center (μ = 0 in the paper), Σ = σ_g² I, empty archives.

    ``heldout``: steps of the demonstrators that nothing learns from, for measurements (``fitness.calibration``).
    """
    engine, ppga = Engine(config, heldout), config.ppga
    for given in (demos, heldout):
        if given is not None:
            check_fits(given, engine.env)
    theta_size = networks.flat_size(engine.search.template)
    archives = archive.make(
        ppga.cells, engine.k, theta_size, engine.env.obs_size, ppga.archive_learning_rate, ppga.threshold_min
    )
    xnes_seed, elite_seed = np.random.SeedSequence(config.seed).spawn(2)
    rng = np.random.default_rng(elite_seed)
    folded = ppga.fitness_coefficient == "folded"  # |c_0|: fitness is never minimised (section 4.1)
    xnes = XNES(ppga.sigma0, engine.objectives, ppga.candidates, seed=xnes_seed, fold_first=folded)
    xnes.reset(draw_center(ppga.xnes_center, engine.objectives, rng))
    key = jax.random.key(config.seed)
    engine.compile_all(key, demos)
    state = engine.init(key, demos)
    return Search(config, engine, archives, xnes, rng, demos, state)


def iteration(search: Search) -> tuple[Search, Info]:
    """One QD iteration, Algorithm 1, lines 4-22."""
    ppga, engine = search.config.ppga, search.engine

    # Gradients (lines 4-5): copy i of θ_μ is trained on objective i alone. The copies are discarded; the running
    # statistics and the robots continue from there.
    copies = engine.train_copies(search.state, filled(search), ppga.gradient_updates, search.demos)
    search = search._replace(state=copies.state._replace(train_state=search.state.train_state))

    # Branching (lines 6-11): candidates along sampled combinations of the gradients, scored over whole episodes.
    xnes = copy.deepcopy(search.xnes)
    coefficients = xnes.ask()
    policies, _ = engine.branch(search.state, copies.theta, coefficients)
    search, candidates = evaluate_next(search, policies)

    # Archive (line 12, Algorithm 2) and search distribution (lines 14-15).
    archives, improvement, accepted = archive.add(search.archives, candidates, ppga.rejects)
    xnes.tell(np.argsort(-improvement, kind="stable"), improvement)
    search = search._replace(archives=archives, xnes=xnes)
    restarts = not accepted.any() or xnes.check_stop(improvement)
    phases = [copies]
    if restarts and ppga.restart_order == "before-walk":
        search, rounds = restart(search)
        phases += rounds

    # Walk (lines 16-17): θ_μ moves on the reward weighted by the xNES mean c_μ; cells just filled give no bonus.
    mean = np.array(search.xnes.mean, np.float32)
    walked = engine.train_policy(search.state, filled(search), walk_weights(search), ppga.walk_updates, search.demos)
    search, phases = search._replace(state=walked.state), [*phases, walked]

    # Reward model (line 18): a fresh rollout of the walked policy, from which the reward model alone learns.
    reward_info = walked.reward_info
    if engine.learns_each_iteration:
        search, fresh, reward_info = update_reward(search)
        phases.append(fresh)

    # Restart (lines 19-22): nothing was added, so start again from a random elite.
    if restarts and ppga.restart_order == "last":
        search, rounds = restart(search)
        phases += rounds

    return search, _info(search, candidates, accepted, mean, restarts, phases, copies, walked, reward_info)


def filled(search: Search) -> jax.Array:
    """Which archive cells are filled (cells, …), on the device: the complement of A_e."""
    return jnp.asarray(archive.occupied(search.archives))


def update_reward(search: Search) -> tuple[Search, Trained, dict[str, jax.Array]]:
    """The reward model learns from a fresh rollout of θ_μ (line 18). Also returns that rollout and measurements."""
    assert search.demos is not None, "a reward model that learns needs demonstrations"
    occupied = filled(search)
    fresh = search.engine.rollout(search.state, occupied)
    state, info = search.engine.update_reward(fresh.state, occupied, search.demos, fresh.transitions)
    return search._replace(state=state), fresh, info


def restart(search: Search) -> tuple[Search, list[Trained]]:
    """Lines 19-22: xNES starts again and θ_μ becomes a random elite, unless the archive is empty.

    The elite keeps its own observation statistics; ``restart_statistics=other`` gives it those of another random elite.
    The reward model then learns from ``restart_rounds`` rollouts of it, before any of its candidates are scored; these
    rollouts are returned, too.
    """
    ppga, engine = search.config.ppga, search.engine
    xnes, rng = copy.deepcopy((search.xnes, search.rng))
    xnes.reset(draw_center(ppga.xnes_center, engine.objectives, rng), ppga.restart_samples == "same")
    search, elite = search._replace(xnes=xnes, rng=rng), archive.random_elite(search.archives, rng)
    if elite is None:
        return search, []
    if ppga.restart_statistics == "other":
        other = archive.random_elite(search.archives, rng)
        assert other is not None
        elite |= {name: other[name] for name in ("obs_mean", "obs_std")}
    search = search._replace(state=engine.restart_at(search.state, elite))
    rounds = []
    for _ in range(ppga.restart_rounds if engine.model.learns else 0):
        search, fresh, _ = update_reward(search)
        rounds.append(fresh)
    return search, rounds


def walk_weights(search: Search) -> np.ndarray:
    """c_μ (1+k,) of the walk (line 16): the xNES mean, whose c_0 ≥ 0 unless coefficients are signed; or fitness alone.

    Fitness alone is used for ``walk_weights=fitness``, and where all of c_μ is 0, because xNES has learned nothing
    since it started: by weights of 0 the walk would not move.
    """
    ppga, c_mu = search.config.ppga, np.array(search.xnes.mean, np.float32)
    fitness_alone = np.eye(len(c_mu), dtype=np.float32)[0]
    return c_mu if ppga.walk_weights == "xnes" and c_mu.any() else fitness_alone


def warm_up(search: Search, updates: int) -> tuple[Search, int, dict[str, float]]:
    """A round of plain PPO on the method's own reward, without measure bonus, before the first iteration (ours).

    A round does at most N2 of the remaining ``updates``, and a learned reward model is updated after it. A store holds
    the round's rollout, since nothing is evaluated yet. Returns the number of updates done and two numbers for the
    run's metrics: environment ``steps`` and phases ``rolled_back``.
    """
    config, engine, demos = search.config, search.engine, search.demos
    occupied, done = filled(search), min(config.ppga.walk_updates, updates)
    trained = engine.train_policy(search.state, occupied, np.eye(engine.objectives)[0], done, demos, bonus=False)
    state, rolled_back = trained.state, float(trained.rolled_back)
    if isinstance(state.store, Transitions):
        state = state._replace(store=trained.transitions)
    if engine.learns_each_iteration:
        assert demos is not None, "a reward model that learns needs demonstrations"
        state, reward_info = engine.update_reward(state, occupied, demos, trained.transitions)
        rolled_back += float(reward_info["reward_rolled_back"])
    info = {"steps": float(done * config.ppo.rollout_length * config.ppo.num_envs), "rolled_back": rolled_back}
    return search._replace(state=state), done, info


def warmed_up(search: Search, updates: int) -> Search:
    """``search`` after that many updates of ``warm_up``."""
    while updates > 0:
        search, done, _ = warm_up(search, updates)
        updates -= done
    return search


def evaluate_next(search: Search, policies: Policies) -> tuple[Search, Candidates]:
    """``evaluate`` the candidates of an iteration with the search's own key, which moves on."""
    key, episode_key, keep_key = jax.random.split(search.state.key, 3)
    state, scores = search.engine.score_and_keep(search.state, filled(search), policies, episode_key, keep_key)
    return search._replace(state=state._replace(key=key)), _candidates(search, policies, scores)


def evaluate(search: Search, policies: Policies, key: jax.Array) -> Candidates:
    """Score λ policies over whole episodes, with the fitness that archives compare, and copy them to the host."""
    return _candidates(search, policies, search.engine.score(search.state, filled(search), policies, key))


def _candidates(search: Search, policies: Policies, scores: Scores) -> Candidates:
    config = search.config
    fitness = scores.true_return if config.ppga.selection == "true" else scores.fitness
    if config.bonus.bonus_in_fitness and parse_method(config.method).bonus:
        p, q = search.engine.bonus
        fitness = fitness + (p + q * is_empty(filled(search), scores.measures)) * scores.length
    policies, scores = to_host((policies, scores._replace(fitness=fitness)))
    return Candidates(**policies._asdict(), **scores._asdict())


def batch_of_elites(search: Search, first: int) -> Policies:
    """λ elites from row ``first`` on, placed on the devices; if fewer are left, the last elite is repeated."""
    elites = archive.elite_arrays(search.archives)
    rows = np.minimum(np.arange(first, first + search.config.ppga.candidates), len(elites["index"]) - 1)
    return search.engine.elites(elites, rows)


def reevaluate(search: Search, key: jax.Array) -> dict[str, np.ndarray]:
    """Score every elite again over new episodes, by the fitness that archives compare at present (Appendix K).

    Archived scores are too high on average, because an archive keeps the best of many noisy scores; new scores are not.
    Elites are scored in rounds of ``episodes`` until each has ``rescore_episodes`` or more, so that the programs that
    scored the candidates serve here as well. Returns, in the order of ``archive.elite_arrays``, means over an elite's
    rounds: ``rescored_fitness``, ``rescored_return``, ``rescored_length`` (n,) and ``rescored_measures`` (n, k); and
    ``rescored_episodes`` (n,), how many episodes they are over. Rounds in which an elite's physics diverged do not
    count; without any other round its means are not-a-number.
    """
    count, size, k = len(search.archives.result), search.config.ppga.candidates, search.engine.k
    batches = [_rescored(search, first, jax.random.fold_in(key, first)) for first in range(0, count, size)]
    none = {**{name: np.zeros(0, np.float32) for name in RESCORED.values()}, "rescored_episodes": np.zeros(0, np.int32)}
    none["rescored_measures"] = np.zeros((0, k), np.float32)
    return {name: np.concatenate([empty, *(batch[name] for batch in batches)])[:count] for name, empty in none.items()}


def _rescored(search: Search, first: int, key: jax.Array) -> dict[str, np.ndarray]:
    """``reevaluate`` for the λ elites from row ``first`` on."""
    evaluation, policies = search.config.evaluation, batch_of_elites(search, first)
    counted = np.zeros(search.config.ppga.candidates, np.int32)
    sums: dict[str, np.ndarray] = {}
    for number in range(math.ceil(evaluation.rescore_episodes / evaluation.episodes)):
        scores = evaluate(search, policies, jax.random.fold_in(key, number))
        sound = archive.usable(scores)
        counted += sound
        for field, name in RESCORED.items():
            values = np.asarray(getattr(scores, field), np.float64)
            sums[name] = sums.get(name, 0.0) + np.where(sound if values.ndim == 1 else sound[:, None], values, 0.0)
    with np.errstate(invalid="ignore"):  # 0 / 0 is not-a-number
        means = {name: (total.T / counted).T.astype(np.float32) for name, total in sums.items()}
    return {**means, "rescored_episodes": counted * np.int32(evaluation.episodes)}


def _info(
    search: Search,
    candidates: Candidates,
    accepted: np.ndarray,
    mean: np.ndarray,
    restarts: bool,
    phases: list[Trained],
    copies: Trained,
    walked: Trained,
    reward_info: dict[str, jax.Array],
) -> Info:
    config = search.config
    rollouts = sum(phase.rollouts for phase in phases) * config.ppo.rollout_length * config.ppo.num_envs
    return Info(
        restarts=float(restarts),
        steps=float(rollouts + candidates.length.sum() * config.evaluation.episodes),
        coefficients=mean,
        added=float(accepted.sum()),
        not_finite=float((~archive.usable(candidates)).sum()),
        walk_reward=float(walked.info.fitness_reward),
        walk_learned=float(walked.info.learned_reward),
        walk_q_share=float(to_host(walked.info.q_share).mean()),
        gradient_q_share=float(to_host(copies.info.q_share)[0]),
        true_reward=float(walked.info.true_reward),
        rolled_back=float(sum(phase.rolled_back for phase in phases)),
        approx_kl=float(walked.info.approx_kl),
        action_std=float(walked.info.action_std),
        reward={name: float(value) for name, value in reward_info.items()},
    )
