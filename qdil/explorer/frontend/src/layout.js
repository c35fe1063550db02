// The explorer's HTML elements, by name, without behaviour.

import { fieldsOf, lastIteration } from "./data.js";
import { replay } from "./replay.js";

function make(tag, properties = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("aria") || name.startsWith("data-") || name === "role" || name === "for") node.setAttribute(name, value);
    else node[name] = value;
  }
  node.append(...children);
  return node;
}

const option = (value, text) => make("option", { value: String(value), textContent: text });
const labelled = (text, control) => make("label", {}, make("span", { textContent: text }), control);

export function build(el, show, withMenus) {
  const ui = {};
  ui.map = make("canvas", {
    className: show.runs[0].cells.length > 1 ? "qdil-map" : "qdil-map qdil-one-axis", tabIndex: 0, role: "application",
    "aria-label": "The archive. Arrow keys move from cell to cell, B goes to the best, with Shift a robot is added beside. "
      + "S lets several robots walk side by side: arrow keys then only move, and Enter adds a cell or takes it away.",
  });
  ui.tip = make("div", { className: "qdil-tip", hidden: true });
  ui.title = make("div", { className: "qdil-title" });
  ui.axes = axisMenus(show.runs[0]);
  ui.caption = make("div", { className: "qdil-caption" });
  ui.robots = make("canvas", { className: "qdil-robots" });
  ui.labels = make("div", { className: "qdil-labels" });
  ui.stage = make("div", {
    className: "qdil-stage", tabIndex: 0, role: "img",
    "aria-label": "The chosen robots walking. Drag or use arrow keys to look around, + and - to come nearer.",
  }, ui.robots, ui.labels);
  ui.strip = make("canvas", { className: "qdil-strip", role: "img", "aria-label": "When each foot touches the ground, and the reward of every step" });
  ui.play = make("button", { type: "button", className: "qdil-play" });
  ui.scrubber = make("input", { type: "range", min: 0, max: 1, step: 0.001, value: 0, "aria-label": "Time in seconds" });
  ui.now = make("output", { className: "qdil-now", "aria-live": "off" });
  ui.speed = make("select", {}, ...[0.1, 0.25, 0.5, 1, 2].map((speed) => option(speed, `${speed} ×`)));
  ui.speed.value = "1";
  ui.beside = make("button", { type: "button", textContent: "+ Side by side", "aria-pressed": false, title: "Let clicks and Enter add robots, up to four (S; or hold Shift)" });
  ui.alone = make("button", { type: "button", textContent: "One robot" });
  ui.status = make("div", { className: "qdil-status", role: "status", "aria-live": "polite" });
  const menus = build.menus(ui, show, withMenus);
  const controls = make("div", { className: "qdil-controls" }, ui.play, ui.scrubber, ui.now, labelled("Speed", ui.speed), ui.beside, ui.alone);
  const help = make("div", {
    className: "qdil-caption",
    textContent: "Click a cell. Keys: arrows move, B best cell, Shift adds a robot, S side by side (arrows then only move, Enter adds), Space plays, comma and full stop step. Drag the robot to look around, Shift + wheel zooms, double click resets.",
  });
  ui.root = make("div", { className: "qdil-explorer", "data-lm-suppress-shortcuts": "true" }, menus,
    make("div", { className: "qdil-columns" },
      make("div", { className: "qdil-left" }, ui.title, ui.axes.bar, make("div", { className: "qdil-over" }, ui.map, ui.tip), ui.caption),
      make("div", { className: "qdil-right" }, ui.stage, controls, ui.strip, help)),
    ui.status);
  el.replaceChildren(ui.root);
  return ui;
}

/** Two menus that choose which of more than two feet the map's axes show: {bar, onChange, sync}. */
function axisMenus({ feet, cells }) {
  let axes = [];
  const menus = cells.length > 2 ? ["Across", "Up"].map((way) => make("select", { "aria-label": `${way}: the foot on this axis` }, ...feet.map((foot, k) => option(k, foot)))) : [];
  const bar = make("div", { className: "qdil-menus", hidden: !menus.length });
  menus.forEach((menu, n) => bar.append(labelled(["Across", "Up"][n], menu)));
  return {
    bar,
    /** Calls `then(axes)`. A foot that the other axis shows changes places with this axis's. */
    onChange: (then) => menus.forEach((menu, n) => menu.addEventListener("input", () => {
      const chosen = Number(menu.value);
      then(axes.map((axis, m) => (m === n ? chosen : axis === chosen ? axes[n] : axis)));
    })),
    sync(current) {
      axes = current;
      menus.forEach((menu, n) => (menu.value = String(axes[n])));
    },
  };
}

// Menus for a page of its own; in a notebook ipywidgets stand above instead.
build.menus = (ui, show, withMenus) => {
  const { runs } = show;
  const menu = {
    run: make("select", {}, ...runs.map((run, i) => option(i, run.name))),
    field: make("select", {}, ...fieldsOf(runs).map(([key, { name }]) => option(key, name))),
    against: make("select", {}, option(-1, "nothing"), ...runs.map((run, i) => option(i, run.name))),
    iteration: make("input", { type: "range", min: 0, max: lastIteration(runs), step: 1 }),
  };
  const iteration = make("output", { "aria-live": "off" });
  const player = make("button", { type: "button", className: "qdil-replay", textContent: "▶", "aria-label": "Replay how the archive filled", "aria-pressed": false });
  ui.stopReplay = replay(player, menu.iteration);
  ui.onMenu = (then) => {
    for (const [name, control] of Object.entries(menu)) {
      control.addEventListener("input", () => {
        const value = name === "field" ? control.value : Number(control.value);
        then(name, name === "iteration" && value === Number(control.max) ? -1 : value);
      });
    }
  };
  ui.sync = (state) => {
    for (const [name, control] of Object.entries(menu)) control.value = String(state[name]);
    if (state.iteration < 0) menu.iteration.value = menu.iteration.max;
    iteration.textContent = state.iteration < 0 ? "end" : state.iteration;
  };
  const bar = make("div", { className: "qdil-menus" }, labelled("Colour", menu.field));
  if (runs.length > 1) bar.prepend(labelled("Run", menu.run));
  if (runs.length > 1) bar.append(labelled("Minus", menu.against));
  if (lastIteration(runs) >= 0) bar.append(player, make("label", {}, make("span", { textContent: "After iteration" }), menu.iteration, iteration));
  bar.hidden = !withMenus;
  return bar;
};

/** The colours that drawings on canvases take from the page around them: {text, dark, faint}. */
export function colours(root) {
  const style = getComputedStyle(root);
  const dark = isDark(style.backgroundColor);
  return { text: style.color, dark, faint: dark ? "#ffffff22" : "#0000001a" };
}

/** Is a CSS colour a dark one? */
function isDark(colour) {
  const [r, g, b, a = 1] = (colour.match(/[\d.]+/g) || [255, 255, 255]).map(Number);
  return a > 0 && 0.299 * r + 0.587 * g + 0.114 * b < 128;
}
