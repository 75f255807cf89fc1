"""Shifts between rasters → ``matches.csv``, ``shifts.tif``, ``rows.csv``, ``columns.csv``, ``summary.json``.

They are described in ``docs/formats/match.md``.

Not here: where the shifts come from (``applications/raster_matches.py``),
the page (``report/match_page.py``).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.applications.raster_matches import BandMatches, MatchProfile, RasterMatches
from sightline.errors import FormatError
from sightline.imaging.placed import PlacedImage
from sightline.io.acquisition.acquired import sha256
from sightline.io.formats.tables import read_columns, write_columns
from sightline.io.results.line_of_sight import peak_memory, write_json
from sightline.matching.matches import KEPT, NOT_CHOSEN, Matches
from sightline.version import VERSION
from sightline.writing import whole_raster

Array = NDArray[np.float64]

#: Columns of ``matches.csv``, and bands of ``shifts.tif``.
COLUMNS = ("line", "column", "d_line", "d_column", "sigma_line", "sigma_column", "correlation", "score")
BANDS = COLUMNS[2:7]
PAIR_COLUMNS = (
    "first", "second", "d_line", "d_column", "rms_line", "rms_column", "sigma_line", "sigma_column", "tried",
    "kept",
)  # fmt: skip
#: Every file of one pair, and of the bands of a file.
MATCH_FILES = ("matches.csv", "rows.csv", "columns.csv", "shifts.tif", "summary.json", "report.html")
BAND_FILES = (
    "pairs.csv", "matches_*.csv", "rows_*.csv", "columns_*.csv", "shifts_*.tif", "summary.json",
    "report.html",
)  # fmt: skip


def match_columns(result: RasterMatches) -> dict[str, Array]:
    """``matches.csv``: a row per window that was kept."""
    kept = result.matches.kept
    at, shift, sigma = result.matches.a[kept], result.shift_px[kept], result.sigma_px[kept]
    values = (*at.T, *shift.T, *sigma.T, result.correlation[kept], result.matches.score[kept])
    return dict(zip(COLUMNS, values, strict=True))


def profile_columns(profile: MatchProfile, name: str) -> dict[str, Any]:
    """``rows.csv`` or ``columns.csv``; rows without a window are left out."""
    there = profile.windows > 0
    return {
        name: profile.place[there],
        "d_line": profile.shift_px[there, 0],
        "d_column": profile.shift_px[there, 1],
        "sigma_line": profile.sigma_px[there, 0],
        "sigma_column": profile.sigma_px[there, 1],
        "windows": profile.windows[there],
    }


def write_match_tables(folder: Path, result: RasterMatches, image: Any, suffix: str = "") -> None:
    """Tables and raster of one pair; `image` is a as given, whose place on the map the raster takes."""
    write_columns(folder / f"matches{suffix}.csv", match_columns(result))
    write_columns(folder / f"rows{suffix}.csv", profile_columns(result.row_means, "line"))
    write_columns(folder / f"columns{suffix}.csv", profile_columns(result.column_means, "column"))
    write_shifts(folder / f"shifts{suffix}.tif", result, image)


def write_shifts(path: Path, result: RasterMatches, image: Any) -> None:
    """The shifts as a raster of a pixel per window."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning
    from rasterio.transform import Affine

    values = np.concatenate([result.shift_px, result.sigma_px, result.correlation[:, None]], axis=1).reshape(
        *result.shape, 5
    )
    profile: dict[str, Any] = {
        "driver": "GTiff", "height": result.shape[0], "width": result.shape[1], "count": 5,
        "dtype": "float32", "nodata": float("nan"), "compress": "deflate", "predictor": 3,
    }  # fmt: skip
    # the middle of a raster pixel is the centre of its window
    (line, column), (down, across) = result.first, result.step
    corner = line + 0.5 - 0.5 * down, column + 0.5 - 0.5 * across
    if isinstance(image, PlacedImage):
        a, b, c, d, e, f = image.transform
        x, y = (p * corner[1] + q * corner[0] + r for p, q, r in ((a, b, c), (d, e, f)))
        profile["transform"] = Affine(a * across, b * down, x, d * across, e * down, y)
        if image.crs is not None:
            profile["crs"] = image.crs
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with whole_raster(path) as draft, rasterio.open(draft, "w", **profile) as target:
            target.update_tags(
                window_line=f"{line:g} + {down} row", window_column=f"{column:g} + {across} column"
            )
            for number, name in enumerate(BANDS, 1):
                target.set_band_description(number, name)
                target.set_band_unit(number, "px" if number < 5 else "1")
                target.write(values[..., number - 1].astype(np.float32), number)


def shift_figures(result: RasterMatches) -> dict[str, Any]:
    """What the shifts are on the whole, for a summary."""
    shift, sigma = result.shift_px[result.matches.kept], result.sigma_px[result.matches.kept]
    counts = result.matches.counts()
    kept = counts.pop("kept")
    outside = counts.pop("outside")
    middle = np.median(shift, axis=0)
    return {
        "median_px": middle.tolist(),
        "mean_px": shift.mean(axis=0).tolist(),
        "rms_px": np.sqrt((shift**2).mean(axis=0)).tolist(),
        "scatter_px": shift.std(axis=0).tolist(),
        "sigma_px": np.median(sigma, axis=0).tolist(),
        "windows": {
            "tried": len(result.matches) - outside,
            "kept": kept,
            "rejected": {name: count for name, count in counts.items() if count},
        },
    }


