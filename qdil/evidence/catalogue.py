"""The claims as records: the paper's C1 to C16, its later version's E1 to E5, and our own questions Q1 to Q6.

A claim is a sentence, where it is made, on which robots, and the comparisons that it consists of. It is reproduced on a
robot if all its comparisons hold. Experiments are named as under the protocol ``paper``; ``parts_under`` gives their
names under the protocol that is judged. ``docs/claims.md`` explains every rule.
"""

from qdil.evidence.paper import METRICS
from qdil.evidence.verdicts import LATER, OURS, PAPER, Claim, Part
from qdil.robots.register import PAPER_ROBOTS
from qdil.runs.studies import PROTOCOL_NAMES, STUDIES, under

MARGIN = 0.1  # share of the reference: a loss up to this is "marginal", and a value that loses no more "holds"
NEAR_ALL = 0.9  # share of the cells that is "near 100 %", as the paper calls walker2d's 91.7 %
LEMMA = "probability"  # the reading of Lemma 1's results file

GAIL, MCOND, MCONBO = "gail", "mcond-gail", "mconbo-gail"
EXPERT = "true+protocol=paper"  # the run that demonstrates: the same one, whatever protocol its imitators follow
BEST = f"{MCONBO}+bonus_q=1.0"
WALKER, HUMANOID = ("walker2d",), ("humanoid",)
WALKER_HUMANOID = WALKER + HUMANOID
FEWER = tuple(f"demo_episodes={n}" for n in (2, 1))
BASELINES = ("airl", "giril", "pwil", "maxent")
AS_PRINTED = ("paper",)  # for claims about single settings, which the other protocols set themselves
ABOVE_RULE = "The interval of the difference lies above 0."
MARGIN_RULE = f"{MARGIN:.0%} of the reference's mean"


def _above(ours: str, against: str, *readings: str) -> tuple[Part, ...]:
    return tuple(Part("above", ours, (against,), reading) for reading in readings)


def _not_below(ours: str, against: str, margin: float, *readings: str) -> tuple[Part, ...]:
    return tuple(Part("not below", ours, (against,), reading, margin) for reading in readings)


def _claim(name: str, sentence: str, where: str, robots: tuple[str, ...], parts: tuple[Part, ...],
           rule: str = ABOVE_RULE, protocols: tuple[str, ...] = PROTOCOL_NAMES) -> Claim:  # fmt: skip
    return Claim(name, sentence, where, robots, parts, rule, protocols, PAPER)


def _later(name: str, sentence: str, robots: tuple[str, ...], parts: tuple[Part, ...], rule: str) -> Claim:
    return Claim(name, sentence, "later version", robots, parts, rule, ("released",), LATER)


def _question(name: str, sentence: str, parts: tuple[Part, ...], rule: str = ABOVE_RULE,
              protocols: tuple[str, ...] = AS_PRINTED) -> Claim:  # fmt: skip
    return Claim(name, sentence, "ours", PAPER_ROBOTS, parts, rule, protocols, OURS)


