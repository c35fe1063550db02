"""Whole smoke runs on walker2d through the command line: expert, demonstrations, GAIL and MConbo-GAIL."""

import json
import shutil
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from qdil import ppga
from qdil.cli import main
from qdil.config import Evaluation, from_json, make_config
from qdil.errors import ConfigError
from qdil.files import sha256, write_json
from qdil.imitation.selection import select
from qdil.plotting import LiveArchive
from qdil.qd import history
from qdil.qd.landing import METRICS
from qdil.runs import summary
from qdil.runs.folder import read_archive
from qdil.runs.progress import Progress
from qdil.runs.report import AfterIteration
from qdil.runs.train import FIRST_COLUMNS, train
from qdil.tools import plan, verify

pytestmark = pytest.mark.physics

FILES = {"config.json", "metrics.csv", "history.npz", "archive.npz", "policies.npz", "summary.json", "manifest.json"}


def qdil(*words: object) -> int:
    return main([str(word) for word in words])


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A folder with a smoke expert, its demonstrations, and two imitators trained on them."""
    root = tmp_path_factory.mktemp("runs")
    common = ["--env", "walker2d", "--budget", "smoke"]
    assert qdil("train", *common, "--method", "true", "--out", root / "true") == 0
    assert qdil("demos", *common, "--expert", root / "true", "--out", root / "demos.npz", "--episodes", 2) == 0
    for method in ("gail", "mconbo-gail"):
        arguments = [*common, "--method", method, "--demos", root / "demos.npz", "--out", root / method]
        assert qdil("train", *arguments, "--set", "demo_episodes=2") == 0
    return root


@pytest.mark.parametrize("method", ["true", "gail", "mconbo-gail"])
def test_a_run_folder_is_whole(made, method):
    folder = made / method
    assert {path.name for path in folder.iterdir()} == FILES
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["sha256"] == {name: sha256(folder / name) for name in FILES - {"manifest.json"}}
    config = json.loads((folder / "config.json").read_text())
    assert config == {**config, "method": method, "env": "walker2d", "seed": 1, "gamma": 0.99}


@pytest.mark.parametrize("method", ["true", "gail", "mconbo-gail"])
def test_metrics_agree_with_the_archive(made, method):
    metrics = pd.read_csv(made / method / "metrics.csv")
    elites = read_archive(made / method)
    last = metrics.iloc[-1]
    assert list(metrics.columns[:9]) == FIRST_COLUMNS
    assert list(metrics["iteration"]) == [1, 2]
    assert last["qd_score"] == pytest.approx(elites["true_return"].sum(), rel=1e-5)
    assert last["learned_qd_score"] == pytest.approx(elites["fitness"].sum(), rel=1e-5)
    assert last["coverage"] == len(elites["index"]) / np.prod(elites["cells"])
    assert last["best"] == pytest.approx(elites["true_return"].max())
    assert (metrics["env_steps"].diff().dropna() > 0).all()


@pytest.mark.parametrize("method", ["true", "gail", "mconbo-gail"])
def test_the_summary_holds_both_readings(made, method):
    elites, metrics = read_archive(made / method), pd.read_csv(made / method / "metrics.csv")
    kept = json.loads((made / method / "summary.json").read_text())
    assert {name: kept[name] for name in METRICS} == metrics[list(METRICS)].iloc[-1].to_dict()
    assert kept["rescored_episodes"] == 20 and (elites["rescored_episodes"] == 20).all()
    landed: dict[tuple[int, int], float] = {}
    for (x, y), value in zip(elites["rescored_measures"], elites["rescored_return"], strict=True):
        cell = min(4, int(5 * x + 1e-4)), min(4, int(5 * y + 1e-4))
        landed[cell] = max(landed.get(cell, -np.inf), float(value))
    assert kept["corrected_qd_score"] == pytest.approx(sum(landed.values()))
    assert kept["corrected_coverage"] == len(landed) / 25
    assert 0 <= kept["relanded"] <= kept["relanded_near"] <= 1
    assert summary.read(made / method) == {name: kept[name] for name in summary.NAMES}
    (made / method / "summary.json").rename(made / "aside.json")
    assert summary.read(made / method) == {name: kept[name] for name in summary.NAMES}  # from the archive
    (made / "aside.json").rename(made / method / "summary.json")


def test_the_expert_is_filled_by_true_returns_and_imitators_by_learned_ones(made):
    expert, imitator = read_archive(made / "true"), read_archive(made / "gail")
    np.testing.assert_array_equal(expert["fitness"], expert["true_return"])
    assert not np.allclose(imitator["fitness"], imitator["true_return"])


@pytest.mark.parametrize("method", ["true", "gail"])
def test_the_history_of_a_run_ends_in_its_archive(made, method):
    elites = read_archive(made / method)
    with np.load(made / method / "history.npz", allow_pickle=False) as file:
        arrays = dict(file)
    cells = int(np.prod(elites["cells"]))
    past = history.History(*(arrays[name] for name in ("iteration", "index", "true_return", "fitness")))
    for name, grid in history.snapshot(past, int(arrays["iterations"]), cells).items():
        np.testing.assert_array_equal(grid[elites["index"]], elites[name])
        assert np.isfinite(grid).sum() == len(elites["index"])
    rows = np.genfromtxt(made / method / "metrics.csv", delimiter=",", names=True)
    for row in rows:
        grid = history.snapshot(past, int(row["iteration"]), cells)["true_return"]
        assert np.isfinite(grid).sum() / cells == pytest.approx(row["coverage"])


def test_demonstrations_are_whole_episodes_of_the_chosen_elites(made):
    with np.load(made / "demos.npz", allow_pickle=False) as file:
        demos = dict(file)
    elites = read_archive(made / "true")
    rows = select(elites["rescored_return"], elites["rescored_measures"], 25, 2)
    np.testing.assert_array_equal(demos["elite_index"], elites["index"][rows])
    np.testing.assert_array_equal(demos["elite_return"], elites["rescored_return"][rows])
    for episode in range(2):
        steps = demos["episode"] == episode
        ended = demos["terminated"][steps] | demos["truncated"][steps]
        assert ended[-1] and not ended[:-1].any()
        # Rows are aligned: the next state of a step is the state of the following one.
        np.testing.assert_array_equal(demos["next_obs"][steps][:-1], demos["obs"][steps][1:])
        np.testing.assert_allclose(demos["episode_return"][episode], demos["reward"][steps].sum(), rtol=1e-5)
        np.testing.assert_allclose(demos["episode_measures"][episode], demos["proxy"][steps].mean(axis=0), rtol=1e-5)
    assert np.abs(demos["action"]).max() <= 1.0


@pytest.mark.parametrize("report", [Progress, LiveArchive, lambda config: AfterIteration(print)])
def test_every_report_follows_a_run(report, tmp_path, capsys):
    config = make_config("walker2d", "true", "smoke")
    assert train(config, tmp_path, report=report(config))
    assert ("compiling, then 2 warm-up updates" in capsys.readouterr().out) == (report is Progress)


def test_same_seed_gives_the_same_bytes_and_another_seed_does_not(made, tmp_path):
    for seed in (1, 2):
        train(make_config("walker2d", "true", "smoke", seed), tmp_path / f"seed-{seed}")
    once, again, other = (sha256(f / "archive.npz") for f in (made / "true", tmp_path / "seed-1", tmp_path / "seed-2"))
    assert once == again != other


def test_a_finished_run_is_not_trained_again(made, capsys):
    before = (made / "true" / "manifest.json").stat().st_mtime_ns
    assert qdil("train", "--env", "walker2d", "--method", "true", "--budget", "smoke", "--out", made / "true") == 0
    first, claimed, corrected = capsys.readouterr().out.splitlines()
    kept = json.loads((made / "true" / "summary.json").read_text())
    assert "already finished" in first
    assert claimed.startswith(f"As claimed: QD-score {kept['qd_score']:,.0f}, coverage {kept['coverage']:.1%}")
    assert corrected.startswith(f"Corrected: QD-score {kept['corrected_qd_score']:,.0f}, coverage")
    assert f"; {kept['relanded']:.0%} of the elites land in their own cell" in corrected
    assert (made / "true" / "manifest.json").stat().st_mtime_ns == before


def test_other_settings_in_a_finished_folder_are_refused(made, capsys):
    arguments = ["--env", "walker2d", "--method", "true", "--budget", "smoke", "--seed", 7, "--out", made / "true"]
    assert qdil("train", *arguments) == 2
    assert "other settings" in capsys.readouterr().err


def test_demonstrations_of_another_robot_are_refused(made, tmp_path, capsys):
    arguments = ["--env", "halfcheetah", "--method", "gail", "--budget", "smoke", "--demos", made / "demos.npz"]
    assert qdil("train", *arguments, "--out", tmp_path / "run") == 2
    assert "holds demonstrations of walker2d" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_demonstrations_of_another_expert_are_refused(made, tmp_path, capsys):
    arguments = ["--env", "walker2d", "--method", "gail", "--budget", "smoke", "--demos", made / "demos.npz"]
    arguments += ["--set", "demo_episodes=2", "--seed", 2, "--out", tmp_path / "run"]
    assert qdil("train", *arguments) == 2
    assert "expert of seed 1, not 2: add --set expert_seed=1" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_without_a_file_the_expert_of_the_runs_own_seed_is_asked_for(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arguments = ["--env", "walker2d", "--method", "gail", "--budget", "smoke", "--seed", 2]
    assert qdil("train", *arguments) == 2
    words = capsys.readouterr().err
    assert f"no demonstrations at {Path('results/smoke/walker2d/demos-1-seed-2.npz')}" in words
    assert "'qdil demos --env walker2d --budget smoke --seed 2'" in words
    assert qdil("train", *arguments, "--set", "expert_seed=1", "--set", "demo_attempts=3") == 2
    words = capsys.readouterr().err
    assert "demos-1-seed-1.npz" in words and "--seed 1 --attempts 3'" in words


def test_a_manifest_names_the_expert_of_the_demonstrations(made):
    manifests = {name: json.loads((made / name / "manifest.json").read_text()) for name in ("true", "gail")}
    expert = {"run": "smoke/walker2d/true/seed-1", "seed": 1, "archive_sha256": sha256(made / "true" / "archive.npz")}
    assert manifests["gail"]["demonstrations_expert"] == expert
    assert manifests["gail"]["demonstrations_sha256"] == sha256(made / "demos.npz")
    assert manifests["true"]["demonstrations_expert"] is None


def test_another_number_of_demonstrations_than_is_recorded_is_refused(made, tmp_path, capsys):
    arguments = ["--env", "walker2d", "--method", "gail", "--budget", "smoke", "--demos", made / "demos.npz"]
    assert qdil("train", *arguments, "--out", tmp_path / "run") == 2
    assert "holds 2 demonstrations, not 1: add --set demo_episodes=2" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_settings_of_speed_alone_do_not_make_a_finished_run_another(made, tmp_path, capsys):
    copy = tmp_path / "run"
    shutil.copytree(made / "true", copy)
    config = json.loads((copy / "config.json").read_text())
    del config["eval_batch_size"]  # as a run of an older version
    (copy / "config.json").write_text(json.dumps(config | {"eval_chunk_steps": 7}))
    arguments = ["--env", "walker2d", "--method", "true", "--budget", "smoke", "--out", copy]
    assert qdil("train", *arguments) == 0
    assert "already finished" in capsys.readouterr().out
    assert from_json(config).evaluation.eval_batch_size == Evaluation.eval_batch_size
    assert qdil("train", *arguments, "--set", "gamma=0.5") == 2


def test_what_is_changed_is_in_the_name_of_its_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arguments = ["--env", "walker2d", "--method", "true", "--budget", "smoke", "--set", "iterations=1"]
    assert qdil("train", *arguments, "--set", "cells=5", "--set", "warmup_updates=0") == 0  # cells are five anyway
    assert list(Path("results/smoke/walker2d").glob("*/*")) == [
        Path("results/smoke/walker2d/true+iterations=1+warmup_updates=0/seed-1")
    ]


def test_more_demonstrations_than_elites_are_refused(made, tmp_path, capsys):
    arguments = ["--env", "walker2d", "--budget", "smoke", "--expert", made / "true", "--out", tmp_path / "d.npz"]
    assert qdil("demos", *arguments, "--episodes", 500) == 2
    assert "only" in capsys.readouterr().err


def test_verify_finds_a_run_as_it_was(made, capsys):
    assert qdil("verify", made / "gail") == 0
    output = capsys.readouterr().out
    assert "All files match the manifest" in output and "elites on new episodes" in output
    assert summary.sentences(summary.read(made / "gail")) in output
    found = verify.verify(made / "true")
    elites = read_archive(made / "true")
    assert found.sampled == min(8, len(elites["index"])) and set(found.returns[:, 0]) <= set(elites["true_return"])
    before, after = found.returns.mean(axis=0)
    assert after == pytest.approx(before, rel=0.5) and (found.moved < 0.5).all()


def test_verify_notices_what_was_changed_or_lost(made, tmp_path, capsys):
    copy = tmp_path / "run"
    shutil.copytree(made / "true", copy)
    with open(copy / "metrics.csv", "a") as file:
        file.write("\n")
    assert qdil("verify", copy) == 1
    assert "metrics.csv: does not match the manifest" in capsys.readouterr().out
    shutil.copy(made / "true" / "metrics.csv", copy)
    (copy / "policies.npz").unlink()
    assert qdil("verify", copy) == 0
    output = capsys.readouterr().out
    assert "policies.npz: missing" in output and "No policies here" in output
    (copy / "metrics.csv").unlink()
    assert qdil("verify", copy) == 1
    assert qdil("verify", tmp_path / "nowhere") == 2


def test_a_dry_run_plans_and_trains_nothing(tmp_path, capsys):
    arguments = ["--env", "walker2d", "--method", "mconbo-gail", "--budget", "smoke", "--set", "iterations=7"]
    assert qdil("train", *arguments, "--dry-run", "--out", tmp_path / "run") == 0
    output = capsys.readouterr().out
    assert '"iterations": 7' in output and "estimate:" in output
    config = make_config("walker2d", "mconbo-gail", "smoke", iterations=7)
    planned = plan.plan(config)
    assert planned.reward_rounds == 7 + 2 and planned.speed.reward_seconds > 0
    assert 0 < planned.seconds < 600
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("method", ["true", "mconbo-gail"])
def test_the_steps_that_are_planned_are_those_that_a_run_makes(made, tmp_path, method, monkeypatch):
    """Counted by what the run itself keeps: the steps its normaliser has seen, and the lengths of its episodes."""
    config = make_config("walker2d", method, "smoke", iterations=3, demo_episodes=2)
    seen, evaluated, evaluate = [], [], ppga.evaluate

    def counted(search, policies, key):
        candidates = evaluate(search, policies, key)
        evaluated.append(candidates.length.sum() * config.evaluation.episodes)
        return candidates

    def append_seen(search, row):
        seen.append(float(search.state.stats.seen))

    monkeypatch.setattr(ppga, "evaluate", counted)
    train(config, tmp_path, made / "demos.npz", AfterIteration(append_seen))
    steps = plan.count(config, learns=method != "true", k=2)
    assert steps.warm_up + steps.training == seen[-1]
    recorded = pd.read_csv(tmp_path / "metrics.csv")["env_steps"].iloc[-1]
    assert recorded == steps.warm_up + steps.training + sum(evaluated[:3])
    assert 0 < sum(evaluated[:3]) <= steps.evaluation == 3 * 8 * 2 * 50
    assert 0 < sum(evaluated[3:]) <= steps.rescoring
    assert len(evaluated[3:]) <= 4 * 10  # 25 cells, 8 at a time; 20 episodes, 2 at a time


def test_an_estimate_counts_what_a_reward_learns_before_the_run(monkeypatch):
    """GIRIL's training from demonstrations, no environment step of which is in ``metrics.csv``."""
    config = make_config("walker2d", "mconbo-gail", "smoke", demo_episodes=2)
    given = []

    class SlowToBegin(plan.Engine):
        def init(self, key, demos):
            given.append(demos)
            time.sleep(3.0)
            return super().init(key, demos)

    monkeypatch.setattr(plan, "Engine", SlowToBegin)
    assert plan.plan(config).speed.start_seconds > 3.0
    assert [len(demos.obs) for demos in given] == [2 * 50]


