"""The Snakemake workflow: what it plans, and a small sweep run for real, killed once on its way."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SNAKEMAKE = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "workflow" / "Snakefile"), "--cores", "2"]
SNAKEMAKE += ["--nolock", "--rerun-incomplete", "--rerun-triggers", "mtime"]


def config(results: Path, methods: str, **more: str) -> list[str]:
    words = {"budget": "smoke", "envs": "walker2d", "methods": methods, "seeds": "1", "results": results, **more}
    return ["--config", *(f"{name}={value}" for name, value in words.items())]


def planned(results: Path, methods: str, rule: str = "all", **more: str) -> dict[str, int]:
    """How many jobs of each rule a dry run announces."""
    command = [*SNAKEMAKE, "--dry-run", rule, *config(results, methods, **more)]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert said.returncode == 0, said.stdout + said.stderr
    if "Nothing to be done" in said.stdout + said.stderr:
        return {}
    table = (said.stdout + said.stderr).split("Job stats:")[-1].splitlines()[3:]
    rows = [line.split() for line in table]
    return {row[0]: int(row[1]) for row in rows[: next(i for i, row in enumerate(rows) if row[:1] == ["total"])]}


def test_imitators_bring_the_expert_and_its_demonstrations_along(tmp_path):
    assert planned(tmp_path, "gail,mconbo-gail", seeds="1,2,3") == {"all": 1, "run": 2 * 3 + 1, "demos": 1}


def test_methods_without_demonstrations_need_none(tmp_path):
    assert planned(tmp_path, "true,mbo-true,zero", seeds="1,2") == {"all": 1, "run": 6}


def test_what_is_there_is_not_run_again(tmp_path):
    manifest = tmp_path / "smoke" / "walker2d" / "true" / "seed-1" / "manifest.json"
    manifest.parent.mkdir(parents=True)
    manifest.write_text("{}")
    assert planned(tmp_path, "true,gail") == {"all": 1, "run": 1, "demos": 1}


def test_a_study_is_its_experiments_each_with_the_demonstrations_it_learns_from(tmp_path):
    """Figs. 12-14: the expert and two methods on 4, 2, 1 and 10 demonstrations."""
    plan = planned(tmp_path, "", budget="laptop", studies="demonstrations", seeds="1,2")
    assert plan == {"all": 1, "run": 2 * (1 + 2 * 4), "demos": 4, "claims": 1}


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
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert "train --env walker2d --method mconbo-gail --set bonus_p=1.0 --set bonus_q=0.0" in said.stdout + said.stderr


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
    assert plan == {"notebooks": 1, "notebook": 2, "run": 3 * 3, "demos": 1}  # three seeds of the study "main"


def test_runs_that_are_there_are_left_alone_by_notebooks(tmp_path):
    """Snakemake removes what it is about to make: a finished run must never be among that."""
    manifest = tmp_path / "laptop" / "walker2d" / "true" / "seed-1" / "manifest.json"
    manifest.parent.mkdir(parents=True)
    manifest.write_text("{}")
    more = {**NOTEBOOKS, "scratch": str(tmp_path / "scratch"), "minutes": "1", "budget": "laptop", "train": "1"}
    assert planned(tmp_path, "", "notebooks", **more)["run"] == 3 * 3 - 1


def test_a_wrong_method_is_refused_in_a_sentence(tmp_path):
    command = [*SNAKEMAKE, "--dry-run", *config(tmp_path, "gial")]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert said.returncode != 0 and "unknown method 'gial'" in said.stdout + said.stderr


@pytest.mark.skipif(os.name != "posix", reason="kills a process group")
def test_a_killed_sweep_goes_on(tmp_path):
    command = [*SNAKEMAKE, *config(tmp_path, "true,mbo-gail")]
    sweep = subprocess.Popen(command, cwd=ROOT, start_new_session=True, stdout=subprocess.DEVNULL)
    expert = tmp_path / "smoke" / "walker2d" / "true" / "seed-1"
    while not (expert / "config.json").exists() and sweep.poll() is None:
        time.sleep(0.1)
    os.killpg(sweep.pid, signal.SIGKILL)
    sweep.wait()
    assert (expert / "config.json").exists() and not (expert / "manifest.json").exists()
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    for method in ("true", "mbo-gail"):
        assert (tmp_path / "smoke" / "walker2d" / method / "seed-1" / "manifest.json").exists()
