// What the explorer says: everything that colours and pictures show, in sentences.

import { FIELDS, forgetful, iterationShown, number, rival, rowOf, values } from "./data.js";

const place = (run, cell) => `column ${Math.floor(cell / run.cells[1]) + 1}, row ${(cell % run.cells[1]) + 1}`;

/** What the archive knows of a cell. */
export function describe(run, cell) {
  const row = rowOf(run, cell);
  if (row < 0) return `Empty cell (${place(run, cell)}): no policy of ${run.name} walks this way.`;
  const [first, second] = run.measures[row].map((share) => `${(100 * share).toFixed(0)} %`);
  return (
    `Cell at ${place(run, cell)}: ${run.feet[0]} on the ground ${first} of the time, ${run.feet[1]} ${second}; ` +
    `true return ${number(run.true_return[row])}, learned fitness ${number(run.fitness[row])}, ` +
    `episode of ${run.length[row].toFixed(0)} steps.`
  );
}

/** What floats beside the pointer: the cell in the run that the map shows, and in the one it is compared with. */
export function tipOf(runs, state, cell) {
  const [run, other, iteration] = [runs[state.run], rival(runs, state), iterationShown(runs, state)];
  const then = (one) => number(values(one, state.field, iteration)[cell]);
  const before = other ? `${run.name} ${then(run)}, ${other.name} ${then(other)}` : then(run);
  const text = (iteration < 0 ? "" : `After iteration ${iteration}: ${before}. At the end: `) + describe(run, cell);
  if (!other) return text;
  const row = rowOf(other, cell);
  return `${text} ${other.name}: ${row < 0 ? "empty" : `true return ${number(other.true_return[row])}`}.`;
}

/** What one of `count` robots' labels says of it. */
export function said(run, tile, count) {
  if (tile.row < 0) return "empty cell: no robot here";
  const archived = `return ${number(run.true_return[tile.row])}`;
  if (!run.plays) return `${archived} · ${run.why}`;
  if (tile.error) return `${archived} · ${tile.error}`;
  if (!tile.rollout) return `${archived} · simulating; the first time, the simulator compiles for up to a minute`;
  const sum = tile.rollout.reward.reduce((a, b) => a + b, 0);
  const end = tile.rollout.fell ? "then falls" : "to the time limit";
  if (count > 1) return `${archived} · here ${number(sum)}, ${tile.rollout.steps} steps, ${end}`;
  return `${archived} in the archive · ${number(sum)} in this episode, ${tile.rollout.steps} steps, ${end}`;
}

/** The line above the map. */
export function titleOf(runs, state) {
  const [other, iteration] = [rival(runs, state), iterationShown(runs, state)];
  return (
    `${FIELDS[state.field].name}: ${runs[state.run].name}${other ? ` minus ${other.name}` : ""}` +
    (iteration >= 0 ? ` after iteration ${iteration}` : "")
  );
}

/** The line below the map: what its colours and marks mean. `few`: the cells with a recording, null where all play. */
export function captionOf(runs, state, few) {
  const [run, other] = [runs[state.run], rival(runs, state)];
  const above = `; orange where ${run.name} is higher, blue where ${other?.name} is, + filled in the former alone, − in the latter alone`;
  const said = [`Colour: ${FIELDS[state.field].unit}${other ? above : ""}. Hatched: empty.`];
  if (state.against >= 0 && state.against !== state.run && !other) {
    said.push(`${runs[state.against].name} has another grid, so it is not subtracted.`);
  }
  if (run.demonstrators.length) said.push("★ demonstrators.");
  if (run.top.length && !other) said.push("● best fifth by return.");
  if (few) said.push(`▸ has a recording (${few.length} of ${run.index.length} cells).`);
  said.push(...history(runs, state, other));
  return said.join(" ");
}

function history(runs, state, other) {
  const without = forgetful(runs, state);
  if (!without.length) return iterationShown(runs, state) < 0 ? [] : ["Robots and their numbers are those of the run's end."];
  const who = without.length === 2 ? "These runs" : other ? without[0].name : "This run";
  return [`${who} kept no history${other ? ", so both are shown at their end" : ": its end is shown"}.`];
}
