// The rollouts that were asked for: there, on their way, or refused.

const SETTLES = 120; // milliseconds; a held arrow key must not ask for every cell that it passes

/** `request(run, cell)` promises a rollout; `arrived()` is called whenever one came or was refused. */
export function recordings(request, arrived) {
  const known = new Map(); // "run:cell" -> {rollout} or {error} or {}
  let timer = 0, keyed = -Infinity;

  function fetch(wanted) {
    for (const [run, cell] of wanted) {
      const key = `${run}:${cell}`;
      if (known.has(key)) continue;
      known.set(key, {});
      request(run, cell).then(
        (rollout) => known.set(key, { rollout }),
        (error) => known.set(key, { error: error.message }),
      ).then(arrived);
    }
  }

  return {
    /** {rollout} or {error}, or neither while it is on its way. */
    of: (run, cell) => known.get(`${run}:${cell}`) || {},
    /** Asks for what is missing; a moment later if a key was pressed just now. */
    fetch(wanted) {
      clearTimeout(timer);
      const rest = keyed + SETTLES - performance.now();
      if (rest > 0) timer = setTimeout(() => fetch(wanted), rest);
      else fetch(wanted);
    },
    keyPressed: () => (keyed = performance.now()),
    /** Forgets that a cell was refused, so that choosing it again asks again. */
    retry(run, cell) {
      if (known.get(`${run}:${cell}`)?.error) known.delete(`${run}:${cell}`);
    },
    end: () => clearTimeout(timer),
  };
}
