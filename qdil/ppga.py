"""PPGA with MConbo-IRL: Algorithm 1 of the paper, one QD iteration a page."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdil.compiled import Compiled, compile_run
from qdil.config import Config
from qdil.hosts import to_host
from qdil.imitation.bonus import is_empty
from qdil.imitation.demos import check_fits
from qdil.imitation.reward_model import Demonstrations
from qdil.phases import State
from qdil.registry import parse_method
from qdil.search import archive, networks
from qdil.search.archive import Archives, Candidates
from qdil.search.evaluate import Policies
from qdil.search.xnes import XNES


class Search(NamedTuple):
    """A run in progress: what is compiled, what lives on the host, what lives on the devices."""

    config: Config
    compiled: Compiled
    archives: Archives
    xnes: XNES
    rng: np.random.Generator  # draws the elites of restarts
    demos: Demonstrations | None
    state: State


def begin(config: Config, demos: Demonstrations | None) -> Search:
    """Algorithm 1, lines 1-2: θ_μ = θ_0, xNES at μ = 0, Σ = σ_g² I, empty archives."""
    compiled = compile_run(config)
    if demos is not None:
        check_fits(demos, compiled.parts.env)
    k, obs_size = len(compiled.parts.env.measure_names), compiled.parts.env.obs_size
    theta_size = networks.flat_size(compiled.parts.like)
    archives = archive.make(config.cells, k, theta_size, obs_size, config.archive_learning_rate, config.threshold_min)
    xnes_seed, elite_seed = np.random.SeedSequence(config.seed).spawn(2)
    xnes = XNES(config.sigma0, 1 + k, config.candidates, seed=xnes_seed)
    key = jax.random.key(config.seed)
    compiled.ahead(key, demos)
    state = compiled.init(key, demos)
    return Search(config, compiled, archives, xnes, np.random.default_rng(elite_seed), demos, state)


def iteration(search: Search) -> tuple[Search, dict[str, float]]:
    """One QD iteration, Algorithm 1, lines 4-22. Archives, xNES and the generator change in place."""
    config, compiled, archives, xnes, rng, demos, state = search
    occupied = jnp.asarray(archive.occupied(archives))
    streams = compiled.parts.streams

    # Gradients (lines 4-5): copy i of θ_μ is trained on reward stream i alone.
    forked = compiled.train(state, occupied, np.eye(streams), False, config.gradient_updates, config.epochs)
    state = _after_gradients(state, forked.state)

    # Branching (lines 6-11): candidates along sampled combinations of the gradients, each over whole episodes.
    coefficients = xnes.ask()
    branched, _ = compiled.branch(state, forked.theta, jnp.asarray(coefficients, jnp.float32))
    key, episode_key = jax.random.split(state.key)
    state = state._replace(key=key)
    candidates = evaluate(search._replace(state=state), branched, episode_key)

    # Archive (line 12, Algorithm 2) and search distribution (lines 14-15).
    improvement = archive.add(archives, candidates)
    xnes.tell(np.argsort(-improvement, kind="stable"), improvement)

    # Walk (lines 16-17): θ_μ moves on the reward weighted by the xNES mean c_μ; cells just filled pay no bonus.
    occupied = jnp.asarray(archive.occupied(archives))
    c_mu = np.array(xnes.mean, np.float32)
    c_mu[0] = np.abs(c_mu[0])
    if archives.soft.empty or config.walk_weights == "fitness":
        c_mu = np.eye(streams)[0]  # nothing passed threshold_min yet, so xNES has nothing to say; or asked for
    walked = compiled.train(state, occupied, _tied(c_mu), True, config.walk_updates, config.epochs)
    state = walked.state

    # Reward model (line 18): fresh rollouts of the walked policy, no gradient step from them but the reward's.
    reward_info: dict[str, jax.Array] = {}
    rolled_back = forked.info["rolled_back"] + walked.info["rolled_back"]
    if compiled.model.learns:
        fresh = compiled.train(state, occupied, _tied(c_mu), True, 1, 0)
        rolled_back += fresh.info["rolled_back"]
        state, reward_info = compiled.update_reward(fresh.state, occupied, demos, fresh.transitions)

    # Restart (lines 19-22): nothing was added, so start again from a random elite with its own statistics.
    restarted = not improvement.any() or xnes.check_stop(improvement)
    if restarted:
        xnes.reset(np.zeros(streams))
        elite = archive.random_elite(archives, rng)
        if elite is not None:
            state = compiled.jump(state, elite["solution"], elite["obs_mean"], elite["obs_std"])

    info = {
        "restarts": float(restarted),
        **{f"c{i}": float(c) for i, c in enumerate(c_mu)},
        "steps": _env_steps(config, candidates, compiled.model.learns),
        "added": float((improvement > 0).sum()),
        "not_finite": float((~archive.usable(candidates)).sum()),
        "walk_reward": float(walked.info["fitness_reward"]),
        "true_reward": float(walked.info["true_reward"]),
        "rolled_back": float(rolled_back),
        "approx_kl": float(walked.info["approx_kl"]),
        "action_std": float(walked.info["action_std"]),
        **{name: float(value) for name, value in reward_info.items()},
    }
    return search._replace(state=state), info


def warm_up(search: Search, updates: int) -> tuple[Search, int, dict[str, float]]:
    """A round of plain PPO on the method's own reward before the first iteration (ours, the same for every method).

    At most N2 of the ``updates`` still to do, so that a learned reward model learns along. Returns how many were done
    and what the run's metrics need to know: environment ``steps``, phases ``rolled_back``.
    """
    config, compiled, demos, state = search.config, search.compiled, search.demos, search.state
    occupied = jnp.asarray(archive.occupied(search.archives))
    weights = _tied(np.eye(compiled.parts.streams)[0])
    now = min(config.walk_updates, updates)
    trained = compiled.train(state, occupied, weights, True, now, config.epochs)
    state, rolled_back = trained.state, trained.info["rolled_back"]
    if compiled.model.learns:
        state, reward_info = compiled.update_reward(state, occupied, demos, trained.transitions)
        rolled_back += reward_info["reward_rolled_back"]
    info = {"steps": float(now * config.window * config.num_envs), "rolled_back": float(rolled_back)}
    return search._replace(state=state), now, info


def warmed_up(search: Search, updates: int) -> Search:
    """``search`` after that many updates of ``warm_up``."""
    while updates > 0:
        search, done, _ = warm_up(search, updates)
        updates -= done
    return search


def _tied(weighting: np.ndarray) -> np.ndarray:
    """One weighting (1+k,) for every copy."""
    return np.tile(weighting, (len(weighting), 1))


def _after_gradients(before: State, after: State) -> State:
    """The copies are thrown away; what they saw of the world (statistics, where the robots are) stays."""
    return after._replace(learner=before.learner)


def evaluate(search: Search, policies: Policies, key: jax.Array) -> Candidates:
    """Score λ policies over whole episodes and bring them to the host, with the fitness that archives compete on."""
    config, state = search.config, search.state
    occupied = jnp.asarray(archive.occupied(search.archives))
    keys = search.compiled.place(jax.random.split(key, (config.candidates, config.episodes)))
    scores = search.compiled.score(policies, state, occupied, keys)
    fitness = scores.true_return if config.selection == "true" else scores.fitness
    if config.bonus_in_fitness and parse_method(config.method).bonus:
        bonus = config.bonus_p + config.bonus_q * is_empty(occupied, scores.measures)
        fitness = fitness + bonus * scores.length
    return Candidates(*to_host((*policies, fitness, *scores[1:])))


def batch_of_elites(search: Search, first: int) -> Policies:
    """λ elites from row ``first`` on, on the devices; the last one fills up a batch that would be too short."""
    elites = archive.elite_arrays(search.archives)
    rows = np.minimum(np.arange(first, first + search.config.candidates), len(elites["index"]) - 1)
    fields: Any = (elites[name][rows] for name in ("solution", "obs_mean", "obs_std"))
    return search.compiled.place(Policies(*fields))


def reevaluate(search: Search, key: jax.Array) -> dict[str, np.ndarray]:
    """Score every elite again, over new episodes and by what fills the archive, as it is now (Appendix K).

    Returns ``rescored_fitness``, ``rescored_return`` (n,) and ``rescored_measures`` (n, k) in the order of
    ``archive.elite_arrays``: what selection of the best of many noisy scores hides.
    """
    count, size = len(search.archives.result), search.config.candidates
    firsts = range(0, count, size)
    scores = [evaluate(search, batch_of_elites(search, first), jax.random.fold_in(key, first)) for first in firsts]
    k = len(search.compiled.parts.env.measure_names)
    fields = {"fitness": (0,), "true_return": (0,), "measures": (0, k)}
    joined = {n: np.concatenate([np.zeros(e), *(getattr(s, n) for s in scores)])[:count] for n, e in fields.items()}
    names = {"fitness": "rescored_fitness", "true_return": "rescored_return", "measures": "rescored_measures"}
    return {names[name]: values.astype(np.float32) for name, values in joined.items()}


def _env_steps(config: Config, candidates: Candidates, learns: bool) -> float:
    """Environment steps of one iteration: both VPPO phases, the reward model's rollout and the evaluated episodes."""
    updates = config.gradient_updates + config.walk_updates + int(learns)
    return float(updates * config.window * config.num_envs + candidates.length.sum() * config.episodes)
