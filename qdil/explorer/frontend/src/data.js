// What the pictures are drawn from: a run's cells as arrays by cell number, at any iteration, compared with another run.

export const FIELDS = {
  true_return: { name: "True return", unit: "reward units per episode" },
  fitness: { name: "Learned fitness", unit: "reward units per episode" },
  difference: { name: "Learned fitness − true return", unit: "reward units per episode" },
};

// What is computed once for an object that doesn't change: a pointer that moves over the map asks for it again and again.
const remembered = new WeakMap();

function once(owner, key, compute) {
  if (!remembered.has(owner)) remembered.set(owner, new Map());
  const known = remembered.get(owner);
  if (!known.has(key)) known.set(key, compute());
  return known.get(key);
}

/** A cell's row among a run's elites, −1 where it is empty. */
export function rowOf(run, cell) {
  const rows = once(run, "rows", () => {
    const all = new Int32Array(run.cells[0] * run.cells[1]).fill(-1);
    run.index.forEach((one, i) => (all[one] = i));
    return all;
  });
  return rows[cell] ?? -1;
}

function valueOf(elites, field, i) {
  return field === "difference" ? elites.fitness[i] - elites.true_return[i] : elites[field][i];
}

export const comparable = (a, b) => a.cells[0] === b.cells[0] && a.cells[1] === b.cells[1];

/** The run that is subtracted, null where none is or where its grid differs. */
export function rival(runs, { run, against }) {
  return against >= 0 && against !== run && comparable(runs[run], runs[against]) ? runs[against] : null;
}

/** The runs in the picture that kept no history. */
export function forgetful(runs, state) {
  const other = rival(runs, state);
  return [runs[state.run], ...(other ? [other] : [])].filter((run) => !run.history);
}

/** The iteration that the picture shows; −1 is the end: asked for, or because a run in the picture kept no history. */
export function iterationShown(runs, state) {
  return forgetful(runs, state).length ? -1 : state.iteration;
}

/** A run's `field` by cell after `iteration`; −1, and for a run that kept no history any: at its end. */
export function values(run, field, iteration) {
  const out = new Float64Array(run.cells[0] * run.cells[1]).fill(NaN);
  if (iteration >= 0 && run.history) {
    const { iteration: when, index } = run.history;
    for (let i = 0; i < when.length && when[i] <= iteration; i++) out[index[i]] = valueOf(run.history, field, i);
  } else {
    run.index.forEach((cell, i) => (out[cell] = valueOf(run, field, i)));
  }
  return out;
}

/** One pair of bounds for all runs and iterations, so that a colour means the same in each. */
export function bounds(runs, field) {
  return once(runs, field, () => {
    let low = Infinity, high = -Infinity;
    for (const run of runs) {
      const all = run.history ? run.history.index.map((_, i) => valueOf(run.history, field, i)) : [];
      for (const value of [...values(run, field, -1), ...all]) {
        if (Number.isFinite(value)) [low, high] = [Math.min(low, value), Math.max(high, value)];
      }
    }
    if (low > high) return [0, 1];
    if (field === "difference") [low, high] = [-Math.max(-low, high, 0), Math.max(-low, high, 0)];
    return high > low ? [low, high] : [low - 0.5, high + 0.5];
  });
}

/** The largest difference between two runs in any cell, at the end and, where both kept it, on the way there. */
function widest(a, b, field) {
  const [mine, theirs] = [values(a, field, -1), values(b, field, -1)];
  const larger = (most, gap) => (Math.abs(gap) > most ? Math.abs(gap) : most); // false for NaN
  let most = mine.reduce((best, value, cell) => larger(best, value - theirs[cell]), 0);
  if (a.history && b.history) {
    const taken = [a, b].flatMap(({ history }, side) => history.index.map((cell, i) => ({
      side, cell, when: history.iteration[i], value: valueOf(history, field, i),
    })));
    const now = [mine, theirs].map((all) => all.fill(NaN));
    let changed = []; // cells, in the iteration that is gone through
    taken.sort((p, q) => p.when - q.when).forEach(({ side, cell, value, when }, i) => {
      now[side][cell] = value;
      changed.push(cell);
      if (taken[i + 1]?.when === when) return;
      most = changed.reduce((best, one) => larger(best, now[0][one] - now[1][one]), most);
      changed = [];
    });
  }
  return most || 1;
}

/** What the heatmap shows: {values, only (0 both or none, 1 first run alone, 2 second alone), low, high, diverges}. */
export function picture(runs, state) {
  const { run, against, field } = state;
  const [other, iteration] = [rival(runs, state), iterationShown(runs, state)];
  const mine = values(runs[run], field, iteration);
  const only = new Uint8Array(mine.length);
  if (!other) {
    const [low, high] = bounds(runs, field);
    return { values: mine, only, low, high, diverges: field === "difference" };
  }
  const theirs = values(other, field, iteration);
  mine.forEach((value, cell) => {
    if (Number.isFinite(value) !== Number.isFinite(theirs[cell])) only[cell] = Number.isFinite(value) ? 1 : 2;
  });
  const most = once(runs, `${field} ${run} ${against}`, () => widest(runs[run], other, field));
  return { values: mine.map((value, cell) => value - theirs[cell]), only, low: -most, high: most, diverges: true };
}

/** The last iteration that any run kept, or −1. */
export function lastIteration(runs) {
  return Math.max(-1, ...runs.map((run) => (run.history ? run.history.last : -1)));
}

export function number(value) {
  if (!Number.isFinite(value)) return "none";
  const size = Math.abs(value);
  return size >= 1000 ? Math.round(value).toLocaleString("en") : value.toFixed(size >= 10 ? 1 : 2);
}
