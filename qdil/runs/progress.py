"""Progress of a run: a bar on a terminal or in a notebook, and plain lines, not too many of them, in a log."""

import sys
import time
from pathlib import Path

from tqdm.auto import tqdm

from qdil.config import Config
from qdil.devices.mesh import idle_devices
from qdil.ppga import Search
from qdil.robots.register import count_measures

SECONDS_BETWEEN_LINES = 15.0
# Columns of metrics.csv that count numbers that were not finite, and what each counts.
PROBLEMS = {
    "not_finite": "candidates left out because their physics diverged",
    "rolled_back": "training phases discarded because a number was not finite",
    "reward_rolled_back": "updates of the reward model discarded because a number was not finite",
}


class Progress:
    """A ``Report`` for people; ``close`` it when the run has ended."""

    def __init__(self, config: Config, live: bool | None = None) -> None:
        """``live``: draw a bar; None: only if standard error is a terminal."""
        self.config = config
        self.name = f"{config.env} {config.method}"
        if config.protocol != "paper":
            self.name += f" ({config.protocol})"
        self.live = sys.stderr.isatty() if live is None else live
        self.bar: tqdm | None = None
        # Number, environment steps and time of the first iteration of this process. Speeds count from there: the time
        # before it, mostly compilation, does not recur.
        self.first: tuple[int, float, float] | None = None
        self.last_line = float("-inf")
        self.problems = dict.fromkeys(PROBLEMS, 0)

    def announce(self, folder: Path, reached: tuple[int, int] | None) -> None:
        """Print whether a new run starts or the run in ``folder`` resumes (``reached``: see ``Report``)."""
        warmed, done = reached or (0, 0)
        if reached:
            self._print(f"Resuming the unfinished run in {folder}: {done} of {self.config.ppga.iterations} iterations.")
        per_copy = self.config.ppo.num_envs // (1 + count_measures(self.config.env))
        if idle := idle_devices(self.config.devices, per_copy, self.config.ppga.candidates):
            self._print(idle)
        if self.live:
            self.bar = tqdm(total=self.config.ppga.iterations, initial=done, desc=self.name, unit="it")
        else:
            left = self.config.ppga.warmup_updates - warmed
            self._print(f"{self.name}: compiling" + (f", then {left} warm-up updates" if left else ""))

    def __call__(self, search: Search, row: dict[str, float]) -> None:
        """Show one iteration."""
        done, time_now = int(row["iteration"]), time.monotonic()
        text = f"coverage {row['coverage']:.0%}, QD-score {row['qd_score']:.0f}, best {row['best']:.0f}"
        if self.first is None:
            self.first = done, row["env_steps"], time_now
        iterations, steps, seconds = done - self.first[0], row["env_steps"] - self.first[1], time_now - self.first[2]
        if iterations and seconds > 0:
            text += f", {steps / seconds:,.0f} steps/s"
        self._print_problems(row)
        if self.bar is not None:
            self._draw(self.bar, done, text, first=not iterations)
        elif done == self.config.ppga.iterations or time_now - self.last_line > SECONDS_BETWEEN_LINES:
            clock = f", {seconds / iterations * (self.config.ppga.iterations - done):.0f} s left" if iterations else ""
            self._print(f"{self.name}: iteration {done}/{self.config.ppga.iterations}, {text}{clock}")
            self.last_line = time_now

    def _draw(self, bar: tqdm, done: int, text: str, first: bool) -> None:
        bar.set_postfix_str(text, refresh=False)
        if first:  # the bar's own clock, too, starts here
            bar.initial = bar.n = done
            bar.unpause()
            bar.refresh()
        else:
            bar.update(done - bar.n)

    def _print_problems(self, row: dict[str, float]) -> None:
        """Print the counts of ``PROBLEMS`` when one first occurs, and again at the last iteration.

        A run with problems has some in nearly every iteration; a line for each would be thousands.
        """
        new = {name: int(row.get(name, 0)) for name in PROBLEMS}
        first_time = any(new[name] and not self.problems[name] for name in PROBLEMS)
        for name, count in new.items():
            self.problems[name] += count
        last = row["iteration"] == self.config.ppga.iterations
        if first_time or (any(self.problems.values()) and last):
            counts = "; ".join(f"{count} {PROBLEMS[name]}" for name, count in self.problems.items() if count)
            self._print(f"{self.name}: by iteration {int(row['iteration'])}, {counts}.")

    def _print(self, line: str) -> None:
        """Print a line without breaking the bar."""
        if self.bar is not None:
            self.bar.write(line)
        else:
            print(line, flush=True)

    def close(self) -> None:
        """Leave the terminal tidy."""
        if self.bar is not None:
            self.bar.close()
