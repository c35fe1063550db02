"""How methods and experiments are named in words: "mconbo-gail" is the paper's MConbo-GAIL, "true" is the expert."""

# Bases that are no acronyms.
BASES = {"true": "Expert", "maxent": "Max-Ent", "diffail": "DiffAIL", "zero": "Zero reward"}
PREFIXES = {"mconbo-": "MConbo-", "mcond-": "MCond-", "mbo-": "Mbo-"}
ACRONYMS = ("gail", "vail", "airl", "giril", "pwil")
OBSERVATION_ONLY = "-obs"
SETTINGS = {"bonus_p": "p", "bonus_q": "q"}  # the paper's symbols; other settings keep their own names


def title(method: str) -> str:
    """The paper's spelling of ``method``; a reward model that the paper does not know keeps its own name."""
    prefix = next((one for one in PREFIXES if method.startswith(one)), "")
    base = method.removeprefix(prefix).removesuffix(OBSERVATION_ONLY)
    spelled = base.upper() if base in ACRONYMS else BASES.get(base, base)
    ending = " from observation" if method.endswith(OBSERVATION_ONLY) else ""
    return PREFIXES.get(prefix, "") + spelled + ending


def label(experiment: str) -> str:
    """An experiment in a legend or a table: ``mconbo-gail+bonus_q=1.0`` is "MConbo-GAIL, q = 1"."""
    method, *settings = experiment.split("+")
    return ", ".join([title(method), *map(_setting, settings)])


def _setting(text: str) -> str:
    name, _, value = text.partition("=")
    try:
        value = f"{float(value):g}"
    except ValueError:
        pass  # not a number: shown as it is
    if name == "demo_episodes":
        return f"{value} demonstration{'' if value == '1' else 's'}"
    if name == "protocol":
        return f"{value} protocol"
    return f"{SETTINGS.get(name, name.replace('_', ' '))} = {value}"