def _grid(result: RasterMatches) -> dict[str, Any]:
    """How windows lie."""
    return {
        "geometry": result.geometry,
        "window": list(result.window),
        "step": list(result.step),
        "first": list(result.first),
        "grid": list(result.shape),
        "reduced": result.reduced,
    }


def summarize_matches(
    result: RasterMatches, inputs: Sequence[Path], *, wall_seconds: float | None
) -> dict[str, Any]:
    """The content of ``summary.json`` of one pair."""
    return {
        "name": " - ".join(result.names),
        "result": "RasterMatches",
        "version": VERSION,
        "images": list(result.names),
        **_grid(result),
        "common_px": result.common_px.tolist(),
        "common_strength": result.common_strength,
        **shift_figures(result),
        "warnings": list(result.warnings),
        "wall_seconds": wall_seconds,
        "peak_memory_bytes": peak_memory(),
        "inputs": {str(path.name): sha256(path) for path in inputs},
    }


def pair_suffix(pair: tuple[int, int]) -> str:
    """End of the names of a pair's files, bands counted from 1."""
    return f"_{pair[0] + 1}_{pair[1] + 1}"


def pair_columns(result: BandMatches) -> dict[str, Any]:
    """``pairs.csv``."""
    figures = [shift_figures(one) for one in result.matches]
    names = [[result.bands[k] for k in pair] for pair in result.pairs]
    columns: dict[str, Any] = {"first": [a for a, _ in names], "second": [b for _, b in names]}
    for key, name in (("median_px", "d"), ("rms_px", "rms"), ("sigma_px", "sigma")):
        both = np.array([one[key] for one in figures]).reshape(-1, 2)
        columns |= {f"{name}_line": both[:, 0], f"{name}_column": both[:, 1]}
    return columns | {key: [one["windows"][key] for one in figures] for key in ("tried", "kept")}


def summarize_bands(
    result: BandMatches, inputs: Sequence[Path], *, wall_seconds: float | None
) -> dict[str, Any]:
    """The content of ``summary.json`` of the bands of a file."""
    return {
        "name": ", ".join(path.name for path in inputs) or "bands",
        "result": "BandMatches",
        "version": VERSION,
        "bands": list(result.bands),
        "pairs": [
            {
                "images": [result.bands[k] for k in pair],
                "suffix": pair_suffix(pair),
                **_grid(one),
                "common_px": one.common_px.tolist(),
                "common_strength": one.common_strength,
                **shift_figures(one),
            }
            for pair, one in zip(result.pairs, result.matches, strict=True)
        ],
        "warnings": list(result.warnings),
        "wall_seconds": wall_seconds,
        "peak_memory_bytes": peak_memory(),
        "inputs": {str(path.name): sha256(path) for path in inputs},
    }


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """``summary.json``."""
    write_json(folder / "summary.json", summary)


def read_raster_matches(path: Path, summary: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes of a `RasterMatches` from its table and the part of a summary that belongs to it.

    Raises
    ------
    FormatError
        If a row is of no window of the grid that the summary says.
    """
    table = {name: np.asarray(values) for name, values in read_columns(path, COLUMNS).items()}
    shape, first, step = (tuple(summary[key]) for key in ("grid", "first", "step"))
    at = np.stack([table["line"], table["column"]], axis=1)
    place = np.rint((at - first) / step).astype(int)
    if ((place < 0) | (place >= np.array(shape))).any():
        raise FormatError(f"{path}: holds windows beyond the grid of summary.json; run the command again")
    count = int(shape[0]) * int(shape[1])
    row = place[:, 0] * int(shape[1]) + place[:, 1]
    lines, columns = np.divmod(np.arange(count), int(shape[1]))
    a = np.array(first) + np.stack([lines, columns], axis=1) * np.array(step)
    b, score = np.full((count, 2), np.nan), np.full(count, np.nan)
    status, covariance = np.full(count, NOT_CHOSEN), np.full((count, 2, 2), np.nan)
    b[row] = a[row] + np.stack([table["d_line"], table["d_column"]], axis=1)
    sigma = np.stack([table["sigma_line"], table["sigma_column"]], axis=1)
    covariance[row] = sigma[:, :, None] * sigma[:, None, :]
    covariance[row, 0, 1] *= table["correlation"]
    covariance[row, 1, 0] *= table["correlation"]
    score[row], status[row] = table["score"], KEPT
    strength = summary["common_strength"]
    return {
        "matches": Matches(a, b, covariance, score, status),
        "shape": (int(shape[0]), int(shape[1])),
        "first": first,
        "step": step,
        "window": tuple(summary["window"]),
        "geometry": str(summary["geometry"]),
        "reduced": int(summary["reduced"]),
        "common_px": np.array(summary["common_px"], dtype=np.float64),
        "common_strength": np.nan if strength is None else float(strength),
        "names": tuple(summary["images"]),
        "overlay": None,
    }
