"""Two processes, which stand for two hosts, train the run that one process trains with as many devices."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from qdil.cli import main
from qdil.devices import hosts
from qdil.errors import ConfigError

pytestmark = pytest.mark.physics

TRAIN = ["train", "--env", "walker2d", "--method", "true", "--budget", "smoke", "--out"]


def host(out: Path, number: int, address: str, *more: str) -> subprocess.Popen:
    """One of two hosts, with a single device."""
    variables = {"JAX_COORDINATOR_ADDRESS": address, "JAX_NUM_PROCESSES": "2", "JAX_PROCESS_ID": str(number)}
    environment = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=1", **variables}
    return subprocess.Popen(
        [sys.executable, "-m", "qdil", *TRAIN, str(out), *more], env=environment, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip


def two_hosts(out: Path, *more: str) -> tuple[list[int], list[str]]:
    """``qdil train`` on both: their exit codes and outputs."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    pair = [host(out, number, address, *more) for number in range(2)]
    try:
        outputs = [process.communicate(timeout=600)[0] for process in pair]
    finally:
        for process in pair:
            process.kill()  # if one has failed, the other waits for it
    return [process.returncode for process in pair], outputs


def test_two_hosts_make_the_run_of_one(tmp_path):
    codes, outputs = two_hosts(tmp_path / "pair")
    assert codes == [0, 0], outputs
    assert "is finished" in outputs[0] and "finished" not in outputs[1]
    assert main([*TRAIN, str(tmp_path / "one"), "--devices", "2"]) == 0
    of_pair, one = (np.load(tmp_path / name / "archive.npz") for name in ("pair", "one"))
    assert of_pair["index"].tolist() == one["index"].tolist()
    np.testing.assert_allclose(of_pair["true_return"], one["true_return"], rtol=1e-3)
    assert '"2 x' in (tmp_path / "pair" / "manifest.json").read_text()
    # Host 0 checks the folder for both, so neither waits for a host that has refused.
    codes, outputs = two_hosts(tmp_path / "pair", "--set", "gamma=0.5")
    assert codes == [2, 2], outputs
    assert "with other settings" in outputs[0] and "host 0 refused" in outputs[1]


@pytest.mark.parametrize(
    "values, message",
    [({"JAX_PROCESS_ID": "0"}, "is set without JAX_COORDINATOR_ADDRESS, JAX_NUM_PROCESSES"),
     ({"JAX_COORDINATOR_ADDRESS": "a:1", "JAX_NUM_PROCESSES": "two", "JAX_PROCESS_ID": "0"}, "must be numbers")],
)  # fmt: skip
def test_variables_that_do_not_fit_are_refused(monkeypatch, values, message):
    for name in hosts.VARIABLES:
        monkeypatch.delenv(name, raising=False)
    for name, value in values.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match=message):
        hosts.join()
