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


def planned(results: Path, methods: str, **more: str) -> dict[str, int]:
    """How many jobs of each rule a dry run announces."""
    command = [*SNAKEMAKE, "--dry-run", *config(results, methods, **more)]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert said.returncode == 0, said.stdout + said.stderr
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
