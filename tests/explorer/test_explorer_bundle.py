"""The explorer's script in the package is the one that its sources make."""

import hashlib
import re
from pathlib import Path

import qdil

EXPLORER = Path(qdil.__file__).parent / "explorer"
FRONTEND, STATIC = EXPLORER / "frontend", EXPLORER / "static"


def test_the_bundle_is_no_older_than_its_sources():
    """``build.mjs`` writes the same hash into the script's first line; `make frontend` builds it anew."""
    scripts = sorted(path.name for path in (FRONTEND / "src").glob("*.js"))
    made_from = hashlib.sha256()
    for name in ["build.mjs", "package-lock.json", *(f"src/{name}" for name in scripts)]:
        made_from.update(f"{name}\n".encode() + (FRONTEND / name).read_bytes())
    first_line = (STATIC / "explorer.js").read_text().partition("\n")[0]
    written = re.search(r"sources sha256:([0-9a-f]{64})", first_line)
    assert written and written[1] == made_from.hexdigest(), "run 'make frontend' and commit qdil/explorer/static"
    assert (STATIC / "explorer.css").read_bytes() == (FRONTEND / "src" / "explorer.css").read_bytes()
