"""Demonstrations of a finished expert: chosen by fresh episodes, and whose they are for which run."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dial import LENGTH, SKILL, config_of

from qdil.config import from_json, make_config, to_json
from qdil.errors import ConfigError
from qdil.files import read_json, sha256, write_json, write_npz
from qdil.imitation import demos
from qdil.imitation.demo_report import smallest_distance
from qdil.methods import parse_method
from qdil.rl import networks
from qdil.runs import folder, missing, summary
from qdil.runs.demos import make_demos
from qdil.runs.folder import demos_of

SIDE = np.array([0.12, 0.32, 0.52, 0.72, 0.92])  # where the dials of the 5 × 5 elites point; measures 0.1, 0.3, …
PLACES = np.stack(np.meshgrid(SIDE, SIDE, indexing="ij"), axis=-1).reshape(-1, 2)
CORNERS, MIDDLE = [0, 4, 20, 24], 12  # elites at the corners of the grid, and in its middle
SEED = 7


def write_expert(where: Path, with_fresh: bool = True) -> Path:
    """An expert on two dials. The five skilled elites are those of the corners and the middle, the first one best.

    The archive's own values are lucky: the skilled elites have the lowest returns, and all elites the same measures.
    """
    skill = np.full(25, -1.0)
    skill[[*CORNERS, MIDDLE]] = SKILL + np.array([0.0, 0.02, 0.04, 0.06, 0.08])
    like = networks.template_of(2, 3, (8,))
    blank = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape), like)

    def always(action):
        last = {**blank["mean"][-1], "b": jnp.array(action)}
        return np.asarray(networks.flatten({"mean": [*blank["mean"][:-1], last], "log_std": blank["log_std"]}))

    fresh_return = LENGTH * (1 - (skill - SKILL) ** 2)
    fresh = {"rescored_return": fresh_return, "rescored_measures": np.floor(10 * PLACES) / 10}
    own = {"true_return": -fresh_return, "fitness": -fresh_return, "measures": np.full((25, 2), 0.5)}
    index, cells = np.arange(25), np.array([5, 5])
    write_npz(where / "archive.npz", index=index, cells=cells, **own, **(fresh if with_fresh else {}))
    solution = np.stack([always([*(2 * p - 1), s]) for p, s in zip(PLACES, skill, strict=True)])
    write_npz(
        where / "policies.npz", index=index, solution=solution, obs_mean=np.zeros((25, 2)), obs_std=np.ones((25, 2))
    )
    write_json(where / "config.json", to_json(config_of("true", 2, SEED)))
    write_json(where / "manifest.json", {})
    return where


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    root = tmp_path_factory.mktemp("demos")
    expert = write_expert(root / "expert")
    return expert, make_demos("dial2", "smoke", 4, SEED, expert, root / "demos.npz", 3)


def test_demonstrators_are_the_best_and_most_diverse_by_fresh_episodes(recorded):
    expert, path = recorded
    with np.load(path) as file:
        found = dict(file)
    assert found["elite_index"][0] == 0 and sorted(found["elite_index"]) == CORNERS
    places = np.floor(10 * PLACES[found["elite_index"]]) / 10
    np.testing.assert_allclose(found["elite_measures"], places, atol=1e-6)
    np.testing.assert_allclose(found["episode_measures"], places, atol=1e-6)
    np.testing.assert_allclose(found["episode_return"], found["elite_return"], rtol=1e-5)
    assert smallest_distance(found["episode_measures"]) == pytest.approx(0.8)
    assert np.bincount(found["heldout_episode"]).tolist() == [LENGTH] * 4


def test_a_file_names_its_expert_and_settings_and_not_a_folder(recorded, tmp_path):
    expert, path = recorded
    origin = {"run": "smoke/dial2/true/seed-7", "seed": SEED, "archive_sha256": sha256(expert / "archive.npz")}
    assert demos.expert_of(path) == origin
    expected = {"demo_episodes": 4, "demo_attempts": 3, "expert_seed": SEED}
    assert len(demos.load(path, "dial2", "probe", expected=expected).obs) == 4 * LENGTH
    again = make_demos("dial2", "smoke", 4, 99, write_expert(tmp_path / "moved"), tmp_path / "demos.npz", 3)
    assert again.read_bytes() == path.read_bytes()  # the seed is the expert's


def test_without_a_path_the_file_lies_beside_the_runs_under_the_experts_seed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_expert(Path("results/smoke/dial2/true/seed-7"))
    assert make_demos("dial2", "smoke", 1, SEED, attempts=1) == Path("results/smoke/dial2/demos-1-seed-7.npz")


def test_an_expert_that_was_not_scored_again_is_refused(tmp_path):
    expert = write_expert(tmp_path / "expert", with_fresh=False)
    with pytest.raises(ConfigError, match="no rescored_return"):
        make_demos("dial2", "smoke", 1, SEED, expert, tmp_path / "demos.npz")


# Whose demonstrations


@pytest.fixture
def trained(monkeypatch):
    """What ``train_missing`` trains and records: pairs of a run's folder and the demonstrations that it reads."""
    runs = []

    def train(config, where, file, report):
        runs.append((where, file))
        write_json(where / "summary.json", dict.fromkeys(summary.NAMES, 1.0))
        write_json(where / "manifest.json", {})

    def make(env, budget, episodes, seed, expert, out, attempts):
        assert (expert / "manifest.json").is_file()
        runs.append((expert, out))
        write_npz(out, **{name: np.zeros((1, 2)) for name in ("episode_measures", "elite_measures")},
                  episode=np.zeros(1), terminated=np.zeros(1, bool), episode_return=np.zeros(1),
                  elite_return=np.zeros(1))  # fmt: skip
        return out

    monkeypatch.setattr(missing, "train", train)
    monkeypatch.setattr(missing, "make_demos", make)
    return runs


