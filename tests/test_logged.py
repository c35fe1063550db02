"""What a run logs about its reward: the bonus's share of steps, the reward without it, θ_μ's age, its calibration."""

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from dial import config_of, demonstrations, dial
from probes import transitions

from qdil import ppga
from qdil.engine.engine import Engine
from qdil.errors import ConfigError
from qdil.evidence import symptoms
from qdil.imitation import demos as demonstrations_file
from qdil.imitation import fitness
from qdil.imitation.reward_model import Demonstrations, InputModel, hide, over_inputs
from qdil.runs.train import _ages, train
from qdil.types import Normaliser, RewardContext

pytestmark = pytest.mark.compiles

SMALL = {"iterations": 6, "eval_chunk_steps": 5}


class Watched(Engine):
    """An engine that keeps the filled cells and the outcome of every training phase."""

    def __init__(self, engine):
        self.__dict__.update(vars(engine))
        self.phases = {}

    def train_copies(self, state, occupied, *args, **kwargs):
        trained = Engine.train_copies(self, state, occupied, *args, **kwargs)
        self.phases["gradient"] = np.asarray(occupied), trained
        return trained

    def train_policy(self, state, occupied, *args, **kwargs):
        trained = Engine.train_policy(self, state, occupied, *args, **kwargs)
        self.phases["walk"] = np.asarray(occupied), trained
        return trained


def share_in_empty_cells(occupied, steps, robots):
    """Step by step: does the measure of its episode, so far for an unfinished one, lie in an empty cell?"""
    so_far, ended = np.asarray(steps.measures_so_far), np.asarray(steps.ended)
    found = []
    for robot in robots:
        for step in range(len(ended)):
            end = step
            while end < len(ended) - 1 and not ended[end, robot]:
                end += 1
            cell = [min(int(m * n + 1e-4), n - 1) for m, n in zip(so_far[end, robot], occupied.shape, strict=True)]
            found.append(not occupied[tuple(cell)])
    return np.mean(found)


@pytest.mark.parametrize("method", ["mbo-true", "mconbo-gail", "gail"])
def test_the_shares_of_steps_that_get_q_are_those_of_a_recount(method):
    """In the gradient phase of the copy that is trained on fitness, which drives the robots 0, K, 2K, …"""
    search = ppga.begin(config_of(method, **SMALL), None if method == "mbo-true" else demonstrations())
    shares = []
    for _ in range(3):
        watched = search._replace(engine=Watched(search.engine))
        search, info = ppga.iteration(watched)
        robots, copies = search.config.ppo.num_envs, search.engine.objectives
        for phase, driven in (("gradient", range(0, robots, copies)), ("walk", range(robots))):
            occupied, trained = watched.engine.phases[phase]
            expected = share_in_empty_cells(occupied, trained.transitions, driven)
            assert getattr(info, f"{phase}_q_share") == pytest.approx(expected, abs=1e-6)
            shares.append(expected)
        p, q = search.engine.bonus
        assert info.walk_learned + p + q * info.walk_q_share == pytest.approx(info.walk_reward, abs=1e-5)
        if method == "mbo-true":
            assert info.walk_learned == pytest.approx(info.true_reward, abs=1e-6)
        search = search._replace(engine=watched.engine)
    assert any(0 < share < 1 for share in shares)


# Age


def test_ages_count_from_the_walk_after_a_restart():
    def ages(order, restarts):
        config, age, found = config_of("true", restart_order=order), 0, []
        for restarted in restarts:
            walk, age = _ages(config, restarted, age)
            found.append(walk)
        return found

    restarts = [False, True, False, False, True, True, False]
    assert ages("last", restarts) == [0, 1, 0, 1, 2, 0, 0]
    assert ages("before-walk", restarts) == [0, 0, 1, 2, 0, 0, 1]


# Calibration


def model_of(reward):
    """A reward model without a state, by a function of inputs and episode ends."""
    model = InputModel(lambda key, expert: (), lambda state, memory, x, ended: (memory, reward(x, ended)))
    return over_inputs(model, hide(actions=False, proxy=False))


def rows(rng, count):
    draw = (rng.normal(size=(count, width)).astype(np.float32) for width in (3, 2, 3, 2))
    return Demonstrations(*map(jnp.asarray, draw))


def steps_of(rng, time=24, envs=4):
    obs, next_obs = (rng.normal(size=(time, envs, 3)).astype(np.float32) for _ in range(2))
    ended = jnp.asarray(rng.uniform(size=(time, envs)) < 0.3)
    return transitions(time, envs, 3, 2, 2, obs=obs, next_obs=next_obs, terminated=ended)


CONTEXT = RewardContext(Normaliser(jnp.full(3, 0.5), jnp.full(3, 2.0)), jnp.zeros((2, 2), bool))


