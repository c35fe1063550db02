// The archive as a picture: cells on the measure square, marks of the demonstrators, the colour bar.

import { diverging, sequential } from "./colours.js";
import { number } from "./data.js";
import { prepare } from "./canvas.js";

const LEFT = 50, BOTTOM = 46, TOP = 10, BAR = 74;

export function heatmap(canvas) {
  let area = { x: LEFT, y: TOP, size: 100 };
  let dims = [1, 1];

  function cellAt(event) {
    const box = canvas.getBoundingClientRect();
    const i = Math.floor(((event.clientX - box.left - area.x) / area.size) * dims[0]);
    const j = Math.floor((1 - (event.clientY - box.top - area.y) / area.size) * dims[1]);
    return i >= 0 && j >= 0 && i < dims[0] && j < dims[1] ? i * dims[1] + j : -1;
  }

  /** Screen rectangle of a cell: [x, y, width, height]. Cell number = i·(cells of measure 2) + j. */
  function place(cell) {
    const [i, j] = [Math.floor(cell / dims[1]), cell % dims[1]];
    const [w, h] = [area.size / dims[0], area.size / dims[1]];
    return [area.x + i * w, area.y + area.size - (j + 1) * h, w, h];
  }

  function draw(picture, run, looks) {
    dims = run.cells;
    const { g, width, height } = prepare(canvas);
    area = { x: LEFT, y: TOP, size: Math.max(40, Math.min(width - LEFT - BAR, height - TOP - BOTTOM)) };
    const colour = picture.diverges ? diverging : sequential;
    const share = (value) => (value - picture.low) / (picture.high - picture.low);
    const hatch = hatching(g, looks.dark);
    const gap = dims[0] > 40 ? 0.25 : 0.5;
    for (let cell = 0; cell < picture.values.length; cell++) {
      const [x, y, w, h] = place(cell);
      const value = picture.values[cell];
      g.fillStyle = Number.isFinite(value) ? colour(share(value)) : looks.dark ? "#3a3a3a" : "#e2e2e2";
      g.fillRect(x + gap, y + gap, w - 2 * gap, h - 2 * gap);
      if (picture.only[cell]) mark(g, picture.only[cell], x, y, w, h, looks.text);
      else if (!Number.isFinite(value)) {
        g.fillStyle = hatch;
        g.fillRect(x + gap, y + gap, w - 2 * gap, h - 2 * gap);
      }
    }
    if (!looks.compares) tops(g, run, place);
    if (looks.playable) playable(g, looks.playable, place);
    stars(g, run, area);
    chosen(g, looks, place);
    axes(g, area, run, looks);
    bar(g, area, picture, colour, looks);
  }

  return { draw, cellAt, place };
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

function stars(g, run, area) {
  for (const [first, second] of run.demonstrators) {
    const [cx, cy] = [area.x + first * area.size, area.y + (1 - second) * area.size];
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

function chosen(g, looks, place) {
  const frame = (cell, outer, inner) => {
    const [x, y, w, h] = place(cell);
    g.lineWidth = 4; g.strokeStyle = outer; g.strokeRect(x, y, w, h);
    g.lineWidth = 1.8; g.strokeStyle = inner; g.strokeRect(x, y, w, h);
  };
  if (looks.hover >= 0) frame(looks.hover, "rgba(255,255,255,.7)", "rgba(0,0,0,.6)");
  if (looks.cursor >= 0) {
    g.setLineDash([4, 3]);
    frame(looks.cursor, "#fff", "#000");
    g.setLineDash([]);
  }
  looks.selected.forEach(([cell, name]) => {
    frame(cell, "#fff", "#000");
    const [x, y, w] = place(cell);
    g.font = "bold 11px sans-serif";
    g.fillStyle = "#000";
    g.fillRect(x + w - 3, y - 9, 13, 13);
    g.fillStyle = "#fff";
    g.textAlign = "center"; g.textBaseline = "middle";
    g.fillText(name, x + w + 3.5, y - 2);
  });
}

function axes(g, area, run, looks) {
  g.fillStyle = looks.text;
  g.strokeStyle = looks.text;
  g.lineWidth = 1;
  g.strokeRect(area.x, area.y, area.size, area.size);
  g.font = "11px sans-serif";
  g.textAlign = "center"; g.textBaseline = "top";
  const bottom = area.y + area.size;
  for (const tick of [0, 0.5, 1]) g.fillText(tick.toString(), area.x + tick * area.size, bottom + 5);
  g.fillText(`share of time on the ground: ${run.feet[0]}`, area.x + area.size / 2, bottom + 22);
  g.textAlign = "right"; g.textBaseline = "middle";
  for (const tick of [0, 0.5, 1]) g.fillText(tick.toString(), area.x - 6, bottom - tick * area.size);
  g.save();
  g.translate(area.x - 36, area.y + area.size / 2);
  g.rotate(-Math.PI / 2);
  g.textAlign = "center";
  g.fillText(`share of time on the ground: ${run.feet[1]}`, 0, 0);
  g.restore();
}

function bar(g, area, picture, colour, looks) {
  const [x, y, w, h] = [area.x + area.size + 14, area.y, 12, area.size];
  for (let i = 0; i < h; i++) {
    g.fillStyle = colour(1 - i / h);
    g.fillRect(x, y + i, w, 1.5);
  }
  g.fillStyle = looks.text;
  g.textAlign = "left"; g.textBaseline = "middle";
  for (const part of [0, 0.5, 1]) {
    const value = picture.low + part * (picture.high - picture.low);
    g.fillText(number(value), x + w + 4, Math.min(Math.max(y + h * (1 - part), y + 6), y + h - 6));
  }
}