def test_each_seed_learns_from_the_expert_of_its_own_seed(tmp_path, trained):
    missing.train_missing(["gail", "zero"], "walker2d", "smoke", [2, 3], tmp_path, lambda line: None)
    home = tmp_path / "smoke" / "walker2d"
    of_seed = [
        [(home / f"true/seed-{s}", None), (home / f"true/seed-{s}", home / f"demos-1-seed-{s}.npz"),
         (home / f"gail/seed-{s}", home / f"demos-1-seed-{s}.npz")]
        for s in (2, 3)
    ]  # fmt: skip
    assert trained == [*of_seed[0], *of_seed[1], (home / "zero/seed-2", None), (home / "zero/seed-3", None)]


def test_one_expert_for_all_seeds_is_a_setting(tmp_path, trained):
    missing.train_missing(["gail+expert_seed=5"], "walker2d", "smoke", [2, 3], tmp_path, lambda line: None)
    home = tmp_path / "smoke" / "walker2d"
    file = home / "demos-1-seed-5.npz"
    assert trained == [
        (home / "true/seed-5", None),
        (home / "true/seed-5", file),
        *((home / f"gail+expert_seed=5/seed-{s}", file) for s in (2, 3)),
    ]


@pytest.mark.parametrize(("seed", "expert_seed", "name"), [(3, 0, "seed-3"), (3, 1, "seed-1"), (1, 1, "seed-1")])
def test_the_file_follows_from_the_settings(seed, expert_seed, name):
    config = make_config("ant", "gail", "laptop", seed, expert_seed=expert_seed, demo_episodes=2)
    assert demos_of(config, Path("r")) == Path(f"r/laptop/ant/demos-2-{name}.npz")


KEPT = sorted((Path(__file__).parents[2] / "results").glob("*/*/*/seed-*/manifest.json"))


@pytest.mark.skipif(not KEPT, reason="no kept runs here")
def test_kept_imitators_learned_from_the_file_that_their_settings_name():
    """Those of earlier versions too: they did not write ``expert_seed``, and their expert was that of seed 1."""
    for manifest in KEPT:
        if manifest.parents[3].name == "showcase":  # copies, of whose demonstrations only the places are kept
            continue
        root = manifest.parents[4]
        config = from_json(folder.read_config(manifest.parent))
        trained_on = read_json(manifest).get("demonstrations_sha256")
        assert (trained_on is not None) == parse_method(config.method).base.imitates
        if trained_on is not None:
            assert trained_on == sha256(demos_of(config, root)), manifest
