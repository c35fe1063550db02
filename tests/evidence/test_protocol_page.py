"""The protocol's page and the plan agree with the claims that are judged."""

import re
from pathlib import Path

import pytest

from qdil.config import BUDGETS, make_config
from qdil.evidence import claims, protocol_page
from qdil.evidence.verdicts import LATER
from qdil.methods import BUILT_IN
from qdil.robots.register import PAPER_ROBOTS
from qdil.runs.experiments import COUNTED_SEEDS, FIRST_SEEDS, RESERVE_SEEDS
from qdil.runs.plan import PLAN, planned
from qdil.runs.studies import budget_of, config_of

PAGE = (Path(claims.__file__).parents[2] / "docs" / "protocol.md").read_text()
BUILT_IN_NAMES = {base.name for base in BUILT_IN}


def needed(robot):
    """What the verdicts on a robot compare under each claim's first protocol, as (budget, experiment)."""
    for claim in claims.CLAIMS:
        if robot in claim.robots or robot == "walker2d":
            for name in claims.experiments_needed([claim], claim.protocols[0]):
                budget, experiment = budget_of(name)
                if "diffail" not in experiment or "diffail" in BUILT_IN_NAMES:
                    yield budget or "laptop", experiment


def test_on_walker2d_the_plan_leaves_no_claim_without_runs():
    assert {(budget, name) for budget, name in needed("walker2d")} <= {
        (budget, name) for budget in ("laptop", "desk") for name in planned(budget, "walker2d")
    }


@pytest.mark.parametrize("robot", ["halfcheetah", "humanoid"])
def test_on_other_robots_the_main_and_the_later_claims_have_runs(robot):
    core = {"C1", "C2", "C3", "C4", "C5", "C6", "C8", "C10", "C15", "Q5a", "Q5b", "Q6a"}
    wanted = [claim for claim in claims.CLAIMS if claim.id in core or claim.source == LATER]
    for claim in wanted:
        names = set(claims.experiments_needed([claim], claim.protocols[0]))
        names = {name for name in names if "diffail" not in name or "diffail" in BUILT_IN_NAMES}
        assert names <= set(planned("laptop", robot)), claim.id


def test_every_planned_experiment_can_be_trained():
    for stage in PLAN:
        assert stage.budget in BUDGETS and set(stage.robots) <= set(PAPER_ROBOTS)
        assert len(set(stage.experiments)) == len(stage.experiments)
        for name in stage.experiments:
            config_of(name, stage.robots[0], stage.budget)


def test_planned_seeds_count_and_none_is_planned_twice():
    for stage in PLAN:
        assert set(stage.seeds) | set(stage.further) <= set(COUNTED_SEEDS)
        assert not set(stage.seeds) & set(stage.further)
    assert not set(FIRST_SEEDS) & set(RESERVE_SEEDS)


def test_the_page_has_every_rule_and_every_comparison_of_the_claims():
    for claim in claims.CLAIMS:
        item = PAGE.split(f"* **{claim.id}** ")[1].split("\n* **")[0]
        assert claim.sentence in item and claim.rule in item and claim.where in item
        assert item.count("\n    * ") == len(claim.parts) - (claim.id == "C14")
        assert all(name in item for name in claims.experiments_needed([claim], claim.protocols[0]))


def test_the_page_has_the_seeds_of_the_code():
    assert f"from {FIRST_SEEDS[0]} to {FIRST_SEEDS[-1]} and from {RESERVE_SEEDS[0]} to {RESERVE_SEEDS[-1]}" in PAGE


def test_stages_show_their_experiments_once():
    items = protocol_page.runs().splitlines()
    assert len(items) == len(PLAN) and "the experiments of 1." in items[1] and "the experiments of 3." in items[3]
    assert "seeds 1-5, and 11-15 where a comparison stays inconclusive: `true`, `gail`," in items[0]


def test_budgets_are_those_of_the_settings():
    row = next(line for line in protocol_page.budgets().splitlines() if "`laptop`" in line and "walker2d" in line)
    config = make_config("walker2d", "mconbo-gail", "laptop")
    for number in (config.ppga.iterations, config.ppo.num_envs, config.simulation.episode_length, config.ppga.cells):
        assert re.search(rf"\b{number}\b", row)
