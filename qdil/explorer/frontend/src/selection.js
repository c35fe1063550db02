// Which cells are watched, up to four, and where the keyboard stands among them.

import { comparable } from "./data.js";

const MOST = 4; // robots side by side

/** `changed(watched)`: another choice; `watched` false where only the keyboard's place moved. */
export function selection(host, runs, changed) {
  let cursor = null; // [run, cell] where the keyboard stands
  let known = ""; // the choice at that time: another one, from the kernel for instance, takes the keyboard along

  const selected = () => host.get("selected");
  const same = ([run, cell], [r, c]) => run === r && cell === c;

  /** The cell of the map's run from which keys move, −1 where nothing was chosen yet. */
  function here() {
    const now = selected();
    const at = cursor && known === JSON.stringify(now) ? cursor : now[now.length - 1];
    return at ? carried(runs[at[0]], runs[host.get("run")], at[1]) : -1;
  }

  /**
   * Watches a cell of the map's run. `how`: "alone"; "add" beside the others; "toggle", which also takes one away that
   * is there; "look", which only moves the keyboard's place.
   */
  function choose(cell, how = "alone") {
    const one = [host.get("run"), cell];
    const now = selected();
    const isThere = now.some((other) => same(other, one));
    let next = now;
    if (how === "alone") next = [one];
    else if (how !== "look" && !isThere) next = [...now.slice(now.length < MOST ? 0 : 1), one];
    else if (how === "toggle" && now.length > 1) next = now.filter((other) => !same(other, one));
    [cursor, known] = [one, JSON.stringify(next)];
    if (next !== now) host.set("selected", next);
    changed(next !== now);
  }

  /** A key's step of `across` columns and `up` rows; the first one goes to the best cell. */
  function move([across, up], how) {
    const run = runs[host.get("run")];
    const [columns, lines] = run.cells;
    const at = here();
    if (at < 0) return choose(run.best, how);
    const i = Math.min(Math.max(Math.floor(at / lines) + across, 0), columns - 1);
    const j = Math.min(Math.max((at % lines) + up, 0), lines - 1);
    choose(i * lines + j, how);
  }

  return { selected, here, choose, move };
}

/** The cell of `to` at the place of a cell of `from`: their grids may differ. */
function carried(from, to, cell) {
  if (comparable(from, to)) return cell;
  const [i, j] = [Math.floor(cell / from.cells[1]), cell % from.cells[1]];
  const along = (n, k) => Math.floor(((n + 0.5) / from.cells[k]) * to.cells[k]);
  return along(i, 0) * to.cells[1] + along(j, 1);
}
