"""A smoke run as a process of its own that says what it is about to do, and waits a moment before it does it.

``python announcing.py FOLDER ITERATIONS``; a test reads the lines and kills the process at one of them.
"""

import os
import sys
import time
from pathlib import Path

from qdil import ppga
from qdil.config import make_config
from qdil.runs import checkpoint, manifest
from qdil.runs.train import train

WAIT = 0.15  # seconds: the test reads a line in much less, so that what it announces has not happened yet


def announced(module: object, name: str) -> None:
    """Let the function ``name`` of ``module`` say its name first."""
    function = getattr(module, name)

    def announcing(*args: object, **more: object) -> object:
        print(name, flush=True)
        time.sleep(WAIT)
        return function(*args, **more)

    setattr(module, name, announcing)


def main() -> None:
    folder, iterations = sys.argv[1:]
    # "replace" is where a file is written, under its temporary name, and about to get its own.
    for module, name in ((ppga, "begin"), (ppga, "warm_up"), (ppga, "iteration"), (os, "replace")):
        announced(module, name)
    for module, name in ((ppga, "reevaluate"), (manifest, "write"), (checkpoint, "remove")):
        announced(module, name)
    SAVE_EVERY, SAVE_SHARE = 0.0, 1e9
    train(make_config("walker2d", "true", "smoke", iterations=int(iterations)), Path(folder))


if __name__ == "__main__":
    main()
