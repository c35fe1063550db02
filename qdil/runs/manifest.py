"""``manifest.json``: the commit, packages, device, times and demonstrations of a run, and the hashes of its files."""

import platform
import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import jax

from qdil.files import sha256, write_json
from qdil.imitation.demos import expert_of
from qdil.ppga import Search

PACKAGES = ("jax", "jaxlib", "brax", "mujoco", "mujoco-mjx", "ribs", "optax", "numpy")
HASHED = ("config.json", "metrics.csv", "history.npz", "archive.npz", "policies.npz", "summary.json")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def this_process() -> dict[str, str]:
    """The commit and the time at which this process starts to work on a run."""
    return {"commit": commit(), "start": _now()}


def write(
    search: Search, folder: Path, processes: Sequence[dict[str, str]], seconds: float, demos_file: Path | None
) -> None:
    """Write ``folder``'s manifest, which makes it a finished run.

    ``processes``: ``this_process`` of each process that worked on the run, in order. The manifest's ``start`` is the
    first one's, ``commit`` the last one's; ``resumed`` lists the starts of the others, and ``commits`` all commits if
    they differ. ``seconds``: wall time of all processes together. ``demonstrations_expert`` names the run that
    ``demos_file`` was recorded from (``expert_of``).
    """
    commits = list(dict.fromkeys(process["commit"] for process in processes))
    devices = jax.devices()[: search.engine.num_devices]
    write_json(
        folder / "manifest.json",
        {
            "commit": processes[-1]["commit"],
            **({"commits": commits} if len(commits) > 1 else {}),
            "start": processes[0]["start"],
            "resumed": [process["start"] for process in processes[1:]],
            "packages": {name: version(name) for name in PACKAGES},
            "python": platform.python_version(),
            "device": f"{len(devices)} x {devices[0].device_kind}",
            "seed": search.config.seed,
            "end": _now(),
            "seconds": round(seconds, 1),
            "demonstrations_sha256": sha256(demos_file) if demos_file else None,
            "demonstrations_expert": expert_of(demos_file) if demos_file else None,
            "sha256": {name: sha256(folder / name) for name in HASHED},
        },
    )


def commit() -> str:
    """The repository's commit, marked where the working tree differs from it; "unknown" outside a repository."""
    package = Path(__file__).parent
    try:
        run = ["git", "-C", str(package)]
        head = subprocess.run([*run, "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
        changed = subprocess.run([*run, "status", "--porcelain", "--", str(package)], capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{head} with local changes" if changed.stdout.strip() else head
