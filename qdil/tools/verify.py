"""``qdil verify``: check a finished run's files by their hashes, and evaluate a sample of its elites again."""

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdil.config import Config, change, from_json
from qdil.engine.engine import Engine
from qdil.errors import ConfigError
from qdil.files import read_json, sha256
from qdil.runs import summary
from qdil.runs.folder import is_finished, read_archive


class Verified(NamedTuple):
    """The result of ``verify``."""

    changed: list[str]  # files whose hash is not the manifest's
    missing: list[str]  # files that the manifest names and the folder does not contain
    sampled: int  # elites evaluated again; 0 without policies
    returns: np.ndarray  # (sampled, 2) true return in the archive, and on new episodes
    moved: np.ndarray  # (sampled,) distance between archived and new measures
    metrics: str = ""  # the run's metrics, as claimed and corrected; empty if its elites were not scored again
    obstacle: str = ""  # the reason why no elite was evaluated, if no file is changed or missing

    def sound(self) -> bool:
        """Whether all files match the manifest. Policies may be missing, since they are not kept in git."""
        return not self.changed and set(self.missing) <= {"policies.npz"}


def verify(folder: Path, seed: int = 0) -> Verified:
    """Check the finished run in ``folder``. Raises ConfigError if there is none, or if its manifest is damaged.

    The hashes are checked first. They need the manifest alone, so that they can be checked for runs of other versions
    of this program and for runs with damaged files.
    """
    expected = _expected(folder)
    missing = [name for name in expected if not (folder / name).is_file()]
    changed = [n for n, digest in expected.items() if n not in missing and sha256(folder / n) != digest]
    nothing = Verified(changed, missing, 0, np.zeros((0, 2)), np.zeros(0))
    if nothing.sound():
        nothing = nothing._replace(metrics=_metrics(folder))
    if missing or changed:
        return nothing
    try:
        config = from_json(read_json(folder / "config.json"))
        elites = read_archive(folder, policies=True)
    except ConfigError as error:
        return nothing._replace(obstacle=str(error))
    count = min(config.ppga.candidates, len(elites["index"]))
    if count == 0:
        return nothing._replace(obstacle="The archive is empty.")
    rows = np.random.default_rng(seed).choice(len(elites["index"]), count, replace=False)
    true_return, measures = _evaluate(config, elites, rows, seed)
    return nothing._replace(
        sampled=count,
        returns=np.stack([elites["true_return"][rows], true_return[:count]], axis=1),
        moved=np.linalg.norm(elites["measures"][rows] - measures[:count], axis=1),
    )


def _metrics(folder: Path) -> str:
    try:
        return summary.sentences(summary.read(folder))
    except ConfigError:
        return ""


def _expected(folder: Path) -> dict[str, str]:
    """The hashes in a run's manifest, by file name."""
    if not is_finished(folder):
        raise ConfigError(f"there is no finished run in {folder}.")
    expected = read_json(folder / "manifest.json").get("sha256")
    if not isinstance(expected, dict):
        raise ConfigError(f"{folder / 'manifest.json'} is damaged: it holds no hashes.")
    return expected


def _evaluate(
    config: Config, elites: dict[str, np.ndarray], rows: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """True return (λ,) and measures (λ, k) of elites ``rows``, the last of which is repeated to fill a batch."""
    # This machine may have fewer devices than the one that trained the run.
    engine = Engine(change(config, method="true", devices=0))
    rows = np.concatenate([rows, np.full(config.ppga.candidates - len(rows), rows[-1])])
    key, init_key = jax.random.split(jax.random.key(seed))
    occupied = jnp.zeros((config.ppga.cells,) * elites["measures"].shape[1], bool)
    scores = engine.score(engine.init(init_key, None), occupied, engine.elites(elites, rows), key)
    return np.asarray(scores.true_return), np.asarray(scores.measures)


def report(found: Verified) -> str:
    """The result in a few lines of text."""
    lines = [f"{name}: does not match the manifest" for name in found.changed]
    lines += [f"{name}: missing" for name in found.missing]
    if not lines:
        lines.append("All files match the manifest.")
    lines += [found.metrics] if found.metrics else []
    if found.sampled:
        old, new = found.returns.T
        change = np.median(np.abs(new - old))
        lines += [
            f"{found.sampled} elites on new episodes:",
            f"  average return {old.mean():.1f} in the archive, {new.mean():.1f} now (median change {change:.1f}),",
            f"  measures moved by {np.median(found.moved):.3f} (median), {found.moved.max():.3f} (largest).",
        ]
    elif found.missing and found.sound():
        lines.append("No policies here to evaluate again: train the run on this machine to get them.")
    if found.obstacle:
        lines.append(f"No elite was evaluated again: {found.obstacle}")
    return "\n".join(lines)
