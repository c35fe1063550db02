"""Elites' episodes as files: a film (mp4), an animation (gif) or a strip of moments (png)."""

import contextlib
import io
import itertools
import subprocess
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import IO, Any

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from qdil.errors import ConfigError
from qdil.explorer import drawing
from qdil.explorer import shown as showing
from qdil.explorer.rollouts import Rollout
from qdil.explorer.shown import Runs, Shown
from qdil.extras import needs
from qdil.files import replace_file
from qdil.imitation.selection import select, top_fifth
from qdil.robots import shapes
from qdil.robots.shapes import Pose

MOST = 4  # robots beside each other
MOMENTS = 6  # poses in a row of a strip
TEXT, FAINT = (27, 31, 36), (222, 226, 231)
GIF_RATE, MP4_RATE = 20, 40  # frames per second
GIF_COLOURS = 96


def render(
    runs: Runs,
    cells: int | Sequence[int],
    path: str | Path,
    speed: float = 0.5,
    width: int = 240,
    config: Mapping[str, Any] | None = None,
) -> Path:
    """Draw the episodes of some elites of a run, side by side and in step, into ``path``; returns it.

    ``runs``: a run as for ``explore`` (of several, the first). ``cells``: at most four cell numbers; or how many cells
    to choose among the best fifth, as different as possible, as for demonstrators. ``path`` ends in ``.mp4`` or
    ``.gif`` (at ``speed`` times real time), or in ``.png`` (for each cell a row of moments from the middle second).
    ``width``: pixels of a robot's picture. Bars below each robot show when each of its k feet touches the ground.
    ``config``: the settings of an archive in memory. Nothing needs a GPU or a screen. Raises ConfigError for another
    suffix, for empty or too many cells, and for runs without policies or without shapes to draw.
    """
    path, shown = Path(path), showing.read(runs, config)[0]
    writers: dict[str, Callable[[Shown, list[int], Path, float, int], None]] = {
        ".mp4": _mp4, ".gif": _gif, ".png": _png
    }  # fmt: skip
    if path.suffix not in writers:
        raise ConfigError(f"'{path.name}' has no known suffix; choose one of {', '.join(writers)}.")
    if speed <= 0 or width < 32:
        raise ConfigError("speed must be above 0 and width at least 32 pixels.")
    chosen = choose(shown, int(cells)) if isinstance(cells, int | np.integer) else [int(cell) for cell in cells]
    if not 1 <= len(chosen) <= MOST:
        raise ConfigError(f"a film shows 1 to {MOST} cells, not {len(chosen)}.")
    writers[path.suffix](shown, chosen, path, speed, width)
    return path


def choose(shown: Shown, count: int) -> list[int]:
    """Cells of ``count`` elites among the best fifth, as different in measures as possible, the best first.

    Raises ConfigError if there are fewer than ``count``.
    """
    archive = shown.archive
    returns, measures = np.asarray(archive["true_return"]), np.asarray(archive["measures"])
    try:
        rows = select(returns, measures, int(np.prod(archive["cells"])), count)
    except ValueError as error:
        pool = len(top_fifth(returns, int(np.prod(archive["cells"]))))
        raise ConfigError(
            f"'{shown.name}' has too few elites to show {count}: {pool} are in the best fifth of its cells."
        ) from error
    return [int(cell) for cell in np.asarray(archive["index"])[rows]]


def still(shown: Shown, rollout: Rollout, step: int, width: int, height: int) -> np.ndarray:
    """(height, width, 3) uint8: the robot at ``step`` of an episode; after the end, its last pose."""
    assert shown.config is not None
    env, step = shown.config["env"], min(step, len(rollout.reward) - 1)
    about = showing.robot(env)
    assert about is not None  # or the run would not play
    pose = Pose(rollout.position[step], rollout.rotation[step])
    what = drawing.scene(shapes.shapes(env), showing.legs(env), pose, rollout.contact[step])
    torso = rollout.position[step, 0]
    target = np.array([torso[0], torso[1], about["middle"] + 0.6 * (torso[2] - about["torso"])])
    return drawing.image(what, target, about["size"], width, height)


