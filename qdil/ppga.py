"""PPGA with MConbo-IRL: Algorithm 1 of the paper, one QD iteration a page."""

import copy
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
from qdil.qd.xnes import XNES
from qdil.rl import networks
from qdil.rl.evaluate import Policies


class Search(NamedTuple):
    """A run in progress, as a value: functions that continue it return a new ``Search`` and leave this one as it is."""

    config: Config
    engine: Engine
    archives: Archives
    xnes: XNES
    rng: np.random.Generator  # draws the elites of restarts
    demos: Demonstrations | None
    state: State


class Info(NamedTuple):
    """Measurements of one QD iteration; with those of the reward model, a row of ``metrics.csv``."""

    restarts: float  # 1.0 if it ended in a restart
    steps: float  # environment steps
    coefficients: np.ndarray  # (1+k,) c_μ of the walk
    added: float  # candidates that improved the soft archive
    not_finite: float  # candidates left out because their physics diverged
    walk_reward: float  # fitness reward per step of the walk
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


def begin(config: Config, demos: Demonstrations | None) -> Search:
    """Algorithm 1, lines 1-2: θ_μ = θ_0, xNES at μ = 0, Σ = σ_g² I, empty archives."""
    engine, ppga = Engine(config), config.ppga
    if demos is not None:
        check_fits(demos, engine.env)
    theta_size = networks.flat_size(engine.search.template)
    archives = archive.make(
        ppga.cells, engine.k, theta_size, engine.env.obs_size, ppga.archive_learning_rate, ppga.threshold_min
    )
    xnes_seed, elite_seed = np.random.SeedSequence(config.seed).spawn(2)
    xnes = XNES(ppga.sigma0, engine.objectives, ppga.candidates, seed=xnes_seed)
    key = jax.random.key(config.seed)
    engine.compile_all(key, demos)
    state = engine.init(key, demos)
    return Search(config, engine, archives, xnes, np.random.default_rng(elite_seed), demos, state)


def iteration(search: Search) -> tuple[Search, Info]:
    """One QD iteration, Algorithm 1, lines 4-22."""
    config, engine, demos, state = search.config, search.engine, search.demos, search.state
    archives, xnes, rng = search.archives, copy.deepcopy(search.xnes), copy.deepcopy(search.rng)
    occupied = jnp.asarray(archive.occupied(archives))

    # Gradients (lines 4-5): copy i of θ_μ is trained on objective i alone. The copies are discarded; the running
    # statistics and the robots continue from there.
    copies = engine.train_copies(state, occupied, config.ppga.gradient_updates)
    state = copies.state._replace(train_state=state.train_state)

    # Branching (lines 6-11): candidates along sampled combinations of the gradients, scored over whole episodes.
    coefficients = xnes.ask()
    policies, _ = engine.branch(state, copies.theta, coefficients)
    key, episode_key = jax.random.split(state.key)
    state = state._replace(key=key)
    candidates = evaluate(search._replace(state=state), policies, episode_key)

    # Archive (line 12, Algorithm 2) and search distribution (lines 14-15).
    archives, improvement = archive.add(archives, candidates)
    xnes.tell(np.argsort(-improvement, kind="stable"), improvement)

    # Walk (lines 16-17): θ_μ moves on the reward weighted by the xNES mean c_μ; cells just filled give no bonus.
    occupied = jnp.asarray(archive.occupied(archives))
    c_mu = walk_weights(config, archives, xnes)
    walked = engine.train_policy(state, occupied, c_mu, config.ppga.walk_updates)
    state, phases = walked.state, [copies, walked]

    # Reward model (line 18): a fresh rollout of the walked policy, from which the reward model alone learns.
    reward_info: dict[str, jax.Array] = {}
    if engine.model.learns:
        assert demos is not None, "a reward model that learns needs demonstrations"
        fresh = engine.rollout(state, occupied)
        phases.append(fresh)
        state, reward_info = engine.update_reward(fresh.state, occupied, demos, fresh.transitions)

    # Restart (lines 19-22): nothing was added, so start again from a random elite with its own statistics.
    restarted = not improvement.any() or xnes.check_stop(improvement)
    if restarted:
        xnes.reset(np.zeros(engine.objectives))
        elite = archive.random_elite(archives, rng)
        if elite is not None:
            state = engine.restart_at(state, elite)

    info = _info(config, candidates, improvement, c_mu, restarted, phases, walked, reward_info)
    return search._replace(archives=archives, xnes=xnes, rng=rng, state=state), info


