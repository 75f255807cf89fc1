"""Offsets of the cameras of a rig → ``rig.csv``; bands of one capture → ``registered.tif``.

Not here: poses of the captures (``sequence_exports.py``).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.rig_bands import LaidBand
from sightline.applications.sequence_poses import SequencePoses
from sightline.io.formats.tables import write_columns
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.rig import OFFSETS
from sightline.writing import whole_raster

RIG, REGISTERED = "rig.csv", "registered.tif"
#: Columns of ``rig.csv``: offsets against the first camera, their sigmas, what they were given to.
_OFFSETS = OFFSETS[:6]
COLUMNS = (
    "camera", *_OFFSETS, *(f"{kind}sigma_{name}" for kind in ("", "prior_") for name in _OFFSETS),
    "focal_length_px", "sigma_focal_length_px", "sightings", "residual_px", "observed",
)  # fmt: skip
#: Lines of a band that are written at a time.
_LINES = 256


def rig_table(problem: SequenceProblem, found: SequencePoses) -> dict[str, Any]:
    """Columns of ``rig.csv``: rad about and m along body axes, px."""
    assert found.rig is not None
    o = found.rig.offsets
    angles = o.orientation.as_rotvec()
    given = np.array([camera.detector.focal_length_px for camera in problem.rig])
    columns: dict[str, Any] = {"camera": np.array(o.names, dtype=str)}
    columns |= dict(zip(_OFFSETS, (*angles.T, *o.position.T), strict=True))
    columns |= {f"sigma_{name}": o.sigma[:, k] for k, name in enumerate(_OFFSETS)}
    columns |= {f"prior_sigma_{name}": o.prior_sigma[:, k] for k, name in enumerate(_OFFSETS)}
    return columns | {
        "focal_length_px": given * (1.0 + o.stretch),
        "sigma_focal_length_px": given * o.sigma[:, 6],
        "sightings": o.sightings,
        "residual_px": o.residual_px,
        "observed": np.array([" ".join(_seen(row)) for row in o.observed], dtype=str),
    }


def _seen(row: Sequence[bool]) -> list[str]:
    """Names of the offsets that the images know better than what was given."""
    return [name for name, on in zip(OFFSETS, row, strict=True) if on]


def write_rig(folder: Path, problem: SequenceProblem, found: SequencePoses) -> None:
    """``rig.csv`` in `folder`."""
    columns = rig_table(problem, found)
    words = {"camera", "observed", "sightings"}
    write_columns(folder / RIG, columns, {name: "%.9g" for name in columns if name not in words})


def rig_summary(problem: SequenceProblem, found: SequencePoses) -> list[dict[str, Any]] | None:
    """Entry ``rig`` of ``summary.json``: a camera each; None where there is one camera."""
    if found.rig is None:
        return None
    o, table = found.rig.offsets, rig_table(problem, found)
    out = []
    for c, camera in enumerate(problem.rig):
        rms = float(o.residual_px[c])
        out.append({
            "camera": camera.name,
            "wavelength_nm": None if math.isnan(camera.wavelength_nm) else float(camera.wavelength_nm),
            "orientation": [float(table[name][c]) for name in _OFFSETS[:3]],
            "orientation_sigma": [float(v) for v in o.sigma[c, :3]],
            "position": [float(v) for v in o.position[c]],
            "position_sigma": [float(v) for v in o.sigma[c, 3:6]],
            "focal_length_px": float(table["focal_length_px"][c]),
            "focal_length_sigma_px": float(table["sigma_focal_length_px"][c]),
            "prior": camera.prior,
            "observed": _seen(o.observed[c]),
            "held": [
                name for name, on, p in zip(OFFSETS, o.observed[c], o.prior_sigma[c], strict=True)
                if not on and (p > 0.0 or name != "stretch") and c > 0
            ],
            "images": int(camera.usable.sum()),
            "sightings": int(o.sightings[c]),
            "rms_px": None if math.isnan(rms) else rms,
        })  # fmt: skip
    return out


def write_registered_capture(folder: Path, bands: Sequence[LaidBand]) -> str:
    """``registered.tif``: all bands of a capture on its first camera, float32, NaN where there is none."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning
    from rasterio.windows import Window

    path, (lines, columns) = folder / REGISTERED, bands[0].source.shape
    profile = {
        "driver": "GTiff", "dtype": "float32", "count": len(bands), "height": lines, "width": columns,
        "nodata": float("nan"), "tiled": True, "compress": "deflate", "predictor": 3,
    }  # fmt: skip
    with warnings.catch_warnings():
        # an image in sensor geometry has no georeferencing, by nature
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with whole_raster(path) as draft, rasterio.open(draft, "w", **profile) as target:
            for number, band in enumerate(bands, start=1):
                target.set_band_description(number, band.name)
                if math.isfinite(band.wavelength_nm):
                    target.update_tags(number, wavelength_nm=f"{band.wavelength_nm:.6g}")
                for first in range(0, lines, _LINES):
                    last = min(first + _LINES, lines)
                    pixels = np.array(band.source.read((first, last), (0, columns)), dtype=np.float32)
                    bad = band.source.mask((first, last), (0, columns))
                    if bad is not None:
                        pixels[bad] = np.nan
                    target.write(pixels, number, window=Window(0, first, columns, last - first))
    return REGISTERED
