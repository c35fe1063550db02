// Two ways in: as a widget of a live notebook (anywidget calls `render`), or as a page of its own with its data inside.

import { decode } from "./decode.js";
import { explorer } from "./explorer.js";

const PATIENCE = 120; // seconds to wait for the kernel: the first rollout compiles

/** anywidget's entry. Returns a function that cleans up when the widget is removed. */
function render({ model, el }) {
  const waiting = new Map();
  const onMessage = (message, buffers) => {
    const key = `${message.run}:${message.cell}`;
    const answer = waiting.get(key);
    if (!answer) return;
    waiting.delete(key);
    if (message.type === "refused") answer.no(new Error(message.why));
    else answer.yes(decode(new Uint8Array(buffers[0].buffer, buffers[0].byteOffset, buffers[0].byteLength)));
  };
  model.on("msg:custom", onMessage);
  const host = {
    show: model.get("show"),
    menus: false,
    get: (name) => model.get(name),
    set(name, value) {
      model.set(name, value);
      model.save_changes();
    },
    on: (name, then) => model.on(`change:${name}`, then),
    request(run, cell) {
      const key = `${run}:${cell}`;
      if (waiting.has(key)) return waiting.get(key).promise;
      const answer = {};
      answer.promise = new Promise((yes, no) => Object.assign(answer, { yes, no }));
      waiting.set(key, answer);
      model.send({ type: "want", run, cell });
      setTimeout(() => {
        if (waiting.delete(key)) answer.no(new Error("The kernel does not answer: it may be busy with another cell, or have stopped."));
      }, PATIENCE * 1000);
      return answer.promise;
    },
  };
  const stop = explorer(el, host);
  return () => {
    model.off("msg:custom", onMessage);
    stop();
  };
}

/** A page's entry. `data`: {show, rollouts: {"run:cell": base64}, state}, all of the state (see page.py). */
function mount(el, data) {
  const { state } = data;
  const listeners = new Map();
  const host = {
    show: data.show,
    menus: true,
    get: (name) => state[name],
    set(name, value) {
      state[name] = value;
      for (const then of listeners.get(name) || []) then();
    },
    on: (name, then) => listeners.set(name, [...(listeners.get(name) || []), then]),
    async request(run, cell) {
      const packed = data.rollouts[`${run}:${cell}`];
      if (!packed) throw new Error("No recording of this cell in this page; cells with a small triangle have one.");
      return decode(Uint8Array.from(atob(packed), (c) => c.charCodeAt(0)));
    },
  };
  // Only now cover the picture that lies under the page in a notebook's output.
  Object.assign(document.body.style, { background: "#fff", minHeight: "100vh" });
  return explorer(el, host);
}

if (globalThis.qdilPage) mount(document.getElementById("qdil-explorer"), globalThis.qdilPage);

export default { render };
