"""From a method's name to its reward model: one place that knows every base model and every prefix."""

from collections.abc import Callable

from qdil.config import Config, Method, parse_method
from qdil.imitation.gail import gail
from qdil.imitation.reward_model import RewardModel, Select, true_reward, with_proxy, without_proxy
from qdil.robots.environment import Environment


def _gail(config: Config, env: Environment, select: Select, width: int) -> RewardModel:
    return gail(
        env.obs_size + env.action_size + width,
        select,
        config.reward_hidden,
        config.reward_learning_rate,
        config.gradient_penalty,
        config.reward_steps,
        config.reward_batch,
    )


Build = Callable[[Config, Environment, Select, int], RewardModel]
BUILDERS: dict[str, Build] = {
    "true": lambda config, env, select, width: true_reward(),
    "gail": _gail,
}


def reward_model(config: Config, env: Environment) -> tuple[RewardModel, Method]:
    """The reward model that ``config.method`` names, and the method's parts (the bonus is added by VPPO's caller)."""
    method = parse_method(config.method)
    select = with_proxy if method.conditioned else without_proxy
    width = len(env.measure_names) if method.conditioned else 0
    return BUILDERS[method.base](config, env, select, width), method
