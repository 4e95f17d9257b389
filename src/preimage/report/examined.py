"""One page about an examination: the verdict, every finding, and the pictures to see them in. All of it is in one HTML file."""

import base64
import io
import os
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.offsetbox import AnnotationBbox, OffsetImage

from preimage.examination import CameraMove, Examination, Finding, Kind, Seen, Severity
from preimage.records import number_of
from preimage.report.figures import ARRIVAL, FAILURE, INK, MUTED, WIDTH_INCHES, draw_row, quiet, sheet
from preimage.report.films import as_rgb
from preimage.report.pages import document
from preimage.storage.atomic_write import atomic_write

NUM_COLUMNS = 10
MOST_SHOWN, MOST_MOVES, MOST_JOINTS = 40, 6, 32
"""Episodes on the contact sheet, camera moves and joints that are drawn: as many as one can look at."""


def examined_page(
    examination: Examination, path: str | os.PathLike[str], *, title: str, camera: str | None = None, joint_unit: str | None = None
) -> Path:
    """Writes the page, self-contained HTML that opens without a network.

    Args:
        camera: the name of the camera that was looked through.
        joint_unit: the unit of the joints, where the data set says.

    Raises:
        OSError: the disk is full or forbidden.
    """
    path = Path(path)
    body = [
        f"<h1>{escape(title)}</h1>",
        _facts(examination.seen, camera, joint_unit),
        f'<div class="headline"><b>{escape(examination.verdict)}</b></div>',
        _table(examination.findings),
        *_pictures(examination, joint_unit),
    ]
    with atomic_write(path) as unfinished:
        unfinished.write_text(document(title, "\n".join(body)), encoding="utf-8")
    return path


def _facts(seen: Sequence[Seen], camera: str | None, joint_unit: str | None) -> str:
    first, steps = next((one for one in seen if one.num_frames), seen[0]), sum(one.num_steps for one in seen)
    height, width, channels = first.shape
    facts = f"{number_of(len(seen), 'episode')} · {number_of(steps, 'step')} at {first.rate_hz:g} Hz"
    facts += f" · {f'camera {camera}, ' if camera else ''}frames {width} x {height} pixels, {number_of(channels, 'channel')}"
    facts += f" · {number_of(len(first.joint_names), 'joint')} in {joint_unit or 'the unit of the data'}"
    return f'<p class="facts">{escape(facts)}</p>'


def _table(findings: Sequence[Finding]) -> str:
    rows = "".join(
        f'<tr class="{finding.severity.value}"><td>{finding.severity.value}</td><td><b>{escape(finding.kind.value)}</b></td>'
        f'<td data-head="what and where">{escape(finding.what)}</td><td data-head="what would help">{escape(finding.help)}</td></tr>\n'
        for finding in findings
    )
    heads = "".join(f'<th scope="col">{head}</th>' for head in ("how grave", "kind", "what and where", "what would help"))
    return (
        '<h2>What was found</h2>\n<div class="card"><table class="words">\n'
        f"<thead><tr>{heads}</tr></thead>\n<tbody>{rows}</tbody></table></div>"
    )


def _pictures(examination: Examination, joint_unit: str | None) -> list[str]:
    """Those that can be drawn: without a frame or joints there is nothing to show."""
    shown = [one for one in examination.seen if one.first is not None and one.num_steps]
    alike = [one for one in shown if (one.joint_names, one.background.shape) == (shown[0].joint_names, shown[0].background.shape)]
    if not shown:
        return []
    flagged = {episode for finding in examination.findings if finding.severity is not Severity.NOTE for episode in finding.episodes}
    pictures = [_picture("First and last frames", "Flagged episodes have red numbers.", _contact_sheet(shown, flagged))]
    if examination.moves:
        words = "What a pixel mostly shows in the episode before and after, and where the two differ."
        pictures.append(_picture("Where the camera moved", words, _moves(shown, examination.moves)))
    words = f"Every episode is a line, in {joint_unit or 'the unit of the data'}; flagged places are red."
    pictures.append(_picture("Joints over time", words, _joints(alike, examination.findings)))
    if len(alike) > 2:
        words = "The joints of the last step, in the two directions in which they differ most: what lies close together is alike."
        pictures.append(_picture("Map of the goals", words, _goals(alike)))
    return pictures


