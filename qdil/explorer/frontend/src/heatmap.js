// The archive as a picture over one or two of its axes: a strip or a square of coloured squares, marks of the
// demonstrators, the colour bar. See projection.js for squares and cells.

import { prepare } from "./canvas.js";
import { diverging, sequential } from "./colours.js";
import { cellOf, number, squareShown } from "./data.js";
import { mapSize } from "./projection.js";

const LEFT = 50, BOTTOM = 46, TOP = 10, BAR = 74;
const STRIP = 110; // pixels, the height of a strip: room to click, and for the colour bar's numbers

export function heatmap(canvas) {
  let area = { x: LEFT, y: TOP, width: 100, height: 100 };
  let drawn = null; // {run, axes, field} of the last drawing
  let [columns, lines] = [1, 1];

  /** The cell that the square under the pointer stands for; −1 beside the map, and where no elite lands. */
  function cellAt(event) {
    const box = canvas.getBoundingClientRect();
    const i = Math.floor(((event.clientX - box.left - area.x) / area.width) * columns);
    const j = Math.floor((1 - (event.clientY - box.top - area.y) / area.height) * lines);
    const isInside = drawn && i >= 0 && j >= 0 && i < columns && j < lines;
    return isInside ? cellOf(drawn.run, drawn.axes, i * lines + j, drawn.field) : -1;
  }

  /** Screen rectangle of a square: [x, y, width, height]. */
  function rectangle(square) {
    const [i, j] = [Math.floor(square / lines), square % lines];
    const [w, h] = [area.width / columns, area.height / lines];
    return [area.x + i * w, area.y + area.height - (j + 1) * h, w, h];
  }

  /** Screen rectangle of the square that shows a cell's elite. */
  const place = (cell) => rectangle(squareShown(drawn.run, drawn.axes, cell, drawn.field));

  function draw(picture, run, axes, style) {
    drawn = { run, axes, field: style.field };
    [columns, lines] = mapSize(run.cells, axes);
    const { g, width, height } = prepare(canvas);
    const size = Math.max(40, Math.min(width - LEFT - BAR, height - TOP - BOTTOM));
    area = axes.length > 1
      ? { x: LEFT, y: TOP, width: size, height: size }
      : { x: LEFT, y: TOP, width: Math.max(40, width - LEFT - BAR), height: STRIP };
    const colour = picture.diverges ? diverging : sequential;
    const share = (value) => (value - picture.low) / (picture.high - picture.low);
    const hatch = hatching(g, style.dark);
    const gap = columns > 40 ? 0.25 : 0.5;
    for (let square = 0; square < picture.values.length; square++) {
      const [x, y, w, h] = rectangle(square);
      const value = picture.values[square];
      g.fillStyle = Number.isFinite(value) ? colour(share(value)) : style.dark ? "#3a3a3a" : "#e2e2e2";
      g.fillRect(x + gap, y + gap, w - 2 * gap, h - 2 * gap);
      if (picture.only[square]) mark(g, picture.only[square], x, y, w, h, style.text);
      else if (!Number.isFinite(value)) {
        g.fillStyle = hatch;
        g.fillRect(x + gap, y + gap, w - 2 * gap, h - 2 * gap);
      }
    }
    if (!style.compares) tops(g, run, place);
    if (style.playable) playable(g, style.playable, place);
    stars(g, run, axes, area);
    chosen(g, style, place);
    frame(g, area, run, axes, style);
    bar(g, area, picture, colour, style);
  }

  return { draw, cellAt };
}

function hatching(g, dark) {
  const tile = document.createElement("canvas");
  tile.width = tile.height = 6;
  const t = tile.getContext("2d");
  t.strokeStyle = dark ? "#555" : "#c4c4c4";
  t.lineWidth = 1;
  t.beginPath();
  t.moveTo(0, 6); t.lineTo(6, 0);
  t.stroke();
  return g.createPattern(tile, "repeat");
}

// Filled in one of two compared runs alone: a plus (this run) or a minus (the other).
function mark(g, which, x, y, w, h, text) {
  const [cx, cy, r] = [x + w / 2, y + h / 2, Math.min(w, h) * 0.28];
  g.strokeStyle = text;
  g.lineWidth = 1.3;
  g.beginPath();
  g.moveTo(cx - r, cy); g.lineTo(cx + r, cy);
  if (which === 1) { g.moveTo(cx, cy - r); g.lineTo(cx, cy + r); }
  g.stroke();
}

