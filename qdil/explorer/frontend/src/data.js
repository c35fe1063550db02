// What the pictures are drawn from: a run's cells as arrays by cell number, at any iteration, compared with another run.

export const FIELDS = {
  true_return: { name: "True return", unit: "reward units per episode" },
  fitness: { name: "Learned fitness", unit: "reward units per episode" },
  difference: { name: "Learned fitness − true return", unit: "reward units per episode" },
};

/** Numbers by cell, NaN where it is empty; `row` gives a cell's row among the run's elites, −1 where it is empty. */
export function byCell(run) {
  const cells = run.cells[0] * run.cells[1];
  const row = new Int32Array(cells).fill(-1);
  run.index.forEach((cell, i) => (row[cell] = i));
  return row;
}

function valueOf(elites, field, i) {
  return field === "difference" ? elites.fitness[i] - elites.true_return[i] : elites[field][i];
}

/** Whether a run shows `iteration` rather than its end. */
export const looksBack = (run, iteration) => iteration >= 0 && Boolean(run.history);

/** A run's `field` by cell after `iteration`; −1, and for a run that kept no history any: at its end. */
export function values(run, field, iteration) {
  const out = new Float64Array(run.cells[0] * run.cells[1]).fill(NaN);
  if (looksBack(run, iteration)) {
    const { iteration: when, index } = run.history;
    for (let i = 0; i < when.length && when[i] <= iteration; i++) out[index[i]] = valueOf(run.history, field, i);
  } else {
    run.index.forEach((cell, i) => (out[cell] = valueOf(run, field, i)));
  }
  return out;
}

/** One pair of bounds for all runs, so that a colour means the same in each. */
export function bounds(runs, field) {
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
}

/** What the heatmap shows: {values, only (0 both or none, 1 first run alone, 2 second alone), low, high, diverges}. */
export function picture(runs, { run, against, field, iteration }) {
  const mine = values(runs[run], field, iteration);
  const only = new Uint8Array(mine.length);
  const [low, high] = bounds(runs, field);
  if (against < 0 || against === run || !comparable(runs[run], runs[against])) {
    return { values: mine, only, low, high, diverges: field === "difference" };
  }
  const theirs = values(runs[against], field, iteration);
  const gap = mine.map((value, cell) => value - theirs[cell]);
  mine.forEach((value, cell) => {
    if (Number.isFinite(value) !== Number.isFinite(theirs[cell])) only[cell] = Number.isFinite(value) ? 1 : 2;
  });
  const most = gap.reduce((best, value) => (Number.isFinite(value) ? Math.max(best, Math.abs(value)) : best), 0) || 1;
  return { values: gap, only, low: -most, high: most, diverges: true };
}

export const comparable = (a, b) => a.cells[0] === b.cells[0] && a.cells[1] === b.cells[1];

/** The last iteration that any run kept, or −1. */
export function lastIteration(runs) {
  return Math.max(-1, ...runs.map((run) => (run.history ? run.history.last : -1)));
}

export function number(value) {
  if (!Number.isFinite(value)) return "none";
  const size = Math.abs(value);
  return size >= 1000 ? Math.round(value).toLocaleString("en") : value.toFixed(size >= 100 ? 1 : size >= 10 ? 1 : 2);
}
