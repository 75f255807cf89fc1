"""A strip's georeferencing as hyperspectral users know it: IGM and GLT, as ENVI files.

IGM: easting, northing, height of every pixel of the image. GLT: sample and line, from 1, of the pixel
that lies nearest to each place of a map; negative where a neighbouring place lends it, 0 where there is none.

Not here: maps of frames (``cube_files.py``).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import GeometryError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Surface
from sightline.io.results.cube_arrays import crs_wkt
from sightline.io.results.cube_files import map_info
from sightline.products.cube_grid import CubeGrid, MapSystem, map_system
from sightline.writing import must_fit, naming_file, whole_text

Array = NDArray[np.float64]

#: Pixels that are located at a time, and rows of the map that are filled at a time.
_PIXELS, _ROWS = 1 << 20, 1024
#: Pixels of the map over which a hole takes its neighbour's pixel.
_REACH = 1.5


def write_lookup(
    folder: Path, stem: str, camera: PushbroomCamera, surface: Surface, radii: tuple[float, float]
) -> dict[str, Any]:
    """IGM and GLT of one band; where they lie, and the size of a pixel of the map.

    Raises
    ------
    GeometryError
        If no pixel sees the ground.
    InputError
        If the disk has no room for the files.
    """
    lines, columns = camera.shape
    must_fit(folder, 24 * lines * columns, "the IGM", "export fewer bands, or shorter strips,")
    middle = camera.locate([[(lines - 1) / 2.0, (columns - 1) / 2.0]], surface)[0]
    if not np.isfinite(middle).all():
        raise GeometryError("the middle of the image sees no ground; there is no map to put it on")
    system = MapSystem(map_system(middle, radii), radii)
    igm = folder / f"{stem}_igm.dat"
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    with naming_file(igm), igm.open("wb") as file:
        for block in _blocks(lines, columns):
            at = np.stack(np.meshgrid(block, np.arange(float(columns)), indexing="ij"), axis=-1)
            ground = camera.locate(at.reshape(-1, 2), surface)
            places = system.places(ground).reshape(len(block), columns, 3)
            file.write(np.ascontiguousarray(places.transpose(0, 2, 1), dtype="<f8").data)  # BIL
            flat = places[..., :2].reshape(-1, 2)
            flat = flat[np.isfinite(flat).all(axis=1)]
            low = np.minimum(low, flat.min(axis=0, initial=np.inf))
            high = np.maximum(high, flat.max(axis=0, initial=-np.inf))
    if not np.isfinite([low, high]).all():
        raise GeometryError("no pixel of the image sees the ground")
    pixels = np.memmap(igm, np.dtype("<f8"), "r", shape=(lines, 3, columns))
    grid = _map(pixels, system, low, high)
    _write_header(folder / f"{stem}_igm.hdr", grid, (lines, columns), ("easting", "northing", "height"), 5)
    rows, width = grid.shape
    must_fit(folder, 12 * rows * width, "the GLT", "export fewer bands, or shorter strips,")
    glt = folder / f"{stem}_glt.dat"
    with naming_file(glt):
        found = np.memmap(glt, np.dtype("<i4"), "w+", shape=(rows, 2, width))
        _fill(found, pixels, grid)
        found.flush()
    _write_header(folder / f"{stem}_glt.hdr", grid, (rows, width), ("sample", "line"), 3, on_map=True)
    files = [f"{stem}_{kind}.{ending}" for kind in ("igm", "glt") for ending in ("dat", "hdr")]
    return {"files": files, "gsd": grid.gsd, "crs": system.crs}


def _blocks(lines: int, columns: int) -> Iterator[Array]:
    """Lines, some at a time."""
    step = max(_PIXELS // columns, 1)
    return (np.arange(float(first), min(first + step, lines)) for first in range(0, lines, step))


def _map(pixels: Array, system: MapSystem, low: Array, high: Array) -> CubeGrid:
    """A map of pixels as large as those of the image, in the middle of it."""
    line, column = pixels.shape[0] // 2, pixels.shape[2] // 2
    here = pixels[max(line - 1, 0) : line + 1, :2, max(column - 1, 0) : column + 1]
    sides = [np.hypot(*(here[-1, :, -1] - here[0, :, -1])), np.hypot(*(here[-1, :, -1] - here[-1, :, 0]))]
    known = [float(side) for side in sides if np.isfinite(side) and side > 0.0]
    gsd = float(f"{max(known):.3g}") if known else 1.0
    west, north = np.floor(low[0] / gsd) * gsd, np.ceil(high[1] / gsd) * gsd
    shape = int((north - low[1]) / gsd) + 1, int((high[0] - west) / gsd) + 1
    return CubeGrid(system, float(west), float(north), gsd, shape)


def _fill(found: Any, pixels: Any, grid: CubeGrid) -> None:
    """Which pixel is nearest to the middle of each place of the map; holes from their neighbours."""
    rows, width = grid.shape
    nearest = np.full((rows, width), np.inf, dtype=np.float32)
    found[:] = 0
    for block in _blocks(pixels.shape[0], pixels.shape[2]):
        part = np.asarray(pixels[int(block[0]) : int(block[-1]) + 1, :2]).transpose(0, 2, 1)
        at = grid.pixels(part.reshape(-1, 2))
        known = np.flatnonzero(np.isfinite(at).all(axis=1))
        cell = np.rint(at[known]).astype(np.int64)
        inside = ((cell >= 0) & (cell < [rows, width])).all(axis=1)
        known, cell = known[inside], cell[inside]
        off = ((at[known] - cell) ** 2).sum(axis=1).astype(np.float32)
        order = np.argsort(-off, kind="stable")  # of two in one place the nearer one is written last
        known, cell, off = known[order], cell[order], off[order]
        better = off < nearest[cell[:, 0], cell[:, 1]]
        known, cell, off = known[better], cell[better], off[better]
        nearest[cell[:, 0], cell[:, 1]] = off
        line, column = np.divmod(known, pixels.shape[2])
        found[cell[:, 0], 0, cell[:, 1]] = column + 1
        found[cell[:, 0], 1, cell[:, 1]] = line + int(block[0]) + 1
    for first in range(0, rows, _ROWS):
        _fill_holes(found, first, min(first + _ROWS, rows), rows)


def _fill_holes(found: Any, first: int, last: int, rows: int) -> None:
    """Places without a pixel of their own get that of the nearest place, with a negative sign."""
    from scipy.ndimage import distance_transform_edt

    margin = int(np.ceil(_REACH))
    begin, end = max(first - margin, 0), min(last + margin, rows)
    part = np.asarray(found[begin:end])
    empty = part[:, 0] <= 0
    if not empty.any() or empty.all():
        return
    away, (row, column) = distance_transform_edt(empty, return_indices=True)
    holes = empty & (away <= _REACH)
    holes[: first - begin] = holes[last - begin :] = False
    where = np.nonzero(holes)
    filled = -part[row[where], :, column[where]]
    found[where[0] + begin, :, where[1]] = filled


def _write_header(
    path: Path,
    grid: CubeGrid,
    shape: tuple[int, int],
    names: tuple[str, ...],
    kind: int,
    *,
    on_map: bool = False,
) -> None:
    """ENVI header of a file whose bands alternate from line to line (BIL)."""
    lines = [
        "ENVI", f"description = {{Sightline: {', '.join(names)}}}", f"samples = {shape[1]}",
        f"lines = {shape[0]}", f"bands = {len(names)}", "header offset = 0", "file type = ENVI Standard",
        f"data type = {kind}", "interleave = bil", "byte order = 0", f"band names = {{{', '.join(names)}}}",
    ]  # fmt: skip
    if on_map:
        lines.append(f"map info = {{{map_info(grid)}}}")
        lines.append("data ignore value = 0")
    lines.append(f"coordinate system string = {{{crs_wkt(grid)}}}")
    whole_text(path, "\n".join(lines) + "\n")
