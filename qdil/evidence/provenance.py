"""The runs behind a comparison: their seeds and commits, and differences that make some of them hard to compare."""

import subprocess
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from qdil.config import GROUP_OF, SPEED_ONLY, to_json
from qdil.evidence import tables
from qdil.evidence.arms import ANOTHER, expert_of, seeds_text
from qdil.files import read_json
from qdil.lab.lemma import results
from qdil.methods import parse_method
from qdil.runs.folder import RESULTS, read_config
from qdil.runs.studies import config_of

ROOT = Path(__file__).parents[2]
PROTOCOL = Path("docs", "protocol.md")
NONE = "None."  # in place of a list of runs


class Origin(NamedTuple):
    """How one run was made."""

    experiment: str
    seed: int
    commit: str  # its first seven digits, and whether the tree differed from it
    other_settings: tuple[str, ...]  # settings that would have another value if it were trained today
    expert: str | None  # see ``arms.Arm.experts``


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
    return Origin(experiment, seed, _short(manifest), tuple(other), expert_of(manifest, seed))


def sentences(envs: Iterable[str], experiments: Sequence[str], budget: str, root: Path = RESULTS) -> str:
    """A list in Markdown, an item per robot that has runs: seeds, commits, and what differs between its runs."""
    lines = []
    for env in envs:
        runs = tables.counted_seeds(experiments, env, budget, root)
        origins = [origin(name, folder, env, budget) for name, folders in runs.items() for folder in folders]
        if origins:
            lines.append(f"* **{env}**: " + " ".join([*_counts(origins), *_apart(origins)]))
    return "\n".join(lines) or NONE


def lemma_sentence(budget: str, root: Path = RESULTS) -> list[str]:
    """Where the numbers on Lemma 1 are from, as an item of such a list; nothing without a results file."""
    path = results.path_of(budget, root)
    return [f"* **Lemma 1**: `{results.FILE}`, made at {_short(read_json(path))}."] if path.is_file() else []


def protocol_commit(root: Path = ROOT) -> str:
    """The commit that last changed ``docs/protocol.md``, its first seven digits; "unknown" outside a repository."""

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(root), *arguments, "--", PROTOCOL.as_posix()]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    try:
        commit, changed = git("log", "-1", "--format=%H"), git("status", "--porcelain")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{commit[:7] or 'unknown'}{' with local changes' if changed else ''}"


def _short(content: dict[str, Any]) -> str:
    """The commit that a file names: its first seven digits, and whether the tree differed from it."""
    commit, *changed = str(content.get("commit", "unknown")).split(" ", 1)
    return " ".join([commit[:7], *changed])


def _counts(origins: Sequence[Origin]) -> list[str]:
    commits = Counter(one.commit for one in origins)
    return [
        f"Seeds {_seeds(origins)}.",
        "Made at " + ", ".join(f"{commit} ({count})" for commit, count in commits.items()) + ".",
    ]


def _seeds(origins: Sequence[Origin]) -> str:
    """The seeds of each experiment: "1-3 of `gail`; 1-2 of `vail`"."""
    seeds: dict[str, list[int]] = {}
    for one in origins:
        seeds.setdefault(one.experiment, []).append(one.seed)
    return "; ".join(f"{seeds_text([numbers])} of `{name}`" for name, numbers in seeds.items())


def _apart(origins: Sequence[Origin]) -> list[str]:
    """A sentence for everything that makes runs hard to compare."""
    found = []
    for name in sorted({name for one in origins for name in one.other_settings}):
        where = [f"`{one.experiment}` {one.seed}" for one in origins if name in one.other_settings]
        found.append(f"**{name} was not today's** in {', '.join(where)}.")
    if others := [one for one in origins if one.expert == ANOTHER]:
        found.append(f"**Not known to have learned from the expert of their own seed**: {_seeds(others)}.")
    for seed in sorted({one.seed for one in origins}):
        experts = {one.expert for one in origins if one.seed == seed} - {None, ANOTHER}
        if len(experts) > 1:
            found.append(f"**Runs of seed {seed} learned from {len(experts)} different archives of its expert.**")
    return found
