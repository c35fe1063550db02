"""The explorer in a real browser, as a page from a file."""

import os

import explorer_runs
import pytest
from explorer_browser import (
    BEST,
    centre,
    click,
    drawn,
    labels,
    needs_browser,
    time_shown,
    two_pictures,
    wait_for,
)

import qdil

pytest_plugins = ["explorer_browser"]
pytestmark = [needs_browser, pytest.mark.physics]


def test_a_page_plays_what_is_clicked(opened, runs):
    watched = opened(qdil.explore(runs["true"], live=False))
    page = watched.page
    wait_for(page, "plays")
    assert labels(page)[0]["cell"] == str(BEST)
    click(page, 6)
    wait_for(page, "plays")
    shown = labels(page)[0]
    assert (shown["cell"], float(shown["return"])) == ("6", 161.5)
    assert "161.5" in page.locator(".qdil-label").inner_text()
    first, second = two_pictures(page)
    assert first != second
    watched.is_clean()


def test_keys_move_through_cells_and_an_empty_one_says_so(opened, runs):
    watched = opened(qdil.explore(runs["true"], live=False))
    page = watched.page
    wait_for(page, "plays")
    click(page, 7)
    page.keyboard.press("ArrowUp")  # 8 is empty
    assert labels(page)[0]["state"] == "empty"
    assert "Empty cell" in page.locator(".qdil-status").inner_text()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowRight")
    assert labels(page)[0]["cell"] == "12"
    page.keyboard.press("b")
    assert labels(page)[0]["cell"] == str(BEST)
    wait_for(page, "plays")
    page.keyboard.press(" ")
    drawn(page)
    stopped = time_shown(page)
    page.wait_for_timeout(300)
    assert time_shown(page) == stopped
    page.keyboard.press(".")
    drawn(page)
    assert time_shown(page) != stopped
    watched.is_clean()


def test_up_to_four_robots_walk_in_step_and_any_size_will_do(opened, runs):
    watched = opened(qdil.explore([runs["true"], runs["gail"]], live=False))
    page = watched.page
    wait_for(page, "plays")
    for cell in (0, 6, 7, 12):
        click(page, cell, modifiers=["Shift"])
    wait_for(page, "plays", 4)
    assert [one["cell"] for one in labels(page)] == ["0", "6", "7", "12"]
    page.set_viewport_size({"width": 480, "height": 900})
    page.wait_for_timeout(300)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    click(page, 18)
    wait_for(page, "plays")
    assert labels(page)[0]["cell"] == "18"
    page.locator(".qdil-menus select").nth(0).select_option("1")
    click(page, 13)
    wait_for(page, "plays")
    assert labels(page)[0]["run"] == "1"
    page.locator(".qdil-menus select").nth(2).select_option("0")
    assert "minus" in page.locator(".qdil-title").inner_text()
    watched.is_clean()


def test_an_archive_of_one_cell(opened, runs):
    watched = opened(qdil.explore(runs["lone"], live=False))
    wait_for(watched.page, "plays")
    assert labels(watched.page)[0]["cell"] == "12"
    watched.is_clean()


def test_the_slider_replays_how_the_archive_filled(opened, runs, tmp_path):
    path = explorer_runs.write(tmp_path / "remembers", [6, 12])
    explorer_runs.write_history(path, [1, 4, 9], [6, 12, 12], last=10)
    watched = opened(qdil.explore([path, runs["gail"]], live=False))
    page = watched.page
    wait_for(page, "plays")
    end = page.evaluate("document.querySelector('.qdil-map').toDataURL()")
    texts = {}
    for iteration in ("1", "4", "10"):
        page.locator(".qdil-menus input[type=range]").fill(iteration)
        page.locator(".qdil-map").hover(position=centre(page, 12))
        texts[iteration] = page.locator(".qdil-tip").inner_text(), page.locator(".qdil-title").inner_text()
        if iteration != "10":
            assert page.evaluate("document.querySelector('.qdil-map').toDataURL()") != end
    assert texts["1"][0].startswith("After iteration 1: none.") and texts["4"][0].startswith("After iteration 4: 10.5.")
    assert texts["10"][0].startswith("Cell at") and "after" not in texts["10"][1]
    assert texts["1"][1].endswith("after iteration 1")
    page.locator(".qdil-menus input[type=range]").fill("4")
    page.locator(".qdil-menus select").nth(1).select_option("fitness")
    page.locator(".qdil-map").hover(position=centre(page, 6))
    page.locator(".qdil-map").hover(position=centre(page, 12))
    assert page.locator(".qdil-tip").inner_text().startswith("After iteration 4: 2.0")
    page.locator(".qdil-menus select").nth(0).select_option("1")  # a run that kept no history shows its end
    assert "after" not in page.locator(".qdil-title").inner_text()
    watched.is_clean()


def test_without_webgl_and_in_a_dark_theme_robots_walk_too(opened, runs):
    refuse = "HTMLCanvasElement.prototype.getContext = new Proxy(HTMLCanvasElement.prototype.getContext, {"
    refuse += "apply: (f, canvas, [kind, ...rest]) => kind.startsWith('webgl') ? null : f.call(canvas, kind, ...rest)})"
    watched = opened(qdil.explore(runs["true"], live=False), script=refuse)
    wait_for(watched.page, "plays")
    light = watched.page.evaluate("document.querySelector('.qdil-map').toDataURL()")
    watched.page.add_style_tag(content=":root { --jp-layout-color1: #111; --jp-ui-font-color1: #eee }")  # JupyterLab's
    watched.page.evaluate("document.body.dataset.jpThemeName = 'JupyterLab Dark'")
    click(watched.page, 6)
    wait_for(watched.page, "plays")
    first, second = two_pictures(watched.page)
    assert first != second
    assert watched.page.evaluate("document.querySelector('.qdil-map').toDataURL()") != light
    if os.environ.get("QDIL_SCREENSHOT"):
        watched.page.screenshot(path=os.environ["QDIL_SCREENSHOT"])
    assert watched.strangers == []
    assert [line for line in watched.complaints if "webgl" not in line.lower()] == []


def test_without_policies_the_heatmap_still_works_and_says_why_no_robot_walks(opened, runs):
    watched = opened(qdil.explore(runs["bare"], live=False))
    click(watched.page, 7)
    shown = labels(watched.page)[0]
    assert (shown["state"], float(shown["return"])) == ("none", 171.75)
    assert "policies are not on this machine" in watched.page.locator(".qdil-label").inner_text()
    watched.is_clean()
