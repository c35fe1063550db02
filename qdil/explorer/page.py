"""The explorer without a kernel: one HTML page that holds everything, and a notebook output around it."""

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

START: dict[str, Any] = {"run": 0, "against": -1, "field": "true_return", "iteration": -1, "selected": []}

# The page holds the script deflated, at a quarter of its size, and inflates it first.
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>html, body {{ margin: 0; }} {css}</style>
</head>
<body>
<div id="qdil-explorer"></div>{without}
<script>
globalThis.qdilPage = {data};
function failed(why) {{
  const place = document.getElementById("qdil-explorer");
  if (place.firstElementChild) return; // it had started
  place.textContent = `The explorer could not start (${{why}}); it needs a browser of 2023 or later.`;
  Object.assign(place.style, {{ background: "#fff", color: "#1b1f24", padding: "8px", font: "14px sans-serif" }});
}}
addEventListener("error", (event) => failed(event.message));
async function start() {{
  const packed = Uint8Array.from(atob("{script}"), (c) => c.charCodeAt(0));
  const inflated = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const script = document.createElement("script");
  script.type = "module";
  script.textContent = await new Response(inflated).text();
  document.head.append(script);
}}
start().catch((error) => failed(error.message));
</script>
</body>
</html>
"""

# For a page outside a notebook. In a notebook's output the picture lies under the page instead.
WITHOUT_SCRIPTS = """
<noscript><p>Scripts are switched off in this browser, so nothing moves here.</p>
<img src="data:image/png;base64,{picture}" alt="{alt}" style="display:block;max-width:100%"></noscript>"""

FRAGMENT = (
    '<div style="position:relative;width:100%;max-width:1180px;min-height:660px">'
    '<img src="data:image/png;base64,{picture}" alt="{alt}" style="display:block;width:100%">'
    '<iframe srcdoc="{page}" title="{alt}" sandbox="allow-scripts" '
    'style="position:absolute;inset:0;width:100%;height:100%;border:0"></iframe></div>'
)


class Page:
    """The explorer as a notebook output that needs no kernel: the page over a picture."""

    def __init__(self, runs: Sequence[Shown], state: dict[str, Any], recordings: int = RECORDINGS) -> None:
        self.runs, self.state, self.recordings = list(runs), state, recordings

    def save(self, path: str | Path, recordings: int | None = None) -> Path:
        """Write the page; see ``save``."""
        return save(self.runs, self.state, path, self.recordings if recordings is None else recordings)

    def _repr_html_(self) -> str:
        document = page(self.runs, self.state, self.recordings)
        return fragment(document, picture(self.runs, self.state), description(self.runs))


def description(runs: Sequence[Shown]) -> str:
    """The alternative text of a picture of the explorer."""
    names = ", ".join(shown.name for shown in runs)
    return f"Archive explorer ({names}): a heatmap of the archive, and the robot of a chosen cell walking."


def save(runs: Sequence[Shown], state: dict[str, Any], path: str | Path, recordings: int = RECORDINGS) -> Path:
    """Write the explorer of ``runs`` as one HTML file that needs no kernel and no network; returns its path."""
    drawn = base64.b64encode(picture(runs, state)).decode()
    without = WITHOUT_SCRIPTS.format(picture=drawn, alt=html.escape(description(runs)))
    content = page(runs, state, recordings, without).encode()
    replace_file(Path(path), lambda file: file.write(content))
    return Path(path)


def page(runs: Sequence[Shown], state: dict[str, Any], recordings: int = RECORDINGS, without: str = "") -> str:
    """A whole HTML document: the explorer of ``runs`` with about ``recordings`` episodes, and nothing to load.

    ``state``: values of the widget's traits, ``axes`` and any that differ from START. The episodes are those of
    ``selected`` and of cells spread over each archive. Together they take at most MOST_BYTES; the page
    gives the number of cells with an episode. ``without``: HTML for browsers that run no scripts.
    """
    state = START | state
    packed, playable = _recorded(runs, state["selected"], recordings)
    data = {"show": showing.content(runs, playable), "rollouts": packed, "state": state}
    return PAGE.format(
        title=html.escape(f"Archive explorer: {', '.join(shown.name for shown in runs)}"),
        css=(STATIC / "explorer.css").read_text(),
        data=json.dumps(data).replace("<", "\\u003c"),
        script=base64.b64encode(zlib.compress((STATIC / "explorer.js").read_bytes(), 9)).decode(),
        without=without,
    )


def _recorded(runs: Sequence[Shown], selected: Sequence[Any], count: int) -> tuple[dict[str, str], list[list[int]]]:
    """About ``count`` packed episodes in base64, by "run:cell"; and for each run the cells that have one."""
    playing = [shown.plays for shown in runs]
    share = -(-count // max(1, sum(playing)))
    packed: dict[str, str] = {}
    playable: list[list[int]] = []
    left = MOST_BYTES
    for i, shown in enumerate(runs):
        wanted = [cell for run, cell in selected if run == i] + showing.spread_out(shown, share)
        cells = [cell for cell in dict.fromkeys(wanted) if cell in shown.archive["index"]] if playing[i] else []
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
    return packed, playable


def fragment(document: str, picture: bytes, alt: str) -> str:
    """``document`` over a PNG ``picture``, for a notebook's output.

    The picture shows where scripts may not run and where JupyterLab removes the frame (an untrusted notebook).
    """
    return FRAGMENT.format(picture=base64.b64encode(picture).decode(), alt=html.escape(alt), page=html.escape(document))
