"""Telling a person how a run goes: a bar on a terminal or in a notebook, plain throttled lines in a log."""

import sys
import time

from tqdm.auto import tqdm

from qdil.config import Config
from qdil.ppga import Search

SECONDS_BETWEEN_LINES = 15.0


class Progress:
    """Call it after every iteration with the search and its row of metrics; ``close`` it at the end."""

    def __init__(self, config: Config, live: bool | None = None) -> None:
        """``live`` draws a bar; by default where standard error is a terminal."""
        self.config = config
        self.live = sys.stderr.isatty() if live is None else live
        self.bar = tqdm(total=config.iterations, desc=f"{config.env} {config.method}", unit="it") if self.live else None
        # The first iteration seen and its moment: what came before, compilation above all, does not recur.
        self.begun: tuple[int, float] | None = None
        self.last_line = 0.0
        if self.bar is None:
            print(f"{config.env} {config.method}: compiling, then {config.warmup_updates} warm-up updates", flush=True)

    def __call__(self, search: Search, row: dict[str, float]) -> None:
        """Show one iteration."""
        text = (
            f"coverage {row['coverage']:.0%}, QD-score {row['qd_score']:.0f}, best {row['best']:.0f}, "
            f"{row['env_steps'] / max(row['wall_seconds'], 1e-9):.0f} steps/s"
        )
        done, total = int(row["iteration"]), self.config.iterations
        if self.begun is None:
            self.begun = done, time.monotonic()
        if self.bar is not None:
            self.bar.set_postfix_str(text, refresh=False)
            self.bar.update(done - self.bar.n)
        elif done == total or time.monotonic() - self.last_line > SECONDS_BETWEEN_LINES:
            first, moment = self.begun
            left = (time.monotonic() - moment) / max(done - first, 1) * (total - done)
            clock = f", {left:.0f} s left" if done > first else ""
            print(f"{self.config.env} {self.config.method}: iteration {done}/{total}, {text}{clock}", flush=True)
            self.last_line = time.monotonic()

    def close(self) -> None:
        """Leave the terminal tidy."""
        if self.bar is not None:
            self.bar.close()
