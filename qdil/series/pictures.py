"""The pictures of the README and of ``docs/performance.md``: drawn from runs and speeds that come with the repository.

``make pictures`` writes all of them into ``docs/pictures``. They need no training and no network.
"""

from collections.abc import Callable
from pathlib import Path

from matplotlib.figure import Figure

from qdil import plotting
from qdil.explorer import render
from qdil.files import replace_file
from qdil.plotting import overview
from qdil.plotting.speed import speeds
from qdil.runs.folder import read_archive
from qdil.series import index
from qdil.series.readme import measured

PICTURES = index.ROOT / "docs" / "pictures"
SHOWCASE = index.ROOT / "results" / "showcase" / "walker2d"
METHODS = ("true", "gail", "mconbo-gail")


def gaits(path: Path) -> None:
    """Four elites of MConbo-GAIL's archive, among the best fifth and as different as possible, at half speed."""
    render(SHOWCASE / "mconbo-gail" / "seed-1", 4, path, speed=0.5, width=200)


def archives(path: Path) -> None:
    """The archives of the expert, GAIL and MConbo-GAIL on one colour scale."""
    shown = {method: read_archive(SHOWCASE / method / "seed-1") for method in METHODS}
    _write(plotting.archives_side_by_side(shown, robot="walker2d"), path)


def method(path: Path) -> None:
    """The parts of MConbo-GAIL and what flows between them."""
    _write(overview.framework(), path)


def speed(path: Path) -> None:
    """The bench's speeds, relative to Brax's own simulator."""
    _write(speeds(measured()), path)


def _write(figure: Figure, path: Path) -> None:
    replace_file(path, lambda file: file.write(plotting.to_png(figure)))


DRAWN: dict[str, Callable[[Path], None]] = {
    "gaits.gif": gaits,
    "archives.png": archives,
    "method.png": method,
    "speed.png": speed,
}


def main() -> None:
    """Draw all pictures into ``docs/pictures``."""
    for name, draw in DRAWN.items():
        draw(PICTURES / name)


if __name__ == "__main__":
    main()