def changed(original: Path, copy: Path, **settings: object) -> Path:
    """A copy of a run with other ``settings``, which its manifest knows."""
    shutil.copytree(original, copy)
    write_json(copy / "config.json", json.loads((copy / "config.json").read_text()) | settings)
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["sha256"]["config.json"] = sha256(copy / "config.json")
    write_json(copy / "manifest.json", manifest)
    return copy


def test_what_more_devices_made_is_verified_on_those_that_are_here(made, tmp_path):
    found = verify.verify(changed(made / "true", tmp_path / "run", devices=64))
    assert found.sound() and found.sampled > 0 and not found.obstacle


def test_a_run_of_another_version_is_hashed_and_no_more(made, tmp_path, capsys):
    assert qdil("verify", changed(made / "true", tmp_path / "run", wings=2)) == 0
    output = capsys.readouterr().out
    assert "All files match the manifest" in output and "settings are of another version: wings" in output


def test_devices_that_are_not_there_are_refused_before_a_dry_run(capsys, tmp_path):
    arguments = ["train", "--env", "walker2d", "--method", "true", "--budget", "smoke", "--devices", 64]
    for more in (["--dry-run"], ["--out", tmp_path / "run"]):
        assert qdil(*arguments, *more) == 2
        output = capsys.readouterr()
        assert (
            output.out == "" and output.err.startswith("qdil: devices=64 was asked for") and output.err.count("\n") == 1
        )
    assert not (tmp_path / "run").exists()


