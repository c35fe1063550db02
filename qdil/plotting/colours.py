"""Colours: Okabe and Ito's, one for every foot, and one for every method that is the same in every figure.

Methods that a study draws together have colours that differ with any kind of colour vision (the tests simulate three
kinds of deficiency). Each base also has a marker, filled according to the prefix. Where a figure draws one method under
several settings, each setting has its own dash and marker.
"""

from collections.abc import Iterable
from typing import Any

from matplotlib.colors import to_hex, to_rgb

from qdil.config import ConfigError
from qdil.methods import OBS_ONLY, Method, parse_method

# Okabe and Ito's colours. RED is their vermillion, PINK their reddish purple.
BLACK, ORANGE, SKY, GREEN = "#000000", "#e69f00", "#56b4e9", "#009e73"
YELLOW, BLUE, RED, PINK = "#f0e442", "#0072b2", "#d55e00", "#cc79a7"
GREY = "#999999"
EMPTY = "0.87"  # grey of an empty cell
SERIES = (BLUE, RED, GREEN, PINK, ORANGE, SKY, BLACK)  # of lines, boxes and points that have no colour otherwise
FEET = (RED, BLUE, GREEN, PINK, ORANGE, SKY)  # foot 1, foot 2, …; a robot has at most six

METHOD_COLOURS = {
    "true": BLACK,
    "mbo-true": GREEN,
    "zero": GREY,
    "mbo-zero": "#117733",
    "gail": BLUE,
    "mcond-gail": SKY,
    "mbo-gail": ORANGE,
    "mconbo-gail": RED,
    "vail": PINK,
    "mconbo-vail": "#882255",
    "airl": "#2e6b2e",
    "mconbo-airl": "#7fbc41",
    "giril": "#e0c000",
    "mconbo-giril": "#997700",
    "pwil": "#8561f2",
    "mconbo-pwil": "#332288",
    "maxent": "#bbbbbb",
    "mconbo-maxent": "#4d4d4d",
    "diffail": "#87d2ff",
    "mconbo-diffail": "#8700f0",
}
OTHER_COLOURS = (PINK, "#882255", GREY, "#332288", "#117733")  # of names that are no methods, and of new bases
MARKERS = {"gail": "o", "vail": "s", "airl": "^", "giril": "v", "pwil": "D", "maxent": "P", "diffail": "p", "zero": "X"}
FILLS = {(False, False): "none", (True, False): "left", (False, True): "bottom", (True, True): "full"}
DASHES: tuple[Any, ...] = (
    "-",
    (0, (4, 1.5)),
    (0, (1, 1.2)),
    (0, (5, 1.5, 1, 1.5)),
    (0, (8, 2)),
    (0, (3, 1, 1, 1, 1, 1)),
)
MARKERS_OF_SETTINGS = ("o", "s", "^", "v", "D", "P", "X", "<", ">", "*", "p", "h", "d")
MANY = 5  # with at least so many settings of one method in a figure, each setting has its own colour
SETTING_COLOURS = ("#332288", SKY, "#117733", "#ddaa33", "#aa4499", "#999933", "#882255", "#44aa99", "#777777")


def method_colour(experiment: str, others: int = 0) -> str:
    """The colour of an experiment's method; for a name that is no method, number ``others`` of ``OTHER_COLOURS``."""
    name = experiment.split("+")[0]
    if name in METHOD_COLOURS:
        return METHOD_COLOURS[name]
    method = _parsed(name)
    if method is None or method.base.name not in METHOD_COLOURS:
        return OTHER_COLOURS[others % len(OTHER_COLOURS)]
    if method.obs_only:
        return _mix(method_colour(name.removesuffix(OBS_ONLY)), "#ffffff", 0.35)
    if method.conditioned:
        return _mix(METHOD_COLOURS[method.base.name], "#ffffff", 0.4)
    return _mix(METHOD_COLOURS[method.base.name], METHOD_COLOURS[f"mconbo-{method.base.name}"], 0.5)


def _parsed(name: str) -> Method | None:
    try:
        return parse_method(name)
    except ConfigError:
        return None


def _mix(colour: str, other: str, share: float) -> str:
    """``share`` of ``other`` mixed into ``colour``."""
    red, green, blue = ((1 - share) * a + share * b for a, b in zip(to_rgb(colour), to_rgb(other), strict=True))
    return to_hex((red, green, blue))


def styles(experiments: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Arguments of ``Axes.plot`` for every experiment of one figure; no two experiments get the same.

    A method has its colour and its base's marker, and is dashed if its reward is the true one. Each experiment with
    changed settings has its own dash and marker; if a method has ``MANY`` of them, also its own colour.
    """
    names = list(dict.fromkeys(experiments))
    methods = {name: name.split("+")[0] for name in names}
    spare = [name for name in names if _parsed(methods[name]) is None]
    line_styles = {name: _method_style(methods[name], spare.index(name) if name in spare else 0) for name in names}
    free = [colour for colour in SETTING_COLOURS if colour not in {style["color"] for style in line_styles.values()}]
    for name, method in methods.items():
        varied = [other for other in names if methods[other] == method and "+" in other]
        if name in varied:
            number = varied.index(name)
            line_styles[name] |= _setting_style(number + 1)
            line_styles[name] |= {"color": free[number % len(free)]} if len(varied) >= MANY else {}
    return line_styles


def _method_style(name: str, spare: int) -> dict[str, Any]:
    method = _parsed(name)
    style: dict[str, Any] = {"color": method_colour(name, spare), "ls": "-", "marker": "None"}
    if method is None:
        return style | {"marker": MARKERS_OF_SETTINGS[-1 - spare % 6]}
    if method.base.name == "true":
        style |= {"ls": "--"}
    elif method.obs_only:
        style |= {"ls": "-."}
    marker = MARKERS.get(method.base.name, "None" if method.base.name == "true" else "*")
    return style | {"marker": marker, "fillstyle": FILLS[method.conditioned, method.bonus]}


def _setting_style(number: int) -> dict[str, Any]:
    """The dash and marker of a method's experiment ``number`` (from 1) with changed settings."""
    marker = MARKERS_OF_SETTINGS[number % len(MARKERS_OF_SETTINGS)]
    return {"ls": DASHES[number % len(DASHES)], "marker": marker, "fillstyle": "full"}
