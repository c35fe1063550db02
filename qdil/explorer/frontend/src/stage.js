// Up to four robots, each on the ground in its own part of one canvas. One camera follows each robot in turn.

import {
  CanvasTexture, CapsuleGeometry, Color, DirectionalLight, Fog, Group, HemisphereLight, Mesh, MeshBasicMaterial,
  MeshStandardMaterial, PCFShadowMap, PerspectiveCamera, PlaneGeometry, Quaternion, RepeatWrapping, RingGeometry, Scene,
  SphereGeometry, SRGBColorSpace, Vector3, WebGLRenderer,
} from "three";
import { FEET, LEGS } from "./colours.js";
import { between, stepAt } from "./decode.js";

const UP = new Vector3(0, 0, 1);
const BODY = "#9aa3b2";
const GROUND = 60; // metres across

/** Where tile `n` of `count` lies, in shares of the canvas: [x, y from the top, width, height]. */
export function tilePlace(n, count) {
  const columns = count > 1 ? 2 : 1, rows = count > 2 ? 2 : 1;
  return [(n % columns) / columns, Math.floor(n / columns) / rows, 1 / columns, 1 / rows];
}

const LABEL = 40; // pixels that a robot's label takes at the top of its part

export function startView() {
  return { azimuth: -Math.PI / 2 + 0.35, elevation: 0.16, distance: 1 };
}

/** Draws `robot` (see shown.py) with three.js. Throws where the browser has no WebGL. */
export function stage(canvas, robot) {
  const renderer = new WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = PCFShadowMap;
  renderer.setScissorTest(true);
  const scene = new Scene();
  const camera = new PerspectiveCamera(32, 1, 0.05, 200);
  camera.up.copy(UP);
  const ground = makeGround();
  const sun = makeSun();
  scene.add(ground, sun, sun.target, new HemisphereLight("#ffffff", "#8a8578", 1.6));
  const bodies = [0, 1, 2, 3].map(() => makeRobot(robot));
  scene.add(...bodies.map((body) => body.group));
  const height = robot.size;
  let fitted = [];

  function draw(rollouts, time, view, dark) {
    const ratio = window.devicePixelRatio || 1;
    const [width, tall] = [canvas.clientWidth, canvas.clientHeight];
    fit(width, tall, ratio);
    const sky = new Color(dark ? "#1d2129" : "#eef2f6");
    scene.background = sky;
    scene.fog = new Fog(sky, 9 * height, 22 * height);
    rollouts.forEach((rollout, n) => {
      const [x, y, w, h] = tilePlace(n, rollouts.length);
      renderer.setViewport(x * width, (1 - y - h) * tall, w * width, h * tall);
      renderer.setScissor(x * width, (1 - y - h) * tall, w * width, h * tall);
      bodies.forEach((body, i) => (body.group.visible = i === n && !!rollout));
      const middle = rollout ? pose(bodies[n], rollout, time) : new Vector3(0, 0, robot.torso);
      look(middle, w * width, h * tall, view);
      renderer.render(scene, camera);
    });
  }

  // Setting a canvas's size clears it and makes new buffers, even if the size stays the same.
  function fit(width, tall, ratio) {
    if (fitted.join() === [width, tall, ratio].join()) return;
    fitted = [width, tall, ratio];
    renderer.setPixelRatio(ratio);
    renderer.setSize(width, tall, false);
  }

  function look(middle, width, tall, { azimuth, elevation, distance }) {
    const aspect = width / tall;
    const target = new Vector3(middle.x, middle.y, robot.middle + 0.6 * (middle.z - robot.torso));
    const far = ((height * 2.7) / Math.min(1, aspect)) * distance;
    const flat = Math.cos(elevation) * far;
    camera.position.set(
      target.x + Math.cos(azimuth) * flat, target.y + Math.sin(azimuth) * flat, Math.max(0.05, target.z + Math.sin(elevation) * far),
    );
    camera.setViewOffset(width, tall, 0, -LABEL / 2, width, tall); // centred in the space below the label
    camera.lookAt(target);
    // Move the ground with the robot by whole tiles: the tiles then seem to lie still.
    ground.position.set(2 * Math.round(target.x / 2), 2 * Math.round(target.y / 2), 0);
    sun.target.position.set(target.x, target.y, 0);
    sun.position.set(target.x - 1.2 * height, target.y - 2 * height, 3.4 * height);
  }

  function dispose() {
    scene.traverse((node) => {
      node.geometry?.dispose();
      node.material?.map?.dispose();
      node.material?.dispose();
    });
    renderer.dispose();
    renderer.forceContextLoss();
  }

  return { draw, dispose };
}

