"""``stages`` of a ``[[band]]``: TDI stages of all its pixels, of its columns, or line by line.

Reads a table ``column,stages``, ``choice.csv`` of ``sightline tdi`` for one signal, or its ``tags.bin``.

Not here: what they do to a camera (``geometry/camera.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError, SpanError, reads
from sightline.geometry.camera import MOST_STAGES
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.acquisition.schema import BandSection
from sightline.io.formats.tables import header_of, read_columns
from sightline.io.results.tdi_tags import read_tdi_tags
from sightline.motion.band import Band

Stages = NDArray[np.int16]

TAGS_ENDING = ".bin"
#: Values of time_reference, in words.
_REFERENCES = '"centre" (the middle of the stages of each pixel), "first-stage" or "last-stage"'


def stages_of(band: BandSection, shape: tuple[int, int], where: str, files: InputFolder) -> Stages | None:
    """TDI stages (1 or lines, columns) of a band whose image has `shape`; None where it names none.

    Parameters
    ----------
    where : str
        File and band, for messages.

    Raises
    ------
    FormatError
        If they do not go with the image, or with the band's other keys.
    """
    if band.stages is None:
        if band.stages_signal is not None:
            raise FormatError(
                f"{where}: stages_signal is given without stages; give stages = a choice.csv of `tdi` too"
            )
        if band.time_reference not in (None, "centre"):
            raise FormatError(
                f"{where}: time_reference = {band.time_reference!r} is given without stages: it says which "
                "of them first_line_time and look_ahead are of; give stages too, or leave it out"
            )
        return None
    if isinstance(band.stages, int):
        if band.stages_signal is not None:
            raise FormatError(
                f"{where}: stages_signal = {band.stages_signal:g} is given with stages = {band.stages}; it "
                "chooses the rows of a choice.csv: leave it out"
            )
        counts = np.full((1, shape[1]), band.stages, dtype=np.int16)
    else:
        path = files(band.stages)
        if path.suffix == TAGS_ENDING:
            if band.stages_signal is not None:
                raise FormatError(
                    f"{where}: stages_signal is given with {path.name}, whose tags hold each line's own "
                    "stages: leave it out"
                )
            counts = read_tag_stages(path, shape)
        else:
            counts = read_stages(path, shape[1], band.stages_signal, placed=band.time_reference is not None)
    if counts.max() > shape[0]:
        raise FormatError(
            f"{where}: stages: {counts.max()} stages are more than the {shape[0]} lines of {band.image}; "
            "give the stages that the image was taken with"
        )
    if band.time_reference is None and (counts != counts.flat[0]).any():
        raise FormatError(
            f"{where}: time_reference is missing: stages are from {counts.min()} to {counts.max()}, and what "
            f"first_line_time and look_ahead are of is not known; give {_REFERENCES}"
        )
    return counts


def check_covered(bands: Sequence[Band], toml: Path) -> None:
    """Refuse bands whose stages lie further from the times of their lines than poses are known.

    Raises
    ------
    SpanError
        Names the band, and up to when poses are needed.
    """
    for band in bands:
        camera = band.camera
        if camera.stages is None or camera.time_reference == "centre":
            continue
        low, high = camera.known_lines
        if low <= 0.0 and high >= camera.lines - 1.0:
            continue
        most = int(np.asarray(camera.stages).max())
        late = camera.middles
        first, last = (float(t) for t in camera.times([0.0, camera.lines - 1.0]))
        begin, end = min(first, first + late[0]), max(last, last + late[1])
        known = camera.known_span
        raise SpanError(
            f'{toml}: [[band]] {band.name}: time_reference = "{camera.time_reference}": the middle of up to '
            f"{most} stages is {late[0]:+.6f} to {late[1]:+.6f} s from the time of a line; positions and "
            f"attitudes are needed in [{begin:.6f}, {end:.6f}] s and cover [{known[0]:.6f}, {known[1]:.6f}] "
            "s: supply them over that span, or times of the middles of the stages with time_reference = "
            '"centre"'
        )


@reads("a table of TDI stages")
def read_stages(path: Path, columns: int, signal: float | None = None, *, placed: bool = True) -> Stages:
    """(1, columns) TDI stages of a table ``column,stages``, or of a ``choice.csv`` for one signal.

    Parameters
    ----------
    path : Path
        One row for every column of the image, in any order.
    columns : int
        Of the image.
    signal : float, optional
        Electrons; of a table with a column ``signal`` the rows of that one count.
    placed : bool
        Whether ``time_reference`` is given: where it and the signal are both missing, both are named at once.

    Raises
    ------
    FormatError
        If the rows are not those of the columns of the image, or there is no such signal.
    """
    several = "signal" in header_of(path, ("column", "stages"))
    if several and signal is None:
        raise FormatError(
            f"{path}: has stages for each of several signals; give stages_signal (electrons per head line), "
            "or stages = the tags.bin of `tdi --signals`, which has those of every line"
            + ("" if placed else f"; where stages differ also time_reference = {_REFERENCES}")
        )
    if not several and signal is not None:
        raise FormatError(
            f"{path}: has no column 'signal', and stages_signal = {signal:g} is given: leave it out"
        )
    names = ("column", "stages", "signal") if several else ("column", "stages")
    table = {name: np.asarray(value, dtype=np.float64) for name, value in read_columns(path, names).items()}
    if several:
        known = np.unique(table["signal"])
        assert signal is not None
        if not known[0] * (1.0 - 1e-6) <= signal <= known[-1] * (1.0 + 1e-6):
            raise FormatError(
                f"{path}: stages_signal = {signal:g} is beyond its signals, {known[0]:g} to {known[-1]:g} "
                "electrons; give one of them"
            )
        rows = table["signal"] == known[np.argmin(np.abs(known - signal))]
        table = {name: value[rows] for name, value in table.items()}
    at, counts = table["column"], table["stages"]
    wrong = ~((counts >= 1) & (counts <= MOST_STAGES) & (counts == np.round(counts)))
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise FormatError(
            f"{path}: stages = {counts[row]:g} at column {at[row]:g}; whole numbers from 1 to {MOST_STAGES} "
            "are allowed"
        )
    order = np.argsort(at, kind="stable")
    twice = at[order][1:][np.diff(at[order]) == 0.0]
    if len(twice):
        raise FormatError(f"{path}: column {twice[0]:g} has two rows; give one row for each column")
    if not np.array_equal(at[order], np.arange(columns)):
        raise FormatError(
            f"{path}: its {len(at)} rows are of columns {at.min():g} to {at.max():g}; the image has the "
            f"columns 0 to {columns - 1}: give one row for each of them, and the table of this band"
        )
    return np.asarray(counts[order][None, :], dtype=np.int16)


@reads("TDI tags")
def read_tag_stages(path: Path, shape: tuple[int, int]) -> Stages:
    """(lines, columns) TDI stages of every pixel of an image of `shape`, as its tags say.

    Raises
    ------
    FormatError
        If the tags are of another image.
    """
    tags = read_tdi_tags(path)
    if (len(tags), tags.columns) != shape:
        raise FormatError(
            f"{path}: tags of {len(tags)} lines x {tags.columns} columns, the image has {shape[0]} x "
            f"{shape[1]}; give the tags of this image"
        )
    if tags.stages.max() > MOST_STAGES:
        raise FormatError(f"{path}: {tags.stages.max()} stages; up to {MOST_STAGES} are allowed")
    widths = np.diff(np.append(tags.first_column, tags.columns))
    return np.repeat(tags.stages.astype(np.int16), widths, axis=1)
