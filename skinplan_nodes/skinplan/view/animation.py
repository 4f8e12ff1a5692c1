"""The arm at work as an animated GIF: station after station, faster than it is."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from skinplan.errors import InputError
from skinplan.transforms import Array, apply
from skinplan.view import palette
from skinplan.view.animation_view import IN_VIEW, SEEN, AnimationView, SeenSurface, shown_colours
from skinplan.view.motion import StationMotion, station_motions
from skinplan.view.stage import Stage

FRAME_MS = 100
LAST_MS = 1000
MOST_FRAMES = 110
MOST_BYTES = 8_000_000
WIDTH_PX = 720
HEAD_PX = 46
HEAD_WIDTH_PX = 590  # what the words need
_COLOURS = 232  # the rest of the 256 of a GIF are greys
_DARKEST = 0.28
_LOOK_S = 0.1  # the scanner moves at most 20 mm between two looks at the usual speed
_SHRINK = 0.8
_LEAST_WIDTH_PX = 160
_LETTERS = 60

Progress = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class Frame:
    """A moment that is shown.

    Attributes:
        motion: Of the station.
        time_s: Since its start [s].
    """

    motion: StationMotion
    time_s: float


def moments(motions: Sequence[StationMotion]) -> tuple[int, list[Frame]]:
    """Chooses the moments of an animation: all stations with their begin and end.

    Args:
        motions: At least one that lasts.

    Returns:
        How many times faster it runs, a whole number, and the frames: as slow as `MOST_FRAMES`
        allow, or with begin and end of each station only.
    """
    faster = 1
    while True:
        step = faster * FRAME_MS / 1000.0
        counts = [int(np.ceil(motion.duration_s / step - 1e-9)) + 1 for motion in motions]
        if sum(counts) <= MOST_FRAMES or max(counts) <= 2:
            break
        faster += 1
    return faster, [
        Frame(motion, min(number * step, motion.duration_s))
        for motion, count in zip(motions, counts, strict=True)
        for number in range(count)
    ]


def motion_gif(
    stage: Stage,
    progress: Progress | None = None,
    width_px: int = WIDTH_PX,
    most_bytes: int = MOST_BYTES,
) -> bytes:
    """Draws the animation.

    Args:
        stage: The part; the subject has a scanner, a station plan and trajectories.
        progress: Told the share done and what is being done.
        width_px: Width of the pictures at most [px].
        most_bytes: Frames are made smaller until the file is no larger.

    Returns:
        The bytes of a GIF file, the same for the same plan.

    Raises:
        InputError: Nothing moves.
    """
    frames = []
    colours = shown_colours(stage.subject)
    for share, image in drawn_frames(stage, width_px):
        frames.append(image)
        if progress is not None:
            progress(share, "animation")
    data = _encoded(frames, colours)
    while len(data) > most_bytes and frames[0].width * _SHRINK >= _LEAST_WIDTH_PX:
        size = (round(frames[0].width * _SHRINK), round(frames[0].height * _SHRINK))
        frames = [frame.resize(size, Image.Resampling.BOX) for frame in frames]
        data = _encoded(frames, colours)
    return data


def drawn_frames(stage: Stage, width_px: int = WIDTH_PX) -> Iterator[tuple[float, Image.Image]]:
    """Yields the share done and the pictures in their order; arguments: `motion_gif`.

    Raises:
        InputError: Nothing moves.
    """
    subject = stage.subject
    motions = [motion for motion in station_motions(subject) if motion.duration_s > 0.0]
    if not motions or subject.scanner is None:
        raise InputError("an animation needs a scanner and a trajectory with a motion")
    faster, frames = moments(motions)
    view, seen = AnimationView(stage, motions, width_px), SeenSurface(stage, subject.scanner)
    before: Frame | None = None
    for number, frame in enumerate(frames):
        scanning = frame.motion.is_scanning(frame.time_s)
        seen.look(_views(before, frame), scanning)
        q = frame.motion.joints(np.array([frame.time_s]))[0]
        body = Image.fromarray(view.image(frame.motion, q, seen.face_colours()))
        page = Image.new("RGB", (max(body.width, HEAD_WIDTH_PX), body.height + HEAD_PX), "white")
        corner = ((page.width - body.width) // 2, HEAD_PX)
        page.paste(body, corner)
        _draw_axis(page, corner, stage, view, frame, q)
        _draw_words(page, _words(stage, frame, faster), seen.share, scanning)
        yield (number + 1) / len(frames), page
        before = frame


def _views(before: Frame | None, frame: Frame) -> Array:
    """Poses of the scanner between two frames while it scans, shape (n, 4, 4) [m], workpiece."""
    motion = frame.motion
    same = before is not None and before.motion is motion
    start = before.time_s if before is not None and same else 0.0
    even = np.arange(start, frame.time_s, _LOOK_S)
    passed = motion.point_s[(motion.point_s >= start) & (motion.point_s <= frame.time_s)]
    times = np.unique(np.concatenate([even, passed, [frame.time_s]]))
    spans = motion.scan_spans
    inside = ((spans[:, :1] <= times) & (times <= spans[:, 1:])).any(axis=0)
    return motion.scanner(motion.joints(times[inside]))


def _draw_axis(
    page: Image.Image,
    corner: tuple[int, int],
    stage: Stage,
    view: AnimationView,
    frame: Frame,
    q: Array,
) -> None:
    """Draws the view axis from the scanner to where it looks, while it scans."""
    scanner = stage.subject.scanner
    if scanner is None or not frame.motion.is_scanning(frame.time_s):
        return
    T = frame.motion.scanner(q[None])[0]
    ends = np.stack([T[:3, 3], T[:3, 3] + scanner.standoff_m * T[:3, 0]])
    cells = view.view.pixels(apply(stage.subject.T_map_workpiece, ends))
    line = [(int(column) + corner[0], int(row) + corner[1]) for row, column in cells]
    ImageDraw.Draw(page).line(line, fill=_bytes(palette.HOLE_FRAME), width=2)


def _words(stage: Stage, frame: Frame, faster: int) -> tuple[str, str]:
    plan, motion = stage.subject.station_plan, frame.motion
    count = 0 if plan is None else len(plan.stations)
    name = stage.subject.part_id
    if len(name) > _LETTERS:
        name = f"{name[: _LETTERS - 1]}…"
    place = f"station {motion.name} ({motion.number + 1} of {count})"
    clock = f"{frame.time_s:.1f} s of {motion.duration_s:.1f} s, {faster} times faster"
    return name, f"{place}: {clock}"


def _draw_words(page: Image.Image, words: tuple[str, str], share: float, scanning: bool) -> None:
    pen = ImageDraw.Draw(page)
    bold, plain = _font("DejaVuSans-Bold.ttf", 15), _font("DejaVuSans.ttf", 13)
    pen.text((8, 4), words[0], font=bold, fill=_bytes(palette.INK))
    pen.text((8, 25), words[1], font=plain, fill=_bytes(palette.INK))
    # Only what is complete reads 100 %.
    told = f"seen {np.floor(100.0 * share + 1e-9):.0f} %"
    state, colour = ("scan", IN_VIEW) if scanning else ("transit", palette.SURFACE)
    left = page.width - 8.0
    for text, widest, patch in ((told, "seen 100 %", SEEN), (state, "transit", colour)):
        left -= pen.textlength(widest, font=plain)
        pen.text((left, 25), text, font=plain, fill=_bytes(palette.INK))
        pen.rectangle((left - 17, 27, left - 6, 38), fill=_bytes(patch))
        left -= 32


def _font(name: str, size: int) -> ImageFont.FreeTypeFont:
    """The font of the other pictures: matplotlib brings it along."""
    file = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name
    return ImageFont.truetype(str(file), size, layout_engine=ImageFont.Layout.BASIC)


def _encoded(frames: Sequence[Image.Image], colours: Sequence[palette.Colour]) -> bytes:
    """Returns the GIF of some pictures of things that have some colours."""
    table = _palette(colours)
    pages = [frame.quantize(palette=table, dither=Image.Dither.NONE) for frame in frames]
    stream = BytesIO()
    durations = [FRAME_MS] * (len(pages) - 1) + [LAST_MS]
    pages[0].save(
        stream, "GIF", save_all=True, append_images=pages[1:], duration=durations, loop=0,
        optimize=False, disposal=1,
    )  # fmt: skip
    return stream.getvalue()


def _palette(colours: Sequence[palette.Colour]) -> Image.Image:
    """Returns a picture with shades of each colour: a choice by how often they are loses some."""
    different = list(dict.fromkeys(colours))
    shades = np.linspace(_DARKEST, 1.0, _COLOURS // len(different))
    greys = np.linspace(0.0, 1.0, 256 - len(different) * len(shades))
    table = np.concatenate([np.outer(shades, colour) for colour in different])
    table = np.concatenate([table, np.tile(greys[:, None], (1, 3))])
    result = Image.new("P", (1, 1))
    result.putpalette(np.rint(255.0 * table).astype(np.uint8).tobytes())
    return result


def _bytes(colour: palette.Colour) -> tuple[int, int, int]:
    red, green, blue = (round(255 * channel) for channel in colour)
    return red, green, blue
