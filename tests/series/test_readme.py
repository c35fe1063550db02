"""The README and the docs: their generated parts are current, their length and pictures are as promised."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from fake_runs import write_arms
from markdown_cells import cells
from PIL import Image

from qdil.config import make_config
from qdil.evidence import figures
from qdil.methods import BUILT_IN
from qdil.plotting import speed
from qdil.series import index, pictures, readme

ROOT = Path(__file__).parent.parent.parent
README = (ROOT / "README.md").read_text()
PAGES = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "notes").glob("*.md")]


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> Path:
    """A copy of the runs that the repository keeps, without those that a reader has added."""
    root = tmp_path_factory.mktemp("kept")
    listed = subprocess.run(["git", "-C", ROOT, "ls-files", "results"], capture_output=True, text=True, check=True)
    for name in listed.stdout.splitlines():
        target = root / Path(name).relative_to("results")
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.suffix != ".pdf" and (ROOT / name).is_file():
            shutil.copy(ROOT / name, target)
    return root


@pytest.mark.parametrize("page, name", readme.PARTS)
def test_generated_parts_are_current(page, name, kept, monkeypatch):
    monkeypatch.setattr(readme, "RESULTS", kept)
    assert readme.part_in((ROOT / page).read_text(), name) == readme.PARTS[page, name](), "run 'make contents'"


def test_a_part_replaces_what_is_between_its_markers():
    page = "before\n\n<!-- generated: birds -->\nold\n<!-- end: birds -->\n\nafter\n"
    made = readme.put_part(page, "birds", "| wren |")
    assert readme.part_in(made, "birds") == "| wren |"
    assert made.startswith("before\n\n<!--") and made.endswith("-->\n\nafter\n") and "old" not in made
    with pytest.raises(ValueError, match="the page has no"):
        readme.put_part("no markers", "birds", "")


@pytest.mark.parametrize(
    "gail, mconbo, words",
    [
        ([1.0, 2.0], [11.0, 12.1], "MConbo-GAIL beats GAIL on QD-score, as the paper claims: the difference"),
        ([11.0, 12.0], [1.0, 2.0], "MConbo-GAIL does **not** beat GAIL"),
        ([1.0, 12.0], [2.0, 11.0], "the runs do not decide whether MConbo-GAIL beats GAIL"),
    ],
)
def test_the_main_sentence_follows_the_runs(tmp_path, gail, mconbo, words):
    write_arms(tmp_path, "walker2d", "qd_score", {"gail": gail, "mconbo-gail": mconbo})
    assert words in readme.verdicts(tmp_path)


def test_without_runs_the_main_sentence_says_so(tmp_path):
    text = readme.verdicts(tmp_path)
    assert "there are no runs yet on the paper's main claim" in text and "16 have no runs yet." in text


def test_verdicts_are_counted_as_the_page_of_claims_lists_them(kept):
    page = (kept / "claims.md").read_text().split("### walker2d")[1].split("\n##")[0]
    head, *rows = cells(page)
    shown = [dict(zip(head, row, strict=True)) for row in rows if row[0].startswith("C")]
    of_paper = [row for row in shown if row["protocol"] == "paper"]
    without = len(re.findall(r"\bC\d+", page.split("No runs yet:")[1]))
    claimed, corrected = ([row[name] for row in of_paper] for name in ("as claimed", "corrected"))
    counts = [
        [some.count(kind) for kind in ("reproduced", "not reproduced", "inconclusive")] for some in (claimed, corrected)
    ]
    expected = [16, *counts[0], without, 13, *counts[1], 13 - sum(counts[1])]
    assert list(map(int, re.findall(r"\d+", readme.verdicts(kept).splitlines()[1]))) == expected
    assert len(of_paper) + without == 16 and corrected.count("–") <= 3


def test_the_results_are_those_of_the_runs_last_iterations(kept):
    table = {row[0]: row[1:] for row in cells(readme.results(kept))[1:]}
    assert list(table) == ["Expert", "GAIL", "MConbo-GAIL"]
    for row, method in zip(table.values(), ("true", "gail", "mconbo-gail"), strict=True):
        last = [pd.read_csv(file).iloc[-1] for file in (kept / "laptop/walker2d" / method).glob("seed-*/metrics.csv")]
        scores, coverage = ([run[name] for run in last] for name in ("qd_score", "coverage"))
        assert row[0] == f"{np.mean(scores):,.0f} ± {np.std(scores, ddof=1):,.0f}"
        assert row[2].startswith(f"{100 * np.mean(coverage):.1f} ±") and row[-1] == str(len(last))
        landed = [returns_by_landing(file) for file in (kept / "laptop/walker2d" / method).glob("seed-*/archive.npz")]
        scores = [sum(best.values()) for best in landed]
        assert row[1] == f"{np.mean(scores):,.0f} ± {np.std(scores, ddof=1):,.0f}"
        assert row[3].startswith(f"{100 * np.mean([len(best) / 400 for best in landed]):.1f} ±")


def returns_by_landing(file: Path) -> dict[tuple[int, ...], float]:
    """The best mean return of the elites that land in each cell of a 20 × 20 archive on fresh episodes."""
    best: dict[tuple[int, ...], float] = {}
    with np.load(file) as archive:
        for place, value in zip(archive["rescored_measures"], archive["rescored_return"], strict=True):
            cell = tuple(min(19, int(20 * float(share) + 1e-4)) for share in place)
            best[cell] = max(float(value), best.get(cell, -np.inf))
    return best


@pytest.mark.parametrize("env", ["walker2d", "halfcheetah"])
def test_the_laptop_page_shows_the_kept_runs(env, kept):
    main = figures.of_study(figures.finished_runs(env, "laptop", kept), "main")
    assert figures.summary_table(main) in (ROOT / "docs" / "laptop-budget.md").read_text()


def test_budgets_show_their_settings():
    row = next(row for row in cells(readme.budgets()) if row[0] == "`laptop`")
    laptop = make_config("walker2d", "mconbo-gail", "laptop")
    assert row[2:4] == [str(laptop.ppo.num_envs), "64-64"] and row[-1] == str(laptop.ppga.iterations)


def test_the_notebooks_parts_link_every_notebook_once():
    links = re.findall(r"\((notebooks/\S+?\.ipynb)\)", index.contents())
    assert links == [f"notebooks/{entry.name}.ipynb" for part in dict.fromkeys(e.part for e in index.read())
                     for entry in index.read() if entry.part == part]  # fmt: skip


def measured(folder: Path) -> Path:
    for robot, env in enumerate(readme.MEASURED, start=1):
        row = {key: 1000.0 * robot for key, _, _ in readme.SPEEDS} | {name: 1.5 * robot for name, _, _ in speed.BARS}
        row |= {"simulator_steps_per_second": 500.0, f"of_{env}": 0.7071}
        (folder / f"laptop-{env}.json").write_text(json.dumps({env: row}))
    return folder


def test_speeds_are_a_row_per_figure_with_gaps_where_a_robot_has_none(tmp_path):
    assert ["memory (MB)", "1,000", "2,000", "3,000"] in cells(readme.speeds(measured(tmp_path)))
    assert ["of humanoid", "", "", "0.71"] in cells(readme.all_speeds(tmp_path))


def test_bars_are_as_high_as_the_speeds(tmp_path):
    ax = speed.speeds(readme.measured(measured(tmp_path))).axes[0]
    assert sorted(patch.get_height() for patch in ax.patches) == sorted(3 * [1.5, 3.0, 4.5])
    assert [text.get_text() for text in ax.get_xticklabels()][0] == "walker2d\n(1 = 500 steps/s)"


def test_the_readme_is_short_and_shows_its_pictures_first():
    assert len(README.splitlines()) <= 120
    first_screen = "\n".join(README.splitlines()[:12])
    assert "docs/pictures/gaits.gif" in first_screen and "docs/pictures/archives.png" in first_screen


def anchors(page: Path) -> set[str]:
    """What a page's headings are called in links, by GitHub's rule."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize(
    "page",
    [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "notes").glob("*.md")],
    ids=lambda path: path.name,
)
def test_links_to_headings_find_them(page):
    for target, anchor in re.findall(r"\]\(([^)\s#]*\.md)?#([^)\s]+)\)", page.read_text()):
        assert anchor in anchors(page.parent / target if target else page), anchor


def test_every_base_reward_is_explained():
    page = (ROOT / "docs" / "running.md").read_text()
    assert all(f"`{name}`" in README and f"| `{name}` |" in page for name in (base.name for base in BUILT_IN))


def test_make_pictures_draws_what_pages_show():
    shown = re.findall(r"pictures/([\w.-]+)\)", README + (ROOT / "docs" / "performance.md").read_text())
    assert set(shown) == set(pictures.DRAWN)
    assert all((pictures.PICTURES / name).stat().st_size < 1.5e6 for name in shown)


def test_the_film_shows_four_robots_that_move():
    with Image.open(pictures.PICTURES / "gaits.gif") as film:
        frames = []
        for i in (0, film.n_frames // 3, film.n_frames // 2):
            film.seek(i)
            frames.append(np.asarray(film.convert("L"), float))
    quarters = [np.array_split(frame, 4, axis=1) for frame in frames]
    for robot in range(4):
        for early, late in zip(quarters, quarters[1:], strict=False):
            assert np.abs(late[robot] - early[robot]).mean() > 0.5
