"""``[cube]`` as a plan, and what ``summary.json`` says of a cube; described in ``docs/formats.md``.

Not here: the pixels (``cube_files.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sightline.applications.frame_cube import CubePlan, CubeSummary
from sightline.io.cube_files import crs_wkt
from sightline.io.sequence_schema import CubeSection


def cube_plan(section: CubeSection) -> CubePlan:
    """The plan that a ``[cube]`` asks for."""
    bands = tuple(section.bands) if isinstance(section.bands, list) else section.bands
    return CubePlan(section.gsd, bands, section.surface, section.fill_nm, section.flatten)


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
        "seconds": cube.seconds,
        "warnings": list(cube.warnings),
    }
