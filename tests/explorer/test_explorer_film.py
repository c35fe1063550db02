"""Films: of archives in memory, of chosen numbers, their strips, and the error of a coder that gives up."""

import sys

import explorer_runs
import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

import qdil
from qdil.config import make_config, to_json
from qdil.explorer import drawing, film
from qdil.explorer.rollouts import Rollout
from qdil.runs.folder import read_archive

CELLS = [0, 6, 7, 12, 18, 23]
pytestmark = pytest.mark.physics


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return explorer_runs.write(tmp_path_factory.mktemp("results") / "seed-1", CELLS)


def test_an_archive_in_memory_is_filmed_with_its_settings(folder, tmp_path):
    archive = read_archive(folder, policies=True)
    settings = to_json(make_config("walker2d", "true", "smoke", 1)) | {"actor_hidden": [8, 8], "episode_length": 20}
    path = qdil.render(archive, np.array([6]), tmp_path / "gait.png", width=64, config=settings)
    assert path.is_file()
    with pytest.raises(qdil.errors.ConfigError, match="no policies in this archive"):
        qdil.render(archive, [6], tmp_path / "gait.png", width=64)


def test_how_many_may_be_a_number_of_numpys(folder, tmp_path):
    with pytest.raises(qdil.errors.ConfigError, match="too few elites"):
        qdil.render(folder, np.int64(9), tmp_path / "gait.png")
    assert qdil.render(folder, np.int64(1), tmp_path / "gait.png", width=64).is_file()


def test_a_coder_that_gives_up_is_quoted(folder, tmp_path, monkeypatch):
    coder = tmp_path / "coder"
    coder.write_text(f"#!{sys.executable}\nimport sys\nsys.stdin.close()\nsys.exit('no such thing as colour')\n")
    coder.chmod(0o755)
    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", lambda: str(coder))
    with pytest.raises(OSError, match="the film could not be coded: no such thing as colour"):
        qdil.render(folder, [6, 12], tmp_path / "gait.mp4", speed=0.2, width=240)
    assert not list(tmp_path.glob("*gait*"))


def test_a_strips_bars_are_of_the_second_that_its_pictures_show(tmp_path, monkeypatch):
    """A foot on the ground in the first of three seconds and in the last quarter of the middle one."""
    seconds, steps = 0.05, 60
    contact = np.zeros((steps, 2), bool)
    contact[:20, 0] = contact[35:40, 0] = True
    pose = np.zeros((steps, 7, 3)), np.tile([1.0, 0, 0, 0], (steps, 7, 1))
    episode = Rollout(*pose, contact, np.zeros(steps, np.float32), seconds, False)
    shown = qdil.explore(explorer_runs.write(tmp_path / "run", [6]), live=False).runs[0]
    monkeypatch.setattr(film.showing, "roll_out", lambda shown, cells: [episode])
    seen = []
    monkeypatch.setattr(film, "still", lambda _, __, step, w, h: seen.append(step) or np.zeros((h, w, 3), np.uint8))
    film._png(shown, [6], tmp_path / "gait.png", 1.0, 100)
    assert seen == [21, 25, 28, 31, 35, 38]  # the middles of six equal parts of steps 20 to 39
    row = np.asarray(Image.open(tmp_path / "gait.png").convert("RGB"))[46 + 100 + 10].astype(int)
    lit = (row == drawing.FEET[0]).all(axis=1)
    marks = (row == film.TEXT).all(axis=1)
    assert lit[455:].sum() + marks[455:].sum() == 145 and not lit[:445].any()
    assert marks.sum() == 2 * film.MOMENTS
