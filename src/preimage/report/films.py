"""Films of a plan: the goal | the imagined frames up to arrival | what the camera saw while executing, or in the recording to compare with.

The panels run on one clock. The imagined film ends at the arrival step, the executed one with the trial; the one that ends first
holds its last frame, and when both have ended the picture stays for one more second.
"""

import itertools
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import matplotlib
import numpy as np
from jaxtyping import Shaped, UInt8
from PIL import Image, ImageDraw, ImageFont

from preimage.records import Demonstration, Plan, Trial
from preimage.storage.atomic_write import atomic_write

PANEL_PIXELS = 256
"""Frames are enlarged by the largest whole factor that keeps their longer side within this; larger frames stay as they are."""
MARGIN, CAPTION, CLOCK = 16, 32, 36
"""Pixels between panels, above them for their names, and below them for the clock."""
MIN_COLUMN = 200
"""A column is at least this wide, so that its caption fits."""
HOLD_S = 1.0

BACKGROUND, INK, MUTED, TRACK = "#15181e", "#f2f4f7", "#9aa4b2", "#2b313b"
GOAL, IMAGINED, EXECUTED, SUCCESS, FAILURE = "#f2b84b", "#6cb2ff", "#c7a6ff", "#5fd38d", "#ff7b72"


def validate_filmed(trial: Trial | None) -> None:
    """Raises ValueError where there is a trial without frames."""
    if trial is not None and not len(trial.frames):
        raise ValueError("the trial was not filmed: execute the plan anew, with filmed=True")


def as_rgb(frame: Shaped[np.ndarray, "H W C"]) -> UInt8[np.ndarray, "H W 3"]:
    """The frame in colour: its first three channels where it has three or more, else its first one as grey."""
    channels = frame[..., :3] if frame.shape[-1] >= 3 else frame[..., :1]
    return np.array(np.broadcast_to(channels, (*frame.shape[:2], 3)), np.uint8)


@dataclass(frozen=True, eq=False)
class _Panel:
    """One column of the film: a name, the frames that run, and the words below when they have ended."""

    name: str
    colour: str
    frames: UInt8[np.ndarray, "T H W C"] | None
    verdict: str
    verdict_colour: str
    moves: bool = True


@dataclass(frozen=True)
class _Stage:
    """Where things stand in a picture of the film (pixels)."""

    num_panels: int
    frame_size: tuple[int, int]

    @property
    def column(self) -> int:
        return max(self.frame_size[0], MIN_COLUMN)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, both even, as yuv420p asks."""
        width = self.num_panels * (self.column + MARGIN) + MARGIN
        height = CAPTION + self.frame_size[1] + CLOCK
        return width + width % 2, height + height % 2

    def left(self, panel: int) -> int:
        return MARGIN + panel * (self.column + MARGIN)

    def frame_corner(self, panel: int) -> tuple[int, int]:
        return self.left(panel) + (self.column - self.frame_size[0]) // 2, CAPTION


def film(plan: Plan, trial: Trial | None, path: str | os.PathLike[str], *, recorded: Demonstration | None = None) -> Path:
    """Writes the film of a plan, and of its execution where there was one, at the plan's rate.

    Args:
        recorded: the recording of the same way, at the plan's rate, to be shown beside it.
        path: ends in `.mp4` (H.264, plays in browsers) or `.gif`; missing folders are made.

    Raises:
        ValueError: the path ends in something else, or the trial was not filmed.
    """
    validate_filmed(trial)
    path = Path(path)
    write = _WRITERS.get(path.suffix.lower())
    if write is None:
        raise ValueError(f"path ends in {path.suffix or 'no suffix'!r}, a film can be written as .mp4 or .gif: {path}")
    with atomic_write(path) as unfinished:
        write(unfinished, _pictures(_panels(plan, trial, recorded), plan), plan.rate_hz)
    return path


def _panels(plan: Plan, trial: Trial | None, recorded: Demonstration | None) -> list[_Panel]:
    goal = plan.goal.frame
    shown = "the image given" if goal is not None else "given as joint angles"
    panels = [
        _Panel("goal", GOAL, None if goal is None else goal[None], shown, MUTED, moves=False),
        _Panel("imagined", IMAGINED, plan.frames[: plan.arrival_step + 1], "arrived", IMAGINED),
    ]
    if trial is not None:
        verdict = f"{trial.deviation_m * 100:.1f} cm off: {'success' if trial.success else 'failure'}"
        panels.append(_Panel("executed", EXECUTED, trial.frames, verdict, SUCCESS if trial.success else FAILURE))
    if recorded is not None:
        panels.append(_Panel("recorded", EXECUTED, recorded.frames, "ended", EXECUTED))
    return panels


def _pictures(panels: list[_Panel], plan: Plan) -> Iterator[Image.Image]:
    """The pictures of the film, one a step, without the hold at the end."""
    stage = _Stage(len(panels), _enlarged_size(plan.frames.shape[2], plan.frames.shape[1]))
    num_steps = max(len(panel.frames) for panel in panels if panel.frames is not None)
    for step in range(num_steps):
        picture = Image.new("RGB", stage.size, BACKGROUND)
        for column, panel in enumerate(panels):
            _draw_panel(picture, stage, column, panel, step, num_steps, plan.rate_hz)
        yield picture


def _draw_panel(picture: Image.Image, stage: _Stage, column: int, panel: _Panel, step: int, num_steps: int, rate_hz: float) -> None:
    draw, left, bottom = ImageDraw.Draw(picture), stage.left(column), CAPTION + stage.frame_size[1]
    draw.text((left, CAPTION // 2), panel.name, panel.colour, font=_font(16, bold=True), anchor="lm")
    _draw_frame(picture, stage.frame_corner(column), stage.frame_size, panel, step)
    if not panel.moves:
        draw.text((left, bottom + CLOCK // 2 + 2), panel.verdict, MUTED, font=_font(13), anchor="lm")
        return
    assert panel.frames is not None
    last = len(panel.frames) - 1
    shown = min(step, last)
    draw.rectangle((left, bottom + 4, left + stage.column - 1, bottom + 6), TRACK)
    reached = round(stage.column * (shown + 1) / num_steps)
    draw.rectangle((left, bottom + 4, left + reached - 1, bottom + 6), panel.colour)
    middle = bottom + CLOCK // 2 + 4
    draw.text((left, middle), f"{shown / rate_hz:.1f} s", INK, font=_font(13), anchor="lm")
    if step >= last:
        corner = (left + stage.column, middle)
        draw.text(corner, panel.verdict, panel.verdict_colour, font=_font(13, bold=True), anchor="rm")


def _draw_frame(picture: Image.Image, corner: tuple[int, int], size: tuple[int, int], panel: _Panel, step: int) -> None:
    if panel.frames is None:
        draw = ImageDraw.Draw(picture)
        draw.rectangle((*corner, corner[0] + size[0] - 1, corner[1] + size[1] - 1), outline=TRACK)
        draw.text((corner[0] + size[0] // 2, corner[1] + size[1] // 2), "no image", MUTED, font=_font(14), anchor="mm")
    else:
        frame = Image.fromarray(as_rgb(panel.frames[min(step, len(panel.frames) - 1)]))
        picture.paste(frame.resize(size, Image.Resampling.NEAREST), corner)


def _enlarged_size(width: int, height: int) -> tuple[int, int]:
    factor = max(1, PANEL_PIXELS // max(width, height))
    return width * factor, height * factor


def _font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """DejaVu Sans as matplotlib ships it: there on every machine, and the letters of the figures."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(f"{matplotlib.get_data_path()}/fonts/ttf/{name}", size)


