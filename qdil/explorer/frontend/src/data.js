// What the pictures are drawn from: a run's values by square of the map, at any iteration, compared with another run.

import { emptyMap, firstCell, mapSize, squareOf } from "./projection.js";

export const FIELDS = {
  true_return: { name: "True return", unit: "reward units per episode" },
  fitness: { name: "Learned fitness", unit: "reward units per episode" },
  difference: { name: "Learned fitness − true return", unit: "reward units per episode" },
  landed: { name: "Return on fresh episodes, where it lands", unit: "reward units per episode, mean over fresh episodes" },
};

/** The fields that these runs can show: where elites land is known only of runs that scored them again. */
export const fieldsOf = (runs) => Object.entries(FIELDS).filter(([key]) => key !== "landed" || runs.some((run) => run.fresh));

// Values computed once for an object that does not change: every move of the pointer over the map reads them.
const remembered = new WeakMap();

function once(owner, key, compute) {
  if (!remembered.has(owner)) remembered.set(owner, new Map());
  const known = remembered.get(owner);
  if (!known.has(key)) known.set(key, compute());
  return known.get(key);
}

/** A cell's row among a run's elites, −1 where it is empty. */
export function rowOf(run, cell) {
  return once(run, "rows", () => new Map(run.index.map((one, row) => [one, row]))).get(cell) ?? -1;
}

/**
 * A run's elites in the cells where they land on fresh episodes: {index: those cells, true_return: mean returns, row: rows
 * of the run}. Of elites that land in one cell, the best comes last; of equal ones, the first of the run.
 */
function landed(run) {
  return once(run, "landed", () => {
    const { cell, true_return } = run.fresh ?? { cell: [], true_return: [] };
    const rows = cell.map((_, row) => row).filter((row) => cell[row] >= 0);
    rows.sort((a, b) => true_return[a] - true_return[b] || b - a);
    return { index: rows.map((row) => cell[row]), true_return: rows.map((row) => true_return[row]), row: rows };
  });
}

/** What a field's map is made of: a run's elites at its end, their history, or the elites where they land. */
function elitesOf(run, field, iteration) {
  if (field === "landed") return landed(run);
  return iteration >= 0 && run.history ? run.history : run;
}

function valueOf(elites, field, i) {
  if (field === "landed") return elites.true_return[i];
  return field === "difference" ? elites.fitness[i] - elites.true_return[i] : elites[field][i];
}

export const comparable = (a, b) => a.cells.join() === b.cells.join();

/** The run that is subtracted; null where none is chosen or its grid differs. */
export function rival(runs, { run, against }) {
  return against >= 0 && against !== run && comparable(runs[run], runs[against]) ? runs[against] : null;
}

/** The shown runs without a history. */
export function forgetful(runs, state) {
  const other = rival(runs, state);
  return [runs[state.run], ...(other ? [other] : [])].filter((run) => !run.history);
}

/** The iteration that the map shows; −1 is the end, also where a shown run has no history. Elites land at the end alone. */
export function iterationShown(runs, state) {
  return state.field === "landed" || forgetful(runs, state).length ? -1 : state.iteration;
}

/** The rows of the best elites by square, −1 where a square is empty; rows of `elitesOf`. */
function bestRows(run, field, axes, iteration) {
  const elites = elitesOf(run, field, iteration);
  const past = elites === run.history;
  const fill = () => {
    const map = emptyMap(run.cells, axes, elites);
    for (let row = 0; row < elites.index.length && !(past && elites.iteration[row] > iteration); row++) map.take(row);
    const [columns, lines] = mapSize(run.cells, axes);
    return Int32Array.from({ length: columns * lines }, (_, square) => map.best(square));
  };
  return past ? fill() : once(elites, `best ${axes}`, fill);
}

/**
 * The cell that a square of a field's map stands for: that of its best elite at the run's end; where it is empty, its
 * first cell. Where elites land, it is the cell that the elite won, and −1 where none lands.
 */
