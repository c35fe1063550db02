"""The runs behind a comparison: their seeds and commits, and differences that make some of them hard to compare."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from qdil.config import GROUP_OF, SPEED_ONLY, to_json
from qdil.evidence import tables
from qdil.files import read_json
from qdil.lab.lemma import results
from qdil.methods import parse_method
from qdil.runs.folder import RESULTS, read_config
from qdil.runs.studies import config_of


class Origin(NamedTuple):
    """How one run was made."""

    experiment: str
    seed: int
    commit: str  # its first seven digits, and whether the tree differed from it
    other_settings: tuple[str, ...]  # settings that would have another value if it were trained today
    demonstrations: tuple[int, int, str] | None  # how many, their expert's seed, and their file's hash; None: none read


def origin(experiment: str, folder: Path, env: str, budget: str) -> Origin:
    """Read a run's manifest and settings.

    Settings that only one version of the library has are left out, and those of demonstrations for a method that does
    not imitate.
    """
    seed = tables.seed_of(folder)
    manifest = read_json(folder / "manifest.json")
    config, trained = config_of(experiment, env, budget, seed), read_config(folder)
    today = to_json(config)
    silent = set(SPEED_ONLY)
    if not parse_method(config.method).base.imitates:
        silent |= {name for name, group in GROUP_OF.items() if group == "demos"}
    other = (n for n in trained if n in today and trained[n] != today[n] and n not in silent)
    file_hash = manifest.get("demonstrations_sha256")
    expert_seed = trained["expert_seed"] or seed
    demonstrations = (config.demos.demo_episodes, expert_seed, file_hash) if file_hash else None
    return Origin(experiment, seed, _short(manifest), tuple(other), demonstrations)


def sentences(envs: Iterable[str], experiments: Sequence[str], budget: str, root: Path = RESULTS) -> str:
    """A list in Markdown, an item per robot that has runs: seeds, commits, and what differs between its runs."""
    lines = []
    for env in envs:
        runs = tables.finished_seeds(experiments, env, budget, root)
        origins = [origin(name, folder, env, budget) for name, folders in runs.items() for folder in folders]
        if origins:
            lines.append(f"* **{env}**: " + " ".join([*_counts(origins), *_apart(origins)]))
    if (lemma := results.path_of(budget, root)).is_file():
        lines.append(f"* **Lemma 1**: `{results.FILE}`, made at {_short(read_json(lemma))}.")
    return "\n".join(lines) or "None."


def _short(content: dict[str, Any]) -> str:
    """The commit that a file names: its first seven digits, and whether the tree differed from it."""
    commit, *changed = str(content.get("commit", "unknown")).split(" ", 1)
    return " ".join([commit[:7], *changed])


def _counts(origins: Sequence[Origin]) -> list[str]:
    seeds: dict[str, list[str]] = {}
    for one in origins:
        seeds.setdefault(one.experiment, []).append(str(one.seed))
    commits = Counter(one.commit for one in origins)
    return [
        "Seeds " + "; ".join(f"{', '.join(numbers)} of `{name}`" for name, numbers in seeds.items()) + ".",
        "Made at " + ", ".join(f"{commit} ({count})" for commit, count in commits.items()) + ".",
    ]


def _apart(origins: Sequence[Origin]) -> list[str]:
    """A sentence for everything that makes runs hard to compare."""
    found = []
    for name in sorted({name for one in origins for name in one.other_settings}):
        where = [f"`{one.experiment}` {one.seed}" for one in origins if name in one.other_settings]
        found.append(f"**{name} was not today's** in {', '.join(where)}.")
    files = {one.demonstrations for one in origins if one.demonstrations}
    for (number, expert_seed), count in Counter(file[:2] for file in files).items():
        if count > 1:
            what = f"{number} demonstrations of the expert with seed {expert_seed}"
            found.append(f"**These runs learned from {count} different files of {what}.**")
    return found