def _picture(name: str, words: str, drawing: Figure) -> str:
    png = io.BytesIO()
    drawing.savefig(png, format="png")
    source = f"data:image/png;base64,{base64.b64encode(png.getvalue()).decode()}"
    return f'<h2>{escape(name)}</h2>\n<p class="note">{escape(words)}</p>\n<img class="sheet" alt="{escape(name)}" src="{source}">'


def _contact_sheet(shown: Sequence[Seen], flagged: set[int]) -> Figure:
    """Flagged episodes are chosen first; all are shown in the order of recording."""
    chosen = _spread([one for one in shown if one.index in flagged], MOST_SHOWN)
    chosen += _spread([one for one in shown if one.index not in flagged], MOST_SHOWN - len(chosen))
    chosen.sort(key=lambda one: one.index)
    side = WIDTH_INCHES / NUM_COLUMNS
    row_inches = side * (0.3 + 2 * chosen[0].shape[0] / chosen[0].shape[1])
    num_rows = -(-len(chosen) // NUM_COLUMNS)
    drawing = sheet(num_rows * row_inches)
    axes = drawing.add_axes((0, 0, 1, 1), xlim=(0, WIDTH_INCHES), ylim=(num_rows * row_inches, 0))
    axes.axis("off")
    for place, one in enumerate(chosen):
        row, column = divmod(place, NUM_COLUMNS)
        left, top, middle = column * side, row * row_inches, row * row_inches + (row_inches - 0.3 * side) / 2
        for frame, above, below in ((one.first, top, middle), (one.last, middle, top + row_inches - 0.3 * side)):
            if frame is not None:
                axes.imshow(as_rgb(frame), extent=(left, left + 0.96 * side, below - 0.02, above + 0.02), aspect="auto")
        colour = FAILURE if one.index in flagged else INK
        axes.text(left + 0.48 * side, top + row_inches - 0.12 * side, str(one.index), fontsize=8, ha="center", color=colour)
    axes.set(xlim=(0, WIDTH_INCHES), ylim=(num_rows * row_inches, 0))
    return drawing


def _spread(some: Sequence[Seen], most: int) -> list[Seen]:
    """At most so many of them, evenly spread."""
    return [some[place] for place in np.linspace(0, len(some) - 1, min(most, len(some))).astype(int)]


def _moves(shown: Sequence[Seen], moves: Sequence[CameraMove]) -> Figure:
    by_index = {one.index: one for one in shown}
    largest = sorted(sorted(moves, key=lambda move: -move.difference)[:MOST_MOVES], key=lambda move: move.before)
    height, width = shown[0].background.shape
    inches = WIDTH_INCHES / MOST_MOVES * height / width + 0.25
    drawing = sheet(3 * inches)
    spacing = {"left": 0.005, "right": 0.995, "top": 0.995, "bottom": 0.22 / (3 * inches), "hspace": 0.17}
    rows: list[dict[int, tuple[np.ndarray, str]]] = [{}, {}, {}]
    for column, move in enumerate(largest):
        before, after = (by_index[index].background for index in (move.before, move.after))
        words = f"shifted {move.shift[0]:+d} down, {move.shift[1]:+d} right" if move.shift else "another view"
        pictures = ((before, f"episode {move.before}"), (after, f"episode {move.after}"), (np.abs(after - before), words))
        for row, (picture, caption) in zip(rows, pictures, strict=True):
            row[column] = picture.astype(np.uint8)[..., None], caption
    for axes, row in zip(drawing.subplots(3, 1, gridspec_kw=spacing), rows, strict=True):
        draw_row(axes, row, (height, width), columns=MOST_MOVES)
    return drawing


def _joints(seen: Sequence[Seen], findings: Sequence[Finding]) -> Figure:
    """Small multiples, flagged joints first; red where a finding names the place and the joint."""
    names = seen[0].joint_names
    flagged = {name for finding in findings if finding.kind in (Kind.JUMP, Kind.NOT_FINITE, Kind.RANGE) for name in finding.joints}
    chosen = sorted(sorted(range(len(names)), key=lambda joint: names[joint] not in flagged)[:MOST_JOINTS])
    columns = min(4, len(chosen))
    rows = -(-len(chosen) // columns)
    height = 1.45 * rows + 0.4
    drawing = sheet(height)
    spacing = {"left": 0.05, "right": 0.99, "top": 1 - 0.2 / height, "bottom": 0.4 / height, "hspace": 0.4, "wspace": 0.16}
    axes = drawing.subplots(rows, columns, squeeze=False, sharex=True, gridspec_kw=spacing)
    gap = np.full((1, len(names)), np.nan)  # one line with gaps draws ten times as fast as a line an episode
    values = np.concatenate([np.concatenate([one.recorded_joints, gap]) for one in seen])
    times = np.concatenate([np.arange(one.num_steps + 1) / one.rate_hz for one in seen])
    by_index = {one.index: one for one in seen}
    for axis in axes.ravel()[len(chosen) :]:
        axis.axis("off")
    for axis, joint in zip(axes.ravel(), chosen, strict=False):
        axis.plot(times, values[:, joint], color="#1f6fb2", linewidth=0.5, alpha=0.5)
        places = {place for finding in findings if names[joint] in finding.joints for place in finding.places if place[0] in by_index}
        for episode, step in places:
            axis.plot(step / by_index[episode].rate_hz, by_index[episode].joints[step, joint], "o", color=FAILURE, markersize=4)
        axis.set_title(names[joint], fontsize=8, loc="left", color=FAILURE if names[joint] in flagged else INK, pad=3)
        axis.locator_params(nbins=4)
        quiet(axis)
        axis.tick_params(labelsize=7)
    for axis in axes[-1]:
        axis.set_xlabel("time (s)", fontsize=8, color=MUTED)
    return drawing


def _goals(seen: Sequence[Seen]) -> Figure:
    points = _plane(np.stack([one.joints[-1] for one in seen]))
    drawing = sheet(6.5)
    axes = drawing.add_axes((0.06, 0.08, 0.93, 0.9))
    axes.scatter(*points.T, s=12, color=ARRIVAL)
    for place in np.unique(np.linspace(0, len(seen) - 1, MOST_SHOWN).astype(int)):
        frame = as_rgb(_last(seen[place]))
        picture = OffsetImage(frame, zoom=38 / max(frame.shape[:2]))
        axes.add_artist(AnnotationBbox(picture, (points[place, 0], points[place, 1]), pad=0.1, bboxprops={"edgecolor": "#c3cad2"}))
        axes.annotate(str(seen[place].index), tuple(points[place]), (0, 22), textcoords="offset points", fontsize=7, ha="center", color=INK)
    axes.margins(0.08)
    axes.set(xlabel="joints, first direction", ylabel="joints, second direction")
    quiet(axes)
    return drawing


def _last(one: Seen) -> np.ndarray:
    assert one.last is not None, "an episode without frames is not drawn"
    return one.last


def _plane(points: Float[np.ndarray, "N J"]) -> Float[np.ndarray, "N 2"]:
    """The two directions in which the points differ most; a single joint gets an empty second direction."""
    centred = points - points.mean(0)
    _, _, directions = np.linalg.svd(centred, full_matrices=False)
    flat = centred @ directions[:2].T  # (N, 1 or 2)
    return np.pad(flat, ((0, 0), (0, 2 - flat.shape[1])))
