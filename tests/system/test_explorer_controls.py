"""The explorer's keys, time, camera and sentences in a real browser, as a page from a file."""

import time

import explorer_runs
import pytest
from explorer_browser import BEST, click, drawn, labels, needs_browser, script, time_shown, wait_for

import qdil

pytest_plugins = ["explorer_browser"]
pytestmark = [needs_browser, pytest.mark.physics]

ROBOTS = "document.querySelector('.qdil-robots').toDataURL()"


def cells(page):
    return [(int(one["run"]), int(one["cell"])) for one in labels(page)]


def test_a_refused_recording_stays_refused_and_says_why(opened, runs):
    page = opened(qdil.explore(runs["true"], live=False, recordings=1)).page
    wait_for(page, "plays")
    assert "(1 of 6 cells)" in page.locator(".qdil-left .qdil-caption").inner_text()
    click(page, 6)
    wait_for(page, "error")
    click(page, BEST, modifiers=["Shift"])
    wait_for(page, "plays")
    assert [one["state"] for one in labels(page)] == ["error", "plays"]
    assert "No recording of this cell" in page.locator(".qdil-label").first.inner_text()
    click(page, 6)  # asks once more
    wait_for(page, "error")


def test_letters_mean_the_same_with_shift_and_caps_lock(opened, runs):
    page = opened(qdil.explore(runs["true"], live=False)).page
    click(page, 6)
    page.keyboard.press("Shift+B")
    assert cells(page) == [(0, 6), (0, BEST)]
    click(page, 6)
    page.keyboard.press("B")  # as Caps Lock writes it
    assert cells(page) == [(0, BEST)]


def test_keys_alone_pair_cells_that_are_far_apart(opened, runs):
    watched = opened(qdil.explore(runs["true"], live=False))
    page = watched.page
    click(page, 6)
    page.keyboard.press("Shift+ArrowUp")
    page.keyboard.press("Shift+ArrowDown")  # back on a cell that is there: it stays
    assert cells(page) == [(0, 6), (0, 7)]
    click(page, 6)
    page.keyboard.press("s")
    for key in ("ArrowRight", "ArrowRight", "ArrowUp", "ArrowUp"):
        page.keyboard.press(key)
    assert cells(page) == [(0, 6)]
    assert "The keys are at: Cell at column 4, row 4" in page.locator(".qdil-status").inner_text()
    page.keyboard.press("Enter")
    wait_for(page, "plays", 2)
    assert cells(page) == [(0, 6), (0, 18)]
    page.keyboard.press("Enter")
    assert cells(page) == [(0, 6)]
    watched.is_clean()


def test_keys_go_on_at_the_same_place_in_a_run_with_another_grid(opened, runs, tmp_path):
    finer = explorer_runs.write(tmp_path / "finer", [55, 66], "gail", side=10)
    page = opened(qdil.explore([runs["true"], finer], live=False)).page
    click(page, 18)  # column 4, row 4 of 5: its middle lies in column 8, row 8 of 10
    page.locator(".qdil-menus select").nth(0).select_option("1")
    page.locator(".qdil-map").focus()
    page.keyboard.press("ArrowLeft")
    assert cells(page) == [(1, 67)]
    page.locator(".qdil-menus select").nth(2).select_option("0")
    assert "Expert has another grid" in page.locator(".qdil-left .qdil-caption").inner_text()


def test_a_held_key_asks_only_for_the_cell_where_it_ends(opened, runs):
    page = opened(qdil.explore(runs["true"], live=False)).page
    script(page, "recordings", "recordings.js")
    asked = page.evaluate("""async () => {
      const asked = [];
      const kept = q.recordings((run, cell) => (asked.push(cell), Promise.resolve({})), () => {});
      for (let cell = 0; cell < 8; cell++) {
        kept.keyPressed();
        kept.fetch([[0, cell]]);
        await new Promise((done) => setTimeout(done, 5));
      }
      await new Promise((done) => setTimeout(done, 400));
      return asked;
    }""")
    assert asked == [7]


def test_two_histories_are_compared_at_one_time_on_one_scale(opened, runs):
    page = opened(qdil.explore(runs["true"], live=False)).page
    script(page, "picture", "projection.js", "data.js")
    pictures = page.evaluate("""() => {
      const run = (returns) => ({
        cells: [1, 2], index: [0, 1], true_return: returns.slice(-2), fitness: [0, 0],
        history: { iteration: [1, 2, 3], index: [0, 0, 1], true_return: returns, fitness: [0, 0, 0], last: 3 },
      });
      const runs = [run([50, 60, 70]), run([10, 58, 71]), { ...run([0, 0, 0]), history: null }];
      const at = (against, iteration) => {
        const drawn = q.picture(runs, { run: 0, against, field: "true_return", iteration, axes: [0, 1] });
        return [[...drawn.values].map((value) => (isNaN(value) ? null : value)), drawn.high];
      };
      return [at(1, 1), at(1, 2), at(1, -1), at(2, 1)];
    }""")
    assert pictures[:3] == [[[40, None], 40], [[2, None], 40], [[2, -1], 40]]
    assert pictures[3] == [[60, 70], 70]  # the other kept no history: both at their end


