"""A smoke run in a separate process that prints the name of each step and waits a moment before taking it.

``python announcing.py FOLDER ITERATIONS``; a test reads the lines and kills the process at one of them.
"""

import os
import sys
import time
from pathlib import Path

import qdil
from qdil import ppga
from qdil.config import make_config
from qdil.runs import checkpoint, manifest, train

WAIT = 0.15  # seconds: the test reads a line in much less, so the step has not happened yet


def announced(module: object, name: str) -> None:
    """Let the function ``name`` of ``module`` print its name first."""
    function = getattr(module, name)

    def announcing(*args: object, **more: object) -> object:
        print(name, flush=True)
        time.sleep(WAIT)
        return function(*args, **more)

    setattr(module, name, announcing)


def main() -> None:
    folder, iterations = sys.argv[1:]
    qdil.use_all_cores()
    # At "replace" a file has been written under its temporary name and is about to be renamed.
    for module, name in ((ppga, "begin"), (ppga, "warm_up"), (ppga, "iteration"), (os, "replace")):
        announced(module, name)
    for module, name in ((ppga, "reevaluate"), (manifest, "write"), (checkpoint, "remove")):
        announced(module, name)
    train.SAVE_SHARE = 1e9
    train.train(make_config("walker2d", "true", "smoke", iterations=int(iterations)), Path(folder), save_seconds=0.0)


if __name__ == "__main__":
    main()
