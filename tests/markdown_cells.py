"""The cells of a Markdown table, without the spaces that pad them."""

import re


def cells(table: str) -> list[list[str]]:
    """The rows of a table, the line under its header left out."""
    rows = [re.split(r"(?<!\\)\|", line.strip().strip("|")) for line in table.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in row] for row in rows if not set("".join(row)) <= set("-: ")]