def test_a_colour_shows_elites_where_they_land_on_fresh_episodes(opened, runs, tmp_path):
    """Elites of cells 0, 6 and 22: the first two land in cell 7, where the first is better, the third in its own."""
    path = explorer_runs.write(tmp_path / "again", [0, 6, 22], landing=[7, 7, 22])
    watched = opened(qdil.explore([path, runs["gail"]], live=False))
    page = watched.page
    page.locator(".qdil-menus select").nth(1).select_option("landed")
    caption, status = page.locator(".qdil-left .qdil-caption"), page.locator(".qdil-status")
    assert page.locator(".qdil-title").inner_text() == "Return on fresh episodes, where it lands: Expert"
    assert "Expert: 1 of 3 elites land in their own cell." in caption.inner_text()
    click(page, 7)
    wait_for(page, "plays")
    assert cells(page) == [(0, 0)]
    assert "On fresh episodes: return 300.0, lands in column 2, row 3." in status.inner_text()
    click(page, 0)  # its elite lands elsewhere, and nobody lands here
    assert cells(page) == [(0, 0)]
    page.keyboard.press("ArrowRight")  # from column 2, row 3 over empty squares to column 5, row 3
    assert cells(page) == [(0, 22)] and "lands in its own cell" in status.inner_text()
    page.keyboard.press("ArrowUp")  # nothing above
    assert cells(page) == [(0, 22)]
    page.locator(".qdil-menus select").nth(0).select_option("1")
    assert "GAIL did not score its elites again." in caption.inner_text()
    watched.is_clean()


def test_a_run_without_fresh_scores_offers_no_such_colour(opened, runs):
    page = opened(qdil.explore(runs["true"], live=False)).page
    assert "landed" not in page.locator(".qdil-menus option").evaluate_all("all => all.map((one) => one.value)")
    click(page, 6)
    assert "fresh" not in page.locator(".qdil-status").inner_text()


def test_a_page_says_what_kept_no_history_and_replays_what_did(opened, runs, tmp_path):
    path = explorer_runs.write(tmp_path / "remembers", [6, 12], "gail")
    explorer_runs.write_history(path, [1, 4, 9], [6, 12, 12], last=10)
    watched = opened(qdil.explore([path, runs["true"]], live=False))
    page = watched.page
    title, caption = page.locator(".qdil-title"), page.locator(".qdil-left .qdil-caption")
    assert "history" not in caption.inner_text()
    page.evaluate("""() => {
      globalThis.titles = [];
      const title = document.querySelector(".qdil-title");
      new MutationObserver(() => titles.push(title.textContent)).observe(title, { childList: true });
    }""")
    page.get_by_role("button", name="Replay how the archive filled").click()
    page.wait_for_function("titles.at(-1) === 'True return: GAIL'")  # back at the end
    shown = [f"True return: GAIL after iteration {iteration}" for iteration in range(1, 10)]
    assert list(dict.fromkeys(page.evaluate("titles"))) == [*shown, "True return: GAIL"]
    page.locator(".qdil-menus input[type=range]").fill("4")
    page.locator(".qdil-menus select").nth(2).select_option("1")
    assert title.inner_text() == "True return: GAIL minus Expert"
    assert "Expert kept no history, so both are shown at their end." in caption.inner_text()
    assert "orange where GAIL is higher" in caption.inner_text()
    page.locator(".qdil-menus select").nth(0).select_option("1")
    assert "This run kept no history: its end is shown." in caption.inner_text()
    watched.is_clean()


def test_time_can_be_dragged_and_slowed(opened, runs):
    watched = opened(qdil.explore(runs["true"], live=False))
    page = watched.page
    wait_for(page, "plays")
    scrubber = page.get_by_label("Time in seconds")
    scrubber.fill("0.1")
    drawn(page)
    assert time_shown(page) == pytest.approx(0.1, abs=0.002)
    first = page.evaluate(ROBOTS)
    page.wait_for_timeout(200)
    assert time_shown(page) == pytest.approx(0.1, abs=0.002)  # who drags wants to look
    box = page.locator(".qdil-strip").bounding_box()
    page.mouse.click(box["x"] + 118 + 0.5 * (box["width"] - 118 - 46), box["y"] + 20)
    drawn(page)
    end = float(scrubber.get_attribute("max"))
    assert time_shown(page) == pytest.approx(end / 2, abs=0.01)
    assert page.evaluate(ROBOTS) != first
    scrubber.fill("0")
    page.get_by_label("Speed").select_option("0.1")
    begin = time.monotonic()
    page.get_by_role("button", name="Play", exact=False).first.click()
    page.wait_for_timeout(800)
    assert 0 < time_shown(page) <= 0.1 * (time.monotonic() - begin)
    page.get_by_label("Speed").select_option("2")
    page.wait_for_function(f"document.querySelector('.qdil-explorer').dataset.time > {end - 0.01}")
    watched.is_clean()


def test_the_camera_follows_a_drag_and_keys_and_comes_back(opened, runs):
    watched = opened(qdil.explore(runs["true"], live=False))
    page = watched.page
    wait_for(page, "plays")
    page.get_by_label("Time in seconds").fill("0.1")
    drawn(page)
    first = page.evaluate(ROBOTS)
    box = page.locator(".qdil-stage").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 120, y + 30, steps=4)
    page.mouse.up()
    drawn(page)
    turned = page.evaluate(ROBOTS)
    page.locator(".qdil-stage").focus()
    page.keyboard.press("+")
    drawn(page)
    assert len({first, turned, page.evaluate(ROBOTS)}) == 3
    page.mouse.dblclick(x, y)
    drawn(page)
    assert page.evaluate(ROBOTS) == first
    watched.is_clean()


def test_a_page_that_cannot_run_says_so_or_shows_its_picture(browser, opened, runs, tmp_path):
    path = qdil.explore(runs["true"], live=False).save(tmp_path / "still.html", recordings=1)
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(path.as_uri())
    assert page.locator("noscript p").is_visible()
    assert page.locator("img").bounding_box()["width"] > 500
    context.close()
    page = browser.new_page()
    page.add_init_script("delete globalThis.DecompressionStream")
    page.goto(path.as_uri())
    page.get_by_text("The explorer could not start").wait_for()
    page.close()
