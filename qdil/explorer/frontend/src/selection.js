// The chosen cells, up to four, and the cell where the keyboard stands.

import { cellOf, comparable, squareShown } from "./data.js";
import { cellNumber, coordinates, mapSize } from "./projection.js";

const MOST = 4; // robots side by side

/** `changed(isNew)` is called after every choice; `isNew` is false where only the keyboard's place moved. */
export function selection(host, runs, changed) {
  let cursor = null; // [run, cell] where the keyboard stands
  let known = ""; // the chosen cells at that time; when the kernel chooses others, the keyboard follows

  const selected = () => host.get("selected");
  const same = ([run, cell], [r, c]) => run === r && cell === c;

  /** The cell of the map's run from which keys move; −1 before the first choice. */
  function here() {
    const chosen = selected();
    const at = cursor && known === JSON.stringify(chosen) ? cursor : chosen[chosen.length - 1];
    return at ? carried(runs[at[0]], runs[host.get("run")], at[1]) : -1;
  }

  /**
   * Chooses a cell of the map's run. `how`: "alone"; "add", beside the others; "toggle", which also takes a chosen cell
   * away; "look", which only moves the keyboard's place.
   */
  function choose(cell, how = "alone") {
    const one = [host.get("run"), cell];
    const chosen = selected();
    const isChosen = chosen.some((other) => same(other, one));
    let next = chosen;
    if (how === "alone") next = [one];
    else if (how !== "look" && !isChosen) next = [...chosen.slice(chosen.length < MOST ? 0 : 1), one];
    else if (how === "toggle" && chosen.length > 1) next = chosen.filter((other) => !same(other, one));
    [cursor, known] = [one, JSON.stringify(next)];
    if (next !== chosen) host.set("selected", next);
    changed(next !== chosen);
  }

  /**
   * A key's step of `across` columns and `up` rows of the map; the first one goes to the best cell. Squares that stand
   * for no cell are passed over; with none beyond them, the choice stays.
   */
  function move([across, up], how) {
    const [run, axes, field] = [runs[host.get("run")], host.get("axes"), host.get("field")];
    const [columns, lines] = mapSize(run.cells, axes);
    const at = here();
    if (at < 0) return choose(run.best, how);
    const square = squareShown(run, axes, at, field);
    const within = (place, size) => Math.min(Math.max(place, 0), size - 1);
    let next = square, last;
    do {
      last = next;
      next = within(Math.floor(last / lines) + across, columns) * lines + within((last % lines) + up, lines);
    } while (next !== last && cellOf(run, axes, next, field) < 0);
    const cell = cellOf(run, axes, next, field);
    choose(cell < 0 ? at : cell, how);
  }

  return { selected, here, choose, move };
}

/** The cell of `to` at the place of a cell of `from`: their grids may differ. */
function carried(from, to, cell) {
  if (comparable(from, to)) return cell;
  const along = (place, axis) => Math.floor(((place + 0.5) / from.cells[axis]) * to.cells[axis]);
  return cellNumber(to.cells, coordinates(from.cells, cell).map(along));
}
