// The explorer: heatmap, robots, gait diagram and controls around one clock and one small state.

import { byCell, comparable, FIELDS, looksBack, number, picture, values } from "./data.js";
import { duration, stepAt } from "./decode.js";
import { flatStage } from "./flat.js";
import { heatmap } from "./heatmap.js";
import { build, isDark } from "./layout.js";
import { stage, startView, tilePlace } from "./stage.js";
import { strips } from "./strips.js";

const MOST = 4; // robots side by side
const REST = 0.8; // seconds between the end of the longest episode and the next showing

/** Fills `el` from `host` (see main.js): {show, menus, get, set, on, request}. Returns a function that ends it. */
export function explorer(el, host) {
  const { show } = host;
  const { runs } = show;
  const rows = runs.map(byCell);
  const ui = build(el, show, host.menus);
  const map = heatmap(ui.map);
  const strip = strips(ui.strip);
  const view = startView();
  const clock = { time: 0, playing: !matchMedia("(prefers-reduced-motion: reduce)").matches, speed: 1 };
  const known = new Map(); // "run:cell" -> {rollout} or {error} or {}
  let hover = -1, beside = false, ended = false, dirty = true, last = 0;
  let picked = null; // the picture that the heatmap shows

  const state = () => ({
    run: host.get("run"), against: host.get("against"), field: host.get("field"), iteration: host.get("iteration"),
  });
  const selected = () => host.get("selected");
  const rowOf = (run, cell) => rows[run][cell];
  let theStage = null;
  if (show.robot) {
    try {
      theStage = stage(ui.robots, show.robot);
    } catch {
      ui.robots = freshCanvas(ui.robots); // one that was asked for WebGL can't be drawn on otherwise
      theStage = flatStage(ui.robots, show.robot);
    }
  }

  // ---- what is shown

  function tiles() {
    return selected().map(([run, cell], n) => ({
      run, cell, name: "ABCD"[n], row: rowOf(run, cell), ...(known.get(`${run}:${cell}`) || {}),
    }));
  }

  function fetchMissing() {
    for (const [run, cell] of selected()) {
      const key = `${run}:${cell}`;
      if (known.has(key) || rowOf(run, cell) < 0 || !runs[run].plays) continue;
      known.set(key, {});
      host.request(run, cell).then(
        (rollout) => known.set(key, { rollout }),
        (error) => known.set(key, { error: error.message }),
      ).then(() => {
        if (known.get(key).error) setTimeout(() => known.delete(key), 0); // the next click may try again
        if (!ended) { tell(); dirty = true; }
      });
    }
  }

  const span = () => Math.max(0, ...tiles().map((tile) => (tile.rollout ? duration(tile.rollout) : 0)));

  function choose(cell, add) {
    if (cell < 0) return;
    const one = [state().run, cell];
    const now = selected();
    const at = now.findIndex(([run, c]) => run === one[0] && c === one[1]);
    if (!add) host.set("selected", [one]);
    else if (at >= 0 && now.length > 1) host.set("selected", now.filter((_, i) => i !== at));
    else if (at < 0) host.set("selected", [...now.slice(now.length < MOST ? 0 : 1), one]);
    clock.time = 0;
    if (!host.menus) refresh();
  }

  function describe(run, cell) {
    const row = rowOf(run, cell);
    const [first, second] = [Math.floor(cell / runs[run].cells[1]), cell % runs[run].cells[1]];
    const place = `column ${first + 1}, row ${second + 1}`;
    if (row < 0) return `Empty cell (${place}): no policy of ${runs[run].name} walks this way.`;
    const r = runs[run];
    const [a, b] = r.measures[row];
    return (
      `Cell at ${place}: ${r.feet[0]} on the ground ${(100 * a).toFixed(0)} % of the time, ${r.feet[1]} ${(100 * b).toFixed(0)} %; ` +
      `true return ${number(r.true_return[row])}, learned fitness ${number(r.fitness[row])}, ` +
      `episode of ${r.length[row].toFixed(0)} steps.`
    );
  }

  function tell() {
    const all = tiles();
    ui.stage.classList.toggle("qdil-rows", all.length > 2);
    ui.labels.replaceChildren(
      ...all.map((tile, n) => {
        const [x, y, w] = tilePlace(n, all.length);
        const box = document.createElement("div");
        box.className = "qdil-label";
        Object.assign(box.style, { left: `${100 * x}%`, top: `${100 * y}%`, width: `${100 * w}%` });
        const head = document.createElement("b");
        head.textContent = `${all.length > 1 ? tile.name + ": " : ""}${runs[tile.run].name}`;
        const text = document.createElement("span");
        text.textContent = said(tile);
        box.append(head, text);
        box.dataset.cell = tile.cell;
        box.dataset.run = tile.run;
        if (tile.row >= 0) box.dataset.return = runs[tile.run].true_return[tile.row];
        box.dataset.state = tile.rollout ? "plays" : tile.row < 0 ? "empty" : tile.error ? "error" : runs[tile.run].plays ? "waits" : "none";
        return box;
      }),
    );
    if (!all.length) ui.status.textContent = "Choose a cell: click it, or use the arrow keys.";
    else ui.status.textContent = all.map((tile) => (all.length > 1 ? tile.name + ": " : "") + describe(tile.run, tile.cell)).join("\n");
  }

  function said(tile) {
    if (tile.row < 0) return "empty cell: no robot here";
    const archived = `return ${number(runs[tile.run].true_return[tile.row])}`;
    if (!runs[tile.run].plays) return `${archived} · ${runs[tile.run].why}`;
    if (tile.error) return `${archived} · ${tile.error}`;
    if (!tile.rollout) return `${archived} · simulating; the first time, the simulator compiles for up to a minute`;
    const sum = tile.rollout.reward.reduce((a, b) => a + b, 0);
    const end = tile.rollout.fell ? "then falls" : "to the time limit";
    if (tiles().length > 1) return `${archived} · here ${number(sum)}, ${tile.rollout.steps} steps, ${end}`;
    return `${archived} in the archive · ${number(sum)} in this episode, ${tile.rollout.steps} steps, ${end}`;
  }

  function colours() {
    const style = getComputedStyle(ui.root);
    const dark = isDark(style.backgroundColor);
    return { text: style.color, dark, faint: dark ? "#ffffff22" : "#0000001a" };
  }

  function drawMap() {
    const now = state();
    picked = picture(runs, now);
    const compares = now.against >= 0 && now.against !== now.run && comparable(runs[now.run], runs[now.against]);
    const few = show.playable && show.playable[now.run];
    map.draw(picked, runs[now.run], {
      ...colours(), hover, compares, playable: few && few.length < runs[now.run].index.length ? few : null,
      selected: tiles().filter((tile) => tile.run === now.run).map((tile) => [tile.cell, tile.name]),
    });
    const unit = FIELDS[now.field];
    const back = looksBack(runs[now.run], now.iteration);
    ui.title.textContent =
      `${unit.name}: ${runs[now.run].name}${compares ? ` minus ${runs[now.against].name}` : ""}`
      + (back ? ` after iteration ${now.iteration}` : "");
    ui.caption.textContent =
      `Colour: ${unit.unit}${compares ? "; orange where the first is better, + filled there alone, − in the other alone" : ""}. Hatched: empty.`
      + (runs[now.run].demonstrators.length ? " ★ demonstrators." : "")
      + (runs[now.run].top.length && !compares ? " ● best fifth by return." : "")
      + (few ? " ▸ has a recording." : "")
      + (back ? " Robots and their numbers are those of the run's end." : "");
  }

  function drawAll() {
    const looks = colours();
    const all = tiles();
    const time = Math.min(clock.time, span());
    if (theStage) theStage.draw(all.length ? all.map((tile) => tile.rollout || null) : [null], time, view, looks.dark);
    strip.draw(all.length ? all : [{ rollout: null, name: "" }], runs[state().run].feet, time, looks);
    ui.scrubber.max = span() || 1;
    ui.scrubber.value = time;
    const rewards = all.filter((tile) => tile.rollout).map((tile) => number(tile.rollout.reward[stepAt(tile.rollout, time)]));
    ui.now.textContent = `${time.toFixed(2)} s${rewards.length ? ` · reward ${rewards.join(" / ")}` : ""}`;
    ui.root.dataset.time = time.toFixed(3);
  }

  function refresh() {
    const now = state();
    ui.sync(now);
    fetchMissing();
    tell();
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

  function seek(time) {
    playing(false);
    clock.time = Math.min(Math.max(time, 0), span());
    dirty = true;
  }

  // ---- hands

  ui.map.addEventListener("pointermove", (event) => {
    const cell = map.cellAt(event);
    if (cell !== hover) {
      hover = cell;
      drawMap();
    }
    ui.tip.hidden = cell < 0;
    if (cell < 0) return;
    ui.tip.textContent = tipOf(cell);
    const box = ui.map.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    Object.assign(ui.tip.style, x > box.width / 2 ? { left: "", right: `${box.width - x + 14}px` } : { right: "", left: `${x + 14}px` });
    ui.tip.style.top = `${y + 12}px`;
  });
  ui.map.addEventListener("pointerleave", () => {
    hover = -1;
    ui.tip.hidden = true;
    drawMap();
  });
  ui.map.addEventListener("click", (event) => {
    ui.map.focus({ preventScroll: true });
    choose(map.cellAt(event), beside || event.shiftKey || event.ctrlKey || event.metaKey);
  });

  function tipOf(cell) {
    const now = state();
    const then = looksBack(runs[now.run], now.iteration) ? values(runs[now.run], now.field, now.iteration)[cell] : null;
    const text = (then === null ? "" : `After iteration ${now.iteration}: ${number(then)}. At the end: `) + describe(now.run, cell);
    if (now.against < 0 || now.against === now.run || !comparable(runs[now.run], runs[now.against])) return text;
    const other = runs[now.against];
    const row = rows[now.against][cell];
    return `${text} ${other.name}: ${row < 0 ? "empty" : `true return ${number(other.true_return[row])}`}.`;
  }

  ui.map.addEventListener("keydown", (event) => {
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const now = selected();
    const { run } = state();
    const [columns, lines] = runs[run].cells;
    const at = now.length ? now[now.length - 1][1] : runs[run].best;
    if (moves[event.key]) {
      const i = Math.min(Math.max(Math.floor(at / lines) + moves[event.key][0], 0), columns - 1);
      const j = Math.min(Math.max((at % lines) + moves[event.key][1], 0), lines - 1);
      choose(now.length ? i * lines + j : at, event.shiftKey);
      event.preventDefault();
    } else if (event.key === "Home" || event.key === "b") {
      choose(runs[run].best, event.shiftKey);
      event.preventDefault();
    }
  });
  ui.root.addEventListener("keydown", (event) => {
    if (event.target.matches("button, select, input")) return;
    const tile = tiles().find((one) => one.rollout);
    const step = tile ? tile.rollout.seconds : 0.01;
    if (event.key === " ") playing(!clock.playing);
    else if (event.key === ",") seek(clock.time - step);
    else if (event.key === ".") seek(clock.time + step);
    else return;
    event.preventDefault();
  });

  ui.play.addEventListener("click", () => playing(!clock.playing));
  ui.scrubber.addEventListener("input", () => seek(Number(ui.scrubber.value)));
  ui.speed.addEventListener("change", () => (clock.speed = Number(ui.speed.value)));
  ui.beside.addEventListener("click", () => {
    beside = !beside;
    ui.beside.setAttribute("aria-pressed", beside);
  });
  ui.alone.addEventListener("click", () => selected().length && (host.set("selected", selected().slice(-1)), refresh()));
  drag(ui.strip, (event) => seek(strip.timeAt(event)), true);
  ui.stage.addEventListener("dblclick", () => { Object.assign(view, startView()); dirty = true; });
  drag(ui.stage, (event) => {
    view.azimuth -= event.movementX * 0.008;
    view.elevation = Math.min(Math.max(view.elevation + event.movementY * 0.006, -0.05), 1.5);
    dirty = true;
  });
  ui.stage.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && !event.metaKey && !event.shiftKey) return; // a plain wheel scrolls the page
    zoom(Math.exp((event.deltaY || event.deltaX) * 0.002));
    event.preventDefault();
  }, { passive: false });
  ui.stage.addEventListener("keydown", (event) => {
    const turn = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.06], ArrowDown: [0, -0.06] }[event.key];
    if (turn) {
      view.azimuth += turn[0];
      view.elevation = Math.min(Math.max(view.elevation + turn[1], -0.05), 1.5);
    } else if (event.key === "+" || event.key === "=") zoom(0.85);
    else if (event.key === "-") zoom(1 / 0.85);
    else return;
    dirty = true;
    event.preventDefault();
  });

  function zoom(factor) {
    view.distance = Math.min(Math.max(view.distance * factor, 0.35), 4);
    dirty = true;
  }

  ui.onMenu((name, value) => {
    host.set(name, value);
    refresh();
  });
  for (const name of ["run", "against", "field", "iteration", "selected"]) host.on(name, refresh);
  const resized = new ResizeObserver(() => { drawMap(); dirty = true; });
  resized.observe(ui.root);
  const themed = new MutationObserver(() => { drawMap(); dirty = true; });
  themed.observe(document.body, { attributes: true, attributeFilter: ["class", "data-jp-theme-name"] });

  playing(clock.playing);
  refresh();
  requestAnimationFrame((stamp) => { last = stamp; frame(stamp); });
  return () => {
    ended = true;
    resized.disconnect();
    themed.disconnect();
    theStage?.dispose();
    ui.root.remove();
  };
}

function freshCanvas(old) {
  const canvas = old.cloneNode();
  old.replaceWith(canvas);
  return canvas;
}

// Calls `move` while a pointer is held down, and, if asked, where it went down.
function drag(element, move, atOnce = false) {
  element.addEventListener("pointerdown", (event) => {
    if (event.button) return;
    element.setPointerCapture(event.pointerId);
    if (atOnce) move(event);
  });
  element.addEventListener("pointermove", (event) => {
    if (element.hasPointerCapture(event.pointerId)) move(event);
  });
}
