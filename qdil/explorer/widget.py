"""The explorer in a live notebook: the front end as a widget with menus; the kernel computes the rollouts."""

import base64
import html
import math
import operator
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import permutations
from pathlib import Path
from typing import Any

import anywidget
import ipywidgets
import traitlets

from qdil.errors import ConfigError
from qdil.explorer import shown as showing
from qdil.explorer.pack import pack
from qdil.explorer.page import STATIC, description
from qdil.explorer.picture import sketch
from qdil.explorer.shown import Shown

FIELDS = {
    "True return": "true_return",
    "Learned fitness": "fitness",
    "Learned fitness − true return": "difference",
    "Return on fresh episodes, where it lands": "landed",
}
MOST = 4  # robots side by side
PICTURES = 200  # the most that the play button shows of a run; the same number as in the front end
KEPT = 512  # packed rollouts that a widget remembers, a few kilobytes each


class View(anywidget.AnyWidget):
    """Map, robots and gait diagram. The traits hold the reader's choices; page and kernel can both set them."""

    _esm = STATIC / "explorer.js"
    _css = STATIC / "explorer.css"
    show = traitlets.Dict().tag(sync=True)
    run = traitlets.Int(0).tag(sync=True)  # the number of the run that the map shows
    against = traitlets.Int(-1).tag(sync=True)  # the number of the run that is subtracted; -1: none
    field = traitlets.Enum(list(FIELDS.values()), "true_return").tag(sync=True)
    iteration = traitlets.Int(-1).tag(sync=True)  # -1: the end of the run
    axes: traitlets.List = traitlets.List().tag(sync=True)  # the measures that the map shows: [across], or [across, up]
    selected: traitlets.List = traitlets.List().tag(sync=True)  # [number of the run, number of the cell], up to four

    def __init__(self, runs: Sequence[Shown], state: dict[str, Any]) -> None:
        super().__init__(show=showing.content(runs), **state)
        runs = list(runs)

        @lru_cache(maxsize=KEPT)
        def packed(number: int, cell: int) -> bytes:
            return pack(showing.roll_out(runs[number], [cell])[0])

        self._packed = packed
        self.on_msg(self._answer)

    @traitlets.validate("run", "against")
    def _is_a_run(self, proposal: Any) -> int:
        lowest = -1 if proposal["trait"].name == "against" else 0
        if not lowest <= proposal["value"] < len(self.show["runs"]):
            allowed = f"{lowest} to {len(self.show['runs']) - 1}"
            raise traitlets.TraitError(f"{proposal['trait'].name} is the number of a run, {allowed}.")
        return proposal["value"]

    @traitlets.validate("axes")
    def _are_axes(self, proposal: Any) -> list[int]:
        k = len(self.show["runs"][0]["cells"])
        choices = [list(axes) for axes in permutations(range(k), min(k, 2))]
        if list(proposal["value"]) not in choices:
            raise traitlets.TraitError(f"axes is one of {', '.join(map(str, choices))}.")
        return [int(axis) for axis in proposal["value"]]

    @traitlets.validate("selected")
    def _are_cells(self, proposal: Any) -> list[list[int]]:
        """Pairs of whole numbers, each a run and one of its cells."""
        return checked(self.show["runs"], proposal["value"])

    def _answer(self, _: Any, message: Any, buffers: Any) -> None:
        """Send the requested rollout, or the reason why there is none."""
        if not isinstance(message, dict) or message.get("type") != "want":
            return
        which = {"run": message.get("run"), "cell": message.get("cell")}
        try:
            content = self._packed(int(message["run"]), int(message["cell"]))
        except ConfigError as error:
            self.send({"type": "refused", "why": str(error), **which})
        except Exception as error:  # any error: the page waits for an answer, and the kernel's log is hidden
            why = f"The rollout failed in the kernel ({type(error).__name__}: {error})"
            self.send({"type": "refused", "why": why, **which})
        else:
            self.send({"type": "rollout", **which}, buffers=[content])


