"""Run folders with known numbers, for tests of code that reads finished runs."""

from pathlib import Path

import numpy as np

from qdil.files import sha256, write_csv, write_json, write_npz
from qdil.qd.landing import CORRECTED, METRICS, SHARES
from qdil.runs.folder import folder_of
from qdil.runs.train import FIRST_COLUMNS

COLUMNS = [*FIRST_COLUMNS, "c0"]


def write_run(root: Path, env: str, experiment: str, seed: int, budget: str = "laptop", **final: float) -> Path:
    """A finished run of three iterations that ends with the metrics ``final``; metrics that are not given are 1.

    Corrected metrics that are not given equal the claimed ones. Two adjacent cells of its 2 × 2 archive are filled,
    with returns 10 and 30; scored again, each is 1 lower and stays in its cell.
    """
    folder = folder_of(experiment, env, budget, seed, root)
    claimed = {name: final.get(name, 1.0) for name in METRICS}
    corrected = {new: final.get(new, claimed[name]) for name, new in zip(METRICS, CORRECTED, strict=True)}
    shares = {name: final.get(name, 1.0) for name in SHARES}
    others = {name: value for name, value in final.items() if name not in {*claimed, *corrected, *shares}}
    last = {"learned_qd_score": 1.0, **claimed, **others}
    rows = [
        {"iteration": i, "env_steps": 1e6 * i, "wall_seconds": 60.0 * i, "restarts": 0, "c0": 1.0, **last}
        for i in (1, 2, 3)
    ]
    write_csv(folder / "metrics.csv", COLUMNS, rows)
    write_json(folder / "summary.json", claimed | corrected | shares)
    write_archive(folder, index=[0, 1], returns=[10.0, 30.0])
    (folder / "config.json").write_text("{}")
    (folder / "manifest.json").write_text("{}")
    return folder


def write_archive(folder: Path, index: list[int], returns: list[float]) -> None:
    """Replace a run's archive of 2 × 2 cells."""
    values = np.array(returns)
    measures = (np.array([[i // 2, i % 2] for i in index]) + 0.5) / 2
    again = {"rescored_return": values - 1, "rescored_fitness": values - 1, "rescored_measures": measures}
    write_npz(folder / "archive.npz", index=np.array(index), measures=measures, true_return=values, fitness=values,
              length=values, cells=np.array([2, 2]), **again)  # fmt: skip


def write_arms(root: Path, env: str, metric: str, arms: dict[str, list[float]], budget: str = "laptop") -> None:
    """Runs with given values of one metric, by experiment: one seed per value, from 1."""
    for experiment, values in arms.items():
        for seed, value in enumerate(values, start=1):
            write_run(root, env, experiment, seed, budget, **{metric: value})


def same_run(one: Path, other: Path) -> bool:
    """The same archive and its history, byte for byte, and the same metrics but for the clock."""
    rows = [np.genfromtxt(f / "metrics.csv", delimiter=",", names=True) for f in (one, other)]
    columns = [name for name in rows[0].dtype.names if name != "wall_seconds"]
    for name in columns:
        np.testing.assert_array_equal(rows[0][name], rows[1][name])
    return all(sha256(one / name) == sha256(other / name) for name in ("archive.npz", "history.npz"))
