"""The cube that a ``[cube]`` asks for, and what ``summary.json`` says of it; see ``docs/formats.md``.

Not here: the pixels (``cube_files.py``).
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.expected_cost import Cost, flight_cost, maps_cost
from sightline.applications.frame_cube import CubeSummary, assemble_cube
from sightline.applications.sequence_poses import SequencePoses, check_flight
from sightline.errors import EstimationError, InputError, SightlineError
from sightline.io.results.cube_arrays import crs_wkt
from sightline.io.results.cube_files import (
    ZARR,
    CubeFolder,
    check_formats,
    is_map_file,
    is_zarr_file,
)
from sightline.io.sequence.load import FrameSequence
from sightline.io.sequence.schema import CubeSection
from sightline.products.cube_plan import CubePlan, choose_bands, expected_cube

#: Rows and columns of a map at least.
LEAST_MAP = 3


def cube_plan(section: CubeSection) -> CubePlan:
    """The plan that a ``[cube]`` asks for."""
    bands = tuple(section.bands) if isinstance(section.bands, list) else section.bands
    plan = CubePlan(section.gsd, bands, section.surface, section.fill_nm, section.flatten)
    if section.picture_nm is None:
        return plan
    red, green, blue = section.picture_nm
    return replace(plan, picture_nm=(red, green, blue))


def ready_to_georeference(sequence: FrameSequence, *, maps: bool = True) -> Cost:
    """What ``georeference`` refuses before an image is looked at, and what it will take, maps included.

    Raises
    ------
    InputError
        If too few frames can be used; if ``[cube]`` asks for bands that the camera does not see, or for maps
        that this machine cannot hold, or of hardly a pixel.
    EstimationError
        If by the tables successive frames show nothing in common.
    """
    problem = sequence.problem
    try:
        check_flight(problem)
        cost = flight_cost(problem)
        if maps and sequence.cube.make:
            check_bands(sequence)
            cost = cost.then(_cost_of_maps(sequence))
        cost.check()
    except (EstimationError, InputError) as error:
        raise type(error)(_of_file(sequence, error)) from None
    return cost


def _of_file(sequence: FrameSequence, error: SightlineError) -> str:
    """A message with the file it is about, once."""
    return str(error) if str(error).startswith(str(sequence.path)) else f"{sequence.path}: {error}"


def _cost_of_maps(sequence: FrameSequence) -> Cost:
    """By the rough poses; nothing where they do not give the size."""
    problem, plan = sequence.problem, cube_plan(sequence.cube)
    try:
        grid, layout = expected_cube(problem, plan)
    except InputError:
        return Cost(0.0, 0.0, "")
    if plan.gsd is not None and min(grid.shape) < LEAST_MAP:
        raise InputError(
            f"[cube] gsd = {plan.gsd:g} m makes maps of {grid.shape[0]} rows x {grid.shape[1]} columns of "
            "what the frames see by their rough poses; give metres of a pixel, about as large as those of "
            "the frames, or leave it out"
        )
    return maps_cost(len(problem), problem.detector.shape, grid.shape, len(layout))


def check_cube(sequence: FrameSequence) -> None:
    """Refuse at once the maps that could not be made once all poses are found.

    Raises
    ------
    InputError
        If ``[cube]`` asks for bands that the camera does not see, or for files whose package is missing.
    """
    if sequence.cube.make:
        check_bands(sequence)
        check_formats(sequence.cube.formats)


def check_bands(sequence: FrameSequence) -> None:
    """InputError if ``[cube]`` asks for bands that the camera does not see."""
    try:
        # which bands there can be does not depend on where they lie
        choose_bands(sequence.problem, cube_plan(sequence.cube), np.zeros((0, 0, 2)), 1.0, 1.0)
    except InputError as error:
        raise InputError(f"{sequence.path}: [cube] {str(error).replace('`', '')}") from None


def write_cube(
    folder: Path,
    sequence: FrameSequence,
    found: SequencePoses,
    *,
    progress: Callable[[str, int, int], None] | None = None,
) -> tuple[CubeSummary, tuple[str, ...]]:
    """Make the cube of a sequence and write its files.

    Parameters
    ----------
    folder : Path
        Exists.
    sequence : FrameSequence
    found : SequencePoses
    progress : callable, optional
        Called with the stage, what is done of it (tiles, pairs of bands, files) and all of that.

    Returns
    -------
    summary : CubeSummary
    files : tuple of str
        Below `folder`. After an error none is left half-written.
    """
    store = CubeFolder(folder, sequence.cube.formats, one_file=sequence.cube.one_file)
    try:
        summary = assemble_cube(sequence.problem, found, cube_plan(sequence.cube), store, progress)
        return summary, store.finish(progress)
    finally:
        store.discard()


def remove_cube(folder: Path) -> None:
    """Remove the files of a cube that was begun, where they are not all of it."""
    for name in ("bands", ZARR):
        shutil.rmtree(folder / name, ignore_errors=True)
    for name in ("cube.tif", "cube.dat", "cube.hdr"):
        (folder / name).unlink(missing_ok=True)


def earlier_cube(folder: Path, cube: Mapping[str, Any]) -> list[str]:
    """Files below a folder of the maps that the `cube` of a summary there lists: names that maps have."""
    listed = [str(name) for name in cube.get("files", ())]
    maps = [name for name in listed if is_map_file(name)]
    if ZARR not in listed or (folder / ZARR).is_symlink():
        return maps
    # the store is named as one; what is in it belongs to it by its form
    inside = [path.relative_to(folder).as_posix() for path in (folder / ZARR).rglob("*") if path.is_file()]
    return maps + [name for name in inside if is_zarr_file(name)]


def cube_summary(cube: CubeSummary, files: Sequence[str] = ()) -> dict[str, Any]:
    """Entry ``cube`` of ``summary.json``: plain numbers and words, no pixels."""
    grid = cube.grid
    bands = [
        {
            "name": name,
            "wavelength_nm": float(cube.wavelength_nm[k]),
            "coverage": float(cube.coverage[k]),
            "passed": float(cube.passed[k]),
            "beyond": float(cube.beyond[k]),
            "map_share": float(cube.whole[k]),
            "seams": float(cube.seams[k]),
            "seam_jump": float(cube.seam_jump[k]),
        }
        for k, name in enumerate(cube.names)
    ]
    pairs = [
        {
            "bands": [int(a), int(b)],
            "rms_px": float(cube.pair_rms_px[k]),
            "noise_px": float(cube.pair_noise_px[k]),
            "windows": int(cube.pair_windows[k]),
        }
        for k, (a, b) in enumerate(cube.pairs)
    ]
    return {
        "files": list(files),
        "shape": list(grid.shape),
        "gsd": grid.gsd,
        "extent": list(grid.extent),
        "crs": crs_wkt(grid) or None,
        "surface": cube.surface,
        "height_sigma": cube.height_sigma,
        "area": cube.area,
        "bands": bands,
        "pairs": pairs,
        "frames_used": cube.frames_used,
        "unread": list(cube.unread),
        "warnings": list(cube.warnings),
    }