def _write_mp4(path: Path, pictures: Iterator[Image.Image], rate_hz: float) -> None:
    last = next(pictures)
    with av.open(str(path.absolute()), "w", format="mp4", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=Fraction(rate_hz).limit_denominator(1000))
        stream.width, stream.height = last.size
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "16"}
        stream.thread_count = 1  # more threads would give other bits on other machines, and save milliseconds
        for picture in itertools.chain([last], pictures):
            container.mux(stream.encode(av.VideoFrame.from_image(picture)))
            last = picture
        for _ in range(max(1, round(HOLD_S * rate_hz))):
            container.mux(stream.encode(av.VideoFrame.from_image(last)))
        container.mux(stream.encode(None))


def _write_gif(path: Path, pictures: Iterator[Image.Image], rate_hz: float) -> None:
    drawn = list(pictures)
    palette = _shared_palette(drawn)
    first, *rest = (picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in drawn)
    step_ms = max(20, round(100 / rate_hz) * 10)  # a GIF counts in hundredths; browsers slow down below two of them
    durations = [step_ms] * len(rest) + [step_ms + round(HOLD_S * 1000)]
    first.save(path, "GIF", save_all=True, append_images=rest, duration=durations, loop=0)


def _shared_palette(pictures: list[Image.Image]) -> Image.Image:
    """256 colours for the whole film: most for the frames, some for the captions, so that neither takes on the other's tint."""
    chosen = np.unique(np.linspace(0, len(pictures) - 1, 8).round().astype(int))
    sample = np.stack([np.asarray(pictures[i]) for i in chosen])
    captions = np.concatenate([sample[:, :CAPTION], sample[:, -CLOCK:]], 1)
    frames = sample[:, CAPTION:-CLOCK]
    palette = Image.new("P", (1, 1))
    palette.putpalette(_colours(frames, 200) + _colours(captions, 56))
    return palette


def _colours(pixels: UInt8[np.ndarray, "N H W 3"], num_colours: int) -> list[int]:
    """So many colours that stand for all in the pixels; each counts once, however rare, or the greys would take every place."""
    packed = np.unique(pixels.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32))
    colours = np.stack([packed >> 16, packed >> 8 & 255, packed & 255], -1).astype(np.uint8)
    reduced = Image.fromarray(colours[None]).quantize(num_colours, Image.Quantize.MEDIANCUT)
    return (reduced.getpalette() or [])[: 3 * num_colours]


_WRITERS: dict[str, Callable[[Path, Iterator[Image.Image], float], None]] = {".mp4": _write_mp4, ".gif": _write_gif}
FILM_SUFFIXES = tuple(_WRITERS)
"""How the name of a film may end."""
