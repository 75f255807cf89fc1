"""Columns of a TDI.toml that an ACQUISITION.toml's cameras and a recovered motion describe.

Not here: columns by count or by a table (``load.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError, InputError
from sightline.imaging.mtf import aperture_mtf, diffusion_mtf, optics_mtf
from sightline.imaging.tdi_transfer import Exposure
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats.tables import header_of, read_columns
from sightline.io.tdi.motion import read_motion_knowledge
from sightline.io.tdi.schema import MtfSection, TdiFile
from sightline.tdi.motion_knowledge import MotionKnowledge
from sightline.tdi.motion_mtf import MotionMtf
from sightline.tdi.scan_columns import ColumnGeometry, band_camera, column_geometry, strip_span
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiGrid

Array = NDArray[np.float64]

#: Columns of a table of columns.
COLUMNS = ("column", "scan_velocity", "slip")
OPTICS = ("optics_mtf_x", "optics_mtf_y")
SIGMAS = ("sigma_velocity", "sigma_slip")


@dataclass(frozen=True, eq=False)
class SeenColumns:
    """Columns of a band, and the motion of its strip where one was recovered.

    Attributes
    ----------
    columns : ScanColumns
    geometry : ColumnGeometry
    span : (float, float)
        s; first and last line of the strip.
    knowledge : MotionKnowledge or None
    notes : tuple of str
        What had to be left out.
    """

    columns: ScanColumns
    geometry: ColumnGeometry
    span: tuple[float, float]
    knowledge: MotionKnowledge | None
    notes: tuple[str, ...]

    def mtf(self, grid: TdiGrid, exposure: Exposure, rules: ChoiceRules) -> MotionMtf | None:
        """MTF under the motion; None without one."""
        if self.knowledge is None:
            return None
        return MotionMtf(self.columns, self.geometry, self.knowledge, grid, exposure, rules, self.span)


def columns_of_acquisition(file: TdiFile, files: InputFolder, motion: Path | None) -> SeenColumns:
    """Velocity and slip of every column of a band, by its camera.

    Parameters
    ----------
    file : TdiFile
        With ``[columns] acquisition``.
    files : InputFolder
        Finds the acquisition.
    motion : Path or None
        Folder that ``recover`` wrote for it: motion, offset and rotation of the band are taken from there.

    Raises
    ------
    FormatError, InputError
        Files that are missing or damaged, or do not belong together.
    """
    section = file.columns
    acquisition = load_acquisition(files(str(section.acquisition)))
    if not acquisition.bands:
        raise InputError(
            f"{acquisition.path}: has no [[band]]: TDI needs a push-broom detector; name such an acquisition"
        )
    name = section.band or acquisition.bands[0].name
    found = None if motion is None else read_motion_knowledge(motion, acquisition)
    camera = band_camera(acquisition.bands, name, None if found is None else found.statics)
    geometry = column_geometry(camera, acquisition.surface)
    rotation_sigma = next(band.rotation_sigma for band in acquisition.bands if band.name == name)
    if found is not None:
        rotation_sigma = found.statics_sigma.get(f"{name} rotation", rotation_sigma)
    # a row that is turned sees the scene slip by as much
    doubt = geometry.attitude_covariance(
        [0.0, 0.0, float(np.hypot(rotation_sigma, section.sigma_slip))], [0.0] * 3
    )
    doubt[:, 0, 0] += section.sigma_velocity**2
    static = np.tile(static_mtf(file.mtf), (len(geometry.column), 1))
    if section.table is not None:
        static *= _optics_of_columns(files(section.table), geometry.column) / optics_of(file.mtf)
    columns = geometry.columns(static, doubt if doubt.any() else None)
    if found is None:
        return SeenColumns(columns, geometry, strip_span(camera), None, ())
    knowledge, notes = found.knowledge, found.knowledge.doubts(geometry)
    taken = file.motion
    averaged = [band.name for band in acquisition.bands if band.camera.stages is not None]
    if averaged and (taken.stages > 1 or taken.integration_ratio < 1.0):
        raise InputError(
            f"[motion] stages = {taken.stages}, integration_ratio = {taken.integration_ratio:g}: "
            f"{acquisition.path} says the stages of {', '.join(averaged)} itself, and what was recovered of "
            "it is the motion, not its average; leave [motion] out"
        )
    if taken.stages > 1 or taken.integration_ratio < 1.0:
        knowledge, highest = knowledge.without_tdi(
            taken.stages, taken.integration_ratio, geometry.line_period
        )
        notes = (
            *notes,
            f"the motion came from images of {taken.stages} stages: it is restored up to {highest:.4g} Hz; "
            "beyond, its density there stands for it, falling",
        )
    return SeenColumns(columns, geometry, strip_span(camera), knowledge, notes)


def check_optics(path: Path, given: Mapping[str, Array]) -> None:
    """FormatError where MTFs of the optics by column are none."""
    for name in OPTICS:
        if name in given and not ((given[name] > 0.0) & (given[name] <= 1.0)).all():
            raise FormatError(f"{path}: {name} must lie above 0, up to 1")


def _optics_of_columns(path: Path, column: Array) -> Array:
    """(C, 2) MTF of the optics of a table whose columns' motion the cameras say."""
    of_motion = [name for name in header_of(path) if name in (*COLUMNS[1:], *SIGMAS)]
    if of_motion:
        raise FormatError(
            f"{path}: gives {of_motion[0]}, and [columns] acquisition is given, whose cameras say how the "
            f"scene moves; leave {', '.join(of_motion)} out of the table, or the acquisition"
        )
    table = {
        name: np.asarray(values, dtype=np.float64)
        for name, values in read_columns(path, ("column", *OPTICS)).items()
    }
    check_optics(path, table)
    order = np.argsort(table["column"], kind="stable")
    if not np.array_equal(table["column"][order], column):
        raise FormatError(
            f"{path}: its {len(order)} rows are of columns {table['column'].min():g} to "
            f"{table['column'].max():g}; the band has the columns {column[0]:g} to {column[-1]:g}: give one "
            "row for each of them"
        )
    return np.column_stack([table[name][order] for name in OPTICS])


def optics_of(section: MtfSection) -> Array:
    """(2,) MTF of the optics across and along."""
    if section.optics_cutoff is not None:
        return optics_mtf(
            section.frequencies,
            section.optics_cutoff,
            obscuration=section.obscuration,
            wavefront=section.wavefront,
        )
    given = 1.0 if section.optics_mtf is None else section.optics_mtf
    return np.broadcast_to(np.asarray(given, dtype=np.float64), (2,))


def static_mtf(section: MtfSection) -> Array:
    """(2,) MTF of optics, aperture and diffusion across and along."""
    f = np.asarray(section.frequencies)
    aperture = [aperture_mtf(f[0], section.aperture_x), aperture_mtf(f[1], section.aperture_y)]
    return np.asarray(optics_of(section) * np.array(aperture) * diffusion_mtf(f, section.diffusion_sigma_px))
