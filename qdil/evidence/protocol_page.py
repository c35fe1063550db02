"""The generated parts of ``docs/protocol.md``: the claims and their rules, the planned runs, the budgets."""

from collections.abc import Sequence

import pandas as pd

from qdil.config import make_config
from qdil.evidence import report, trust
from qdil.evidence.arms import seeds_text
from qdil.evidence.catalogue import CLAIMS, LEMMA, parts_under
from qdil.evidence.markdown import markdown_table
from qdil.evidence.verdicts import Claim, Part
from qdil.robots.register import PAPER_ROBOTS
from qdil.runs.plan import PLAN, Stage


def claims() -> str:
    """A list in Markdown: every claim with its robots, protocols, rule and comparisons."""
    return "\n".join(_claim(claim) for claim in CLAIMS)


def _claim(claim: Claim) -> str:
    first = claim.protocols[0]
    robots = "all robots" if set(claim.robots) == set(PAPER_ROBOTS) else ", ".join(claim.robots)
    protocols = ", ".join(f"`{protocol}`" for protocol in claim.protocols)
    return "\n".join(
        [
            f"* **{claim.id}** {claim.sentence} ({claim.where}; {robots}; {protocols}). {claim.rule}",
            *(f"    * {_words(part, first)}" for part in parts_under(claim, first) if part.reading != LEMMA),
        ]
    )


def _words(part: Part, protocol: str) -> str:
    """A comparison in words, each experiment with the name of its folder."""
    names = ", ".join(f"`{name}`" for name in (part.ours, *part.against))
    return f"{report.comparison(part, protocol)} ({names})"


def runs() -> str:
    """A list in Markdown, an item per stage of the plan: budget, robots, seeds, and the names of the experiments."""
    return "\n".join(f"{number}. {_stage(stage)}" for number, stage in enumerate(PLAN, start=1))


def _stage(stage: Stage) -> str:
    seeds = f"seeds {seeds_text([stage.seeds])}"
    if stage.further:
        seeds += f", and {seeds_text([stage.further])} where a comparison stays inconclusive"
    first = [one.experiments for one in PLAN].index(stage.experiments)
    names = ", ".join(f"`{name}`" for name in stage.experiments)
    shown = names if PLAN[first] is stage else f"the experiments of {first + 1}"
    return f"**`{stage.budget}`, {', '.join(stage.robots)}**, {seeds}: {shown}."


def budgets() -> str:
    """A row per budget and robot of the plan: the settings that size a run."""
    planned = dict.fromkeys((stage.budget, robot) for stage in PLAN for robot in stage.robots)
    return markdown_table(pd.DataFrame([_budget(name, robot) for name, robot in planned]))


def _budget(name: str, robot: str) -> dict[str, str]:
    of = make_config(robot, "mconbo-gail", name)
    layers = ("-".join(map(str, hidden)) for hidden in (of.ppo.actor_hidden, of.ppo.critic_hidden))
    return {
        "budget": f"`{name}`",
        "robot": robot,
        "iterations": f"{of.ppga.iterations} after {of.ppga.warmup_updates} updates of warm-up",
        "N1, N2": f"{of.ppga.gradient_updates}, {of.ppga.walk_updates}",
        "robots × steps": f"{of.ppo.num_envs} × {of.ppo.rollout_length}",
        "episode (steps)": str(of.simulation.episode_length),
        "candidates × episodes": f"{of.ppga.candidates} × {of.evaluation.episodes}",
        "cells": " × ".join([str(of.ppga.cells)] * 2),
        "networks": ", ".join(dict.fromkeys(layers)),
        "demonstrations": str(of.demos.demo_episodes),
    }


def chance(looks: Sequence[tuple[int, ...]] = trust.LOOKS) -> str:
    """How often a comparison without a true difference is called, by the numbers of seeds at which it is judged."""
    return markdown_table(trust.looks_table(looks))


def few_seeds() -> str:
    """How often intervals over few seeds contain the true difference."""
    return markdown_table(trust.table())