def test_calibration_is_the_mean_reward_of_each_kind_of_steps():
    rng = np.random.default_rng(0)
    model = model_of(lambda x, ended: x.obs.sum(-1) + 2 * x.action.sum(-1) - x.next_obs[..., 0] + 3 * x.proxy[..., 1])
    shown, heldout, steps = rows(rng, 7), rows(rng, 5), steps_of(rng)
    state = model.init(jax.random.key(0), shown)
    found = fitness.calibration(model, state, CONTEXT, shown, heldout, steps)

    def expected(some):
        obs, action, next_obs, proxy = (np.asarray(getattr(some, name), float) for name in Demonstrations._fields)
        reward = (obs - 0.5).sum(-1) / 2 + 2 * action.sum(-1) - (next_obs[..., 0] - 0.5) / 2 + 3 * proxy[..., 1]
        return reward.mean()

    kinds = {"expert_reward": shown, "heldout_reward": heldout, "policy_reward": steps}
    assert {name: float(value) for name, value in found.items()} == pytest.approx(
        {name: expected(some) for name, some in kinds.items()}, rel=1e-4
    )
    assert "heldout_reward" not in fitness.calibration(model, state, CONTEXT, shown, None, steps)


def test_a_demonstrated_row_counts_as_an_episode_of_one_step():
    rng = np.random.default_rng(1)
    model, shown, steps = model_of(lambda x, ended: ended.astype(jnp.float32)), rows(rng, 7), steps_of(rng)
    found = fitness.calibration(model, model.init(jax.random.key(0), shown), CONTEXT, shown, shown, steps)
    assert float(found["expert_reward"]) == float(found["heldout_reward"]) == 1.0
    assert float(found["policy_reward"]) == pytest.approx(float(np.mean(steps.ended)))


def test_many_steps_are_measured_by_some_from_beginning_to_end():
    """A reward that is the row's number, or the time: half-way on average."""
    rng = np.random.default_rng(3)
    model, shown, steps = model_of(lambda x, ended: x.proxy[..., 0]), rows(rng, 3000), steps_of(rng, time=100, envs=16)
    shown = shown._replace(proxy=jnp.tile(jnp.arange(3000.0)[:, None], (1, 2)))
    time = jnp.broadcast_to(jnp.arange(100.0)[:, None, None], (100, 16, 2))
    seen = []
    model = model._replace(reward=lambda *args, of=model.reward: seen.append(args[-1].reward.size) or of(*args))
    state = model.init(jax.random.key(0), shown)
    found = fitness.calibration(model, state, CONTEXT, shown, None, steps._replace(proxy=time))
    assert float(found["expert_reward"]) == pytest.approx(1500, abs=15)
    assert float(found["policy_reward"]) == pytest.approx(50, abs=3)
    assert max(seen) < 1.2 * fitness.MEASURED


# A run


def write_demos(path, **heldout):
    """A file of one demonstration on two dials, with held-out columns."""
    shown = demonstrations(count=1)._asdict()
    columns = {name: np.asarray(values) for name, values in shown.items()}
    demonstrations_file.save(path, columns | {"episode": np.zeros(len(columns["obs"]), int)} | heldout, dial())
    return path


def heldout_columns(**changed):
    """Three rows of another demonstration."""
    further = {name: np.asarray(values)[-3:] for name, values in demonstrations(count=2)._asdict().items()}
    return {f"heldout_{name}": values for name, values in (further | changed).items()}


def test_a_run_logs_ages_and_what_its_reward_says_of_held_out_steps(tmp_path):
    for name, columns in (("with", heldout_columns()), ("without", {})):
        demos = write_demos(tmp_path / f"{name}.npz", **columns)
        train(config_of("mcond-gail", **SMALL), tmp_path / name, demos)
    metrics, without = (pd.read_csv(tmp_path / name / "metrics.csv") for name in ("with", "without"))
    assert set(metrics) - set(without) == {"heldout_reward"}
    run = symptoms.read(tmp_path / "with")
    np.testing.assert_array_equal(metrics["age"], symptoms.ages(run._replace(metrics=metrics.drop(columns="age"))))
    assert np.isfinite(metrics[["expert_reward", "heldout_reward", "policy_reward"]]).all(axis=None)
    archives = [(tmp_path / name / "archive.npz").read_bytes() for name in ("with", "without")]
    assert archives[0] == archives[1]  # measuring changes nothing


def test_held_out_steps_that_do_not_fit_are_refused(tmp_path):
    config = config_of("mcond-gail", **SMALL)
    for changed, sentence in (
        ({"obs": np.zeros((2, 2))}, "unequal numbers of rows"),
        ({"obs": np.full((3, 2), np.nan)}, "not finite"),
        ({"obs": np.zeros((3, 5))}, "obs of width 5"),
    ):
        demos = write_demos(tmp_path / "demos.npz", **heldout_columns(**changed))
        with pytest.raises(ConfigError, match=sentence):
            train(config, tmp_path / "run", demos)


def test_held_out_steps_without_actions_serve_methods_that_hide_them(tmp_path):
    columns = heldout_columns()
    del columns["heldout_action"]
    demos = write_demos(tmp_path / "demos.npz", **columns)
    assert demonstrations_file.load_heldout(demos) is None
    found = demonstrations_file.load_heldout(demos, needs_actions=False)
    assert found.action.shape == (3, 0)
    np.testing.assert_allclose(found.obs, columns["heldout_obs"], rtol=1e-6)
    assert demonstrations_file.load_heldout(write_demos(tmp_path / "none.npz")) is None
