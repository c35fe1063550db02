"""Figures and tables come from run folders, and what the README shows is what the kept runs say."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from qdil import run
from qdil.config import ConfigError
from qdil.evidence import figures
from qdil.files import write_npz

ROOT = Path(run.__file__).parent.parent
LISTED = subprocess.run(["git", "-C", ROOT, "ls-files", "results/laptop"], capture_output=True, text=True).stdout
KEPT = sorted({Path(line).parts[1:3] for line in LISTED.split() if line.endswith("seed-1/manifest.json")})


def fake_run(folder: Path, returns: list[float]) -> None:
    """A finished run of two iterations whose numbers are known."""
    folder.mkdir(parents=True)
    rows = [f"{i},{i * 1e6},{i * 60},{sum(returns)},0.5,{max(returns)},{np.mean(returns)},1,0" for i in (1, 2)]
    (folder / "metrics.csv").write_text("\n".join([",".join(run.FIRST_COLUMNS), *rows]) + "\n")
    values = np.array(returns)
    measures = np.linspace(0.1, 0.9, len(values))[:, None].repeat(2, axis=1)
    again = {"rescored_return": values - 1}
    write_npz(folder / "archive.npz", index=np.arange(len(values)), measures=measures, true_return=values,
              fitness=values, length=values, cells=np.array([2, 2]), **again)  # fmt: skip
    (folder / "config.json").write_text("{}")
    (folder / "manifest.json").write_text("{}")


def test_tables_and_pictures_come_from_the_runs(tmp_path):
    fake_run(tmp_path / "laptop" / "walker2d" / "true" / "seed-1", [10.0, 30.0])
    written = figures.write_figures("walker2d", "laptop", 1, tmp_path)
    assert {path.suffix for path in written} == {".png", ".md"}
    assert all(path.stat().st_size > 100 for path in written)
    assert written[-1].read_text().splitlines()[-1] == "| `true` | 40 | 50.0% | 30 | 20 | 19 | 2.0 | 2.0 |"


def test_nothing_to_draw_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="no finished runs"):
        figures.write_figures("walker2d", "laptop", 1, tmp_path)


@pytest.mark.parametrize("budget, env", KEPT)
def test_the_readme_shows_what_the_kept_runs_say(budget, env):
    table = figures.summary_table(figures.finished_runs(env, budget, 1, ROOT / "results"))
    assert table in (ROOT / "README.md").read_text()
