"""The explorer without a kernel: a page that holds everything, and what a notebook keeps of it."""

import base64
import html
import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from qdil.explorer import shown as showing
from qdil.explorer.pack import pack
from qdil.explorer.picture import picture
from qdil.explorer.shown import Shown
from qdil.files import replace_file

STATIC = Path(__file__).parent / "static"
RECORDINGS = 100  # episodes in a page, over all its runs
MOST_BYTES = 900_000  # of packed episodes in a page, so that a notebook that holds one stays below 2 MB

# The script is kept deflated, a quarter of its size; inflating it is the only thing that runs before it.
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>html, body {{ margin: 0; }} {css}</style>
</head>
<body>
<div id="qdil-explorer"></div>
<script>
globalThis.qdilPage = {data};
const packed = Uint8Array.from(atob("{script}"), (c) => c.charCodeAt(0));
new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"))).text().then((code) => {{
  const script = document.createElement("script");
  script.type = "module";
  script.textContent = code;
  document.head.append(script);
}});
</script>
</body>
</html>
"""

FRAGMENT = (
    '<div style="position:relative;width:100%;max-width:1180px;min-height:660px">'
    '<img src="data:image/png;base64,{picture}" alt="{alt}" style="display:block;width:100%">'
    '<iframe srcdoc="{page}" title="{alt}" sandbox="allow-scripts" '
    'style="position:absolute;inset:0;width:100%;height:100%;border:0"></iframe></div>'
)


class Page:
    """The explorer as a notebook's output for where no kernel will be: the page over a picture."""

    def __init__(self, runs: Sequence[Shown], state: dict[str, Any], recordings: int = RECORDINGS) -> None:
        self.runs, self.state, self.recordings = list(runs), state, recordings

    def save(self, path: str | Path, recordings: int | None = None) -> Path:
        """Write the page; see ``save``."""
        return save(self.runs, self.state, path, self.recordings if recordings is None else recordings)

    def _repr_html_(self) -> str:
        names = ", ".join(shown.name for shown in self.runs)
        alt = f"Archive explorer ({names}): a heatmap of the archive, and the robot of a chosen cell walking."
        return fragment(page(self.runs, self.state, self.recordings), picture(self.runs, self.state), alt)


def save(runs: Sequence[Shown], state: dict[str, Any], path: str | Path, recordings: int = RECORDINGS) -> Path:
    """Write the explorer of ``runs`` as one HTML file that needs no kernel and no network; returns its path."""
    content = page(runs, state, recordings).encode()
    replace_file(Path(path), lambda file: file.write(content))
    return Path(path)


def page(runs: Sequence[Shown], state: dict[str, Any], recordings: int = RECORDINGS) -> str:
    """A whole HTML document: the explorer of ``runs`` with about ``recordings`` episodes, and nothing to load.

    ``state``: what is chosen at first (run, against, field, iteration, selected, as in the widget). Episodes are of
    cells spread over each archive, those of ``selected`` always among them.
    """
    playing = [shown.plays for shown in runs]
    share = -(-recordings // max(1, sum(playing)))
    state = {"run": 0, "against": -1, "field": "true_return", "iteration": -1, "selected": [], **state}
    wanted = [[cell for run, cell in state["selected"] if run == i] for i in range(len(runs))]
    packed: dict[str, str] = {}
    playable: list[list[int]] = []
    left = MOST_BYTES
    for i, shown in enumerate(runs):
        cells = [c for c in dict.fromkeys(wanted[i] + showing.spread_out(shown, share)) if c in shown.archive["index"]]
        cells = cells if playing[i] else []
        kept: list[int] = []
        allowance = left // max(1, sum(playing[i:]))
        for cell, rollout in zip(cells, showing.roll_out(shown, cells) if cells else [], strict=True):
            content = pack(rollout)
            if len(content) > allowance:
                break
            allowance, left = allowance - len(content), left - len(content)
            packed[f"{i}:{cell}"] = base64.b64encode(content).decode()
            kept.append(cell)
        playable.append(kept)
    data = {"show": showing.told(runs, playable), "rollouts": packed, "state": state}
    return PAGE.format(
        title=html.escape(f"Archive explorer: {', '.join(shown.name for shown in runs)}"),
        css=(STATIC / "explorer.css").read_text(),
        data=json.dumps(data).replace("<", "\\u003c"),
        script=base64.b64encode(zlib.compress((STATIC / "explorer.js").read_bytes(), 9)).decode(),
    )


def fragment(document: str, picture: bytes, alt: str) -> str:
    """``document`` over a PNG ``picture``, for a notebook's output.

    Where scripts may not run, or where the frame is taken out (a notebook that is not trusted), the picture is seen.
    """
    return FRAGMENT.format(picture=base64.b64encode(picture).decode(), alt=html.escape(alt), page=html.escape(document))
