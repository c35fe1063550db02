// The explorer's sentences: everything that colours and pictures show, in words.

import { cellOf, FIELDS, forgetful, iterationShown, landingOf, number, rival, rowOf, squareShown, values } from "./data.js";
import { mapSize, squareOf } from "./projection.js";

/** Where a cell lies on the map. */
function place(run, axes, cell) {
  const [, lines] = mapSize(run.cells, axes);
  const square = squareOf(run.cells, axes, cell);
  const column = `column ${Math.floor(square / lines) + 1}`;
  return axes.length > 1 ? `${column}, row ${(square % lines) + 1}` : column;
}

/** What a run's elite of `row` does on fresh episodes; empty if it was not scored again. */
function onFreshEpisodes(run, axes, cell, row) {
  if (!run.fresh) return "";
  const landing = landingOf(run, cell);
  const where = landing < 0 ? "no finite score" : landing === cell ? "lands in its own cell" : `lands in ${place(run, axes, landing)}`;
  return ` On fresh episodes: return ${number(run.fresh.true_return[row] ?? NaN)}, ${where}.`;
}

/** What the archive holds in a cell: all k measures, returns, length. */
export function describe(run, axes, cell) {
  const row = rowOf(run, cell);
  if (row < 0) return `Empty cell (${place(run, axes, cell)}): no policy of ${run.name} walks this way.`;
  const [first, ...others] = run.measures[row].map((share) => `${(100 * share).toFixed(0)} %`);
  const feet = [`${run.feet[0]} on the ground ${first} of the time`, ...others.map((share, k) => `${run.feet[k + 1]} ${share}`)];
  return (
    `Cell at ${place(run, axes, cell)}: ${feet.join(", ")}; ` +
    `true return ${number(run.true_return[row])}, learned fitness ${number(run.fitness[row])}, ` +
    `episode of ${run.length[row].toFixed(0)} steps.` +
    onFreshEpisodes(run, axes, cell, row)
  );
}

/** The text beside the pointer: the cell in the map's run and in the run that is subtracted. */
export function tipOf(runs, state, cell) {
  const [run, other, iteration] = [runs[state.run], rival(runs, state), iterationShown(runs, state)];
  const square = squareShown(run, state.axes, cell, state.field);
  const then = (one) => number(values(one, state.field, iteration, state.axes)[square]);
  const before = other ? `${run.name} ${then(run)}, ${other.name} ${then(other)}` : then(run);
  const text = (iteration < 0 ? "" : `After iteration ${iteration}: ${before}. At the end: `) + describe(run, state.axes, cell);
  if (!other) return text;
  const row = rowOf(other, cellOf(other, state.axes, square, state.field));
  return `${text} ${other.name}: ${row < 0 ? "empty" : `true return ${number(other.true_return[row])}`}.`;
}

/** The label of one of `count` robots: its return in the archive, and its episode. */
export function episodeText(run, tile, count) {
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

/** The caption below the map: its colours and marks. `few`: the cells with a recording, null where a kernel plays all. */
export function captionOf(runs, state, few) {
  const [run, other] = [runs[state.run], rival(runs, state)];
  const above = `; orange where ${run.name} is higher, blue where ${other?.name} is, + filled in the former alone, − in the latter alone`;
  const sentences = [`Colour: ${FIELDS[state.field].unit}${other ? above : ""}. Hatched: empty.`];
  if (run.cells.length > state.axes.length && state.field !== "landed") {
    const others = run.feet.filter((_, axis) => !state.axes.includes(axis)).join(", ");
    sentences.push(`Each square shows the best elite, by true return, over the other feet (${others}).`);
  }
  if (state.field === "landed") sentences.push(...landing([run, ...(other ? [other] : [])]));
  if (state.against >= 0 && state.against !== state.run && !other) {
    sentences.push(`${runs[state.against].name} has another grid, so it is not subtracted.`);
  }
  if (run.demonstrators.length) sentences.push("★ demonstrators.");
  if (run.top.length && !other) sentences.push("● best fifth by return.");
  if (few) sentences.push(`▸ has a recording (${few.length} of ${run.index.length} cells).`);
  sentences.push(...history(runs, state, other));
  return sentences.join(" ");
}

function landing(shown) {
  const shares = shown.map((run) => {
    if (!run.fresh) return `${run.name} did not score its elites again.`;
    const home = run.index.filter((cell, row) => run.fresh.cell[row] === cell).length;
    return `${run.name}: ${home} of ${run.index.length} elites land in their own cell.`;
  });
  return ["Each square shows the best of the elites that land in it.", ...shares];
}

function history(runs, state, other) {
  if (state.field === "landed") return [];
  const without = forgetful(runs, state);
  if (!without.length) return iterationShown(runs, state) < 0 ? [] : ["Robots and their numbers are those of the run's end."];
  const who = without.length === 2 ? "These runs" : other ? without[0].name : "This run";
  return [`${who} kept no history${other ? ", so both are shown at their end" : ": its end is shown"}.`];
}
