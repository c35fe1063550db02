// The map's squares. An archive has one axis for each of its k feet; the map shows one or two of these axes. A square
// holds every cell with the same place on the shown axes: one cell where the map shows all axes, a stack of them
// otherwise. A square stands for the best elite of its stack. A cell's number counts row by row, the last axis fastest.

/** A cell's place on each of the k axes; `dims`: cells along each axis. */
export function coordinates(dims, cell) {
  const places = new Array(dims.length);
  for (let axis = dims.length - 1; axis >= 0; axis--) {
    places[axis] = cell % dims[axis];
    cell = Math.floor(cell / dims[axis]);
  }
  return places;
}

/** Undoes `coordinates`. */
export const cellNumber = (dims, places) => places.reduce((number, place, axis) => number * dims[axis] + place, 0);

/** The map's columns and rows; a strip has one row. */
export const mapSize = (dims, axes) => [dims[axes[0]], axes.length > 1 ? dims[axes[1]] : 1];

/** The number of the square that holds a cell: column · rows + row. */
export function squareOf(dims, axes, cell) {
  const places = coordinates(dims, cell);
  return axes.reduce((number, axis) => number * dims[axis] + places[axis], 0);
}

/** The first cell of a square's stack. */
export function firstCell(dims, axes, square) {
  const places = new Array(dims.length).fill(0);
  const shown = coordinates(axes.map((axis) => dims[axis]), square);
  axes.forEach((axis, n) => (places[axis] = shown[n]));
  return cellNumber(dims, places);
}

/**
 * An empty map that takes elites one by one. `elites`: {index: cell numbers, true_return}, a row for each elite; a later
 * elite of a cell replaces an earlier one. The best elite of a square has the highest true return, of equal ones the
 * lowest cell number.
 */
export function emptyMap(dims, axes, { index, true_return }) {
  const stacks = new Map(); // square -> cell -> row of its elite
  const beats = (a, b) => true_return[a] > true_return[b] || (true_return[a] === true_return[b] && index[a] < index[b]);
  return {
    /** Puts the elite of `row` into its cell; returns the square. */
    take(row) {
      const square = squareOf(dims, axes, index[row]);
      if (!stacks.has(square)) stacks.set(square, new Map());
      stacks.get(square).set(index[row], row);
      return square;
    },
    /** The row of a square's best elite, −1 where all its cells are empty. */
    best(square) {
      let best = -1;
      for (const row of stacks.get(square)?.values() ?? []) if (best < 0 || beats(row, best)) best = row;
      return best;
    },
  };
}
