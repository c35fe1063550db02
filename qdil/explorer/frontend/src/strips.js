// Under the robots: when each foot is on the ground (a gait diagram) and the reward of every step, with the playhead.

import { FEET } from "./colours.js";
import { number } from "./data.js";
import { duration } from "./decode.js";
import { prepare } from "./canvas.js";

const LEFT = 118, RIGHT = 46, ROW = 11, REWARD = 34, GAP = 12, AXIS = 18;

export function strips(canvas) {
  let span = 1;

  /** The time in seconds under the pointer. */
  function timeAt(event) {
    const box = canvas.getBoundingClientRect();
    return Math.min(Math.max((event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT), 0), 1) * span;
  }

  /** `tiles`: [{rollout or null, name}], `feet`: names; drawn from 0 to the longest episode's end. */
  function draw(tiles, feet, time, style) {
    const block = feet.length * (ROW + 2) + REWARD + GAP;
    canvas.style.height = `${Math.max(1, tiles.length) * block + AXIS}px`;
    const { g, width, height } = prepare(canvas);
    span = Math.max(0.1, ...tiles.map((tile) => (tile.rollout ? duration(tile.rollout) : 0)));
    const across = width - LEFT - RIGHT;
    const range = rewardRange(tiles);
    const x = (t) => LEFT + (t / span) * across;
    tiles.forEach((tile, n) => {
      const top = n * block;
      g.fillStyle = style.text;
      g.font = "11px sans-serif";
      g.textAlign = "right"; g.textBaseline = "middle";
      feet.forEach((foot, k) => g.fillText(`${k ? "" : tiles.length > 1 ? tile.name + "  " : ""}${foot}`, LEFT - 8, top + 4 + k * (ROW + 2) + ROW / 2));
      g.fillText("reward per step", LEFT - 8, top + feet.length * (ROW + 2) + REWARD / 2 + 4);
      g.fillStyle = style.faint;
      feet.forEach((_, k) => g.fillRect(LEFT, top + 4 + k * (ROW + 2), across, ROW));
      if (tile.rollout) one(g, tile.rollout, feet, top + 4, { x, right: LEFT + across, range }, style);
    });
    axis(g, height - AXIS, across, span, style);
    const playhead = x(Math.min(time, span));
    g.strokeStyle = style.text;
    g.lineWidth = 1.5;
    g.beginPath(); g.moveTo(playhead, 0); g.lineTo(playhead, height - AXIS + 4); g.stroke();
  }

  return { draw, timeAt };
}

function rewardRange(tiles) {
  let [low, high] = [0, 0];
  for (const { rollout } of tiles) {
    for (const value of rollout ? rollout.reward : []) [low, high] = [Math.min(low, value), Math.max(high, value)];
  }
  return high > low ? [low, high] : [0, 1];
}

function one(g, rollout, feet, top, { x, right, range: [low, high] }, style) {
  feet.forEach((_, k) => {
    g.fillStyle = FEET[k % FEET.length];
    const y = top + k * (ROW + 2);
    for (let t = 0; t < rollout.steps; ) {
      let end = t;
      while (end < rollout.steps && (rollout.contact[end] >> k) & 1) end++;
      if (end > t) g.fillRect(x(t * rollout.seconds), y, x(end * rollout.seconds) - x(t * rollout.seconds), ROW);
      t = Math.max(end, t + 1);
    }
  });
  const base = top + feet.length * (ROW + 2) + 4;
  const y = (value) => base + REWARD - 4 - ((value - low) / (high - low)) * (REWARD - 6);
  g.strokeStyle = style.faint;
  g.lineWidth = 1;
  g.beginPath(); g.moveTo(x(0), y(0)); g.lineTo(x(duration(rollout)), y(0)); g.stroke();
  g.strokeStyle = style.text;
  g.beginPath();
  rollout.reward.forEach((value, t) => g.lineTo(x((t + 0.5) * rollout.seconds), y(value)));
  g.stroke();
  // The scale, the same for all robots: its highest and lowest reward.
  g.fillStyle = style.text;
  g.font = "11px sans-serif";
  g.textAlign = "left"; g.textBaseline = "middle";
  for (const value of [high, low]) g.fillText(number(value), right + 5, y(value));
}

function axis(g, y, across, span, style) {
  g.fillStyle = style.text;
  g.font = "11px sans-serif";
  g.textBaseline = "top"; g.textAlign = "center";
  const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20].find((s) => span / s <= 8) || 50;
  for (let t = 0; t <= span + 1e-9; t += step) {
    g.fillText(`${Number(t.toFixed(1))} s`, LEFT + (t / span) * across, y + 3);
  }
}
