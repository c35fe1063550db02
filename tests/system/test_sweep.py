"""The Snakemake workflow: the jobs that it plans, and a small sweep that is killed once and completed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from snakemake.cli import get_argument_parser

from qdil.series import index

pytestmark = pytest.mark.physics  # starts processes

ROOT = Path(__file__).parents[2]
SNAKEMAKE = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "workflow" / "Snakefile"), "--cores", "2"]
SNAKEMAKE += ["--nolock", "--rerun-incomplete", "--rerun-triggers", "mtime"]


def config(results: Path, methods: str, **more: str) -> list[str]:
    words = {"budget": "smoke", "envs": "walker2d", "methods": methods, "seeds": "1", "results": results, **more}
    return ["--config", *(f"{name}={value}" for name, value in words.items())]


def planned(results: Path, methods: str, rule: str = "all", **more: str) -> dict[str, int]:
    """How many jobs of each rule a dry run announces."""
    command = [*SNAKEMAKE, "--dry-run", rule, *config(results, methods, **more)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    if "Nothing to be done" in done.stdout + done.stderr:
        return {}
    table = (done.stdout + done.stderr).split("Job stats:")[-1].splitlines()[3:]
    rows = [line.split() for line in table]
    return {row[0]: int(row[1]) for row in rows[: next(i for i, row in enumerate(rows) if row[:1] == ["total"])]}


def test_imitators_bring_the_expert_and_its_demonstrations_along(tmp_path):
    assert planned(tmp_path, "gail,mconbo-gail", seeds="1,2,3") == {"all": 1, "run": 3 * 3, "demos": 3}


def test_each_seed_learns_from_its_own_expert(tmp_path):
    command = [*SNAKEMAKE, "--dry-run", "--printshellcmds", *config(tmp_path, "gail", seeds="2,3")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    folder = tmp_path / "smoke" / "walker2d"
    for seed in (2, 3):
        file = folder / f"demos-1-seed-{seed}.npz"
        assert f"--seed {seed} --out {folder}/gail/seed-{seed} --demos {file}" in done.stdout + done.stderr
        recorded = f"--seed {seed} --episodes 1 --expert {folder}/true/seed-{seed} --out {file}"
        assert recorded in done.stdout + done.stderr


def test_one_expert_for_all_seeds_is_a_setting_of_the_experiment(tmp_path):
    assert planned(tmp_path, "gail+expert_seed=2", seeds="1,2,3") == {"all": 1, "run": 3 + 1, "demos": 1}


def test_methods_without_demonstrations_need_none(tmp_path):
    assert planned(tmp_path, "true,mbo-true,zero", seeds="1,2") == {"all": 1, "run": 6}


def test_what_is_there_is_not_run_again(tmp_path):
    manifest = tmp_path / "smoke" / "walker2d" / "true" / "seed-1" / "manifest.json"
    manifest.parent.mkdir(parents=True)
    manifest.write_text("{}")
    assert planned(tmp_path, "true,gail") == {"all": 1, "run": 1, "demos": 1}


def test_a_study_is_its_experiments_each_with_the_demonstrations_it_learns_from(tmp_path):
    """Figs. 12-14: the expert and two methods on 4, 2, 1 and 10 demonstrations, those of each seed's expert."""
    plan = planned(tmp_path, "", budget="laptop", studies="demonstrations", seeds="1,2")
    assert plan == {"all": 1, "run": 2 * (1 + 2 * 4), "demos": 2 * 4, "claims": 1}


def test_claims_are_judged_once_all_runs_are_there_and_never_from_smoke(tmp_path):
    for budget in ("laptop", "full"):
        assert planned(tmp_path, "true", budget=budget) == {"all": 1, "run": 1, "claims": 1}
    folder = tmp_path / "laptop" / "walker2d" / "true" / "seed-1"
    folder.mkdir(parents=True)
    (folder / "manifest.json").write_text("{}")
    assert planned(tmp_path, "true", budget="laptop") == {"all": 1, "claims": 1}
    (tmp_path / "claims.md").write_text("newer than its runs")
    assert planned(tmp_path, "true", budget="laptop") == {}


def test_studies_and_methods_add_up_and_share_runs(tmp_path):
    plan = planned(tmp_path, "gail,zero", studies="main,p-and-q")
    assert plan == {"all": 1, "run": 3 + 8 + 1, "demos": 1}


