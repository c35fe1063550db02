"""Telling a person how a run goes: a bar on a terminal or in a notebook, plain throttled lines in a log."""

import sys
import time
from pathlib import Path

from tqdm.auto import tqdm

from qdil.config import Config
from qdil.devices.mesh import idle_devices
from qdil.ppga import Search
from qdil.robots.register import count_measures

SECONDS_BETWEEN_LINES = 15.0
# Columns of metrics.csv that say how often something turned not finite, as people would put it.
TROUBLES = {
    "not_finite": "candidates left out because their physics diverged",
    "rolled_back": "training phases undone because they turned not finite",
    "reward_rolled_back": "rounds of the reward model's learning undone because they turned not finite",
}


class Progress:
    """Call it after every iteration with the search and its row of metrics; ``close`` it at the end."""

    def __init__(self, config: Config, live: bool | None = None) -> None:
        """``live`` draws a bar; by default where standard error is a terminal."""
        self.config = config
        self.name = f"{config.env} {config.method}"
        self.live = sys.stderr.isatty() if live is None else live
        self.bar: tqdm | None = None
        # Iterations and steps at the first iteration seen, and its moment: what came before, compilation above all,
        # neither recurs nor says anything about speed.
        self.first: tuple[int, float, float] | None = None
        self.last_line = float("-inf")
        self.troubles = dict.fromkeys(TROUBLES, 0)

    def announce(self, folder: Path, reached: tuple[int, int] | None) -> None:
        """Say what is about to happen: all of a run in ``folder``, or the rest of one that ``reached`` that far."""
        warmed, done = reached or (0, 0)
        if reached:
            self._say(
                f"Going on with the unfinished run in {folder}: {done} of {self.config.ppga.iterations} iterations."
            )
        per_copy = self.config.ppo.num_envs // (1 + count_measures(self.config.env))
        if idle := idle_devices(self.config.devices, per_copy, self.config.ppga.candidates):
            self._say(idle)
        if self.live:
            self.bar = tqdm(total=self.config.ppga.iterations, initial=done, desc=self.name, unit="it")
        else:
            left = self.config.ppga.warmup_updates - warmed
            self._say(f"{self.name}: compiling" + (f", then {left} warm-up updates" if left else ""))

    def __call__(self, search: Search, row: dict[str, float]) -> None:
        """Show one iteration."""
        done, now = int(row["iteration"]), time.monotonic()
        text = f"coverage {row['coverage']:.0%}, QD-score {row['qd_score']:.0f}, best {row['best']:.0f}"
        if self.first is None:
            self.first = done, row["env_steps"], now
        iterations, steps, seconds = done - self.first[0], row["env_steps"] - self.first[1], now - self.first[2]
        if iterations and seconds > 0:
            text += f", {steps / seconds:,.0f} steps/s"
        self._tell_troubles(row)
        if self.bar is not None:
            self._draw(self.bar, done, text, first=not iterations)
        elif done == self.config.ppga.iterations or now - self.last_line > SECONDS_BETWEEN_LINES:
            clock = f", {seconds / iterations * (self.config.ppga.iterations - done):.0f} s left" if iterations else ""
            self._say(f"{self.name}: iteration {done}/{self.config.ppga.iterations}, {text}{clock}")
            self.last_line = now

    def _draw(self, bar: tqdm, done: int, text: str, first: bool) -> None:
        bar.set_postfix_str(text, refresh=False)
        if first:  # the clock of its speed and of the time left starts here, too
            bar.initial = bar.n = done
            bar.unpause()
            bar.refresh()
        else:
            bar.update(done - bar.n)

    def _tell_troubles(self, row: dict[str, float]) -> None:
        """Name what went wrong: at once the first time, and all together at the end.

        A run in trouble has some in nearly every iteration, and nobody reads thousands of such lines.
        """
        new = {name: int(row.get(name, 0)) for name in TROUBLES}
        first_time = any(new[name] and not self.troubles[name] for name in TROUBLES)
        for name, count in new.items():
            self.troubles[name] += count
        last = row["iteration"] == self.config.ppga.iterations
        if first_time or (any(self.troubles.values()) and last):
            told = "; ".join(f"{count} {TROUBLES[name]}" for name, count in self.troubles.items() if count)
            self._say(f"{self.name}: by iteration {int(row['iteration'])}, {told}.")

    def _say(self, line: str) -> None:
        """A line that leaves the bar whole."""
        if self.bar is not None:
            self.bar.write(line)
        else:
            print(line, flush=True)

    def close(self) -> None:
        """Leave the terminal tidy."""
        if self.bar is not None:
            self.bar.close()
