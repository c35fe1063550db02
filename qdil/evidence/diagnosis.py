"""Does an imitation work? A run's numbers beside what a healthy run shows, and what to do where they differ. No JAX.

``diagnose`` reads a run's folder; ``CHECKS`` lists the questions. Each has a healthy range and the source of it:

* *controls*: the kept runs ``true`` (three seeds on walker2d, one on halfcheetah) and ``mbo-true`` (three on walker2d)
  at ``laptop``, whose reward is never stale and never wrong; the range is theirs, rounded away from them.
* *budget*: the condition by which the small budgets' sizes were chosen.
* *reasoning*: no control has the number; the text says what it would mean beyond the range. For the rank correlation
  of two orders: of normal variables, the share of pairs in the same order is 1/2 + arcsin(2 sin(ρ π/6)) / π.

No range was fitted to runs that imitate. "look here" is no proof of a fault, and "ok" none of success: the true return
on fresh episodes decides, and only an experimenter can see that.
"""

import json
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from qdil.evidence import symptoms
from qdil.evidence.markdown import markdown_table
from qdil.evidence.symptoms import DoesNotApply, NotRecorded, RunFiles

OK, LOOK, NOT_RECORDED, NOT_APPLICABLE = "ok", "look here", "not recorded", "does not apply"
INFINITY = math.inf
PAGE, TITLE = 110, 44  # characters of the report: of a line, and of a check's title
MOST = 0.5  # share of discarded phases above which a run has learned nearly nothing
MOSTLY_DISCARDED = "Most of its training phases were discarded, so the numbers below say little about imitation."


class Check(NamedTuple):
    """A question to a run: its number, and the range of it that a healthy run shows."""

    name: str
    group: str  # what it is about: reward, archive or search
    title: str
    read: Callable[[RunFiles], float]
    low: float  # the healthy range, both ends in it
    high: float
    form: str  # how the number is written: "share" (as a percentage), "correlation" or "ratio"
    source: str  # of the range: controls, budget or reasoning, as above
    below: str = ""  # what a number below the range means, and what to do
    above: str = ""


STALE = (
    "Elites keep scores of an earlier reward model, so challengers cannot win. Let the reward model see an elite "
    "before it is scored (restart_rounds), or learn from all recent policies (replay_share)."
)
TOO_STRONG = "D is too strong. Weaken it: fewer reward_steps, a larger gradient_penalty, or VAIL."
GUESSES = "D guesses. The imitation is perfect, or D has learned nothing: the order of returns tells which."
LUCKY = "Cells were won by luck: read the corrected metrics. More episodes per candidate or fewer cells help."
NO_Q = "The bonus is p alone there: it rewards lasting, and does not lead to empty cells."
ONLY_Q = "The bonus is a constant there: nearly every step gets all of it."
SURE = "reasoning: at 50 % D guesses; above 95 % it is sure, and hardly tells one policy step from another"
TWO_OF_THREE = "reasoning: 0.5 puts two of three pairs of elites in the true order, a coin one of two"
GRADIENT = "reasoning: a bonus that no step gets, or every step, has no gradient (mbo-true: about 1 %, and no effect)"

