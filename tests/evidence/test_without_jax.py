"""Reading finished runs never imports JAX, so it starts in a second and needs no accelerator."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from fake_runs import write_arms

import qdil.evidence

READERS = [
    *(f"qdil.evidence.{path.stem}" for path in Path(qdil.evidence.__file__).parent.glob("[a-z]*.py")),
    *(f"qdil.runs.{name}" for name in ("folder", "experiments", "studies")),
]
CODE = """
import importlib, json, sys, time
from qdil import cli
status = cli.main(["claims", "--results", sys.argv[1], "--env", "walker2d"])
seconds, slow = time.process_time(), sorted({"jax", "scipy.stats", "matplotlib", "ribs"} & set(sys.modules))
for name in sys.argv[2:]:
    importlib.import_module(name)
print(json.dumps({"status": status, "seconds": seconds, "slow": slow, "jax": "jax" in sys.modules}))
"""


@pytest.mark.physics  # starts a process
def test_claims_are_judged_in_a_second_or_two_and_readers_import_no_jax(tmp_path):
    write_arms(tmp_path, "walker2d", "qd_score", {"mconbo-gail": [110.0, 120.0], "gail": [10.0, 20.0]})
    command = [sys.executable, "-c", CODE, str(tmp_path), *READERS]
    ran = subprocess.run(command, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    *printed, last = ran.stdout.splitlines()
    found = json.loads(last)
    assert "C1 walker2d (paper): QD-score: MConbo-GAIL above GAIL: reproduced" in printed
    assert found["status"] == 0 and found["slow"] == [] and not found["jax"]
    assert found["seconds"] < 2, "processor time"  # 0.8 s on two quiet cores
