"""A simulated raw image of JunoCam, as products have it: the image, its metadata and those of another, truth.

Not here: what the camera sees (``simulate/spinning_frames.py``), reading (``io/formats/junocam.py``).
"""

from __future__ import annotations

import json
import warnings
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.execution import Step, no_step
from sightline.geometry.earth import to_geodetic
from sightline.geometry.instrument import AreaDetector
from sightline.io.formats.junocam import (
    CLOCK,
    COLUMN,
    COLUMNS,
    COMMON_LINE,
    DELAY,
    DISTORTION,
    FOCAL,
    LINES,
    MU,
    RADII,
    ROTATION,
    STRIPS,
    TURN,
    companding_table,
    sun_direction,
)
from sightline.simulate.files import write_numbers
from sightline.simulate.spinning_frames import SpinningCamera, SpinningFrameOptions, SpinningScenario
from sightline.writing import whole_raster, whole_text

#: When the image is taken, and s until the other one.
_START, _LATER = datetime(2022, 8, 17, 13, 25, 44, 834000, tzinfo=UTC), 600
#: Of both images.
PRODUCTS = ("JNCE_2022229_00C00001_V01", "JNCE_2022229_00C00002_V01")
#: Names of the files of a scene: the raw image, its metadata and the other's, attitudes.
IMAGE, OWN, OTHER = f"{PRODUCTS[0]}-raw.png", "00001-Metadata.json", "00002-Metadata.json"
TRUTH = "truth-attitudes.csv"


def spinning_scenario(seed: int, options: SpinningFrameOptions) -> SpinningScenario:
    """The image that options ask for, by the published numbers of JunoCam and Jupiter."""
    strips = tuple(
        AreaDetector(name, (LINES, COLUMNS), FOCAL, (line + COMMON_LINE, COLUMN), DISTORTION)
        for name, line in STRIPS
    )
    camera = SpinningCamera(
        strips,
        CLOCK + DELAY,
        TURN,
        RADII,
        MU,
        ROTATION,
        sun_direction(_START),
        companding_table(),
    )
    return SpinningScenario(camera, seed, options)


def write_spinning(scenario: SpinningScenario, folder: Path, step: Step = no_step) -> tuple[str, ...]:
    """The image, metadata and truth into a folder; their names."""
    _write_image(scenario, folder / IMAGE, step)
    seconds = np.array([0.0, float(_LATER)])
    turning = Rotation.from_rotvec(-ROTATION * seconds[:, None] * [0.0, 0.0, 1.0])
    under = to_geodetic(turning.apply(scenario.positions(seconds)), RADII)
    for name, product, later, (longitude, latitude, altitude) in zip(
        (OWN, OTHER), PRODUCTS, seconds.tolist(), under.tolist(), strict=True
    ):
        content = {
            "INSTRUMENT_ID": "JNC",
            "PRODUCT_ID": product,
            "START_TIME": f"{_START.replace(tzinfo=None) + timedelta(seconds=later):%Y-%m-%dT%H:%M:%S.%f}",
            "INTERFRAME_DELAY": f"{DELAY} <s>",
            "SPACECRAFT_ALTITUDE": f"{altitude / 1e3:.3f} <km>",
            "SUB_SPACECRAFT_LATITUDE": f"{np.degrees(latitude):.6f}",
            "SUB_SPACECRAFT_LONGITUDE": f"{-np.degrees(longitude) % 360.0:.6f}",
        }
        whole_text(folder / name, json.dumps(content, indent=1) + "\n")
    table = np.column_stack([scenario.t, scenario.attitudes.as_quat()])
    write_numbers(folder / TRUTH, "t,x,y,z,w", table)
    return IMAGE, OWN, OTHER, TRUTH


def _write_image(scenario: SpinningScenario, path: Path, step: Step) -> None:
    """Framelets one below the other."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    count = scenario.options.exposures * len(STRIPS)
    pixels = np.empty((count * LINES, COLUMNS), np.uint8)
    for k, framelet in enumerate(scenario.framelets()):
        pixels[k * LINES : (k + 1) * LINES] = framelet
        step(k + 1, count)
    profile = {"driver": "PNG", "dtype": "uint8", "count": 1, "height": len(pixels), "width": COLUMNS}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with whole_raster(path) as draft, rasterio.open(draft, "w", **profile) as target:
            target.write(pixels, 1)
