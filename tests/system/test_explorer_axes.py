"""Archives of one measure and of more than two, in a real browser: a strip, and two axes that the reader chooses."""

import explorer_runs
import numpy as np
import pytest
from explorer_browser import centre, click, drawn, labels, needs_browser

import qdil
from qdil.explorer import projection

pytest_plugins = ["explorer_browser"]
pytestmark = [needs_browser, pytest.mark.physics]

SIDE = 4


def some_cells(k, count, seed=0):
    return sorted(np.random.default_rng(seed).choice(SIDE**k, count, replace=False).tolist())


def mixed(archive, seed):
    """``archive`` with returns that do not grow with the cell's number."""
    returns = np.random.default_rng(seed).permutation(len(archive["index"]))
    return archive | {"true_return": returns.astype(np.float32)}


@pytest.fixture(scope="module")
def four():
    """An archive of four measures, and another to compare it with."""
    return {name: mixed(explorer_runs.archive(some_cells(4, 90, i), i, SIDE, 4), i) for i, name in enumerate("ab")}


def chosen(page):
    return int(labels(page)[0]["cell"])


def best_cells(archive, axes):
    """Square -> cell of its best elite."""
    rows = projection.best_rows(archive, axes)
    return dict(zip(projection.squares(archive, axes)[rows].tolist(), archive["index"][rows].tolist(), strict=True))


def test_a_click_chooses_the_best_elite_of_a_square_and_the_status_gives_all_measures(opened, four):
    watched = opened(qdil.explore(four["a"], live=False))
    page = watched.page
    best = best_cells(four["a"], (0, 1))
    for square in list(best)[::5]:
        click(page, square, cells=SIDE)
        assert chosen(page) == best[square]
        row = int(np.flatnonzero(four["a"]["index"] == best[square])[0])
        shares = [f"{int(100 * share + 0.5)} %" for share in four["a"]["measures"][row]]
        status = page.locator(".qdil-status").inner_text()
        assert f"column {square // SIDE + 1}, row {square % SIDE + 1}" in status
        assert f"foot 1 on the ground {shares[0]} of the time, foot 2 {shares[1]}, foot 3 {shares[2]}" in status
        assert f"foot 4 {shares[3]}; true return {number(four['a']['true_return'][row])}, " in status
    caption = page.locator(".qdil-left .qdil-caption").inner_text()
    assert "the best elite, by true return, over the other feet (foot 3, foot 4)" in caption
    watched.is_clean()


def test_the_axes_are_chosen_with_keys_and_a_foot_is_never_on_both(opened, four):
    watched = opened(qdil.explore(four["a"], live=False))
    page = watched.page
    across, up = (page.get_by_label(f"{way}: the foot on this axis") for way in ("Across", "Up"))
    before, cell = page.evaluate("document.querySelector('.qdil-map').toDataURL()"), chosen(page)
    across.focus()
    page.keyboard.press("ArrowDown")  # from foot 1 to foot 2, which the other axis shows
    assert (across.input_value(), up.input_value()) == ("1", "0")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Tab")
    page.keyboard.press("End")
    assert (across.input_value(), up.input_value()) == ("2", "3")
    assert chosen(page) == cell  # the robot stays
    drawn(page)
    assert page.evaluate("document.querySelector('.qdil-map').toDataURL()") != before
    assert "over the other feet (foot 1, foot 2)" in page.locator(".qdil-left .qdil-caption").inner_text()
    best = best_cells(four["a"], (2, 3))
    square = next(square for square in best if square % SIDE < SIDE - 1 and square + 1 in best)
    click(page, square, cells=SIDE)
    assert chosen(page) == best[square]
    page.keyboard.press("ArrowUp")
    assert chosen(page) == best[square + 1]
    watched.is_clean()


def test_robots_of_one_square_share_its_mark_and_an_empty_square_is_empty(opened):
    archive = explorer_runs.archive([0, 1, SIDE**2], side=SIDE, k=3)  # two in the first square of the first two axes
    explored = qdil.explore(archive, live=False)
    explored.state["selected"] = [[0, 0], [0, 1]]
    watched = opened(explored)
    assert [int(one["cell"]) for one in labels(watched.page)] == [0, 1]
    click(watched.page, 7, cells=SIDE)
    assert labels(watched.page)[0]["state"] == "empty"
    assert "Empty cell (column 2, row 4)" in watched.page.locator(".qdil-status").inner_text()
    watched.is_clean()


def test_two_archives_of_four_measures_are_compared_square_by_square(opened, four):
    watched = opened(qdil.explore(four, live=False))
    page = watched.page
    page.locator(".qdil-menus select").nth(2).select_option("1")
    first, second = (best_cells(archive, (0, 1)) for archive in four.values())
    square = next(square for square in first if square in second and first[square] != second[square])
    page.locator(".qdil-map").hover(position=centre(page, square, SIDE))
    returns = [archive["true_return"][archive["index"] == cells[square]][0] for archive, cells in
               zip(four.values(), (first, second), strict=True)]  # fmt: skip
    tip = page.locator(".qdil-tip").inner_text()
    assert f"true return {number(returns[0])}," in tip and tip.endswith(f"b: true return {number(returns[1])}.")
    watched.is_clean()


def number(value):
    return f"{value:.1f}" if value >= 10 else f"{value:.2f}"


def test_an_archive_of_one_measure_is_a_strip(opened):
    cells = [0, 2, 3, 9]
    archive = explorer_runs.archive(cells, side=10, k=1)
    watched = opened(qdil.explore(archive, live=False))
    page = watched.page
    box = page.locator(".qdil-map").bounding_box()
    assert 100 < box["height"] < box["width"] / 2
    assert page.get_by_label("the foot on this axis").count() == 0

    def at(cell):
        return {"x": 50 + (cell + 0.5) * (box["width"] - 50 - 74) / 10, "y": 60}

    page.locator(".qdil-map").click(position=at(2))
    assert chosen(page) == 2
    assert (
        "Cell at column 3: foot 1 on the ground 25 % of the time; true return 120.5"
        in page.locator(".qdil-status").inner_text()
    )
    page.keyboard.press("ArrowRight")
    assert chosen(page) == 3
    page.keyboard.press("ArrowUp")
    assert chosen(page) == 3
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")
    assert labels(page)[0]["state"] == "empty"
    page.keyboard.press("b")
    assert chosen(page) == 9
    watched.is_clean()


def test_the_slider_shows_the_best_elite_of_every_iteration(opened, tmp_path):
    """Cells 0 and 1 lie in one square of the first two axes."""
    path = explorer_runs.write(tmp_path / "run", [0, 1], with_policies=False, side=SIDE, env="ant", k=4)
    explorer_runs.write_history(path, [1, 4, 9], [0, 1, 0], last=10)  # returns 0, 10.5, 21
    page = opened(qdil.explore(path, live=False)).page
    tips = {}
    for iteration in ("1", "4", "9"):
        page.locator(".qdil-menus input[type=range]").fill(iteration)
        page.locator(".qdil-map").hover(position=centre(page, 5, SIDE))
        page.locator(".qdil-map").hover(position=centre(page, 0, SIDE))
        tips[iteration] = page.locator(".qdil-tip").inner_text().split(" At the end")[0]
    assert tips == {
        "1": "After iteration 1: 0.00.", "4": "After iteration 4: 10.5.", "9": "After iteration 9: 21.0.",
    }  # fmt: skip
