"""The settings of a run: typed groups, budgets, refusals before anything compiles, ``config.json``. No JAX here.

``settings`` declares every setting once; ``protocols`` names three sets of choices; ``checks`` builds a checked
``Config``; ``budgets`` has ``make_config``;
``text`` reads and writes settings as text.
"""

from qdil.config.budgets import BUDGETS as BUDGETS
from qdil.config.budgets import DESK as DESK
from qdil.config.budgets import LAPTOP as LAPTOP
from qdil.config.budgets import PER_ROBOT as PER_ROBOT
from qdil.config.budgets import SIGNED_THRESHOLD as SIGNED_THRESHOLD
from qdil.config.budgets import SMOKE as SMOKE
from qdil.config.budgets import make_config as make_config
from qdil.config.checks import OLD_NAMES as OLD_NAMES
from qdil.config.checks import change as change
from qdil.config.checks import check as check
from qdil.config.checks import from_settings as from_settings
from qdil.config.protocols import PROTOCOLS as PROTOCOLS
from qdil.config.settings import GROUP_OF as GROUP_OF
from qdil.config.settings import GROUPS as GROUPS
from qdil.config.settings import IDENTITY as IDENTITY
from qdil.config.settings import PPGA as PPGA
from qdil.config.settings import PPO as PPO
from qdil.config.settings import SPEED_ONLY as SPEED_ONLY
from qdil.config.settings import Bonus as Bonus
from qdil.config.settings import Config as Config
from qdil.config.settings import Demos as Demos
from qdil.config.settings import Evaluation as Evaluation
from qdil.config.settings import Reward as Reward
from qdil.config.settings import Simulation as Simulation
from qdil.config.settings import choices as choices
from qdil.config.settings import descriptions as descriptions
from qdil.config.settings import flat as flat
from qdil.config.settings import value_of as value_of
from qdil.config.text import from_json as from_json
from qdil.config.text import parse_settings as parse_settings
from qdil.config.text import same_but_for_speed as same_but_for_speed
from qdil.config.text import settings_help as settings_help
from qdil.config.text import to_json as to_json
from qdil.config.text import with_current_names as with_current_names
from qdil.errors import ConfigError as ConfigError