def test_an_experiment_runs_with_the_settings_in_its_name(tmp_path):
    command = [*SNAKEMAKE, "--dry-run", "--printshellcmds", *config(tmp_path, "mconbo-gail+bonus_p=1.0+bonus_q=0.0")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert "train --env walker2d --method mconbo-gail --set bonus_p=1.0 --set bonus_q=0.0" in done.stdout + done.stderr


NOTEBOOKS = {"notebooks": "01_background,05_mconbo_gail", "source": "notebooks", "executed": "executed", "seed": "1"}


def test_notebooks_wait_for_one_training_at_smoke_and_only_if_they_show_runs(tmp_path):
    more = {**NOTEBOOKS, "scratch": str(tmp_path), "minutes": "1"}
    assert planned(tmp_path, "", "notebooks", **more) == {"notebooks": 1, "notebook": 2, "trained": 1}
    more["notebooks"] = "01_background"
    assert planned(tmp_path, "", "notebooks", **more) == {"notebooks": 1, "notebook": 1}


def test_beyond_smoke_notebooks_bring_their_runs_only_if_asked_to(tmp_path):
    more = {**NOTEBOOKS, "scratch": str(tmp_path / "scratch"), "minutes": "1", "budget": "laptop"}
    assert planned(tmp_path, "", "notebooks", **more) == {"notebooks": 1, "notebook": 2}
    plan = planned(tmp_path, "", "notebooks", **more, train="1")
    assert plan == {"notebooks": 1, "notebook": 2, "run": 3 * 3, "demos": 3}  # three seeds of the study "main"


def test_runs_that_are_there_are_left_alone_by_notebooks(tmp_path):
    """Snakemake removes what it is about to make: a finished run must never be among that."""
    manifest = tmp_path / "laptop" / "walker2d" / "true" / "seed-1" / "manifest.json"
    manifest.parent.mkdir(parents=True)
    manifest.write_text("{}")
    more = {**NOTEBOOKS, "scratch": str(tmp_path / "scratch"), "minutes": "1", "budget": "laptop", "train": "1"}
    assert planned(tmp_path, "", "notebooks", **more)["run"] == 3 * 3 - 1


def test_a_wrong_method_is_refused_in_a_sentence(tmp_path):
    command = [*SNAKEMAKE, "--dry-run", *config(tmp_path, "gial")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode != 0 and "unknown method 'gial'" in done.stdout + done.stderr


def test_all_notebooks_are_a_target_of_their_own(tmp_path):
    """By default: every numbered notebook, and at smoke the runs that they show."""
    settings = ["--config", "budget=smoke", f"results={tmp_path}", f"scratch={tmp_path}"]
    command = [*SNAKEMAKE, "--dry-run", "--printshellcmds", "notebooks", *settings]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    for name in index.names_in():
        assert f"{name}.ipynb --target {tmp_path}/notebooks/smoke/{name}.ipynb" in done.stdout + done.stderr
    assert "--env walker2d --seed 1 --minutes 30" in done.stdout + done.stderr
    assert "study --budget smoke --env walker2d main" in done.stdout + done.stderr


def test_the_example_profile_is_one_that_snakemake_takes():
    """Its options are Snakemake's; the Snakefile leaves the number of retries to it."""
    profile = yaml.safe_load((ROOT / "workflow" / "profiles" / "slurm" / "config.yaml").read_text())
    options = {option for action in get_argument_parser()._actions for option in action.option_strings}
    assert {f"--{name}" for name in profile} <= options
    assert profile["retries"] > 1 and profile["rerun-triggers"] == ["mtime"]
    assert "retries:" not in (ROOT / "workflow" / "Snakefile").read_text()


def wait_for(expert: Path, sweep: subprocess.Popen, log: Path) -> dict[int, str]:
    """Wait until a sweep's first run has a checkpoint of at least five iterations; return its metrics by iteration."""
    while sweep.poll() is None:
        done = [int(path.name.split("-")[1]) for path in (expert / "checkpoint").glob("[0-9]*.npz")]
        if max(done, default=0) >= 5:
            return {int(line.split(",")[0]): line for line in (expert / "metrics.csv").read_text().splitlines()[1:]}
        time.sleep(0.02)
    raise AssertionError(log.read_text())


@pytest.mark.skipif(os.name != "posix", reason="kills a process group")
def test_a_killed_sweep_resumes_from_its_checkpoint(tmp_path):
    """The finished run keeps the rows, with their times, that were written before the kill."""
    long = "+iterations=60"
    settings = config(tmp_path, f"true{long},mbo-gail", save_seconds="0")
    expert, log = tmp_path / "smoke" / "walker2d" / f"true{long}" / "seed-1", tmp_path / "log"
    with open(log, "w") as file:
        how = {"cwd": ROOT, "stdout": file, "stderr": subprocess.STDOUT}
        command = [*SNAKEMAKE, "--printshellcmds", str(expert / "manifest.json"), *settings]
        sweep = subprocess.Popen(command, start_new_session=True, **how)
        try:
            before = wait_for(expert, sweep, log)
        finally:
            os.killpg(sweep.pid, signal.SIGKILL)
    assert sweep.wait() == -signal.SIGKILL
    assert not (expert / "manifest.json").exists()
    done = subprocess.run([*SNAKEMAKE, *settings], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"Resuming the unfinished run in {expert}" in done.stdout + done.stderr
    for method in ("true", f"true{long}", "mbo-gail"):
        assert (tmp_path / "smoke" / "walker2d" / method / "seed-1" / "manifest.json").exists()
    after = {int(line.split(",")[0]): line for line in (expert / "metrics.csv").read_text().splitlines()[1:]}
    assert list(after) == list(range(1, 61))
    kept = [number for number, line in before.items() if after[number] == line]
    assert kept == list(range(1, len(kept) + 1)) and len(kept) >= 5
