// The explorer: heatmap, robots, gait diagram and controls around one clock and one small state.

import { cellOf, number, picture, rival, rowOf, squareShown } from "./data.js";
import { duration, stepAt } from "./decode.js";
import { flatStage } from "./flat.js";
import { cameraHands, mapHands, timeHands } from "./hands.js";
import { heatmap } from "./heatmap.js";
import { build, colours } from "./layout.js";
import { recordings } from "./recordings.js";
import { selection } from "./selection.js";
import { stage, startView, tilePlace } from "./stage.js";
import { strips } from "./strips.js";
import { captionOf, describe, episodeText, tipOf, titleOf } from "./words.js";

const REST = 0.8; // seconds between the end of the longest episode and the next showing
const STATE = ["run", "against", "field", "iteration", "axes"];

/** Fills `el` from `host` (see main.js): {show, menus, get, set, on, request}. Returns a function that removes it all. */
export function explorer(el, host) {
  const { show } = host;
  const { runs } = show;
  const ui = build(el, show, host.menus);
  const [map, strip, view] = [heatmap(ui.map), strips(ui.strip), startView()];
  const clock = { time: 0, playing: !matchMedia("(prefers-reduced-motion: reduce)").matches, speed: 1 };
  const theStage = show.robot ? stageOf(ui, show.robot) : null;
  const kept = recordings(host.request, () => { if (!ended) { writeStatus(); dirty = true; } });
  const choice = selection(host, runs, (isNew) => {
    if (isNew) clock.time = 0;
    kept.retry(state().run, choice.here());
    refresh(); // the host itself calls it only for a new choice
  });
  let hover = -1, beside = false, ended = false, dirty = true, last = 0;

  const state = () => Object.fromEntries(STATE.map((name) => [name, host.get(name)]));

  // ---- drawing and text

  function tiles() {
    return choice.selected().map(([run, cell], n) => ({
      run, cell, name: "ABCD"[n], row: rowOf(runs[run], cell), ...kept.of(run, cell),
    }));
  }

  const span = () => Math.max(0, ...tiles().map((tile) => (tile.rollout ? duration(tile.rollout) : 0)));

  function writeStatus() {
    const all = tiles();
    const { run, axes } = state();
    ui.stage.classList.toggle("qdil-rows", all.length > 2);
    ui.labels.replaceChildren(...all.map((tile, n) => label(tile, runs[tile.run], n, all.length)));
    const lines = all.map((tile) => (all.length > 1 ? `${tile.name}: ` : "") + describe(runs[tile.run], axes, tile.cell));
    const at = cursor();
    if (at >= 0) lines.push(`The keys are at: ${describe(runs[run], axes, at)} Enter adds it.`);
    const text = lines.join("\n") || "Choose a cell: click it, or use the arrow keys.";
    if (ui.status.textContent !== text) ui.status.textContent = text; // an equal text would be read aloud again
  }

  /** The cell where the keyboard stands, if it is not a chosen one; otherwise −1. */
  function cursor() {
    const [run, cell] = [state().run, choice.here()];
    return beside && !choice.selected().some(([r, c]) => r === run && c === cell) ? cell : -1;
  }

  function drawMap() {
    const current = state();
    const run = runs[current.run];
    const few = show.playable && show.playable[current.run];
    map.draw(picture(runs, current), run, current.axes, {
      ...colours(ui.root), field: current.field, hover, cursor: cursor(), compares: rival(runs, current) !== null,
      playable: few && few.length < run.index.length ? few.filter((cell) => isShown(run, current, cell)) : null,
      selected: names(run, current),
    });
    ui.title.textContent = titleOf(runs, current);
    ui.caption.textContent = captionOf(runs, current, few);
  }

  /** Does a click on the map choose this cell? Where elites land, another one may cover it. */
  function isShown(run, { axes, field }, cell) {
    return field !== "landed" || cellOf(run, axes, squareShown(run, axes, cell, field), field) === cell;
  }

  /** The map's run's robots: [cell, letter]; those in one square share it, with all their letters. */
  function names(run, { run: number, axes, field }) {
    const squares = new Map();
    for (const tile of tiles().filter((tile) => tile.run === number)) {
      const square = squareShown(run, axes, tile.cell, field);
      squares.set(square, [tile.cell, (squares.get(square)?.[1] ?? "") + tile.name]);
    }
    return [...squares.values()];
  }

  function drawAll() {
    const style = colours(ui.root);
    const all = tiles();
    const time = Math.min(clock.time, span());
    if (theStage) theStage.draw(all.length ? all.map((tile) => tile.rollout || null) : [null], time, view, style.dark);
    strip.draw(all.length ? all : [{ rollout: null, name: "" }], runs[state().run].feet, time, style);
    ui.scrubber.max = span() || 1;
    ui.scrubber.value = time;
    const rewards = all.filter((tile) => tile.rollout).map((tile) => number(tile.rollout.reward[stepAt(tile.rollout, time)]));
    ui.now.textContent = `${time.toFixed(2)} s${rewards.length ? ` · reward ${rewards.join(" / ")}` : ""}`;
    ui.root.dataset.time = time.toFixed(3);
  }

  function refresh() {
    ui.sync(state());
    ui.axes.sync(state().axes);
    kept.fetch(choice.selected().filter(([run, cell]) => rowOf(runs[run], cell) >= 0 && runs[run].plays));
    writeStatus();
    redraw();
  }

  function redraw() {
    drawMap();
    dirty = true;
  }

  // ---- the clock

  function frame(stamp) {
    if (ended) return;
    const passed = Math.min((stamp - last) / 1000, 0.1);
    last = stamp;
    const length = span();
    if (clock.playing && length > 0 && !document.hidden) {
      clock.time += passed * clock.speed;
      if (clock.time > length + REST) clock.time = 0;
      dirty = true;
    }
    if (dirty && ui.root.clientWidth) {
      dirty = false;
      drawAll();
    }
    requestAnimationFrame(frame);
  }

  function playing(on) {
    clock.playing = on;
    if (on && clock.time >= span()) clock.time = 0;
    ui.play.textContent = on ? "❚❚ Pause" : "▶ Play";
    ui.play.setAttribute("aria-pressed", on);
    dirty = true;
  }

  // ---- pointer and keys

  function pointed(cell, event) {
    if (cell !== hover) {
      hover = cell;
      drawMap();
    }
    ui.tip.hidden = cell < 0;
    if (cell < 0) return;
    ui.tip.textContent = tipOf(runs, state(), cell);
    const box = ui.map.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    Object.assign(ui.tip.style, x > box.width / 2 ? { left: "", right: `${box.width - x + 14}px` } : { right: "", left: `${x + 14}px` });
    ui.tip.style.top = `${y + 12}px`;
  }

  function toggleBeside() {
    beside = !beside;
    ui.beside.setAttribute("aria-pressed", beside);
    writeStatus();
    drawMap();
  }

  mapHands(ui.map, map, {
    choice, best: () => runs[state().run].best, beside: { on: () => beside, toggle: toggleBeside }, hover: pointed,
    keyPressed: kept.keyPressed,
  });
  timeHands(ui, strip, {
    toggle: () => playing(!clock.playing),
    now: () => clock.time,
    step: () => tiles().find((one) => one.rollout)?.rollout.seconds,
    pace: (speed) => (clock.speed = speed),
    seek(time) {
      playing(false);
      clock.time = Math.min(Math.max(time, 0), span());
    },
  });
  cameraHands(ui.stage, view, () => (dirty = true));
  ui.beside.addEventListener("click", toggleBeside);
  ui.alone.addEventListener("click", () => choice.selected().length && (host.set("selected", choice.selected().slice(-1)), refresh()));
  const change = (name, value) => {
    host.set(name, value);
    refresh();
  };
  ui.onMenu(change);
  ui.axes.onChange((axes) => change("axes", axes));
  for (const name of [...STATE, "selected"]) host.on(name, refresh);
  const resized = new ResizeObserver(redraw);
  resized.observe(ui.root);
  const themed = new MutationObserver(redraw);
  themed.observe(document.body, { attributes: true, attributeFilter: ["class", "data-jp-theme-name"] });

  playing(clock.playing);
  refresh();
  requestAnimationFrame((stamp) => { last = stamp; frame(stamp); });
  return () => {
    ended = true;
    kept.end();
    ui.stopReplay();
    resized.disconnect();
    themed.disconnect();
    theStage?.dispose();
    ui.root.remove();
  };
}

/** The label over one of `count` robots: its run and returns. Tests read its data attributes. */
function label(tile, run, n, count) {
  const [x, y, w] = tilePlace(n, count);
  const [box, head, text] = ["div", "b", "span"].map((tag) => document.createElement(tag));
  box.className = "qdil-label";
  Object.assign(box.style, { left: `${100 * x}%`, top: `${100 * y}%`, width: `${100 * w}%` });
  head.textContent = `${count > 1 ? `${tile.name}: ` : ""}${run.name}`;
  text.textContent = episodeText(run, tile, count);
  box.append(head, text);
  const unseen = tile.row < 0 ? "empty" : tile.error ? "error" : run.plays ? "waits" : "none";
  Object.assign(box.dataset, { cell: tile.cell, run: tile.run, state: tile.rollout ? "plays" : unseen });
  if (tile.row >= 0) box.dataset.return = run.true_return[tile.row];
  return box;
}

function stageOf(ui, robot) {
  try {
    return stage(ui.robots, robot);
  } catch {
    const canvas = ui.robots.cloneNode(); // a canvas that was asked for WebGL gives no other context
    ui.robots.replaceWith(canvas);
    ui.robots = canvas;
    return flatStage(canvas, robot);
  }
}
