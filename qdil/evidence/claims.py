"""Judge the claims of ``catalogue`` from the finished runs: on every robot, under every protocol, by both readings."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from qdil.config import BUDGETS
from qdil.errors import ConfigError
from qdil.evidence import arms, tables
from qdil.evidence.arms import Arm
from qdil.evidence.catalogue import CLAIMS, LEMMA, parts_under
from qdil.evidence.claims_page import markdown, plain, verdicts_on, write
from qdil.evidence.corrected import CORRECTED, METRICS
from qdil.evidence.readings import READINGS
from qdil.evidence.report import overview, table
from qdil.evidence.verdicts import NO_RUNS, SMALL_MDP, Claim, Finding, Part, Verdict, find, with_holm
from qdil.lab.lemma import results
from qdil.robots.register import PAPER_ROBOTS
from qdil.robots.register import find as find_robot
from qdil.runs.folder import RESULTS
from qdil.runs.studies import PROTOCOL_NAMES, budget_of

__all__ = ["CLAIMS", "Claim", "Verdict", "judge", "markdown", "overview", "plain", "table", "verdicts_on", "write"]

BY_CORRECTED = dict(zip(METRICS, CORRECTED, strict=True))  # a reading as claimed -> its corrected counterpart
Arms = dict[tuple[str, str], Arm]  # by reading and experiment


def experiments_needed(claims: Iterable[Claim] = CLAIMS, protocol: str | None = None) -> tuple[str, ...]:
    """Every experiment that ``claims`` compare under a protocol (None: under those of the claim), each once.

    A name that starts with a budget, such as ``desk/gail``, is an experiment at that budget.
    """
    found: dict[str, None] = {}
    for claim in claims:
        for one in claim.protocols if protocol is None else set(claim.protocols) & {protocol}:
            parts = [part for part in parts_under(claim, one) if part.reading != LEMMA]
            found |= dict.fromkeys(name for part in parts for name in (part.ours, *part.against))
    return tuple(found)


def judge(root: Path = RESULTS, budget: str = "laptop", envs: Sequence[str] | None = None) -> list[Verdict]:
    """Judge every claim on every robot of the paper (or those of ``envs``) from the finished runs of one budget.

    Seeds outside ``COUNTED_SEEDS`` do not count. The first of a claim's protocols is always judged, the others where
    there are runs. Lemma 1 is judged on every problem in its results file. Verdicts come in the order of protocols,
    claims, and robots. Raises ConfigError for a budget that does not exist, a robot that is not the paper's, and a
    results file that cannot be read.
    """
    if budget not in BUDGETS:
        raise ConfigError(f"unknown budget '{budget}'; choose one of {', '.join(BUDGETS)}.")
    robots = tuple(PAPER_ROBOTS if envs is None else envs)
    for env in robots:
        if find_robot(env).name not in PAPER_ROBOTS:
            raise ConfigError(f"the claims are not about '{env}', but about {', '.join(PAPER_ROBOTS)}.")
    changes = _lemma_changes(budget, root)
    judged = [claim for claim in CLAIMS if _is_of(claim, budget)]
    values = {env: _arms(judged, env, budget, root) for env in robots}
    problems = dict.fromkeys((SMALL_MDP, *(name for name in changes if name not in PAPER_ROBOTS)))
    verdicts = [
        _judge(claim, env, protocol, values.get(env, {}), changes.get(env))
        for protocol in PROTOCOL_NAMES
        for claim in judged
        if protocol in claim.protocols
        for env in ([*problems, *robots] if claim.id == "C14" else robots)
    ]
    return [v for v in verdicts if v.protocol == v.claim.protocols[0] or v.verdict != NO_RUNS]


def _is_of(claim: Claim, budget: str) -> bool:
    """Whether a claim is judged at a budget: one that names budgets only at these."""
    named = {budget_of(name)[0] for part in claim.parts for name in (part.ours, *part.against)} - {None}
    return not named or budget in named


def _corrected(parts: Sequence[Part]) -> tuple[Part, ...]:
    """The same comparisons of corrected metrics; none if a part compares anything but the four metrics."""
    if not all(part.reading in BY_CORRECTED for part in parts):
        return ()
    return tuple(part._replace(reading=BY_CORRECTED[part.reading]) for part in parts)


def _judge(claim: Claim, env: str, protocol: str, values: Arms, changes: results.Changes | None) -> Verdict:
    parts = parts_under(claim, protocol)
    as_claimed, corrected = ([_find(part, values, changes) for part in some] for some in (parts, _corrected(parts)))
    return Verdict(claim, env, protocol, with_holm(as_claimed), with_holm(corrected))


def _arms(claims: Sequence[Claim], env: str, budget: str, root: Path) -> Arms:
    """Every reading that some claim needs, of every finished run that counts."""
    parts = [part for claim in claims for protocol in claim.protocols for part in parts_under(claim, protocol)]
    needed = {(part.reading, name): None for part in parts for name in (part.ours, *part.against)}
    needed |= {(BY_CORRECTED[what], name): None for what, name in needed if what in BY_CORRECTED}
    folders = {name: _folders(name, env, budget, root) for name in dict.fromkeys(name for _, name in needed)}
    return {(what, name): arms.read(folders[name], READINGS[what]) for what, name in needed if folders[name]}


def _folders(name: str, env: str, budget: str, root: Path) -> list[Path]:
    of_budget, experiment = budget_of(name)
    return tables.counted_seeds([experiment], env, of_budget or budget, root).get(experiment, [])


def _find(part: Part, values: Arms, changes: results.Changes | None) -> Finding:
    """Judge a comparison from the runs' ``values``, or Lemma 1 from the ``changes`` in its file."""
    if part.reading == LEMMA and changes:
        part = part._replace(ours=changes.improvement)
        found = find(part, {part.ours: Arm(dict(enumerate(changes.by_seed)))})
        return found._replace(trials=tuple(changes.trials))
    return find(part, {name: arm for (what, name), arm in values.items() if what == part.reading})


def _lemma_changes(budget: str, root: Path) -> dict[str, results.Changes]:
    """Changes of P(m ∈ A_e | π) by problem or robot; empty without a file."""
    try:
        return {env: results.changes(problem) for env, problem in results.read(budget, root).items()}
    except (ValueError, KeyError, TypeError, AttributeError):
        path = results.path_of(budget, root)
        raise ConfigError(f"{path} is no results file of Lemma 1: remove it and execute its notebook again.") from None
