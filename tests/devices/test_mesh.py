"""How many devices a run uses, and the sentence about those that are idle."""

import jax
import pytest

from qdil.devices import mesh
from qdil.errors import ConfigError


@pytest.fixture
def eight(monkeypatch):
    monkeypatch.setattr(jax, "device_count", lambda: 8)


@pytest.mark.parametrize(
    ("per_copy", "candidates", "used"), [(8, 8, 8), (64, 96, 8), (10, 25, 5), (7, 8, 1), (12, 18, 6), (1000, 300, 5)]
)
def test_as_many_devices_as_divide_both_counts(eight, per_copy, candidates, used):
    assert mesh.choose_num_devices(0, per_copy, candidates) == used


def test_idle_devices_are_reported_with_counts_that_would_use_all(eight):
    assert mesh.idle_devices(0, 64, 96) is None
    assert mesh.idle_devices(5, 1000, 300) is None  # the user asked for five
    sentence = mesh.idle_devices(0, 1000, 300)
    assert sentence.startswith("Using 5 of 8 devices")
    assert "num_envs=3000 and candidates=304 would use all" in sentence
    assert mesh.choose_num_devices(0, 3000 // 3, 304) == 8
    assert "num_envs=24 and candidates=8 " in mesh.idle_devices(0, 7, 8)


@pytest.mark.parametrize(
    ("requested", "counts", "message"),
    [(9, (9, 9), "devices=9 was asked for, but this process has 8"), (3, (8, 9), "devices=3 must divide"),
     (3, (9, 8), "here 9 and 8")],
)  # fmt: skip
def test_what_cannot_be_met_is_refused_in_a_sentence(eight, requested, counts, message):
    with pytest.raises(ConfigError, match=message) as refused:
        mesh.choose_num_devices(requested, *counts)
    assert str(refused.value).endswith(".")


def test_of_several_hosts_none_may_be_left_out(eight, monkeypatch):
    monkeypatch.setattr(jax, "process_count", lambda: 2)
    assert mesh.choose_num_devices(0, 8, 16) == 8
    with pytest.raises(ConfigError, match="several hosts"):
        mesh.choose_num_devices(4, 8, 16)
    with pytest.raises(ConfigError, match="must divide"):
        mesh.choose_num_devices(0, 12, 16)
