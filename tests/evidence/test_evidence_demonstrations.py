"""Tables of demonstrations agree with the files."""

import numpy as np

from qdil.evidence import demonstrations
from qdil.files import write_npz
from qdil.runs.folder import folder_of


def recorded(lengths=(3, 5)):
    rng, rows = np.random.default_rng(0), sum(lengths)
    episode = np.repeat(np.arange(len(lengths)), lengths)
    proxy = rng.integers(0, 2, (rows, 2)).astype(float)
    return {
        "obs": rng.normal(size=(rows, 17)), "next_obs": rng.normal(size=(rows, 17)),
        "action": rng.normal(size=(rows, 6)), "proxy": proxy, "episode": episode,
        "episode_return": np.array([10.0, 14.0])[: len(lengths)],
        "elite_return": np.array([11.0, 12.0])[: len(lengths)],
        "elite_measures": np.full((len(lengths), 2), 0.25),
        "episode_measures": np.array([proxy[episode == e].mean(axis=0) for e in range(len(lengths))]),
    }  # fmt: skip


def test_only_robots_with_a_file_are_read(tmp_path):
    folder = tmp_path / "laptop"
    write_npz(folder / "walker2d" / "demos-4-seed-2.npz", **recorded())
    write_npz(folder / "humanoid" / "demos-2-seed-2.npz", **recorded())  # not the budget's usual number
    write_npz(folder / "halfcheetah" / "demos-4-seed-1.npz", **recorded())  # another expert
    found = demonstrations.of_robots("laptop", 2, tmp_path)
    assert list(found) == ["walker2d"] and found["walker2d"]["obs"].shape == (8, 17)


def test_what_is_there_is_not_recorded_again(tmp_path):
    path = tmp_path / "smoke" / "walker2d" / "demos-1-seed-3.npz"
    missing = demonstrations.record_missing("walker2d", "smoke", 3, tmp_path)
    assert missing.startswith("none recorded: there is no finished") and "seed-3" in missing
    write_npz(path, **recorded())
    before = path.read_bytes()
    assert demonstrations.record_missing("walker2d", "smoke", 3, tmp_path).startswith("loaded")
    assert path.read_bytes() == before


def test_an_expert_without_policies_gives_no_demonstrations(tmp_path):
    folder = folder_of("true", "walker2d", "smoke", 1, tmp_path)
    folder.mkdir(parents=True)
    for name in ("config.json", "manifest.json"):
        (folder / name).write_text("{}")
    write_npz(folder / "archive.npz", index=np.zeros(0))
    assert "has no policies.npz" in demonstrations.record_missing("walker2d", "smoke", 1, tmp_path)


def test_a_row_per_episode_beside_the_archives_values():
    demos = recorded()
    table = demonstrations.episodes(demos, "walker2d")
    assert table["steps (rows)"].tolist() == [3, 5] and list(table.index) == [1, 2]
    assert table["return"].tolist() == [10.0, 14.0] and table["return, as selected"].tolist() == [11.0, 12.0]
    assert table["foot_left down"].tolist() == [demos["proxy"][:3, 1].mean(), demos["proxy"][3:, 1].mean()]
    assert set(table["foot down, as selected"]) == {0.25}


def test_falls_are_shown_where_the_file_tells():
    table = demonstrations.episodes(recorded() | {"falls": np.array([3, 0]), "demo_attempts": np.array(16)}, "walker2d")
    assert table["falls of 16"].tolist() == [3, 0]
    assert not any("falls" in column for column in demonstrations.episodes(recorded(), "walker2d"))


def test_summary_gives_means_and_deviations():
    table = demonstrations.summary({"walker2d": recorded(), "humanoid": recorded((4,))})
    assert table.loc["walker2d", "return per episode"] == "12 ± 3" and table.loc["walker2d", "rows"] == 8
    assert table.loc["humanoid", "steps per episode"] == "4"
    assert demonstrations.summary({}).empty


def test_one_step_shows_its_own_numbers():
    demos = recorded()
    table = demonstrations.one_step(demos, 4)
    assert table["numbers"].tolist() == [17, 6, 17, 2]
    assert table["the first of them"].iloc[3].split() == [f"{x:.2f}" for x in demos["proxy"][4]]


def test_luck_compares_returns_and_places():
    archive = {
        "true_return": np.array([10.0, 30.0]),
        "rescored_return": np.array([10.0, 20.0]),
        "measures": np.array([[0.1, 0.2], [0.5, 0.5]]),
        "rescored_measures": np.array([[0.4, 0.6], [0.5, 0.6]]),
    }
    table = demonstrations.luck({"walker2d": archive})
    np.testing.assert_allclose(table.loc["walker2d"], [20.0, 15.0, -25.0, 0.3])
