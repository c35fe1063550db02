// Undoes pack.py: a rollout's bytes become typed arrays.

async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// `count` whole numbers from their low bytes, which lie before their high bytes, with the sign in the lowest bit.
function planes(raw, at, count) {
  const numbers = new Int32Array(count);
  for (let i = 0; i < count; i++) {
    const folded = raw[at + i] | (raw[at + count + i] << 8);
    numbers[i] = folded & 1 ? -((folded + 1) >> 1) : folded >> 1;
  }
  return numbers;
}

/** {steps, frames, links, feet, stride, seconds, fell, position (F·L·3), rotation (F·L·4), contact (T), reward (T)} */
export async function decode(bytes) {
  const raw = await inflate(bytes);
  const size = new DataView(raw.buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(raw.subarray(4, 4 + size)));
  const { frames, links, steps } = header;
  let at = 4 + size;
  const channels = links * 7;
  const changes = planes(raw, at, channels * frames);
  at += 2 * channels * frames;
  const levels = planes(raw, at, steps);
  at += 2 * steps;
  const position = new Float32Array(frames * links * 3);
  const rotation = new Float32Array(frames * links * 4);
  for (let c = 0; c < channels; c++) {
    const isPlace = c < links * 3;
    const target = isPlace ? position : rotation;
    const unit = isPlace ? header.position_unit : header.rotation_unit;
    const width = isPlace ? links * 3 : links * 4;
    const offset = isPlace ? c : c - links * 3;
    let value = 0;
    for (let f = 0; f < frames; f++) {
      value += changes[c * frames + f];
      target[f * width + offset] = value * unit;
    }
  }
  for (let f = 0; f < frames; f++) {
    const root = f * links * 3;
    for (let i = 3; i < links * 3; i++) position[root + i] += position[root + (i % 3)];
  }
  const reward = Float32Array.from(levels, (level) => header.reward_low + level * header.reward_unit);
  return { ...header, position, rotation, contact: raw.slice(at, at + steps), reward };
}

/** Where frame time `t` seconds lies between poses: [frame before, frame after, share of the second]. */
export function between(rollout, t) {
  const last = rollout.frames - 1;
  const exact = Math.min(Math.max(t / (rollout.seconds * rollout.stride), 0), last);
  const first = Math.min(Math.floor(exact), last);
  return [first, Math.min(first + 1, last), exact - first];
}

/** The step that is under way at `t` seconds. */
export function stepAt(rollout, t) {
  return Math.min(Math.max(Math.floor(t / rollout.seconds + 1e-6), 0), rollout.steps - 1);
}

export const duration = (rollout) => rollout.steps * rollout.seconds;
