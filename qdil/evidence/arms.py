"""One reading of an experiment's finished runs by seed, and whether runs of one seed may be paired.

The run of seed s learns from the demonstrations of the expert of seed s. Two methods' runs of one seed therefore share
their expert, and the difference between them is free of the luck of its demonstrations. A run that learned from the
expert of another seed must not be paired: all seeds may then share one set of demonstrations.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from qdil.evidence import student, tables
from qdil.evidence.student import Estimate, shared_seeds
from qdil.files import read_json

UNPAIRED = "‡"  # in tables, marks a difference of runs that are not paired by seed
ANOTHER = "another"  # in place of an expert's hash: the expert of another seed, or one that the manifest does not name


class Arm(NamedTuple):
    """A number per finished run of an experiment on one robot."""

    values: Mapping[int, float]  # by seed
    # By seed: the hash of the archive whose elites demonstrated, None without demonstrations, or ANOTHER.
    experts: Mapping[int, str | None] = MappingProxyType({})


def expert_of(manifest: Mapping[str, Any], seed: int) -> str | None:
    """The expert that the run of ``seed`` learned from, as in ``Arm.experts``."""
    if not manifest.get("demonstrations_sha256"):
        return None
    expert = manifest.get("demonstrations_expert") or {}
    return str(expert["archive_sha256"]) if expert.get("seed") == seed else ANOTHER


def read(folders: Iterable[Path], reading: Callable[[Path], float]) -> Arm:
    """Read one number of each run in ``folders``."""
    by_seed = {tables.seed_of(folder): folder for folder in folders}
    experts = {seed: expert_of(read_json(folder / "manifest.json"), seed) for seed, folder in by_seed.items()}
    return Arm({seed: reading(folder) for seed, folder in by_seed.items()}, experts)


def pairable(arms: Sequence[Arm]) -> bool:
    """Whether runs of one seed may be paired: all learned from one expert, that of their seed, or from none."""
    if any(ANOTHER in arm.experts.values() for arm in arms):
        return False
    shared = shared_seeds(*(arm.values for arm in arms))
    return all(len({arm.experts.get(seed) for arm in arms} - {None}) <= 1 for seed in shared)


class Compared(NamedTuple):
    """A difference between arms, and what of them was compared."""

    difference: Estimate
    arms: tuple[Arm, ...]
    paired: bool = True

    def seeds(self) -> tuple[tuple[int, ...], ...]:
        """The seeds of each arm, in ascending order."""
        return tuple(tuple(sorted(arm.values)) for arm in self.arms)


def shared(arms: Sequence[Arm]) -> tuple[Arm, ...]:
    """The arms with the seeds that all have; as they are if they share none."""
    seeds = shared_seeds(*(arm.values for arm in arms))
    return tuple(arm._replace(values={s: arm.values[s] for s in seeds}) for arm in arms) if seeds else tuple(arms)


def difference(ours: Arm, reference: Arm) -> Compared:
    """The mean of ours minus that of the reference: paired by seed, or by Welch where runs may not be paired."""
    both = (ours, reference)
    if not pairable(both):
        values = ([*arm.values.values()] for arm in both)
        return Compared(student.unpaired(*values), both, paired=False)
    return Compared(student.paired(ours.values, reference.values), shared(both))


def seeds_text(seeds: Sequence[Sequence[int]], paired: bool = True) -> str:
    """The seeds that were compared: "1-3" of all arms, or "1-3 / 1-2" arm by arm, marked if they are not paired."""
    return " / ".join(dict.fromkeys(map(_ranges, seeds))) + ("" if paired else f" {UNPAIRED}")


def _ranges(seeds: Sequence[int]) -> str:
    """Ascending seeds as a text: "1-3, 5"; "none" if there are none."""
    runs: list[list[int]] = []
    for seed in seeds:
        if runs and seed == runs[-1][-1] + 1:
            runs[-1].append(seed)
        else:
            runs.append([seed])
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs) or "none"
