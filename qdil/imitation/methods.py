"""From a configuration to the reward model that its method names, variants included."""

from qdil.config import Config
from qdil.imitation.reward_model import Inputs, RewardModel, hide, over_inputs
from qdil.registry import bases, parse_method
from qdil.robots.environment import Environment


def reward_model(config: Config, env: Environment) -> RewardModel:
    """The reward model of ``config.method`` (the measure bonus is added by who pays, see ``phases.pay``)."""
    method = parse_method(config.method)
    base = bases()[method.base]
    if not base.imitates:
        return base.build(config)
    select = hide(actions=method.obs_only, proxy=not method.conditioned)
    widths = Inputs(
        env.obs_size,
        0 if method.obs_only else env.action_size,
        env.obs_size,
        len(env.measure_names) if method.conditioned else 0,
    )
    return over_inputs(base.build(config, widths), select, raw_expert=config.expert_obs == "raw")