export function cellOf(run, axes, square, field) {
  const row = bestRows(run, field, axes, -1)[square];
  if (field === "landed") return row < 0 ? -1 : run.index[landed(run).row[row]];
  return row < 0 ? firstCell(run.cells, axes, square) : run.index[row];
}

/** The cell where the elite of a cell lands on fresh episodes; −1 if that is not known. */
export function landingOf(run, cell) {
  const row = rowOf(run, cell);
  return row >= 0 && run.fresh ? run.fresh.cell[row] : -1;
}

/** The square where a field's map shows the elite of a cell. */
export function squareShown(run, axes, cell, field) {
  const landing = field === "landed" ? landingOf(run, cell) : -1;
  return squareOf(run.cells, axes, landing < 0 ? cell : landing);
}

/** A run's `field` by square after `iteration`; at the run's end for −1 and for a run without a history. */
export function values(run, field, iteration, axes) {
  const elites = elitesOf(run, field, iteration);
  return Float64Array.from(bestRows(run, field, axes, iteration), (row) => (row < 0 ? NaN : valueOf(elites, field, row)));
}

/** One pair of bounds for all runs, iterations and axes, so that a colour means the same in each. */
export function bounds(runs, field) {
  return once(runs, field, () => {
    let low = Infinity, high = -Infinity;
    const shown = (run) => (field === "landed" ? [run, landed(run)] : run.history ? [run, run.history] : [run]);
    for (const elites of runs.flatMap(shown)) {
      elites.index.forEach((_, row) => {
        const value = valueOf(elites, field, row);
        if (Number.isFinite(value)) [low, high] = [Math.min(low, value), Math.max(high, value)];
      });
    }
    if (low > high) return [0, 1];
    if (field === "difference") [low, high] = [-Math.max(-low, high, 0), Math.max(-low, high, 0)];
    return high > low ? [low, high] : [low - 0.5, high + 0.5];
  });
}

/** The largest difference between two runs in any square, at the end and, if both have a history, at any iteration. */
function widest(a, b, field, axes) {
  const [ofA, ofB] = [values(a, field, -1, axes), values(b, field, -1, axes)];
  const larger = (most, gap) => (Math.abs(gap) > most ? Math.abs(gap) : most); // false for NaN
  let most = ofA.reduce((best, value, square) => larger(best, value - ofB[square]), 0);
  if (field !== "landed" && a.history && b.history) {
    const events = [a, b].flatMap(({ history }, side) => history.index.map((_, row) => ({
      side, row, when: history.iteration[row],
    })));
    const maps = [a, b].map((run) => emptyMap(run.cells, axes, run.history));
    const value = (side, square) => {
      const row = maps[side].best(square);
      return row < 0 ? NaN : valueOf([a, b][side].history, field, row);
    };
    let changed = []; // squares, in the iteration under way
    events.sort((p, q) => p.when - q.when).forEach(({ side, row, when }, i) => {
      changed.push(maps[side].take(row));
      if (events[i + 1]?.when === when) return;
      most = changed.reduce((best, square) => larger(best, value(0, square) - value(1, square)), most);
      changed = [];
    });
  }
  return most || 1;
}

/** What the heatmap shows: {values, only (0 both or none, 1 first run alone, 2 second alone), low, high, diverges}. */
export function picture(runs, state) {
  const { run, against, field, axes } = state;
  const [other, iteration] = [rival(runs, state), iterationShown(runs, state)];
  const first = values(runs[run], field, iteration, axes);
  const only = new Uint8Array(first.length);
  if (!other) {
    const [low, high] = bounds(runs, field);
    return { values: first, only, low, high, diverges: field === "difference" };
  }
  const second = values(other, field, iteration, axes);
  first.forEach((value, square) => {
    if (Number.isFinite(value) !== Number.isFinite(second[square])) only[square] = Number.isFinite(value) ? 1 : 2;
  });
  const most = once(runs, `${field} ${run} ${against} ${axes}`, () => widest(runs[run], other, field, axes));
  return { values: first.map((value, square) => value - second[square]), only, low: -most, high: most, diverges: true };
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