def checked(runs: Sequence[Mapping[str, Any]], selected: Sequence[Any]) -> list[list[int]]:
    """``selected`` as lists of two integers. Raises TraitError for cells that do not exist and for more than four.

    ``runs``: as ``shown.content`` returns them.
    """
    if len(selected) > MOST:
        raise traitlets.TraitError(f"{MOST} robots at most walk side by side, not {len(selected)}.")
    pairs = []
    for one in selected:
        try:
            run, cell = (operator.index(number) for number in one)
        except (TypeError, ValueError):
            raise traitlets.TraitError(f"'{one}' is no pair of whole numbers: of a run, and of a cell.") from None
        if not 0 <= run < len(runs):
            raise traitlets.TraitError(f"there is no run {run}: they are numbered from 0 to {len(runs) - 1}.")
        cells = math.prod(runs[run]["cells"])
        if not 0 <= cell < cells:
            raise traitlets.TraitError(f"'{runs[run]['name']}' has no cell {cell}: they go from 0 to {cells - 1}.")
        pairs.append([run, cell])
    return pairs


class Explorer(ipywidgets.VBox):
    """The view with its menus above it; rearrange or replace ``children`` as any ipywidgets box's."""

    def __init__(self, runs: Sequence[Shown], state: dict[str, Any]) -> None:
        self.runs = list(runs)
        self.view = View(runs, state)
        names = [shown.name for shown in runs]
        self.run_menu = ipywidgets.Dropdown(options=_numbered(names), value=self.view.run, description="Run")
        scored_again = any(run["fresh"] for run in self.view.show["runs"])
        fields = [(text, field) for text, field in FIELDS.items() if field != "landed" or scored_again]
        self.field_menu = ipywidgets.Dropdown(options=fields, value=self.view.field, description="Colour")
        against = [("nothing", -1), *_numbered(names)]
        self.against_menu = ipywidgets.Dropdown(options=against, value=self.view.against, description="Minus")
        menus: list[Any] = [self.run_menu, self.field_menu, self.against_menu] if len(names) > 1 else [self.field_menu]
        for menu, trait in ((self.run_menu, "run"), (self.field_menu, "field"), (self.against_menu, "against")):
            ipywidgets.link((menu, "value"), (self.view, trait))
        last = max((run["history"]["last"] for run in self.view.show["runs"] if run["history"]), default=-1)
        if last >= 0:
            menus.append(self._iteration_menu(last))
        super().__init__([ipywidgets.HBox(menus, layout={"flex_flow": "row wrap"}), self.view])

    def _iteration_menu(self, last: int) -> Any:
        """A slider, with a play button, over the iterations at which the archive filled."""
        slider = ipywidgets.IntSlider(last, 0, last, description="Iteration")
        step = max(1, round(last / PICTURES))
        player = ipywidgets.Play(value=last, min=0, max=last, step=step, interval=60, show_repeat=False)
        ipywidgets.jslink((player, "value"), (slider, "value"))
        slider.observe(lambda change: self._show_iteration(change["new"], last), "value")
        return ipywidgets.HBox([player, slider])

    def _show_iteration(self, iteration: int, last: int) -> None:
        self.view.iteration = -1 if iteration == last else iteration

    def _repr_mimebundle_(self, **kwargs: Any) -> Any:
        """The widget, and a small picture for saved notebooks that are shown without a kernel."""
        bundle = super()._repr_mimebundle_(**kwargs)
        drawn = base64.b64encode(sketch(self.runs, self._state())).decode()
        alt = html.escape(description(self.runs))
        bundle["text/html"] = f'<img src="data:image/png;base64,{drawn}" alt="{alt}" style="max-width:100%">'
        return bundle

    def _state(self) -> dict[str, Any]:
        return {name: getattr(self.view, name) for name in ("run", "against", "field", "iteration", "axes", "selected")}

    @property
    def selected(self) -> list[tuple[str, int]]:
        """The chosen cells: (name of the run, number of the cell)."""
        return [(self.runs[number].name, int(cell)) for number, cell in self.view.selected]

    def save(self, path: str | Path, recordings: int | None = None) -> Path:
        """Write the explorer as a web page; see ``page.save``."""
        from qdil.explorer.page import RECORDINGS, save

        return save(self.runs, self._state(), path, RECORDINGS if recordings is None else recordings)


def _numbered(names: list[str]) -> list[tuple[str, int]]:
    """Menu entries; equal names get their number."""
    return [(name if names.count(name) == 1 else f"{name} ({i + 1})", i) for i, name in enumerate(names)]
