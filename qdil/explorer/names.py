"""What menus call a method: as the paper spells it, so that "mconbo-gail" is MConbo-GAIL and "true" the expert."""

BASES = {"true": "Expert", "maxent": "Max-Ent", "zero": "Zero reward"}  # others are acronyms
PREFIXES = {"mconbo-": "MConbo-", "mcond-": "MCond-", "mbo-": "Mbo-"}
ACRONYMS = ("gail", "vail", "airl", "giril", "pwil")


def title(method: str) -> str:
    """The paper's spelling of ``method``; a reward model that it does not know keeps its own name."""
    prefix = next((one for one in PREFIXES if method.startswith(one)), "")
    base, obs_only = method.removeprefix(prefix).removesuffix("-obs"), method.endswith("-obs")
    spelled = base.upper() if base in ACRONYMS else BASES.get(base, base)
    return PREFIXES.get(prefix, "") + spelled + (" from observation" if obs_only else "")
