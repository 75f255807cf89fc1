"""``[noise] table`` of a TDI.toml: noise, full wells and diffusion of every column by itself.

Not here: the keys for all columns at once (``schema.py``), what they mean (``imaging/tdi_noise.py``).
"""

from __future__ import annotations

import difflib
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError
from sightline.imaging.mtf import diffusion_mtf
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.io.formats.tables import header_of, read_columns
from sightline.io.quantities import Within
from sightline.io.tdi.schema import ChoiceSection, MtfSection, NoiseSection, TdiFile
from sightline.tdi.setting import ScanColumns, TdiDetector

Array = NDArray[np.float64]

#: Every column of the table but its first, and where its key stands for all columns at once.
NOISE = ("gain", "shot", "read", "dark", "output")
WELLS = ("full_well_line", "full_well_sum")
DIFFUSION = "diffusion_sigma_px"
_SECTIONS: dict[str, tuple[str, type[NoiseSection] | type[ChoiceSection] | type[MtfSection]]] = {
    **dict.fromkeys(NOISE, ("noise", NoiseSection)),
    **dict.fromkeys(WELLS, ("choice", ChoiceSection)),
    DIFFUSION: ("mtf", MtfSection),
}
#: Columns of the `columns.csv` of ``sightline noise``, whose `gain` is something else.
_OF_RESPONSE = {"offset", "flags"}


def read_noise_table(path: Path, toml: Path, file: TdiFile, column: Array) -> dict[str, Array]:
    """Values (C,) of every key in a table of columns.

    Parameters
    ----------
    path : Path
        The table.
    toml : Path
        The TDI.toml that names it.
    file : TdiFile
        What stands in that.
    column : (C,)
        Numbers of the columns that are chosen for, rising.

    Raises
    ------
    FormatError
        A key that stands in both files, a column that is missing or stands twice, values that cannot be.
    """
    header = header_of(path)
    _check_header(path, header)
    names = [name for name in _SECTIONS if name in header]
    for name in names:
        section = _SECTIONS[name][0]
        if name in getattr(file, section).model_fields_set:
            raise FormatError(
                f"{toml}: [{section}] {name} = {getattr(getattr(file, section), name):g} is given, and a "
                f"column {name!r} in {path.name} too; leave one of them out"
            )
    table = {
        name: np.asarray(values, dtype=np.float64)
        for name, values in read_columns(path, ("column", *names), infinite=WELLS).items()
    }
    rows = _rows_of(path, table.pop("column"), column)
    values = {name: given[rows] for name, given in table.items()}
    for name, given in values.items():
        _check_values(path, name, given, column)
    return values


def _check_header(path: Path, header: list[str]) -> None:
    """FormatError where the header is that of another table, or has a column that would count for nothing."""
    if _OF_RESPONSE <= set(header):
        raise FormatError(
            f"{path}: is the columns.csv of `sightline noise`, whose `gain` is the response of a column; "
            f"[noise] table takes column and any of {', '.join(_SECTIONS)}, where gain is a relative "
            "variance: its noise.toml has these for all columns"
        )
    for name in header:
        if name != "column" and name not in _SECTIONS:
            close = difflib.get_close_matches(name.lower(), _SECTIONS, n=1, cutoff=0.6)
            meant = f"did you mean {close[0]}?" if close else f"allowed are {', '.join(_SECTIONS)}"
            raise FormatError(f"{path}: column {name!r} is not known; {meant}")
    if not set(header) & set(_SECTIONS):
        raise FormatError(
            f"{path}: has nothing but the numbers of columns; add one or more of {', '.join(_SECTIONS)}"
        )


def _rows_of(path: Path, given: Array, column: Array) -> NDArray[np.intp]:
    """Rows of the columns that are chosen for."""
    order = np.argsort(given, kind="stable")
    twice = np.flatnonzero(np.diff(given[order]) == 0.0)
    if len(twice):
        raise FormatError(f"{path}: column {given[order][twice[0]]:g} stands twice; give one row for each")
    place = np.minimum(np.searchsorted(given[order], column), len(given) - 1)
    missing = np.flatnonzero(given[order][place] != column)
    strange = given[~np.isin(given, column) & ((given > column[-1]) | (given < column[0]))]
    if len(missing) or len(strange):
        which = (
            f"column {column[missing[0]]:g} has no row"
            if len(missing)
            else f"column {strange[0]:g} is none of them"
        )
        raise FormatError(
            f"{path}: {which}: [columns] has the columns {column[0]:g} to {column[-1]:g}; give one row for "
            "each of them, and the table of this detector"
        )
    return np.asarray(order[place], dtype=np.intp)


def _check_values(path: Path, name: str, values: Array, column: Array) -> None:
    """FormatError where a value lies outside of what the key of all columns may be."""
    model = _SECTIONS[name][1]
    within = next(bound for bound in model.model_fields[name].metadata if isinstance(bound, Within))
    for value, at in zip(values.tolist(), column.tolist(), strict=True):
        if not within.holds(value):
            raise FormatError(f"{path}: {name} = {value:g} at column {at:g}: {within.words()} allowed")


def with_noise_table(
    columns: ScanColumns, detector: TdiDetector, file: TdiFile, values: dict[str, Array], path: Path
) -> tuple[ScanColumns, TdiDetector]:
    """Columns and detector with what a table says of each column.

    Parameters
    ----------
    columns : ScanColumns
        With the static MTF that the file gives all columns.
    detector : TdiDetector
        As the file gives it for all columns.
    file : TdiFile
    values : dict of (C,)
        From :func:`read_noise_table`.
    path : Path
        Of the table, for messages.

    Raises
    ------
    FormatError
        A column without any noise, or whose well a head line overfills.
    """
    if DIFFUSION in values:
        spread = diffusion_mtf(np.asarray(file.mtf.frequencies), values[DIFFUSION][:, None])
        columns = replace(columns, static_mtf=columns.static_mtf * spread)
    names = [name for name in (*NOISE, *WELLS) if name in values]
    if not names:
        return columns, detector
    rows, first, kind = np.unique(
        np.column_stack([values[name] for name in names]), axis=0, return_index=True, return_inverse=True
    )
    kinds = tuple(
        _kind(detector, dict(zip(names, row.tolist(), strict=True)), columns.column[at], file, path)
        for row, at in zip(rows, first, strict=True)
    )
    if len(kinds) == 1:
        return columns, kinds[0]
    return replace(columns, kind=kind.ravel().astype(np.intp)), replace(detector, kinds=kinds)


def _kind(
    detector: TdiDetector, values: dict[str, float], column: float, file: TdiFile, path: Path
) -> TdiDetector:
    """What columns of such values are like."""
    noise = replace(detector.noise, **{name: values[name] for name in NOISE if name in values})
    if noise == NoiseLaw(shot=0.0):
        raise FormatError(
            f"{path}: column {column:g} has no noise: every setting would have an infinite SNR; shot = 1 is "
            "that of photons"
        )
    wells = {name: values[name] for name in WELLS if name in values}
    well, highest = wells.get("full_well_line", np.inf), file.signals.electrons[-1]
    if detector.exposure.head_stages and well < highest:
        raise FormatError(
            f"{path}: full_well_line = {well:g} electrons of column {column:g} lies below the highest signal "
            f"of a head line, {highest:g}: it would saturate before anything can be chosen; lower [signals], "
            "shorten the head's integration_ratio, or correct the full well"
        )
    return replace(
        detector,
        noise=noise,
        full_well_line=wells.get("full_well_line", detector.full_well_line),
        full_well_sum=wells.get("full_well_sum", detector.full_well_sum),
    )