OF_PAPER = (
    _claim("C1", "MConbo-GAIL beats GAIL on QD-score", "Fig. 5, Table 1", PAPER_ROBOTS,
           _above(MCONBO, GAIL, "qd_score")),
    _claim("C2", "MConbo-VAIL beats VAIL on QD-score", "Fig. 8, Table 1", PAPER_ROBOTS,
           _above("mconbo-vail", "vail", "qd_score")),
    _claim("C3", "MConbo-GAIL's coverage is near 100 %, above the expert's", "Fig. 5", PAPER_ROBOTS,
           (Part("at least", MCONBO, (), "coverage", NEAR_ALL), *_above(MCONBO, EXPERT, "coverage")),
           f"The interval of the coverage lies at or above {NEAR_ALL:.0%}, which the paper calls near 100 % on "
           "walker2d (91.7 %), and that of the difference to the expert's above 0."),
    _claim("C4", "MConbo-GAIL reaches or passes the expert's QD-score", "Fig. 5", WALKER_HUMANOID,
           _not_below(MCONBO, EXPERT, 0.0, "qd_score"), "The interval of the difference lies at or above 0."),
    _claim("C5", "MConbo-GAIL beats AIRL, GIRIL, PWIL and Max-Ent on QD-score", "Table 1", PAPER_ROBOTS,
           tuple(part for base in BASELINES for part in _above(MCONBO, base, "qd_score"))),
    _claim("C6", "MConbo-GAIL beats GAIL on average return", "Fig. 5", WALKER_HUMANOID,
           _above(MCONBO, GAIL, "average")),
    _claim("C7", "Without the bonus every metric falls", "Fig. 7", WALKER, _above(MCONBO, MCOND, *METRICS),
           "MCond-GAIL is MConbo-GAIL without the bonus. The intervals of all four metrics' differences lie above 0."),
    _claim("C8", "MCond-GAIL is no worse than GAIL, and MConbo-GAIL beats MCond-GAIL, on coverage and QD-score",
           "Fig. 11, Table 9", PAPER_ROBOTS,
           (*_not_below(MCOND, GAIL, MARGIN, "qd_score", "coverage"), *_above(MCONBO, MCOND, "qd_score", "coverage")),
           f"No worse: the interval of the difference lies above a loss of {MARGIN_RULE} (the paper calls such scores "
           "comparable on two robots). Beats: above 0."),
    _claim("C9", "p = 0.5, q = 1 is the best of the grid", "Fig. 10", PAPER_ROBOTS,
           tuple(part for point in STUDIES["p-and-q"] if point != BEST for part in _above(BEST, point, "qd_score")),
           "QD-score against each of the other eight points of p, q = 0, 0.5, 1: the interval of every difference lies "
           "above 0. The paper's text names neither its robot nor its grid.", AS_PRINTED),
    _claim("C10", "Without expert actions the loss is marginal", "Fig. 15, Table 2", PAPER_ROBOTS,
           _not_below(f"{MCONBO}-obs", MCONBO, MARGIN, *METRICS),
           f"In all four metrics the interval of the difference lies above a loss of {MARGIN_RULE}."),
    _claim("C11", "With 2 or 1 demonstrations coverage holds, QD-score falls, and MConbo-GAIL still beats GAIL",
           "Figs. 12, 13", WALKER,
           (*(part for n in FEWER for part in _not_below(f"{MCONBO}+{n}", MCONBO, MARGIN, "coverage")),
            *(Part("below", f"{MCONBO}+{n}", (MCONBO,), "qd_score") for n in FEWER),
            *(part for n in FEWER for part in _above(f"{MCONBO}+{n}", f"{GAIL}+{n}", "qd_score"))),
           f"Against 4 demonstrations: holds, the interval lies above a loss of {MARGIN_RULE}; falls, below 0. Beats: "
           "QD-score with as few demonstrations, above 0."),
    _claim("C12", "10 demonstrations beat 4", "Fig. 14", WALKER,
           _above(f"{MCONBO}+demo_episodes=10", MCONBO, "qd_score"), f"On QD-score. {ABOVE_RULE}"),
    _claim("C13", "The bonus improves PPGA with the true reward, which then beats MConbo-GAIL", "Fig. 16", HUMANOID,
           (*_above("mbo-true", "true", "qd_score"), *_above("mbo-true", MCONBO, "qd_score")),
           f"On QD-score, all of one protocol. {ABOVE_RULE}"),
    _claim("C14", "PPO on 1[m ∈ A_e] alone does not lower P(m ∈ A_e | π), on average", "Lemma 1", PAPER_ROBOTS,
           (Part("at least", "PPO", (), LEMMA),),
           "The probability after PPO minus that before. On small problems it is exact, after one update (mdp; in "
           "mdp-falls episodes may end early, which the proof excludes). On robots it is estimated by sampling, after "
           "the number of updates in the table; a seed's archives share one policy, so their mean is one number. The "
           "interval of the mean lies at or above 0. This judges an average. The lemma promises more, that no single "
           "improvement lowers the probability; the table shows in how many trials it fell.", AS_PRINTED),
    _claim("C15", "With the bonus, c₀ rises while cells are being found", "Appendix G", PAPER_ROBOTS,
           (Part("more than", MCONBO, (), "c0_rise"), *_above(MCONBO, MCOND, "c0_rise")),
           "The mean change of |c₀| of the xNES mean in an iteration that fills new cells, without iterations that "
           "start after a restart of xNES: its interval lies above 0, and so does that of the difference to "
           "MCond-GAIL, which has no bonus. Chance alone makes |c₀| rise a little, so the second comparison is the "
           "stronger test."),
    _claim("C16", "MConbo-GAIL's archives vary less from cell to cell", "Fig. 6", ("halfcheetah", "humanoid"),
           (Part("below", MCONBO, (GAIL,), "roughness"), Part("below", MCONBO, (EXPERT,), "roughness")),
           "The mean difference between returns of neighbouring filled cells, over the mean size of a return, is lower "
           "than GAIL's and than the expert's: the intervals lie below 0."),
)  # fmt: skip

