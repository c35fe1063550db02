"""What stands behind a comparison: which runs, made by which commits, and what sets some of them apart from others."""

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from qdil.config import SPEED_ONLY, to_json
from qdil.evidence import tables
from qdil.runs.folder import RESULTS, read_config
from qdil.runs.studies import config_of

LEMMA_FILE = "lemma.json"  # the results of Lemma 1's experiments, beside a budget's runs


class Origin(NamedTuple):
    """Where one run is from."""

    experiment: str
    seed: int
    commit: str  # its first seven digits, and whether the tree differed from it
    other_settings: tuple[str, ...]  # that would be different if it were trained today
    demonstrations: tuple[int, str] | None  # how many, and the hash of their file


def origin(experiment: str, folder: Path, env: str, budget: str) -> Origin:
    """Read a run's manifest and settings. Settings that it knows nothing of are left out."""
    seed = tables.seed_of(folder)
    manifest: dict[str, Any] = json.loads((folder / "manifest.json").read_text())
    config, was = config_of(experiment, env, budget, seed), read_config(folder)
    today = to_json(config)
    other = (name for name in was if name in today and was[name] != today[name] and name not in SPEED_ONLY)
    shown = manifest.get("demonstrations_sha256")
    demonstrations = (config.demos.demo_episodes, shown) if shown else None
    return Origin(experiment, seed, _short(manifest), tuple(other), demonstrations)


def sentences(envs: Iterable[str], experiments: Sequence[str], budget: str, root: Path = RESULTS) -> str:
    """A list in Markdown, an item per robot that has runs: seeds, commits, and what is not the same for all."""
    lines = []
    for env in envs:
        runs = tables.finished_seeds(experiments, env, budget, root)
        origins = [origin(name, folder, env, budget) for name, folders in runs.items() for folder in folders]
        if origins:
            lines.append(f"* **{env}**: " + " ".join([*_counts(origins), *_apart(origins)]))
    if (lemma := root / budget / LEMMA_FILE).is_file():
        lines.append(f"* **Lemma 1**: `{LEMMA_FILE}`, made at {_short(json.loads(lemma.read_text()))}.")
    return "\n".join(lines) or "None."


def _short(made: dict[str, Any]) -> str:
    """A commit's first seven digits, and whether the tree differed from it."""
    commit, *changed = str(made.get("commit", "unknown")).split(" ", 1)
    return " ".join([commit[:7], *changed])


def _counts(origins: Sequence[Origin]) -> list[str]:
    seeds: dict[str, list[str]] = {}
    for run_ in origins:
        seeds.setdefault(run_.experiment, []).append(str(run_.seed))
    commits = Counter(run_.commit for run_ in origins)
    return [
        "Seeds " + "; ".join(f"{', '.join(numbers)} of `{name}`" for name, numbers in seeds.items()) + ".",
        "Made at " + ", ".join(f"{commit} ({count})" for commit, count in commits.items()) + ".",
    ]


def _apart(origins: Sequence[Origin]) -> list[str]:
    """A sentence for everything that makes runs hard to compare."""
    said = []
    settings = sorted({name for run_ in origins for name in run_.other_settings})
    for name in settings:
        whose = [f"`{run_.experiment}` {run_.seed}" for run_ in origins if name in run_.other_settings]
        said.append(f"**{name} was not today's** in {', '.join(whose)}.")
    files = {run_.demonstrations for run_ in origins if run_.demonstrations}
    for number, count in Counter(number for number, _ in files).items():
        if count > 1:
            said.append(f"**These runs learned from {count} different files of {number} demonstrations.**")
    return said
