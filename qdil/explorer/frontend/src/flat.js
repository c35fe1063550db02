// The stage where a browser has no WebGL: the same robots as thick lines on a plain canvas, without perspective.

import { prepare } from "./canvas.js";
import { FEET } from "./colours.js";
import { between, stepAt } from "./decode.js";
import { tilePlace } from "./stage.js";

export function flatStage(canvas, robot) {
  function draw(rollouts, time, view, dark) {
    const { g, width, height } = prepare(canvas);
    rollouts.forEach((rollout, n) => {
      const [x, y, w, h] = tilePlace(n, rollouts.length);
      const box = [x * width, y * height, w * width, h * height];
      g.save();
      g.beginPath(); g.rect(...box); g.clip();
      g.fillStyle = dark ? "#1d2129" : "#eef2f6";
      g.fillRect(...box);
      if (rollout) one(g, box, robot, rollout, time, view);
      g.restore();
    });
  }
  return { draw, dispose() {} };
}

function one(g, [x, y, w, h], robot, rollout, time, { azimuth, elevation, distance }) {
  const scale = (Math.min(w, h) / (robot.size * 1.7)) / distance;
  const [first] = between(rollout, time);
  const at = (l) => rollout.position.subarray((first * rollout.links + l) * 3, (first * rollout.links + l) * 3 + 3);
  const middle = at(0);
  const right = [-Math.sin(azimuth), Math.cos(azimuth)];
  const project = (p) => [
    x + w / 2 + ((p[0] - middle[0]) * right[0] + (p[1] - middle[1]) * right[1]) * scale,
    y + h * 0.8 - p[2] * Math.cos(elevation) * scale,
  ];
  g.strokeStyle = "#888";
  g.lineWidth = 1;
  g.beginPath(); g.moveTo(x, y + h * 0.8); g.lineTo(x + w, y + h * 0.8); g.stroke();
  g.lineCap = "round";
  const touching = rollout.contact[stepAt(rollout, time)];
  for (const { link, ends, radius, foot } of robot.capsules) {
    const q = rollout.rotation.subarray((first * rollout.links + link) * 4, (first * rollout.links + link) * 4 + 4);
    const [a, b] = [ends.slice(0, 3), ends.slice(3)].map((v) => project(turned(q, v).map((c, i) => c + at(link)[i])));
    g.strokeStyle = foot >= 0 && (touching >> foot) & 1 ? FEET[foot % FEET.length] : "#8d99ae";
    g.lineWidth = 2 * radius * scale;
    g.beginPath(); g.moveTo(...a); g.lineTo(b[0] + 0.01, b[1]); g.stroke();
  }
}

function turned([w, x, y, z], [a, b, c]) {
  const t = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
  return [a + w * t[0] + y * t[2] - z * t[1], b + w * t[1] + z * t[0] - x * t[2], c + w * t[2] + x * t[1] - y * t[0]];
}
