"""The paper's claims C1 to C16 and our own questions Q1 to Q4, each judged from the finished runs.

A claim is a record: the sentence, where the paper makes it, on which robots, and the comparisons that it consists of.
It is reproduced on a robot if all its comparisons hold. ``docs/claims.md`` explains every rule.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

from qdil.config import BUDGETS
from qdil.errors import ConfigError
from qdil.evidence import tables
from qdil.evidence.paper import METRICS
from qdil.evidence.readings import READINGS
from qdil.evidence.report import markdown, overview, plain, table, write
from qdil.evidence.verdicts import SMALL_MDP, Claim, Finding, Part, Verdict, find
from qdil.lab.lemma import results
from qdil.robots.register import PAPER_ROBOTS
from qdil.robots.register import find as find_robot
from qdil.runs.folder import RESULTS
from qdil.runs.studies import STUDIES

__all__ = ["CLAIMS", "Claim", "Verdict", "judge", "markdown", "overview", "plain", "table", "write"]

MARGIN = 0.1  # share of the reference: a loss up to this is "marginal", and a value that loses no more "holds"
NEAR_ALL = 0.9  # share of the cells that is "near 100 %", as the paper calls walker2d's 91.7 %
LEMMA = "probability"  # the reading of Lemma 1's results file


def _above(ours: str, against: str, *readings: str) -> tuple[Part, ...]:
    return tuple(Part("above", ours, (against,), reading) for reading in readings)


def _not_below(ours: str, against: str, margin: float, *readings: str) -> tuple[Part, ...]:
    return tuple(Part("not below", ours, (against,), reading, margin) for reading in readings)


GAIL, MCOND, MCONBO = "gail", "mcond-gail", "mconbo-gail"
BEST = f"{MCONBO}+bonus_q=1.0"
WALKER, WALKER_HUMANOID = ("walker2d",), ("walker2d", "humanoid")
FEWER = tuple(f"demo_episodes={n}" for n in (2, 1))
ABOVE_RULE = "The interval of the difference lies above 0."
MARGIN_RULE = f"{MARGIN:.0%} of the reference's mean"

CLAIMS = (
    Claim("C1", "MConbo-GAIL beats GAIL on QD-score", "Fig. 5, Table 1", PAPER_ROBOTS,
          _above(MCONBO, GAIL, "qd_score"), ABOVE_RULE),
    Claim("C2", "MConbo-VAIL beats VAIL on QD-score", "Fig. 8, Table 1", PAPER_ROBOTS,
          _above("mconbo-vail", "vail", "qd_score"), ABOVE_RULE),
    Claim("C3", "MConbo-GAIL's coverage is near 100 %, above the expert's", "Fig. 5", PAPER_ROBOTS,
          (Part("at least", MCONBO, (), "coverage", NEAR_ALL), *_above(MCONBO, "true", "coverage")),
          f"The interval of the coverage lies at or above {NEAR_ALL:.0%}, which the paper calls near 100 % on walker2d "
          "(91.7 %), and that of the difference to the expert's above 0."),
    Claim("C4", "MConbo-GAIL reaches or passes the expert's QD-score", "Fig. 5", WALKER_HUMANOID,
          _not_below(MCONBO, "true", 0.0, "qd_score"), "The interval of the difference lies at or above 0."),
    Claim("C5", "MConbo-GAIL beats AIRL, GIRIL, PWIL and Max-Ent on QD-score", "Table 1", PAPER_ROBOTS,
          tuple(part for base in ("airl", "giril", "pwil", "maxent") for part in _above(MCONBO, base, "qd_score")),
          ABOVE_RULE),
    Claim("C6", "MConbo-GAIL beats GAIL on average return", "Fig. 5", WALKER_HUMANOID,
          _above(MCONBO, GAIL, "average"), ABOVE_RULE),
    Claim("C7", "Without the bonus every metric falls", "Fig. 7", WALKER, _above(MCONBO, MCOND, *METRICS),
          "MCond-GAIL is MConbo-GAIL without the bonus. The intervals of all four metrics' differences lie above 0."),
    Claim("C8", "MCond-GAIL is no worse than GAIL, and MConbo-GAIL beats MCond-GAIL, on coverage and QD-score",
          "Fig. 11, Table 9", PAPER_ROBOTS,
          (*_not_below(MCOND, GAIL, MARGIN, "qd_score", "coverage"), *_above(MCONBO, MCOND, "qd_score", "coverage")),
          f"No worse: the interval of the difference lies above a loss of {MARGIN_RULE} (the paper calls such scores "
          "comparable on two robots). Beats: above 0."),
    Claim("C9", "p = 0.5, q = 1 is the best of the grid", "Fig. 10", PAPER_ROBOTS,
          (Part("best of", BEST, tuple(e for e in STUDIES["p-and-q"] if e != BEST), "qd_score"),),
          "QD-score against the best of the other eight points of p, q = 0, 0.5, 1: the interval of the difference "
          "lies above 0. The paper's text names neither its robot nor its grid."),
    Claim("C10", "Without expert actions the loss is marginal", "Fig. 15, Table 2", PAPER_ROBOTS,
          _not_below(f"{MCONBO}-obs", MCONBO, MARGIN, *METRICS),
          f"In all four metrics the interval of the difference lies above a loss of {MARGIN_RULE}."),
    Claim("C11", "With 2 or 1 demonstrations coverage holds, QD-score falls, and MConbo-GAIL still beats GAIL",
          "Figs. 12, 13", WALKER,
          (*(part for n in FEWER for part in _not_below(f"{MCONBO}+{n}", MCONBO, MARGIN, "coverage")),
           *(Part("below", f"{MCONBO}+{n}", (MCONBO,), "qd_score") for n in FEWER),
           *(part for n in FEWER for part in _above(f"{MCONBO}+{n}", f"{GAIL}+{n}", "qd_score"))),
          f"Against 4 demonstrations: holds, the interval lies above a loss of {MARGIN_RULE}; falls, below 0. Beats: "
          "QD-score with as few demonstrations, above 0."),
    Claim("C12", "10 demonstrations beat 4", "Fig. 14", WALKER,
          _above(f"{MCONBO}+demo_episodes=10", MCONBO, "qd_score"), f"On QD-score. {ABOVE_RULE}"),
    Claim("C13", "The bonus improves PPGA with the true reward, which then beats MConbo-GAIL", "Fig. 16", ("humanoid",),
          (*_above("mbo-true", "true", "qd_score"), *_above("mbo-true", MCONBO, "qd_score")),
          f"On QD-score. {ABOVE_RULE}"),
    Claim("C14", "PPO on 1[m ∈ A_e] alone does not lower P(m ∈ A_e | π), on average", "Lemma 1", PAPER_ROBOTS,
          (Part("at least", "PPO", (), LEMMA),),
          "The probability after PPO minus that before. On small problems it is exact, after one update (mdp; in "
          "mdp-falls episodes may end early, which the proof excludes). On robots it is estimated by sampling, after "
          "the number of updates in the table; a seed's archives share one policy, so their mean is one number. The "
          "interval of the mean lies at or above 0. This judges an average. The lemma promises more, that no single "
          "improvement lowers the probability; the table shows in how many trials it fell."),
    Claim("C15", "With the bonus, c₀ rises while cells are being found", "Appendix G", PAPER_ROBOTS,
          (Part("more than", MCONBO, (), "c0_rise"), *_above(MCONBO, MCOND, "c0_rise")),
          "The mean change of |c₀| of the xNES mean in an iteration that fills new cells, without iterations that "
          "start after a restart of xNES: its interval lies above 0, and so does that of the difference to MCond-GAIL, "
          "which has no bonus. Chance alone makes |c₀| rise a little, so the second comparison is the stronger test."),
    Claim("C16", "MConbo-GAIL's archives vary less from cell to cell", "Fig. 6", ("halfcheetah", "humanoid"),
          (Part("below", MCONBO, (GAIL,), "roughness"), Part("below", MCONBO, ("true",), "roughness")),
          "The mean difference between returns of neighbouring filled cells, over the mean size of a return, is lower "
          "than GAIL's and than the expert's: the intervals lie below 0."),
    Claim("Q1a", "p alone, without imitation, raises the QD-score over no reward at all", "ours", PAPER_ROBOTS,
          _above("mbo-zero+bonus_q=0.0", "zero", "qd_score"), ABOVE_RULE),
    Claim("Q1b", "q alone, without imitation, raises the QD-score over no reward at all", "ours", PAPER_ROBOTS,
          _above("mbo-zero+bonus_p=0.0", "zero", "qd_score"), ABOVE_RULE),
    Claim("Q1c", "p and q, without imitation, raise the QD-score over no reward at all", "ours", PAPER_ROBOTS,
          _above("mbo-zero", "zero", "qd_score"), ABOVE_RULE),
    Claim("Q1d", "MConbo-GAIL beats GAIL on QD-score without a reward for survival (p = 0)", "ours", PAPER_ROBOTS,
          _above(f"{MCONBO}+bonus_p=0.0", GAIL, "qd_score"), ABOVE_RULE),
    Claim("Q1e", "MConbo-GAIL has a higher QD-score with p than without", "ours", PAPER_ROBOTS,
          _above(MCONBO, f"{MCONBO}+bonus_p=0.0", "qd_score"), ABOVE_RULE),
    Claim("Q2", "Selection by the true return gives a higher QD-score than by the learned one", "ours", PAPER_ROBOTS,
          _above(f"{MCONBO}+selection=true", MCONBO, "qd_score"), ABOVE_RULE),
    Claim("Q3", "The weighted walk gives a higher QD-score than the unweighted one", "ours", PAPER_ROBOTS,
          _above(MCONBO, f"{MCONBO}+walk_weights=fitness", "qd_score"), ABOVE_RULE),
    Claim("Q4", "MConbo helps every base: AIRL, GIRIL, PWIL and Max-Ent, on QD-score", "ours", PAPER_ROBOTS,
          tuple(part for base in ("airl", "giril", "pwil", "maxent")
                for part in _above(f"mconbo-{base}", base, "qd_score")), ABOVE_RULE),
)  # fmt: skip


def experiments_needed(claims: Iterable[Claim] = CLAIMS) -> tuple[str, ...]:
    """Every experiment that ``claims`` compare, each once."""
    parts = [part for claim in claims for part in claim.parts if part.reading != LEMMA]
    return tuple(dict.fromkeys(name for part in parts for name in (part.ours, *part.against)))


def judge(root: Path = RESULTS, budget: str = "laptop", envs: Sequence[str] | None = None) -> list[Verdict]:
    """Judge every claim on every robot of the paper (or those of ``envs``) from the finished runs of one budget.

    All finished seeds count. Lemma 1 is judged on every problem in its results file. Raises ConfigError for a budget
    that does not exist, a robot that is not the paper's, and a results file that cannot be read.
    """
    if budget not in BUDGETS:
        raise ConfigError(f"unknown budget '{budget}'; choose one of {', '.join(BUDGETS)}.")
    robots = tuple(PAPER_ROBOTS if envs is None else envs)
    for env in robots:
        if find_robot(env).name not in PAPER_ROBOTS:
            raise ConfigError(f"the claims are not about '{env}', but about {', '.join(PAPER_ROBOTS)}.")
    changes = _lemma_changes(budget, root)
    values = {env: _values(env, budget, root) for env in robots}
    problems = dict.fromkeys((SMALL_MDP, *(name for name in changes if name not in PAPER_ROBOTS)))
    values = {**{name: {} for name in problems}, **values}
    return [
        Verdict(claim, env, tuple(_find(part, values[env], changes.get(env)) for part in claim.parts))
        for claim in CLAIMS
        for env in values
        if env not in problems or claim.id == "C14"
    ]


Values = dict[tuple[str, str], list[float]]  # a number per seed, by reading and experiment


def _values(env: str, budget: str, root: Path) -> Values:
    """Every reading that some claim needs, of every finished run."""
    runs = tables.finished_seeds(experiments_needed(), env, budget, root)
    parts = [part for claim in CLAIMS for part in claim.parts]
    needed = dict.fromkeys((part.reading, name) for part in parts for name in (part.ours, *part.against))
    return {(what, name): [READINGS[what](folder) for folder in runs[name]] for what, name in needed if name in runs}


def _find(part: Part, values: Values, changes: results.Changes | None) -> Finding:
    """Judge a comparison from the runs' ``values``, or Lemma 1 from the ``changes`` in its file."""
    if part.reading == LEMMA and changes:
        part = part._replace(ours=changes.improvement)
        return find(part, {part.ours: changes.by_seed})._replace(trials=tuple(changes.trials))
    return find(part, {name: numbers for (what, name), numbers in values.items() if what == part.reading})


def _lemma_changes(budget: str, root: Path) -> dict[str, results.Changes]:
    """Changes of P(m ∈ A_e | π) by problem or robot; empty without a file."""
    try:
        return {env: results.changes(problem) for env, problem in results.read(budget, root).items()}
    except (ValueError, KeyError, TypeError, AttributeError):
        path = results.path_of(budget, root)
        raise ConfigError(f"{path} is no results file of Lemma 1: remove it and execute its notebook again.") from None