CHECKS = (
    Check(
        "expert_accuracy", "reward", "expert steps that D recognises",
        symptoms.accuracy("expert"), 0.55, 0.95, "share", SURE, GUESSES, TOO_STRONG,
    ),
    Check(
        "policy_accuracy", "reward", "policy steps that D recognises",
        symptoms.accuracy("policy"), 0.55, 0.95, "share", SURE, GUESSES, TOO_STRONG,
    ),
    Check(
        "heldout_reward", "reward", "reward for held-out demonstrations",
        symptoms.heldout_reward, 0.5, INFINITY, "share",
        "reasoning: at 50 %, half of what was learned about the demonstrations holds for these episodes alone",
        "The reward model knows its demonstrations by heart. Use more of them, measure conditioning, or VAIL.",
    ),
    Check(
        "order_stored", "reward", "order of learned and true return, stored",
        symptoms.order("fitness", "true_return"), 0.5, 1.0, "correlation", TWO_OF_THREE,
        "The scores that fill the archive say little about what an elite is worth.",
    ),
    Check(
        "order_fresh", "reward", "order of learned and true return, fresh",
        symptoms.order("rescored_fitness", "rescored_return"), 0.5, 1.0, "correlation", TWO_OF_THREE,
        "The final reward says little about the true return. Look at the demonstrations: do they fall, are they alike?",
    ),
    Check(
        "survival_share", "reward", "reward that any step gets, p included",
        symptoms.survival_share, 0.0, 0.5, "share",
        "reasoning: above one half, lasting earns more than imitating",
        above="Staying in the episode earns more than imitating. Lower bonus_p, or use a reward of either sign: AIRL.",
    ),
    Check(
        "survival_order", "reward", "order of fitness and episode length",
        symptoms.survival_order, -0.5, 0.5, "correlation",
        "controls: true 0.13 to 0.32, mbo-true 0.24 to 0.51",
        "Elites that fall early score higher: a reward that is negative on average makes falling worthwhile.",
        "Fitness measures how long a robot lasts. Compare with zero and mbo-zero, which imitate nothing.",
    ),
    Check(
        "stale_ratio", "archive", "stored fitness / fresh fitness",
        symptoms.stale_ratio, 0.8, 1.25, "ratio",
        "controls: 1.02 to 1.04 on walker2d, 0.81 on halfcheetah",
        "The reward has risen since elites were stored, so that newcomers win too easily.", STALE,
    ),
    Check(
        "stale_order", "archive", "order of stored and fresh fitness",
        symptoms.stale_order, 0.8, 1.0, "correlation", "controls: 0.86 to 0.97", STALE,
    ),
    Check(
        "relanded", "archive", "elites that land in their own cell",
        symptoms.landing("relanded"), 0.2, 1.0, "share",
        "controls: 25 to 34 % on walker2d; the 4 % on halfcheetah are not healthy", LUCKY,
    ),
    Check(
        "relanded_near", "archive", "elites that land in or next to their cell",
        symptoms.landing("relanded_near"), 0.5, 1.0, "share",
        "budget: at least half (controls: 82 to 91 % on walker2d, 25 % on halfcheetah)", LUCKY,
    ),
    Check(
        "episode_share", "archive", "elites' episodes, of the time limit",
        symptoms.episode_share, 0.8, 1.0, "share", "controls: 88 to 95 % on walker2d; a cheetah cannot fall",
        "Elites fall early, and the measures of a short episode are noise. Look at the demonstrations' lengths, too.",
    ),
    Check(
        "restart_jump", "search", "learned reward after a restart / later",
        symptoms.restart_jump, 0.8, 1.4, "ratio", "controls: 0.92 to 1.19 on walker2d, 1.36 on halfcheetah",
        "The reward for a restart's elite rises once the reward model has seen it.",
        "The reward model overrates a policy that it has not seen, and cells are won meanwhile. Raise restart_rounds.",
    ),
    Check(
        "restart_share", "search", "late iterations with a restart",
        symptoms.restart_share, 0.0, 0.2, "share", "controls: true 4 to 10 %, mbo-true 11 to 19 %",
        above="The search starts anew before it gets anywhere. Stale thresholds are the usual cause.",
    ),
    Check(
        "idle_share", "search", "late walks without coefficients",
        symptoms.idle_share, 0.0, 0.05, "share", "controls: 0 to 1 %",
        above="xNES has learned nothing when the walk begins. See rejects, restart_order and xnes_center.",
    ),
    Check(
        "gradient_q_share", "search", "steps that get q, gradient phase",
        symptoms.q_share("gradient"), 0.05, 0.9, "share", GRADIENT, NO_Q, ONLY_Q,
    ),
    Check(
        "walk_q_share", "search", "steps that get q, walk",
        symptoms.q_share("walk"), 0.05, 0.9, "share", GRADIENT, NO_Q, ONLY_Q,
    ),
    Check(
        "discarded", "search", "training phases that were discarded",
        symptoms.discarded_share, 0.0, 0.01, "share", "controls, and all other kept runs: 0 %",
        above="Numbers were not finite, and what was learned in those phases is gone. Lower the learning rates.",
    ),
)  # fmt: skip