function tops(g, run, place) {
  for (const cell of run.top) {
    const [x, y, w, h] = place(cell);
    const r = Math.max(1, Math.min(w, h) * 0.12);
    g.beginPath();
    g.arc(x + w / 2, y + h / 2, r, 0, 7);
    g.fillStyle = "#fff";
    g.fill();
    g.strokeStyle = "#000";
    g.lineWidth = 0.6;
    g.stroke();
  }
}

function playable(g, cells, place) {
  g.fillStyle = "#fff";
  g.strokeStyle = "#000";
  g.lineWidth = 0.5;
  for (const cell of cells) {
    const [x, y, w, h] = place(cell);
    const s = Math.min(w, h) * 0.34;
    g.beginPath();
    g.moveTo(x + w - s - 1, y + h - s - 1); g.lineTo(x + w - 1, y + h - s / 2 - 1); g.lineTo(x + w - s - 1, y + h - 1);
    g.closePath();
    g.fill(); g.stroke();
  }
}

function stars(g, run, axes, area) {
  for (const measures of run.demonstrators) {
    const up = axes.length > 1 ? measures[axes[1]] : 0.5;
    const [cx, cy] = [area.x + measures[axes[0]] * area.width, area.y + (1 - up) * area.height];
    g.beginPath();
    for (let i = 0; i < 10; i++) {
      const r = i % 2 ? 3.6 : 8.5, a = (i * Math.PI) / 5 - Math.PI / 2;
      g.lineTo(cx + r * Math.cos(a), cy + r * Math.sin(a));
    }
    g.closePath();
    g.fillStyle = "#d55e00";
    g.fill();
    g.strokeStyle = "#fff";
    g.lineWidth = 1.2;
    g.stroke();
  }
}

function chosen(g, style, place) {
  const outline = (cell, outer, inner) => {
    const [x, y, w, h] = place(cell);
    g.lineWidth = 4; g.strokeStyle = outer; g.strokeRect(x, y, w, h);
    g.lineWidth = 1.8; g.strokeStyle = inner; g.strokeRect(x, y, w, h);
  };
  if (style.hover >= 0) outline(style.hover, "rgba(255,255,255,.7)", "rgba(0,0,0,.6)");
  if (style.cursor >= 0) {
    g.setLineDash([4, 3]);
    outline(style.cursor, "#fff", "#000");
    g.setLineDash([]);
  }
  style.selected.forEach(([cell, name]) => {
    outline(cell, "#fff", "#000");
    const [x, y, w] = place(cell);
    g.font = "bold 11px sans-serif";
    g.fillStyle = "#000";
    g.fillRect(x + w - 3, y - 9, 13 + 9 * (name.length - 1), 13);
    g.fillStyle = "#fff";
    g.textAlign = "center"; g.textBaseline = "middle";
    g.fillText(name, x + w + 3.5 + 4.5 * (name.length - 1), y - 2);
  });
}

function frame(g, area, run, axes, style) {
  const name = (axis) => `share of time on the ground: ${run.feet[axis]}`;
  g.fillStyle = style.text;
  g.strokeStyle = style.text;
  g.lineWidth = 1;
  g.strokeRect(area.x, area.y, area.width, area.height);
  g.font = "11px sans-serif";
  g.textAlign = "center"; g.textBaseline = "top";
  const bottom = area.y + area.height;
  for (const tick of [0, 0.5, 1]) g.fillText(tick.toString(), area.x + tick * area.width, bottom + 5);
  g.fillText(name(axes[0]), area.x + area.width / 2, bottom + 22);
  if (axes.length < 2) return;
  g.textAlign = "right"; g.textBaseline = "middle";
  for (const tick of [0, 0.5, 1]) g.fillText(tick.toString(), area.x - 6, bottom - tick * area.height);
  g.save();
  g.translate(area.x - 36, area.y + area.height / 2);
  g.rotate(-Math.PI / 2);
  g.textAlign = "center";
  g.fillText(name(axes[1]), 0, 0);
  g.restore();
}

function bar(g, area, picture, colour, style) {
  const [x, y, w, h] = [area.x + area.width + 14, area.y, 12, area.height];
  for (let i = 0; i < h; i++) {
    g.fillStyle = colour(1 - i / h);
    g.fillRect(x, y + i, w, 1.5);
  }
  g.fillStyle = style.text;
  g.textAlign = "left"; g.textBaseline = "middle";
  for (const part of [0, 0.5, 1]) {
    const value = picture.low + part * (picture.high - picture.low);
    g.fillText(number(value), x + w + 4, Math.min(Math.max(y + h * (1 - part), y + 6), y + h - 6));
  }
}
