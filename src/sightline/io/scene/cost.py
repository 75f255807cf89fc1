"""What it takes to make the scene of a recipe, said before it is made.

Not here: whether what is made could be used (``cli/usable.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from sightline.applications.expected_cost import Cost, orientation_cost_of, rendering_cost
from sightline.io.acquisition.load import read_acquisition
from sightline.io.formats.junocam import COLUMNS, LINES, STRIPS
from sightline.io.scene.recipe import SceneRecipe
from sightline.simulate.acquired import AcquiredOptions
from sightline.simulate.frames import FrameCaseOptions
from sightline.simulate.instruments import InstrumentOptions
from sightline.simulate.scenarios import ground_cells
from sightline.simulate.sequence_options import SequenceOptions
from sightline.simulate.spinning_frames import SpinningFrameOptions
from sightline.simulate.stereo_options import StereoOptions
from sightline.simulate.strip_options import StripOptions


def scene_cost(recipe: SceneRecipe) -> Cost:
    """What it takes to make a scene."""
    return _COSTS[recipe.family.name](recipe.options, recipe.files)


def _strip_cost(options: StripOptions, files: Mapping[str, Any]) -> Cost:
    return _bands_cost(options.lines, options.columns, len(options.names), ground_cells(options))


def _orbit_cost(options: InstrumentOptions, files: Mapping[str, Any]) -> Cost:
    widest = max(options.width(detector) for detector in options.detectors)
    return _bands_cost(options.lines, widest, len(options.detectors), 0.0)


def _acquired_cost(options: AcquiredOptions, files: Mapping[str, Any]) -> Cost:
    bands = len(read_acquisition(Path(options.acquisition)).band) if options.acquisition else 1
    return _bands_cost(options.lines, options.columns, bands, 0.0)


def _bands_cost(lines: int, columns: int, bands: int, ground: float) -> Cost:
    seen = (lines + 1000.0) * (columns + 128.0)
    asked = f"--lines {lines:,} --columns {columns:,} of {bands} bands"
    return rendering_cost(float(lines) * columns * bands, max(seen, ground), asked)


def _photographs_cost(options: FrameCaseOptions, files: Mapping[str, Any]) -> Cost:
    lines, columns = options.shape
    walk = 3.0 * options.step_sigma * (options.frames + 2) ** 0.5 * options.focal_length_px
    across = 1.2 * (lines**2 + columns**2) ** 0.5 + 2.0 * walk
    along = across + options.ground_speed * options.interval * options.frames / options.gsd
    # a side of a texture has no more cells than that; a relief has a post at every other pixel at most, and
    # is drawn twice as long each way
    ground = min(across, 8192.0) * min(along, 8192.0) + (across * along if options.relief_rms > 0.0 else 0.0)
    asked = f"{options.frames:,} frames of --lines {lines} --columns {columns}"
    return rendering_cost(float(options.frames) * lines * columns, ground, asked)


def _spinning_cost(options: SpinningFrameOptions, files: Mapping[str, Any]) -> Cost:
    pixels = float(options.exposures) * len(STRIPS) * LINES * COLUMNS
    return rendering_cost(pixels, 0.0, f"{options.exposures} exposures of JunoCam")


def _pass_cost(options: StereoOptions, files: Mapping[str, Any]) -> Cost:
    lines, columns = options.frame
    of = f"--cameras {options.cameras:,} --shots {options.shots:,} --points {options.points:,}"
    cost = orientation_cost_of(float(options.cameras) * options.shots * options.points, of)
    if not files["images"]:
        return cost
    pixels = float(options.cameras) * options.shots * lines * columns
    return cost.then(rendering_cost(pixels, 4.0 * lines * columns, f"frames of {lines} x {columns} px"))


def _flight_cost(options: SequenceOptions, files: Mapping[str, Any]) -> Cost:
    lines, columns = options.shape
    frames, flown = options.total_frames, options.frames * (1.0 - options.overlap) + 1.0
    wide = columns * (1.0 + (options.flight_lines + options.cross_lines) * (1.0 - options.side_overlap))
    asked = f"{frames:,} frames of --lines {lines} --columns {columns}"
    # what the frames see when they swing, to 4 sigma on both sides
    swing = 8.0 * (options.position_jitter / options.gsd + options.jitter * options.focal_length_px)
    ground = (flown * lines + swing) * (wide + swing)
    return rendering_cost(float(frames) * lines * columns, ground, asked)


#: What it takes to make a scene of each family.
_COSTS: dict[str, Callable[[Any, Mapping[str, Any]], Cost]] = {
    "strip": _strip_cost,
    "orbit": _orbit_cost,
    "acquired": _acquired_cost,
    "photographs": _photographs_cost,
    "spinning": _spinning_cost,
    "pass": _pass_cost,
    "flight": _flight_cost,
}
