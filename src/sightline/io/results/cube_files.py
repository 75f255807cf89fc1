"""A cube of bands on a map → GeoTIFFs (COG), Zarr, NetCDF, ENVI; written tile by tile.

Pixels are float32, NaN where there is no value. While the cube is made it lies in one plain file, band after
band, from which everything else is written; that file with a header is the ENVI form.

Not here: the pixels (``products/frame_cube.py``), Zarr and NetCDF (``cube_arrays.py``), the summary
(``cube_summary.py``).
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.execution import silent
from sightline.io.names import file_stem
from sightline.io.results.cube_arrays import (
    CHUNK,
    Blocks,
    crs_wkt,
    cube_chunks,
    netcdf_library,
    write_netcdf,
    write_zarr,
    zarr_library,
)
from sightline.io.results.registered import TILE, optimise
from sightline.products.cube_bands import BandLayout
from sightline.products.cube_grid import CubeGrid
from sightline.writing import must_fit, naming_file, whole_raster, whole_text

Pixels = NDArray[np.float32]

FORMATS = ("tif", "zarr", "netcdf", "envi")
#: Name of the NetCDF file.
NETCDF = "cube.nc"
#: Name of the Zarr store, and what a file in it is called: of the store itself, of an array, of a chunk.
ZARR = "cube.zarr"
_ZARR_FILE = re.compile(r"cube\.zarr/(zarr\.json|(cube|wavelength|x|y|spatial_ref)/(zarr\.json|c(/\d+)*))")
_BYTES = 4


@dataclass(frozen=True)
class RawBand:
    """A band of the plain file, read in windows.

    Attributes
    ----------
    path : Path
    band : int
    shape : (rows, columns)
    """

    path: Path
    band: int
    shape: tuple[int, int]

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> Pixels:
        """Pixels of lines [first, last) and columns [first, last), float32, C order."""
        rows, width = self.shape
        start = (self.band * rows + lines[0]) * width
        whole = np.fromfile(
            self.path, np.dtype("<f4"), (lines[1] - lines[0]) * width, offset=start * _BYTES
        ).reshape(-1, width)
        return np.ascontiguousarray(whole[:, slice(*columns)], dtype=np.float32)

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.bool_] | None:
        """True where there is no value; None if there is one everywhere."""
        gaps = ~np.isfinite(self.read(lines, columns))
        return gaps if gaps.any() else None


def check_formats(formats: Sequence[str]) -> None:
    """InputError if a format is unknown, or needs the extra ``cube``, which is not installed."""
    wrong = [name for name in formats if name not in FORMATS]
    if wrong or not formats:
        raise InputError(f"`formats` must be among {', '.join(FORMATS)}, got {list(formats)}")
    if "zarr" in formats:
        zarr_library()
    if "netcdf" in formats:
        netcdf_library()


class CubeFolder:
    """Files of a cube, in one folder: takes the pixels, then writes what is wanted of them.

    Parameters
    ----------
    folder : Path
        Exists.
    formats : sequence of str
        Of `FORMATS`.
    one_file : bool
        One GeoTIFF of all bands, ``cube.tif``, in place of ``bands/NAME.tif`` for each.

    Raises
    ------
    InputError
        If a format is unknown, or needs the extra ``cube``, which is not installed.
    """

    def __init__(self, folder: Path, formats: Sequence[str] = ("tif",), *, one_file: bool = False) -> None:
        """Check that everything asked for can be written, before work starts."""
        check_formats(formats)
        self.folder, self.formats, self.one_file = Path(folder), tuple(formats), one_file
        self.draft = self.folder / ".cube.draft.dat"

    def begin(self, grid: CubeGrid, layout: BandLayout) -> None:
        """Make room for all bands on the disk."""
        self.grid, self.layout = grid, layout
        size = len(layout) * grid.shape[0] * grid.shape[1] * _BYTES
        must_fit(self.folder, size, "the cube", "ask for fewer bands or a larger gsd,")
        with naming_file(self.draft), self.draft.open("wb") as file:
            file.truncate(size)

    def write(self, row: int, column: int, values: Pixels) -> None:
        """Pixels (B, rows, columns) of a tile that begins at (row, column)."""
        rows, width = self.grid.shape
        data = np.ascontiguousarray(values, dtype="<f4")
        # buffered: a bare write takes a part of the bytes where a disk runs full, and only returns how many
        with naming_file(self.draft), self.draft.open("r+b") as file:
            for band in range(len(data)):
                for line in range(data.shape[1]):
                    file.seek(((band * rows + row + line) * width + column) * _BYTES)
                    file.write(data[band, line].data)

    def source(self, band: int) -> RawBand:
        """A band as it was written."""
        return RawBand(self.draft, band, self.grid.shape)

    def finish(self, tell: Callable[[str, int, int], None] | None = None) -> tuple[str, ...]:
        """Write all formats; names of the files, below the folder. Nothing else is left.

        `tell` is called with what is written, how many files of it are, and how many will be.
        """
        tell = silent if tell is None else tell
        written: list[str] = []
        if "tif" in self.formats:
            written += self._write_tiffs(tell)
        if "zarr" in self.formats:
            tell("writing Zarr", 0, 1)
            write_zarr(self.folder / ZARR, self.grid, self.layout, self._pixels())
            written.append(ZARR)
        if "netcdf" in self.formats:
            tell("writing NetCDF", 0, 1)
            write_netcdf(self.folder / NETCDF, self.grid, self.layout, self._pixels())
            written.append(NETCDF)
        if "envi" in self.formats:
            tell("writing ENVI", 0, 1)
            written += self._write_envi()
        self.discard()
        return tuple(written)

    def discard(self) -> None:
        """Remove the plain file."""
        self.draft.unlink(missing_ok=True)

    def _blocks(self, height: int) -> Iterable[tuple[int, int]]:
        rows = self.grid.shape[0]
        return ((first, min(first + height, rows)) for first in range(0, rows, height))

    def _write_tiffs(self, tell: Callable[[str, int, int], None]) -> list[str]:
        names = band_files(self.layout)
        tell("writing GeoTIFFs", 0, len(names))
        if self.one_file:
            self._write_tiff(self.folder / "cube.tif", range(len(names)))
            return ["cube.tif"]
        (self.folder / "bands").mkdir(exist_ok=True)
        for band, name in enumerate(names):
            self._write_tiff(self.folder / "bands" / f"{name}.tif", [band])
            tell("writing GeoTIFFs", band + 1, len(names))
        return [f"bands/{name}.tif" for name in names]

    def _write_tiff(self, path: Path, bands: Sequence[int]) -> None:
        import rasterio
        from rasterio.errors import NotGeoreferencedWarning
        from rasterio.transform import Affine
        from rasterio.windows import Window

        grid, draft = self.grid, path.with_name(f".{path.name}.draft.tif")
        profile: dict[str, Any] = {
            "driver": "GTiff", "height": grid.shape[0], "width": grid.shape[1], "count": len(bands),
            "dtype": "float32", "nodata": float("nan"), "tiled": True, "blockxsize": TILE, "blockysize": TILE,
            "BIGTIFF": "IF_SAFER", "transform": Affine(*grid.transform),
        }  # fmt: skip
        if grid.system.crs is not None:
            profile["crs"] = grid.system.crs
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", NotGeoreferencedWarning)
                with whole_raster(draft) as made, rasterio.open(made, "w", **profile) as target:
                    for number, band in enumerate(bands, start=1):
                        target.set_band_description(number, self.layout.names[band])
                        nm = self.layout.wavelength_nm[band]
                        if np.isfinite(nm):
                            target.update_tags(number, wavelength_nm=f"{nm:.6g}")
                        source = self.source(band)
                        for first, last in self._blocks(TILE):
                            pixels = source.read((first, last), (0, grid.shape[1]))
                            window = Window(0, first, grid.shape[1], last - first)
                            target.write(pixels, number, window=window)
                optimise(draft, path, np.dtype(np.float32))
        finally:
            draft.unlink(missing_ok=True)

    def _pixels(self) -> Blocks:
        """All pixels, chunk of rows by chunk of rows, and of bands."""
        height, step = CHUNK, cube_chunks(self.grid, self.layout)[0]
        sources = [self.source(band) for band in range(len(self.layout))]
        for first, last in self._blocks(height):
            for k in range(0, len(sources), step):
                some = [
                    source.read((first, last), (0, self.grid.shape[1])) for source in sources[k : k + step]
                ]
                yield (slice(k, k + len(some)), slice(first, last)), np.stack(some)

    def _write_envi(self) -> list[str]:
        self.draft.replace(self.folder / "cube.dat")
        whole_text(self.folder / "cube.hdr", envi_header(self.grid, self.layout))
        return ["cube.dat", "cube.hdr"]


def band_files(layout: BandLayout) -> list[str]:
    """Name of the file of each band, without its ending: wavelengths in ascending order sort as text too."""
    digits = len(str(max(len(layout) - 1, 1)))
    out = []
    for number, (name, nm) in enumerate(zip(layout.names, layout.wavelength_nm, strict=True)):
        text = f"{nm:.1f}nm" if np.isfinite(nm) else name.replace(" ", "-")
        out.append(f"{number:0{digits}d}-{file_stem(text)}")
    return out


def is_map_file(name: str) -> bool:
    """Whether a name, from the folder of the result on, is one that files of maps have."""
    return re.fullmatch(r"bands/[^/]+\.tif|cube\.(tif|nc|dat|hdr)", name) is not None


def is_zarr_file(name: str) -> bool:
    """Whether a file, named from the folder of the result on, is part of its Zarr store."""
    return _ZARR_FILE.fullmatch(name) is not None


def envi_header(grid: CubeGrid, layout: BandLayout) -> str:
    """Header of the plain file: size, type, place on the map, wavelengths."""
    rows, columns = grid.shape
    lines = [
        "ENVI", "description = {Sightline: cube of a frame sequence}", f"samples = {columns}",
        f"lines = {rows}", f"bands = {len(layout)}", "header offset = 0", "file type = ENVI Standard",
        "data type = 4", "interleave = bsq", "byte order = 0", "data ignore value = nan",
        f"map info = {{{map_info(grid)}}}",
    ]  # fmt: skip
    wkt = crs_wkt(grid)
    if wkt:
        lines.append(f"coordinate system string = {{{wkt}}}")
    if np.isfinite(layout.wavelength_nm).all():
        lines.append("wavelength units = Nanometers")
        lines.append(f"wavelength = {{{', '.join(f'{nm:.6g}' for nm in layout.wavelength_nm)}}}")
    lines.append(f"band names = {{{', '.join(layout.names)}}}")
    return "\n".join(lines) + "\n"


def map_info(grid: CubeGrid) -> str:
    """Where a map lies, as ENVI writes it."""
    west, north, gsd = grid.west, grid.north, grid.gsd
    place = f"1, 1, {west!r}, {north!r}, {gsd!r}, {gsd!r}"
    return f"{_map_name(grid)}, {place}{_map_end(grid)}, units=Meters"


def _map_name(grid: CubeGrid) -> str:
    """Projection as ENVI calls it."""
    system = grid.system.crs or ""
    if system.startswith(("EPSG:326", "EPSG:327")):
        return "UTM"
    return "Projected" if system else "Arbitrary"


def _map_end(grid: CubeGrid) -> str:
    """Zone, hemisphere and datum of a UTM map; the datum of others is in the system's WKT."""
    system = grid.system.crs or ""
    if _map_name(grid) != "UTM":
        return ""
    return f", {int(system[-2:])}, {'North' if system.startswith('EPSG:326') else 'South'}, WGS-84"