BY_NAME = {check.name: check for check in CHECKS}


class Finding(NamedTuple):
    """A check's answer for one run."""

    check: Check
    value: float  # not-a-number without an answer
    status: str  # OK, LOOK, NOT_RECORDED or NOT_APPLICABLE
    why: str = ""  # why the question does not apply

    @property
    def advice(self) -> str:
        """What the number means if it is outside of the healthy range; otherwise empty."""
        if self.status != LOOK:
            return ""
        return self.check.below if self.value < self.check.low else self.check.above


class Diagnosis(NamedTuple):
    """All findings about one run."""

    run: RunFiles
    findings: tuple[Finding, ...]  # in the order of CHECKS

    @property
    def title(self) -> str:
        """The run's folder, and how far it is."""
        done, asked = len(self.run.metrics), self.run.settings.get("iterations", "?")
        state = "finished" if self.run.finished else "not finished"
        count = f", {done} of {asked} iterations" if done else ", no iterations recorded"
        return f"{self.run.folder.as_posix()}: {state}{count}"

    @property
    def mostly_discarded(self) -> bool:
        """Whether most training phases were discarded."""
        return any(finding.check.name == "discarded" and finding.value > MOST for finding in self.findings)


def diagnose(folder: Path) -> Diagnosis:
    """The findings about the run in ``folder``, finished or not. Raises ConfigError if there is no run."""
    run = symptoms.read(folder)
    return Diagnosis(run, tuple(_answer(check, run) for check in CHECKS))


def of_runs(runs: Mapping[str, Sequence[Path]]) -> dict[str, list[Diagnosis]]:
    """The diagnoses of runs by experiment; see ``tables``."""
    return {name: [diagnose(folder) for folder in folders] for name, folders in runs.items()}


def _answer(check: Check, run: RunFiles) -> Finding:
    try:
        value = check.read(run)
    except NotRecorded:
        return Finding(check, math.nan, NOT_RECORDED)
    except DoesNotApply as reason:
        return Finding(check, math.nan, NOT_APPLICABLE, str(reason))
    return Finding(check, value, judge(check, value))


def judge(check: Check, value: float) -> str:
    """OK if ``value`` lies in the check's healthy range, else LOOK; NOT_RECORDED for not-a-number."""
    if math.isnan(value):
        return NOT_RECORDED
    return OK if check.low <= value <= check.high else LOOK


# As text


def number(check: Check, value: float) -> str:
    """A check's number as it is written; empty for not-a-number."""
    if math.isnan(value):
        return ""
    return f"{100 * value:.0f} %" if check.form == "share" else f"{value:.2f}"


def healthy(check: Check) -> str:
    """The healthy range as it is written: "55-95 %", "at least 0.50"."""
    unbounded = {"share": (0.0, 1.0), "correlation": (-1.0, 1.0), "ratio": (0.0, INFINITY)}[check.form]
    low, high = number(check, check.low), "" if check.high == INFINITY else number(check, check.high)
    if check.high >= unbounded[1]:
        return f"at least {low}"
    if check.low <= unbounded[0]:
        return f"at most {high}"
    return f"{low.removesuffix(' %')} to {high}"


