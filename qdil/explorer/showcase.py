"""Small copies of finished runs, kept in the repository: readers see robots walk before they train any."""

import json
import shutil
from pathlib import Path

import numpy as np

from qdil.explorer import shown as showing
from qdil.files import sha256, write_json, write_npz
from qdil.runs.folder import RESULTS, demos_name, read_archive, read_config

FOLDER = RESULTS / "showcase"


def keep(folder: Path, root: Path = FOLDER) -> Path:
    """Copy a finished run into ``root/<env>/<method>/seed-<n>`` with its policies in 16 bits; returns that folder.

    16 bits halve the size; the rounding changes an episode no more than another start state does. The measures of the
    run's demonstrators are copied too. Raises ConfigError for a run that is not finished or has no policies.
    """
    config, archive = read_config(folder), read_archive(folder, policies=True)
    target = root / config["env"] / config["method"] / f"seed-{config['seed']}"
    write_npz(target / "archive.npz", **{n: archive[n] for n in (*showing.NEEDED, *showing.FRESH) if n in archive})
    policies = {name: archive[name] for name in ("index", "obs_mean", "obs_std")}
    write_npz(target / "policies.npz", **policies, solution=archive["solution"].astype(np.float16))
    write_json(target / "config.json", config)
    manifest = json.loads((folder / "manifest.json").read_text())
    files = ["config.json", "archive.npz", "policies.npz"]
    if (folder / "history.npz").is_file():
        shutil.copyfile(folder / "history.npz", target / "history.npz")
        files.append("history.npz")
    manifest |= {"policies": "rounded to 16 bits for the showcase", "sha256": {n: sha256(target / n) for n in files}}
    demonstrators = showing.read(folder)[0].demonstrators
    if len(demonstrators):
        name = demos_name(config["demo_episodes"], config.get("expert_seed") or config["seed"])
        write_npz(target.parent.parent / name, elite_measures=demonstrators)
    write_json(target / "manifest.json", manifest)
    return target


def kept(env: str, root: Path = FOLDER) -> dict[str, Path]:
    """A robot's runs in the showcase, by method: the expert first, then its imitators."""
    folders = {path.parent.parent.name: path.parent for path in sorted((root / env).glob("*/seed-*/manifest.json"))}
    return dict(sorted(folders.items(), key=lambda one: (one[0] != "true", len(one[0]), one[0])))
