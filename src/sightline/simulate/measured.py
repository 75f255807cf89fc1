"""Readers of the real curves, grounds and reliefs that simulated scenes may be made of.

Data sets are looked for in the folder that is given, as an argument or by the environment variable
``SIGHTLINE_DATA``, and nowhere else; each function names the set it reads. Only what is asked for by name
reads them: no default depends on whether they are there. What is made of them is in ``scenarios.py``.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from sightline.access import read_json, read_text
from sightline.errors import FormatError, foreign_errors, reads
from sightline.imaging.rasters import open_raster, raster_errors
from sightline.simulate.scene import Relief
from sightline.simulate.texture import Array

# The kernel's reference axes are defined in a frame kernel that is not among the data. Only changes of
# attitude over seconds are wanted, so that any fixed axes serve: those of J2000 are put in their place.
_MRO_REFERENCE = [
    "FRAME_MRO_MME_OF_DATE = -74900",
    "FRAME_-74900_NAME = 'MRO_MME_OF_DATE'",
    "FRAME_-74900_CLASS = 4",
    "FRAME_-74900_CLASS_ID = -74900",
    "FRAME_-74900_CENTER = -74",
    "TKFRAME_-74900_RELATIVE = 'J2000'",
    "TKFRAME_-74900_SPEC = 'MATRIX'",
    "TKFRAME_-74900_MATRIX = ( 1, 0, 0, 0, 1, 0, 0, 0, 1 )",
]


def data_folder() -> Path | None:
    """Folder of the real data sets that ``SIGHTLINE_DATA`` gives; None: none is given."""
    named = os.environ.get("SIGHTLINE_DATA")
    return Path(named) if named else None


def data_file(name: str, folder: Path | None = None) -> Path:
    """Path of one file of the real data sets in `folder`, else in :func:`data_folder`.

    Raises FormatError, saying where it was looked for, if it is not there.
    """
    folder = folder or data_folder()
    if folder is None or not (folder / name).is_file():
        where = f"{name}, and no folder of real data is given" if folder is None else folder / name
        raise FormatError(
            f"real data not found: {where}; set SIGHTLINE_DATA to the folder that holds "
            f"{Path(name).parts[0]}, or choose what is made without real data (as the defaults are)"
        )
    return folder / name


def hirise_curve(folder: Path | None = None) -> tuple[Array, Array]:
    """The jitter of MRO recovered from HiRISE image PSP_008469_2040.

    Returns
    -------
    t : (2048,) s from the first row, about 3.574 ms apart
    curves : (2048, 3) HiRISE pixels: roll (its sample column), pitch (its line column) and, as nothing was
        measured about yaw, the line column played backwards
    """
    path = data_file("hirise_jitter_psp008469/mroJitter.txt", folder)
    with foreign_errors(path, "cannot be read", "three columns of numbers (sample, line, time) are expected"):
        table = np.loadtxt(read_text(path, "a table of jitter").splitlines(), comments="#")
    if table.ndim != 2 or table.shape[1] != 3:
        raise FormatError(f"{path}: expected three columns (sample, line, time), got shape {table.shape}")
    curves = np.column_stack([table[:, 0], table[:, 1], table[::-1, 1]])
    return table[:, 2] - table[0, 2], curves


@reads("an ISD with `instrument_pointing` times and quaternions")
def isd_attitude_curve(path: Path, degree: int = 3) -> tuple[Array, Array]:
    """What the attitudes of a USGS line-scan ISD have beyond a polynomial: real small motions.

    Parameters
    ----------
    path : Path
        ISD in JSON with ``instrument_pointing`` (ALE's spelling).
    degree : int
        Of the polynomial removed from each axis.

    Returns
    -------
    t : (N,) s from the first quaternion
    angles : (N, 3) rad about the instrument's axes, relative to the middle attitude, polynomial removed
    """
    from scipy.spatial.transform import Rotation

    pointing = read_json(path, "an ISD")["instrument_pointing"]
    t = np.asarray(pointing["ephemeris_times"], dtype=np.float64)
    quat_wxyz = np.asarray(pointing["quaternions"], dtype=np.float64)
    # ALE writes scalar first, from inertial to instrument axes
    instrument_from_inertial = Rotation.from_quat(np.roll(quat_wxyz, -1, axis=1))
    middle = instrument_from_inertial[t.size // 2]
    angles = (middle * instrument_from_inertial.inv()).as_rotvec()
    t = t - t[0]
    return t, without_polynomial(t, angles, degree)


def mro_ck_curve(folder: Path | None = None, degree: int = 5, step: float = 2e-3) -> tuple[Array, Array]:
    """The attitude of MRO during the same image, from its C kernel: needs the extra ``spice``.

    Returns
    -------
    t : (N,) s, `step` apart
    angles : (N, 3) rad about the spacecraft's axes, polynomial of `degree` removed
    """
    try:
        import spiceypy
    except ImportError as error:
        raise FormatError(
            "reading a C kernel needs spiceypy, which is not installed; run `pip install spiceypy`"
        ) from error
    from scipy.spatial.transform import Rotation

    kernels = [
        str(data_file(f"hirise_jitter_psp008469/{name}", folder))
        for name in ("mroLSK.tls", "mroSCLK.tsc", "mroCK.bc")
    ]
    spiceypy.furnsh(kernels)
    spiceypy.lmpool(_MRO_REFERENCE)
    try:
        window = spiceypy.ckcov(kernels[2], -74000, False, "INTERVAL", 0.0, "SCLK")
        first, last = spiceypy.wnfetd(window, 0)
        # MRO's clock ticks 256 times a second
        ticks = np.arange(first, last, step * 256.0)
        matrices, times = [], []
        for tick in ticks:
            matrix, clock = spiceypy.ckgp(-74000, float(tick), 64.0, "J2000")[:2]
            matrices.append(matrix)
            times.append(spiceypy.sct2e(-74, clock))
    finally:
        for kernel in kernels:
            spiceypy.unload(kernel)
        for line in _MRO_REFERENCE:
            spiceypy.dvpool(line.split("=")[0].strip())
    body_from_inertial = Rotation.from_matrix(np.asarray(matrices))
    t, keep = np.unique(np.asarray(times), return_index=True)
    angles = (body_from_inertial[len(keep) // 2] * body_from_inertial.inv()).as_rotvec()[keep]
    t = t - t[0]
    return t, without_polynomial(t, angles, degree)


def without_polynomial(t: Array, angles: Array, degree: int) -> Array:
    """`angles` (N, 3) less the least-squares polynomial of `degree` in `t`, each axis alone."""
    scaled = 2.0 * (t - t[0]) / (t[-1] - t[0]) - 1.0
    basis = np.polynomial.legendre.legvander(scaled, degree)
    return np.asarray(angles - basis @ np.linalg.lstsq(basis, angles, rcond=None)[0], dtype=np.float64)


def landsat_bands(folder: Path | None = None) -> NDArray[np.uint8]:
    """Four registered Landsat 7 bands of Everest: (4, 800, 655) uint8, B4, red, green, blue.

    Turned so that the longer side runs along the lines' direction (rows).
    """
    names = ("LE71400412000304SGS00_B4.tif", "LE71400412000304SGS00_RGB.tif")
    layers = []
    for name in names:
        path = data_file(f"landsat7_everest/{name}", folder)
        with raster_errors(path), open_raster(path) as source:
            layers.append(source.read())
    bands = np.concatenate(layers).transpose(0, 2, 1)
    return cast(NDArray[np.uint8], np.ascontiguousarray(bands))


def srtm_relief(centre: tuple[float, float], size: tuple[float, float], folder: Path | None = None) -> Relief:
    """Real relief of Mont Ventoux (SRTM 3", tile N44E005) on local axes.

    Parameters
    ----------
    centre : (float, float)
        m, the local x and y where the middle of the cut lies.
    size : (float, float)
        m along x and y; the cut is around 44.18 N 5.28 E, the summit of the mountain.

    Returns
    -------
    Relief
        Heights less their mean over the cut, m; posts three arc seconds apart, as in the tile.
    """
    path = data_file("srtm_n44e005/N44E005.hgt", folder)
    with raster_errors(path), open_raster(path) as source:
        tile = source.read(1).astype(np.float64)
        row, column = (int(v) for v in source.index(5.28, 44.18))
    tile[tile <= -32768.0] = np.nan
    dy = np.pi / 180.0 / 1200.0 * 6371000.0
    dx = dy * float(np.cos(np.radians(44.18)))
    rows, columns = int(np.ceil(size[1] / dy)) + 3, int(np.ceil(size[0] / dx)) + 3
    top, left = row - rows // 2, column - columns // 2
    if min(top, left) < 0 or top + rows > tile.shape[0] or left + columns > tile.shape[1]:
        raise FormatError(
            f"the relief tile is too small: {size[0] / 1e3:.1f} x {size[1] / 1e3:.1f} km were asked for; "
            "it gives at most 40 x 40 km about its cut; ask for fewer lines or columns"
        )
    heights = tile[top : top + rows, left : left + columns]
    if np.isnan(heights).any():
        raise FormatError("the relief tile has voids in the cut asked for; ask for fewer lines or columns")
    heights = heights - heights.mean()
    west = centre[0] - 0.5 * (columns - 1) * dx
    north = centre[1] + 0.5 * (rows - 1) * dy
    return Relief(heights, west, north, (dx, dy))
