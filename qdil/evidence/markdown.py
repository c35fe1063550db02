"""Tables in Markdown."""

from collections.abc import Container

import pandas as pd


def markdown_table(frame: pd.DataFrame, right: Container[str] = ()) -> str:
    """A table of texts in Markdown, without the frame's index; the columns named in ``right`` are aligned right."""
    texts = frame.astype(str).map(lambda text: text.replace("|", "\\|"))
    sides = ["right" if name in right else "left" for name in frame.columns]
    return texts.to_markdown(index=False, disable_numparse=True, colalign=sides)