def test_a_damaged_file_of_a_run_is_named(made, tmp_path, capsys):
    copy = tmp_path / "run"
    shutil.copytree(made / "gail", copy)
    arguments = ["train", "--env", "walker2d", "--method", "gail", "--budget", "smoke", "--out", copy]
    arguments += ["--demos", made / "demos.npz", "--set", "demo_episodes=2"]
    (copy / "manifest.json").write_text('{"commit": "a')
    assert (qdil(*arguments), qdil("verify", copy)) == (2, 2)
    output = capsys.readouterr().err
    assert output.count("manifest.json is damaged") == output.count("\n") == 2
    shutil.copy(made / "gail" / "manifest.json", copy)
    (copy / "config.json").write_bytes(b"\xff{")
    assert (qdil(*arguments), qdil("verify", copy)) == (2, 1)
    output = capsys.readouterr()
    assert "config.json is damaged" in output.err and "config.json: does not match the manifest" in output.out
    shutil.copy(made / "gail" / "config.json", copy)
    (copy / "archive.npz").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(ConfigError, match="archive.npz is damaged"):
        read_archive(copy)


@pytest.mark.slow
@pytest.mark.parametrize("env", ["halfcheetah", "humanoid"])
def test_the_other_robots_run_end_to_end(env, tmp_path):
    common = ["--env", env, "--budget", "smoke"]
    assert qdil("train", *common, "--method", "true", "--out", tmp_path / "true") == 0
    assert qdil("demos", *common, "--expert", tmp_path / "true", "--out", tmp_path / "demos.npz") == 0
    for method in ("gail", "mconbo-gail"):
        arguments = [*common, "--method", method, "--demos", tmp_path / "demos.npz", "--out", tmp_path / method]
        assert qdil("train", *arguments) == 0
        assert len(read_archive(tmp_path / method)["index"]) > 0