# The later version's arms have the bonus (p = 0, q = 2) and no measure conditioning.
OF_LATER = (
    *(_later(f"E{i}", f"The bonus improves {title} on QD-score", PAPER_ROBOTS, _above(f"mbo-{base}", base, "qd_score"),
             ABOVE_RULE)
      for i, (base, title) in enumerate({"gail": "GAIL", "vail": "VAIL", "diffail": "DiffAIL"}.items(), start=1)),
    *(_later(f"E4{letter}", f"{title} with the bonus passes the expert's QD-score on humanoid", HUMANOID,
             _above(f"mbo-{base}", EXPERT, "qd_score"),
             f"{ABOVE_RULE} The abstract says \"by 20 %\" and names no base, so each is judged. {published}")
      for letter, base, title, published in (
          ("a", "gail", "GAIL", "The authors' numbers are 5.31 million against 5.71 million of the expert that they "
           "released: with this base they do not show it."),
          ("b", "vail", "VAIL", "The authors' numbers are 7.26 million against 5.71 million of the expert that they "
           "released."),
          ("c", "diffail", "DiffAIL", "The authors' numbers are 8.92 million against 5.71 million of the expert that "
           "they released."))),
    _later("E5", "The bonus improves PPGA with the true reward on QD-score", HUMANOID,
           _above("mbo-true", "true", "qd_score"), ABOVE_RULE),
)  # fmt: skip

GAIN_RULE = (
    "The gain is MConbo-GAIL's QD-score minus GAIL's, as a share of GAIL's mean. Yes: the interval of the difference "
    f"between the two gains excludes 0. No: it holds 0 and nothing beyond ±{MARGIN:.0%} of GAIL's mean."
)


def _gain(against: tuple[str, str], ours: tuple[str, str] = (MCONBO, GAIL)) -> tuple[Part, ...]:
    return (Part("gain differs", ours[0], (ours[1], *against), "qd_score", MARGIN),)


OF_OURS = (
    _question("Q1a", "p alone, without imitation, raises the QD-score over no reward at all",
              _above("mbo-zero+bonus_q=0.0", "zero", "qd_score")),
    _question("Q1b", "q alone, without imitation, raises the QD-score over no reward at all",
              _above("mbo-zero+bonus_p=0.0", "zero", "qd_score")),
    _question("Q1c", "p and q, without imitation, raise the QD-score over no reward at all",
              _above("mbo-zero", "zero", "qd_score")),
    _question("Q1d", "MConbo-GAIL beats GAIL on QD-score without a reward for survival (p = 0)",
              _above(f"{MCONBO}+bonus_p=0.0", GAIL, "qd_score")),
    _question("Q1e", "MConbo-GAIL has a higher QD-score with p than without",
              _above(MCONBO, f"{MCONBO}+bonus_p=0.0", "qd_score")),
    _question("Q2", "Selection by the true return gives a higher QD-score than by the learned one",
              _above(f"{MCONBO}+selection=true", MCONBO, "qd_score")),
    _question("Q3", "The weighted walk gives a higher QD-score than the unweighted one",
              _above(MCONBO, f"{MCONBO}+walk_weights=fitness", "qd_score")),
    _question("Q4", "MConbo helps every base: AIRL, GIRIL, PWIL and Max-Ent, on QD-score",
              tuple(part for base in BASELINES for part in _above(f"mconbo-{base}", base, "qd_score")),
              protocols=PROTOCOL_NAMES),
    _question("Q5a", "MConbo-GAIL has a higher QD-score under `improved` than under `paper`",
              _above(MCONBO, f"{MCONBO}+protocol=paper", "qd_score"), protocols=("improved",)),
    _question("Q5b", "MConbo-GAIL has a higher QD-score under `improved` than under `released`, which selects by the "
              "true reward", _above(MCONBO, f"{MCONBO}+protocol=released", "qd_score"), protocols=("improved",)),
    _question("Q6a", "MConbo-GAIL's gain over GAIL is another under this protocol than under `paper`",
              _gain((f"{MCONBO}+protocol=paper", f"{GAIL}+protocol=paper")), GAIN_RULE, PROTOCOL_NAMES[1:]),
    _question("Q6b", "MConbo-GAIL's gain over GAIL is another at `desk` than at `laptop`",
              _gain((f"laptop/{MCONBO}", f"laptop/{GAIL}"), (f"desk/{MCONBO}", f"desk/{GAIL}")),
              GAIN_RULE, PROTOCOL_NAMES),
)  # fmt: skip

CLAIMS: tuple[Claim, ...] = (*OF_PAPER, *OF_LATER, *OF_OURS)


def parts_under(claim: Claim, protocol: str) -> tuple[Part, ...]:
    """A claim's comparisons with their experiments' names under a protocol; Lemma 1 is the same under all."""

    def renamed(part: Part) -> Part:
        against = tuple(under(name, protocol) for name in part.against)
        return part._replace(ours=under(part.ours, protocol), against=against)

    return tuple(part if part.reading == LEMMA else renamed(part) for part in claim.parts)
