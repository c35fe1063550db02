// Every requested rollout: received, under way, or refused.

const SETTLES = 120; // milliseconds; a held arrow key must not request every cell that it passes

/** `request(run, cell)` promises a rollout; `arrived()` is called after each answer. */
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
    /** {rollout} or {error}; neither while the request is under way. */
    of: (run, cell) => known.get(`${run}:${cell}`) || {},
    /** Requests the missing rollouts; after a key press it waits a moment first. */
    fetch(wanted) {
      clearTimeout(timer);
      const rest = keyed + SETTLES - performance.now();
      if (rest > 0) timer = setTimeout(() => fetch(wanted), rest);
      else fetch(wanted);
    },
    keyPressed: () => (keyed = performance.now()),
    /** Forgets a refusal, so that the next choice of the cell requests it again. */
    retry(run, cell) {
      if (known.get(`${run}:${cell}`)?.error) known.delete(`${run}:${cell}`);
    },
    end: () => clearTimeout(timer),
  };
}