function makeGround() {
  const tile = document.createElement("canvas");
  tile.width = tile.height = 64;
  const g = tile.getContext("2d");
  g.fillStyle = "#d9dde2";
  g.fillRect(0, 0, 64, 64);
  g.fillStyle = "#c3c9d1";
  g.fillRect(0, 0, 32, 32);
  g.fillRect(32, 32, 32, 32);
  const texture = new CanvasTexture(tile);
  texture.colorSpace = SRGBColorSpace;
  texture.wrapS = texture.wrapT = RepeatWrapping;
  texture.repeat.set(GROUND / 2, GROUND / 2);
  texture.anisotropy = 8;
  const ground = new Mesh(new PlaneGeometry(GROUND, GROUND), new MeshStandardMaterial({ map: texture, roughness: 1 }));
  ground.receiveShadow = true;
  return ground;
}

function makeSun() {
  const sun = new DirectionalLight("#fff6e8", 2.4);
  sun.castShadow = true;
  sun.shadow.mapSize.set(1024, 1024);
  sun.shadow.radius = 3;
  Object.assign(sun.shadow.camera, { left: -3, right: 3, top: 3, bottom: -3, near: 0.1, far: 20 });
  return sun;
}

function makeRobot(robot) {
  const group = new Group();
  const links = Array.from({ length: robot.links }, () => new Group());
  const feet = robot.feet.map(() => []);
  group.add(...links);
  for (const { link, ends, radius, foot, leg } of robot.capsules) {
    const [a, b] = [new Vector3(...ends.slice(0, 3)), new Vector3(...ends.slice(3))];
    const length = a.distanceTo(b);
    const shape = length > 1e-6 ? new CapsuleGeometry(radius, length, 8, 20) : new SphereGeometry(radius, 24, 16);
    const material = new MeshStandardMaterial({ color: leg >= 0 ? LEGS[leg % LEGS.length] : BODY, roughness: 0.55, metalness: 0.05 });
    const mesh = new Mesh(shape, material);
    mesh.castShadow = mesh.receiveShadow = true;
    mesh.position.copy(a).add(b).multiplyScalar(0.5);
    if (length > 1e-6) mesh.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), b.sub(a).normalize());
    links[link].add(mesh);
    if (foot >= 0) feet[foot].push(mesh);
  }
  // Each touching foot also gets a ring on the ground, for readers who cannot tell the colours apart.
  const rings = robot.feet.map((_, k) => {
    const ring = new Mesh(new RingGeometry(0.16, 0.21, 40), new MeshBasicMaterial({ color: FEET[k % FEET.length] }));
    group.add(ring);
    return ring;
  });
  return { group, links, feet, rings, place: new Vector3() };
}

const [qa, qb, foot] = [new Quaternion(), new Quaternion(), new Vector3()];

/** Puts a robot into the pose at `time`; returns the position of its first link, the torso. */
function pose(body, rollout, time) {
  const [first, second, share] = between(rollout, time);
  const { position: p, rotation: r, links } = rollout;
  body.links.forEach((link, l) => {
    const [a, b] = [(first * links + l) * 3, (second * links + l) * 3];
    link.position.set(
      p[a] + (p[b] - p[a]) * share, p[a + 1] + (p[b + 1] - p[a + 1]) * share, p[a + 2] + (p[b + 2] - p[a + 2]) * share,
    );
    const [c, d] = [(first * links + l) * 4, (second * links + l) * 4];
    qa.set(r[c + 1], r[c + 2], r[c + 3], r[c]).normalize();
    qb.set(r[d + 1], r[d + 2], r[d + 3], r[d]).normalize();
    link.quaternion.copy(qa).slerp(qb, share);
  });
  const touching = rollout.contact[stepAt(rollout, time)];
  body.group.updateMatrixWorld(true);
  body.feet.forEach((meshes, k) => {
    const on = (touching >> k) & 1;
    let lowest = null;
    for (const mesh of meshes) {
      mesh.material.color.set(on ? FEET[k % FEET.length] : LEGS[k % LEGS.length]);
      mesh.material.emissive.set(on ? FEET[k % FEET.length] : "#000000");
      mesh.material.emissiveIntensity = on ? 0.45 : 0;
      mesh.getWorldPosition(foot);
      if (!lowest || foot.z < lowest.z) lowest = foot.clone();
    }
    body.rings[k].visible = !!on && lowest !== null; // a foot without capsules is not drawn
    if (lowest) body.rings[k].position.set(lowest.x, lowest.y, 0.004);
  });
  return body.links[0].position;
}