def report(found: Diagnosis) -> str:
    """A page of text: a line per finding, and below them the advice on those that need a look."""
    lines = [found.title, *([MOSTLY_DISCARDED] if found.mostly_discarded else []), ""]
    lines.append(f"{'':{TITLE}}{'this run':>8}   {'healthy':17} verdict")
    group = ""
    for finding in found.findings:
        check = finding.check
        if check.group != group:
            group = check.group
            lines.append(group)
        verdict = finding.status + (f": {finding.why}" if finding.why else "")
        lines.append(f"  {check.title:{TITLE - 2}}{number(check, finding.value):>8}   {healthy(check):17} {verdict}")
    return "\n".join([*lines, "", *_advice(found)])


def _advice(found: Diagnosis) -> list[str]:
    """How many numbers need a look, and what they mean; findings with the same meaning together."""
    looks = [finding for finding in found.findings if finding.status == LOOK]
    known = sum(not math.isnan(finding.value) for finding in found.findings)
    by_advice: dict[str, list[str]] = {}
    for finding in looks:
        by_advice.setdefault(finding.advice, []).append(finding.check.title)
    texts = [f"- {'; '.join(titles)}: {advice}" for advice, titles in by_advice.items()]
    wrapped = [textwrap.fill(text, PAGE, subsequent_indent="  ") for text in texts]
    return [f"{len(looks)} of {known} numbers need a look.", *wrapped]


def as_json(found: Diagnosis) -> str:
    """An object with the run's folder, its iterations and its findings; null for a number that is not known."""
    findings = {
        finding.check.name: {
            "value": None if math.isnan(finding.value) else round(finding.value, 4),
            "low": finding.check.low,
            "high": None if finding.check.high == INFINITY else finding.check.high,
            "status": finding.status,
            "note": finding.why or finding.advice,
        }
        for finding in found.findings
    }
    iterations = len(found.run.metrics)
    content: dict[str, Any] = {"run": found.run.folder.as_posix(), "finished": found.run.finished}
    return json.dumps(content | {"iterations": iterations, "findings": findings}, indent=2, ensure_ascii=False)


def table(found: Mapping[str, Sequence[Diagnosis]]) -> pd.DataFrame:
    """A row per check, a column per experiment: the mean over seeds, marked where that is outside the healthy range."""
    columns = {"healthy": [healthy(check) for check in CHECKS]}
    for name, diagnoses in found.items():
        columns[name] = [_cell(check, [one.findings[i] for one in diagnoses]) for i, check in enumerate(CHECKS)]
    index = pd.MultiIndex.from_tuples([(check.group, check.title) for check in CHECKS], names=["about", "number"])
    return pd.DataFrame(columns, index=index)


def _cell(check: Check, findings: Sequence[Finding]) -> str:
    """The mean of what is known, with "look here" if it is outside the healthy range; else why nothing is known."""
    values = [finding.value for finding in findings if not math.isnan(finding.value)]
    if not values:
        return findings[0].status if findings else ""
    mean = float(np.mean(values))
    return number(check, mean) + (f" ({LOOK})" if judge(check, mean) == LOOK else "")


def tidy(found: Mapping[str, Sequence[Diagnosis]]) -> pd.DataFrame:
    """A row per known number, for ``plotting.findings``: title, form, low, high, healthy, experiment, value."""
    rows = [
        {"title": f.check.title, "form": f.check.form, "low": f.check.low, "high": f.check.high,
         "healthy": healthy(f.check), "experiment": name, "value": f.value}
        for i in range(len(CHECKS))
        for name, diagnoses in found.items()
        for f in (one.findings[i] for one in diagnoses)
        if not math.isnan(f.value)
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=["title", "form", "low", "high", "healthy", "experiment", "value"])


def guide() -> str:
    """The checks as a Markdown table, for the documentation."""
    rows = [
        {"about": check.group, "number": check.title, "healthy": healthy(check), "source of the range": check.source}
        for check in CHECKS
    ]
    return markdown_table(pd.DataFrame(rows))
