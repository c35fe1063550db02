"""The report of a demonstrations file: its numbers, the spread, and a warning if nothing stands."""

import numpy as np
import pytest

from qdil.files import write_npz
from qdil.imitation import demo_report


def demos(falls=(False, True), lengths=(5, 3)):
    """Two demonstrations, recorded 0.5 apart; their demonstrators were selected 1.0 apart."""
    episode = np.repeat(np.arange(len(lengths)), lengths)
    ends = np.cumsum(lengths) - 1
    terminated = np.zeros(len(episode), bool)
    terminated[ends] = falls
    return {
        "episode": episode,
        "terminated": terminated,
        "episode_return": np.array([1234.4, 56.0]),
        "episode_measures": np.array([[0.1, 0.2], [0.4, 0.6]]),
        "elite_return": np.array([1000.0, 70.0]),
        "elite_measures": np.array([[0.1, 0.1], [0.9, 0.7]]),
        "falls": np.array([3, 16]),
        "demo_attempts": np.array(16),
    }


def test_the_table_has_the_files_numbers():
    header, first, second, spread = demo_report.report(demos()).splitlines()
    assert header.split()[:3] == ["demonstration", "steps", "end"]
    assert first.endswith("   3 of 16") and second.endswith("  16 of 16")
    assert "time limit   1,234" in first and "0.10, 0.20" in first and "0.100" in first  # 0.1 from its place
    assert " fall " in second and "0.40, 0.60" in second and "0.90, 0.70" in second
    assert f"{np.hypot(0.5, 0.1):.3f}" in second
    assert spread == "Smallest distance between two demonstrations: 1.000 as selected, 0.500 as recorded."
    assert len({len(line) for line in (header, first, second)}) == 1


def test_files_of_earlier_versions_do_not_count_falls():
    old = {name: values for name, values in demos().items() if name not in ("falls", "demo_attempts")}
    header = demo_report.report(old).splitlines()[0]
    assert header.split()[-1] == "distance"


@pytest.mark.parametrize("count", [2, 3, 6])
def test_the_smallest_distance_is_that_of_the_nearest_pair(count):
    places = np.random.default_rng(count).random((count, 3))
    pairs = [np.sqrt(((a - b) ** 2).sum()) for i, a in enumerate(places) for b in places[:i]]
    assert demo_report.smallest_distance(places) == pytest.approx(min(pairs))


def test_a_warning_with_figures_if_all_fall():
    warning = demo_report.fall_warning(demos(falls=(True, True)))
    assert warning.startswith("Warning: all 2 demonstrations end in a fall, after 3 to 5 steps")
    assert "of 32 simulated episodes, 19 fell" in warning
    assert demo_report.report(demos(falls=(True, True))).endswith(warning)


def test_a_single_demonstration_has_no_spread_and_may_fall():
    one = demos() | {"episode": np.zeros(4, int), "terminated": np.array([False] * 3 + [True])}
    one |= {name: one[name][:1] for name in ("episode_return", "episode_measures", "elite_return", "elite_measures")}
    one |= {"falls": np.array([16])}
    lines = demo_report.report(one).splitlines()
    assert len(lines) == 3 and "the demonstration ends in a fall, after 4 steps; of 16" in lines[-1]


def test_no_warning_if_one_stands_or_the_file_does_not_tell(tmp_path):
    assert demo_report.fall_warning(demos()) is None
    silent = {name: values for name, values in demos((True, True)).items() if name != "terminated"}
    assert demo_report.fall_warning(silent) is None
    for name, columns in {"stands": demos(), "silent": silent}.items():
        write_npz(tmp_path / f"{name}.npz", **columns)
        assert demo_report.fall_warning_of(tmp_path / f"{name}.npz") is None
    write_npz(tmp_path / "falls.npz", **demos((True, True)))
    assert demo_report.fall_warning_of(tmp_path / "falls.npz") == demo_report.fall_warning(demos((True, True)))


def test_a_file_that_cannot_be_read_is_left_to_training(tmp_path):
    (tmp_path / "damaged.npz").write_bytes(b"PK\x03\x04")
    for name in ("damaged.npz", "missing.npz"):
        assert demo_report.fall_warning_of(tmp_path / name) is None