def _frames(shown: Shown, cells: list[int], speed: float, width: int, rate: int) -> Iterator[np.ndarray]:
    """Pictures of all robots in step, ``rate`` per second, until half a second after the longest episode."""
    rollouts = showing.roll_out(shown, cells)
    below = [_gait(rollout, max(len(r.reward) for r in rollouts), width) for rollout in rollouts]
    heads = [_head(shown, cell, width) for cell in cells]
    steps_per_frame = speed / rate / rollouts[0].seconds
    longest = max(len(rollout.reward) for rollout in rollouts)
    count = int(np.ceil(longest / steps_per_frame))
    for frame in range(count + rate // 2):
        step = min(int(frame * steps_per_frame), longest - 1)
        columns = [
            np.concatenate([head, still(shown, rollout, step, width, width), _playhead(strip, step, longest)])
            for head, rollout, strip in zip(heads, rollouts, below, strict=True)
        ]
        yield np.concatenate(columns, axis=1)


def _gif(shown: Shown, cells: list[int], path: Path, speed: float, width: int) -> None:
    pictures = [Image.fromarray(frame) for frame in _frames(shown, cells, speed, width, GIF_RATE)]
    # One palette, from pictures of the whole film: colours then do not flicker.
    sample = np.concatenate([np.asarray(picture) for picture in pictures[:: max(1, len(pictures) // 8)]])
    palette = Image.fromarray(sample).quantize(GIF_COLOURS, dither=Image.Dither.NONE)
    first, *others = (picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures)
    buffer = io.BytesIO()
    first.save(buffer, "GIF", save_all=True, append_images=others, duration=1000 // GIF_RATE, loop=0, optimize=True)
    replace_file(path, lambda file: file.write(buffer.getvalue()))


def _mp4(shown: Shown, cells: list[int], path: Path, speed: float, width: int) -> None:
    with needs("explorer", "an .mp4 film"):
        import imageio_ffmpeg
    draft = path.with_name(f".{path.name}.part.mp4")
    draft.parent.mkdir(parents=True, exist_ok=True)
    frames = (
        frame[: len(frame) - len(frame) % 2] for frame in _frames(shown, cells, speed, width - width % 2, MP4_RATE)
    )
    first = next(frames)  # even width and height: the coder halves the resolution of colours
    size = f"{first.shape[1]}x{first.shape[0]}"
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(MP4_RATE), "-i", "-"]
    wanted = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "23", "-movflags", "faststart"]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *given, *wanted, str(draft)]
    try:
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as coder:
            assert coder.stdin is not None and coder.stderr is not None
            _feed(coder.stdin, itertools.chain([first], frames))
            complaint = coder.stderr.read().decode()
        if coder.returncode:
            raise OSError(f"the film could not be coded: {complaint.strip()}")
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def _feed(pipe: IO[bytes], frames: Iterable[np.ndarray]) -> None:
    """Write frames until the coder stops reading; its own error message then explains the failure."""
    with contextlib.suppress(BrokenPipeError), pipe:
        for frame in frames:
            pipe.write(frame.tobytes())


def _png(shown: Shown, cells: list[int], path: Path, speed: float, width: int) -> None:
    """A row per cell: moments of the middle second of its episode, or of a whole shorter episode.

    Bars below show the feet on the ground in that second, with a mark under each picture for its moment.
    """
    rows = []
    for cell, rollout in zip(cells, showing.roll_out(shown, cells), strict=True):
        steps = len(rollout.reward)
        taken = min(steps, int(np.ceil(1 / rollout.seconds)))
        first = (steps - taken) // 2
        moments = ((np.arange(MOMENTS) + 0.5) / MOMENTS * taken).astype(int)
        pictures = [still(shown, rollout, first + int(step), width, width) for step in moments]
        strip = _gait(rollout, taken, MOMENTS * width, first)
        for step in moments:
            strip = _playhead(strip, int(step), taken)
        about = f"; bars: the {taken * rollout.seconds:.2g} s of the pictures"
        rows += [_head(shown, cell, MOMENTS * width, about), np.concatenate(pictures, axis=1), strip]
    buffer = io.BytesIO()
    Image.fromarray(np.concatenate(rows)).save(buffer, "PNG", optimize=True)
    replace_file(path, lambda file: file.write(buffer.getvalue()))


@lru_cache(maxsize=8)
def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans.ttf"), size)


def _head(shown: Shown, cell: int, width: int, about: str = "") -> np.ndarray:
    """(46, width, 3): a robot's return, and the share of time that each foot is on the ground; then ``about``."""
    row = int(np.flatnonzero(np.asarray(shown.archive["index"]) == cell)[0])
    shares = [round(100 * float(share)) for share in shown.archive["measures"][row]]
    picture = Image.new("RGB", (width, 46), "white")
    pen = ImageDraw.Draw(picture)
    pen.text((8, 5), f"return {shown.archive['true_return'][row]:.0f}", TEXT, _font(14))
    pen.text((8, 25), f"{_shares_text(shares)}{about}", TEXT, _font(11))
    return np.asarray(picture)


def _shares_text(shares: Sequence[int]) -> str:
    """How long each foot is on the ground, in percent; short enough for a picture of 240 pixels."""
    if len(shares) > 2:
        return f"on the ground {', '.join(map(str, shares))} %"
    return f"{'foot' if len(shares) == 1 else 'feet'} on the ground {', '.join(f'{share} %' for share in shares)}"


def _gait(rollout: Rollout, count: int, width: int, first: int = 0) -> np.ndarray:
    """(10 + 12 k, width, 3): a bar for each foot, coloured while it touches the ground, white after the episode.

    The bars show ``count`` steps from step ``first`` on.
    """
    feet = rollout.contact.shape[1]
    strip = np.full((10 + 12 * feet, width, 3), 255, np.uint8)
    step = first + np.minimum(np.arange(width) * count // width, count - 1)
    runs_on = step < len(rollout.reward)
    for foot in range(feet):
        on = runs_on & rollout.contact[np.minimum(step, len(rollout.reward) - 1), foot]
        colour = drawing.FEET[foot % len(drawing.FEET)]
        row = np.where(on[:, None], colour, np.where(runs_on[:, None], FAINT, 255)).astype(np.uint8)
        strip[6 + 12 * foot : 15 + 12 * foot] = row
    return strip


def _playhead(strip: np.ndarray, step: int, longest: int) -> np.ndarray:
    marked = strip.copy()
    at = min(int((step + 0.5) / longest * strip.shape[1]), strip.shape[1] - 2)
    marked[2:-3, at : at + 2] = TEXT
    return marked
