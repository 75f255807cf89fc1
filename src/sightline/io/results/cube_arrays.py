"""A cube as Zarr and NetCDF, by the CF conventions: coordinates, wavelengths, coordinate system.

Not here: where the pixels come from, other files (``cube_files.py``).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.execution import thread_count
from sightline.products.cube_bands import BandLayout
from sightline.products.cube_grid import CubeGrid
from sightline.version import VERSION
from sightline.writing import naming_file, whole

#: Where a block of pixels (bands, rows, columns) lies, and these.
Blocks = Iterator[tuple[tuple[slice, slice], NDArray[np.float32]]]

#: Dimensions of the cube.
CUBE_DIMENSIONS = ("band", "y", "x")
#: Name of the variable that holds the coordinate system; the one that rioxarray looks for.
GRID_MAPPING = "spatial_ref"
#: Side of a chunk, px, and bands in one: a spectrum and a map both cost few chunks.
CHUNK, CHUNK_BANDS = 256, 16
#: Compression of NetCDF: higher levels take twice as long for a few per cent.
_DEFLATE = 1


def crs_wkt(grid: CubeGrid) -> str:
    """WKT of the map's coordinate system; "" for local metres."""
    if grid.system.crs is None:
        return ""
    from pyproj import CRS

    return CRS.from_user_input(grid.system.crs).to_wkt(version="WKT1_GDAL")


def cube_chunks(grid: CubeGrid, layout: BandLayout) -> tuple[int, int, int]:
    """Chunks of the cube: bands, rows, columns."""
    return min(CHUNK_BANDS, len(layout)), min(CHUNK, grid.shape[0]), min(CHUNK, grid.shape[1])


def cube_attributes(grid: CubeGrid) -> dict[str, Any]:
    """Attributes of the cube itself."""
    wanted = {"long_name": "pixel values of the frames, resampled", "units": "1", "coordinates": "wavelength"}
    return wanted | ({"grid_mapping": GRID_MAPPING} if grid.system.crs is not None else {})


def coordinates(
    grid: CubeGrid, layout: BandLayout
) -> dict[str, tuple[tuple[str, ...], NDArray[Any], dict[str, Any]]]:
    """Dimensions, values and attributes of all variables but the cube."""
    north = grid.centres(np.arange(float(grid.shape[0])), np.zeros(1))[:, 1]
    east = grid.centres(np.zeros(1), np.arange(float(grid.shape[1])))[:, 0]
    out: dict[str, tuple[tuple[str, ...], NDArray[Any], dict[str, Any]]] = {
        "wavelength": (
            ("band",),
            np.asarray(layout.wavelength_nm, dtype=np.float64),
            {"standard_name": "radiation_wavelength", "long_name": "middle of the band", "units": "nm"},
        )
    }
    for name, values, along in (("y", north, "northing"), ("x", east, "easting")):
        more = {"long_name": f"{along} of the middle of a pixel", "units": "m", "axis": name.upper()}
        if grid.system.crs is not None:
            more["standard_name"] = f"projection_{name}_coordinate"
        out[name] = ((name,), values, more)
    wkt = crs_wkt(grid)
    if wkt:
        from pyproj import CRS

        transform = " ".join(repr(float(number)) for number in _as_gdal(grid))
        named = CRS.from_user_input(grid.system.crs).to_cf()
        system = named | {"crs_wkt": wkt, "spatial_ref": wkt, "GeoTransform": transform}
        out[GRID_MAPPING] = ((), np.array(0, dtype=np.int32), system)
    return out


def global_attributes(grid: CubeGrid, layout: BandLayout) -> dict[str, Any]:
    """Attributes of the whole file."""
    named = {"coordinates": GRID_MAPPING} if grid.system.crs is not None else {}
    return {
        "Conventions": "CF-1.11",
        "title": "cube of a frame sequence",
        "source": f"Sightline {VERSION}",
        "band_names": list(layout.names),
        **named,
    }


def _as_gdal(grid: CubeGrid) -> tuple[float, ...]:
    """The six numbers in the order of a GeoTransform."""
    a, b, c, d, e, f = grid.transform
    return c, a, b, f, d, e


def zarr_library() -> Any:
    """The module, or what to install."""
    try:
        import zarr
    except ImportError:
        raise InputError("Zarr files need zarr, which is not installed; run `pip install zarr`") from None
    return zarr


def netcdf_library() -> Any:
    """The module, or what to install."""
    try:
        import netCDF4
    except ImportError:
        raise InputError(
            "NetCDF files need netCDF4, which is not installed; run `pip install netCDF4`"
        ) from None
    return netCDF4


def write_zarr(path: Path, grid: CubeGrid, layout: BandLayout, blocks: Blocks) -> None:
    """A Zarr 3 group with consolidated metadata; `blocks` come in the order of `cube_chunks`."""
    zarr = zarr_library()
    with zarr.config.set({"threading.max_workers": thread_count()}), naming_file(path):
        group = zarr.create_group(store=path, overwrite=True)
        cube = group.create_array(
            "cube", shape=(len(layout), *grid.shape), chunks=cube_chunks(grid, layout), dtype="float32",
            fill_value=np.nan, dimension_names=CUBE_DIMENSIONS, attributes=cube_attributes(grid),
        )  # fmt: skip
        for (bands, rows), pixels in blocks:
            cube[bands, rows, :] = pixels
        for name, (along, values, attributes) in coordinates(grid, layout).items():
            array = group.create_array(
                name, shape=values.shape, dtype=values.dtype, dimension_names=along, attributes=attributes
            )
            array[...] = values
        group.attrs.update(global_attributes(grid, layout) | {"transform": list(grid.transform)})
        if grid.system.crs is not None:
            group.attrs["crs_wkt"] = crs_wkt(grid)
        with warnings.catch_warnings():
            # consolidated metadata are no part of the format's text yet; readers without them pass them over
            warnings.simplefilter("ignore", zarr.errors.ZarrUserWarning)
            zarr.consolidate_metadata(path)


def write_netcdf(path: Path, grid: CubeGrid, layout: BandLayout, blocks: Blocks) -> None:
    """A NetCDF-4 file, deflated, chunked as the Zarr."""
    library = netcdf_library()
    with whole(path) as draft, library.Dataset(draft, "w", format="NETCDF4") as file:
        for name, size in zip(CUBE_DIMENSIONS, (len(layout), *grid.shape), strict=True):
            file.createDimension(name, size)
        cube = file.createVariable(
            "cube", "f4", CUBE_DIMENSIONS, compression="zlib", complevel=_DEFLATE, shuffle=True,
            chunksizes=cube_chunks(grid, layout), fill_value=np.float32(np.nan),
        )  # fmt: skip
        cube.setncatts(cube_attributes(grid))
        for (bands, rows), pixels in blocks:
            cube[bands, rows, :] = pixels
        for name, (along, values, attributes) in coordinates(grid, layout).items():
            variable = file.createVariable(name, values.dtype, along)
            variable.setncatts(attributes)
            variable[...] = values
        wanted = global_attributes(grid, layout)
        file.setncatts(wanted | {"band_names": ", ".join(layout.names)})
