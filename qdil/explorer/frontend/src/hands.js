// Pointer and keys on the map, the robots and the time.

import { startView } from "./stage.js";

const MOVES = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const FRAME = 0.01; // seconds, the length of a step while no robot is loaded

/** The key of an event: letters in lower case, whatever Shift and Caps Lock do; "" for shortcuts of browser and editor. */
function keyOf(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return "";
  return event.key.length === 1 ? event.key.toLowerCase() : event.key;
}

/** Calls `act(key, event)`. Unless `act` returns false, the key neither scrolls the page nor reaches the notebook. */
function onKeys(element, act) {
  element.addEventListener("keydown", (event) => {
    if (act(keyOf(event), event) === false) return;
    event.preventDefault();
    event.stopPropagation();
  });
}

/** The map: choose cells. `choice` as selection.js makes it, `best()` the best cell, `beside` {on, toggle}. */
export function mapHands(canvas, map, { choice, best, beside, hover, keyPressed }) {
  canvas.addEventListener("pointermove", (event) => hover(map.cellAt(event), event));
  canvas.addEventListener("pointerleave", () => hover(-1));
  canvas.addEventListener("click", (event) => {
    canvas.focus({ preventScroll: true });
    const more = beside.on() || event.shiftKey || event.ctrlKey || event.metaKey;
    if (map.cellAt(event) >= 0) choice.choose(map.cellAt(event), more ? "toggle" : "alone");
  });
  onKeys(canvas, (key, event) => {
    keyPressed();
    const how = event.shiftKey ? "add" : beside.on() ? "look" : "alone";
    if (MOVES[key]) return choice.move(MOVES[key], how);
    if (key === "Home" || key === "b") return choice.choose(best(), how === "look" ? "add" : how);
    if (key === "Enter") {
      const here = choice.here();
      return choice.choose(here < 0 ? best() : here, event.shiftKey || beside.on() ? "toggle" : "alone");
    }
    return key === "s" ? beside.toggle() : false;
  });
}

/** Time keys, anywhere in the explorer. `time` {toggle, seek, now, step, pace}. */
export function timeHands(ui, strip, time) {
  onKeys(ui.root, (key, event) => {
    if (event.target.matches("button, select, input")) return false;
    const step = time.step() || FRAME;
    if (key === " ") return time.toggle();
    if (key === ",") return time.seek(time.now() - step);
    return key === "." ? time.seek(time.now() + step) : false;
  });
  ui.play.addEventListener("click", time.toggle);
  ui.scrubber.addEventListener("input", () => time.seek(Number(ui.scrubber.value)));
  ui.speed.addEventListener("change", () => time.pace(Number(ui.speed.value)));
  drag(ui.strip, (event) => time.seek(strip.timeAt(event)), true);
}

/** The camera: changes `view` in place, then calls `changed()`. */
export function cameraHands(stage, view, changed) {
  const turn = (azimuth, elevation) => {
    view.azimuth += azimuth;
    view.elevation = Math.min(Math.max(view.elevation + elevation, -0.05), 1.5);
    changed();
  };
  const zoom = (factor) => {
    view.distance = Math.min(Math.max(view.distance * factor, 0.35), 4);
    changed();
  };
  drag(stage, (event) => turn(-event.movementX * 0.008, event.movementY * 0.006));
  stage.addEventListener("dblclick", () => changed(Object.assign(view, startView())));
  stage.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && !event.metaKey && !event.shiftKey) return; // a plain wheel scrolls the page
    zoom(Math.exp((event.deltaY || event.deltaX) * 0.002));
    event.preventDefault();
  }, { passive: false });
  onKeys(stage, (key) => {
    if (MOVES[key]) return turn(0.1 * MOVES[key][0], 0.06 * MOVES[key][1]);
    if (key === "+" || key === "=") return zoom(0.85);
    return key === "-" ? zoom(1 / 0.85) : false;
  });
}

// Calls `move` while a pointer is dragged; with `atOnce`, also where it went down.
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