def walk_weights(config: Config, archives: Archives, xnes: XNES) -> np.ndarray:
    """c_μ (1+k,) of the walk (line 16): the xNES mean with |c_0|, so that fitness is never minimised; or fitness alone.

    Fitness alone is used for ``walk_weights=fitness``, and until a candidate exceeds ``threshold_min``, because before
    that xNES has learned nothing.
    """
    c_mu = np.array(xnes.mean, np.float32)
    c_mu[0] = np.abs(c_mu[0])
    fitness_alone = archives.soft.empty or config.ppga.walk_weights == "fitness"
    return np.eye(len(c_mu), dtype=np.float32)[0] if fitness_alone else c_mu


def warm_up(search: Search, updates: int) -> tuple[Search, int, dict[str, float]]:
    """A round of plain PPO on the method's own reward before the first iteration (ours, the same for every method).

    A round does at most N2 of the remaining ``updates``, and a learned reward model is updated after it. Returns the
    number of updates done and two numbers for the run's metrics: environment ``steps`` and phases ``rolled_back``.
    """
    config, engine, demos = search.config, search.engine, search.demos
    occupied = jnp.asarray(archive.occupied(search.archives))
    done = min(config.ppga.walk_updates, updates)
    trained = engine.train_policy(search.state, occupied, np.eye(engine.objectives)[0], done)
    state, rolled_back = trained.state, float(trained.rolled_back)
    if engine.model.learns:
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


def evaluate(search: Search, policies: Policies, key: jax.Array) -> Candidates:
    """Score λ policies over whole episodes, with the fitness that archives compare, and copy them to the host."""
    config, occupied = search.config, jnp.asarray(archive.occupied(search.archives))
    scores = search.engine.score(search.state, occupied, policies, key)
    fitness = scores.true_return if config.ppga.selection == "true" else scores.fitness
    if config.bonus.bonus_in_fitness and parse_method(config.method).bonus:
        p, q = search.engine.bonus
        fitness = fitness + (p + q * is_empty(occupied, scores.measures)) * scores.length
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
    Returns ``rescored_fitness``, ``rescored_return`` (n,) and ``rescored_measures`` (n, k) in the order of
    ``archive.elite_arrays``.
    """
    count, size = len(search.archives.result), search.config.ppga.candidates
    firsts = range(0, count, size)
    scores = [evaluate(search, batch_of_elites(search, first), jax.random.fold_in(key, first)) for first in firsts]
    shapes = {"fitness": (0,), "true_return": (0,), "measures": (0, search.engine.k)}
    joined = {n: np.concatenate([np.zeros(e), *(getattr(s, n) for s in scores)])[:count] for n, e in shapes.items()}
    names = {"fitness": "rescored_fitness", "true_return": "rescored_return", "measures": "rescored_measures"}
    return {names[name]: values.astype(np.float32) for name, values in joined.items()}


def _info(
    config: Config,
    candidates: Candidates,
    improvement: np.ndarray,
    c_mu: np.ndarray,
    restarted: bool,
    phases: list[Trained],
    walked: Trained,
    reward_info: dict[str, jax.Array],
) -> Info:
    learns = bool(reward_info)
    updates = config.ppga.gradient_updates + config.ppga.walk_updates + int(learns)
    rollouts = updates * config.ppo.rollout_length * config.ppo.num_envs
    return Info(
        restarts=float(restarted),
        steps=float(rollouts + candidates.length.sum() * config.evaluation.episodes),
        coefficients=c_mu,
        added=float((improvement > 0).sum()),
        not_finite=float((~archive.usable(candidates)).sum()),
        walk_reward=float(walked.info.fitness_reward),
        true_reward=float(walked.info.true_reward),
        rolled_back=float(sum(phase.rolled_back for phase in phases)),
        approx_kl=float(walked.info.approx_kl),
        action_std=float(walked.info.action_std),
        reward={name: float(value) for name, value in reward_info.items()},
    )
