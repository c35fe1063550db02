"""Settings of Sphinx for the site, see ``make site``; ``qdil.series.site`` gathers the pages around this file."""

from importlib.util import find_spec
from pathlib import Path

project = "Quality diversity imitation learning"
author = "the qdil authors"
html_title = "qdil"
language = "en"

extensions = ["myst_nb", "sphinx.ext.mathjax"]
include_patterns = ["**.md", "**.ipynb"]
suppress_warnings = ["myst.xref_ambiguous", "mystnb.unknown_mime_type"]

nb_execution_mode = "off"  # the pages are copies that were executed before
nb_render_markdown_format = "myst"
nb_merge_streams = True
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
myst_heading_slug_func = "qdil.series.site.anchor"

# One file with everything that formulas need, fonts among it: no page may load anything from the network.
MATHJAX = find_spec("sphinx-mathjax-offline").submodule_search_locations[0]  # type: ignore[union-attr,index]
mathjax_path = "tex-svg.js"
mathjax3_config = {"options": {"enableMenu": False}, "svg": {"mtextInheritFont": True}}

html_theme = "furo"
html_static_path = [str(Path(MATHJAX, "static", "mathjax", mathjax_path)), "MATHJAX-LICENSE", "site.css"]
html_css_files = ["site.css"]
templates_path = ["templates"]
html_copy_source = False
html_use_index = False
html_show_sphinx = False
html_show_copyright = False
html_show_search_summary = False  # it would fetch the pages found, which browsers refuse where there is no server
