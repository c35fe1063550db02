"""How methods are named in words: "mconbo-gail" is the paper's MConbo-GAIL, and "true" is the expert."""

BASES = {"true": "Expert", "maxent": "Max-Ent", "zero": "Zero reward"}  # the paper's other bases are acronyms
PREFIXES = {"mconbo-": "MConbo-", "mcond-": "MCond-", "mbo-": "Mbo-"}
ACRONYMS = ("gail", "vail", "airl", "giril", "pwil")
OBSERVATION_ONLY = "-obs"


def title(method: str) -> str:
    """The paper's spelling of ``method``; a reward model that the paper does not know keeps its own name."""
    prefix = next((one for one in PREFIXES if method.startswith(one)), "")
    base = method.removeprefix(prefix).removesuffix(OBSERVATION_ONLY)
    spelled = base.upper() if base in ACRONYMS else BASES.get(base, base)
    ending = " from observation" if method.endswith(OBSERVATION_ONLY) else ""
    return PREFIXES.get(prefix, "") + spelled + ending
