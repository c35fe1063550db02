// Colour scales that remain in order for any kind of colour vision, and the colours of up to six feet and their legs.

const VIRIDIS = [
  [68, 1, 84], [72, 26, 108], [71, 47, 125], [65, 68, 135], [57, 86, 140], [49, 104, 142], [42, 120, 142],
  [35, 136, 142], [31, 152, 139], [34, 168, 132], [53, 183, 121], [84, 197, 104], [122, 209, 81], [165, 219, 54],
  [210, 226, 27], [253, 231, 37],
];
const AROUND_ZERO = [[0, 68, 136], [67, 147, 195], [166, 206, 227], [243, 243, 243], [253, 204, 150], [230, 130, 40], [153, 60, 0]];

function scale(stops, share) {
  const exact = Math.min(Math.max(share, 0), 1) * (stops.length - 1);
  const i = Math.min(Math.floor(exact), stops.length - 2);
  const part = exact - i;
  return `rgb(${stops[i].map((a, c) => Math.round(a + (stops[i + 1][c] - a) * part)).join(",")})`;
}

/** Shares 0 to 1 from dark violet to yellow. */
export const sequential = (share) => scale(VIRIDIS, share);

/** Shares 0 (blue: less) by way of 0.5 (grey: equal) to 1 (orange: more). */
export const diverging = (share) => scale(AROUND_ZERO, share);

// Okabe and Ito's colours, which any kind of colour vision tells apart; drawing.py has the same.
export const FEET = ["#e69f00", "#56b4e9", "#009e73", "#d55e00", "#0072b2", "#cc79a7"];
export const LEGS = ["#7d6b4f", "#5f7f96", "#4f7a6b", "#8a6450", "#4f6680", "#86697a"]; // each with a touch of its foot's
