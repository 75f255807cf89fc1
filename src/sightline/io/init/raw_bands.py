"""An ACQUISITION.toml for raw bands beside the metadata of a product that was made of them.

The metadata give the orbit, the attitudes and the lags of the bands. Where the real detectors look they do
not say: each band looks where it sees at its own time what line 0 of the product sees.

Not here: bands without metadata (``bands.py``), gyros (``telemetry.py``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Ellipsoid
from sightline.geometry.trajectory import Trajectory
from sightline.io.formats.products.pleiades import START, WHAT, pleiades_attitude, pleiades_orbit
from sightline.io.formats.products.pleiades_telemetry import read_pleiades_telemetry
from sightline.io.formats.products.product import Product
from sightline.io.formats.products.tree import read_xml
from sightline.io.formats.tables import ATTITUDES, POSITIONS, write_columns
from sightline.io.init.bands import (
    BandImage,
    FirstAcquisition,
    acquisition_text,
    band_images,
    judged_lags,
    path_from,
    search,
)
from sightline.io.init.presets import PRESETS, Preset
from sightline.io.init.telemetry import FirstSensors, body_turn, first_sensors
from sightline.io.names import toml_string

Array = NDArray[np.float64]

_POSITIONS, _ATTITUDES = "positions.csv", "attitudes.csv"
#: s from row to row of tables that are made of polynomials, by which tables reach beyond the images, and by
#: which attitudes of the metadata may be continued to cover them.
_STEP, _BEYOND, _CONTINUED = 0.125, 0.25, 0.5


def acquisition_of_raw_bands(
    product: Product, images: Sequence[Path], folder: Path, names: Sequence[str] = ()
) -> FirstAcquisition:
    """Bands in sensor geometry along the orbit of a product that was made of them.

    Parameters
    ----------
    product : Product
        Whose metadata tell lags, orbit and attitudes (Pleiades).
    images, names
        As of `band_images`.
    folder : Path
        Where the file will lie: paths of the images are relative to it.

    Raises
    ------
    InputError
        If the product tells no lags, the bands cannot be told or do not go together, or are longer than what
        is known of the attitude.
    """
    if product.raw is None:
        raise InputError(
            f"{images[0]}: is no metadata of a product, and {product.path.name} ({product.kind}) tells no "
            "lags of bands in sensor geometry; give the product alone, or the images with --preset NAME "
            f"({', '.join(PRESETS)})"
        )
    if product.raw.doubt:
        raise InputError(f"{product.path}: does not say when raw bands were exposed: {product.raw.doubt}")
    known = PRESETS["pleiades"]
    preset = replace(known, lags={**product.raw.lags}, line_period=product.raw.line_period)
    bands = band_images(preset, images, names)
    said = judged_lags(product.path, preset, known, bands)
    first = {band.name: product.raw.begin + preset.lags[band.name] for band in bands}
    _check_begin(product, product.raw.begin)
    ends = [first[band.name] + preset.line_period * preset.wide_of(band.name) * band.lines for band in bands]
    flown = _flown(product, (min(first.values()) - _BEYOND, max(ends) + _BEYOND))
    camera = product.model.camera
    mount = _mount(camera.pointing, camera.detector.directions)
    looks = {band.name: _look(flown, mount, first[band.name], product.height or 0.0) for band in bands}
    sensors = first_sensors(product, flown)
    assumed = (
        f"bands in sensor geometry of {product.kind}, {product.name}",
        f"lags and line period: {product.path.name} (Band_TS_List), whole frames that move together by 5 ms "
        "from product to product: 3 ms (1-sigma)",
        *preset.sources[1:],
        f"orbit and attitudes: those of {product.path.name}, as it describes its own virtual line",
        "line 0 of every image shows the same ground, the columns lie about the middle of the view: bands "
        f"lie to {preset.offset_sigma_px:g} fine px and turn to {preset.rotation_sigma:g} rad (1-sigma)",
        *(() if sensors is None else sensors.assumed),
    )
    unknown = (
        f"looks of the real detectors: not in {product.path.name}, which describes its own virtual line",
        "where in the raw images the product begins: line 0 is taken for its first line",
        "heights of the ground within the scene: one height, that of the product; give [surface] dem",
        *(() if sensors is None else sensors.unknown),
    )
    parts = [
        _common(product, preset, bands[0], mount),
        *(_band(preset, band, bands[0], folder, first[band.name], looks[band.name]) for band in bands),
        _surface(product),
        *search(preset, bands),
        *([sensors.text] if sensors is not None and sensors.text else []),
    ]
    text = acquisition_text(assumed, unknown, parts, folder)
    return FirstAcquisition(text, assumed, unknown, said, write=_Tables(flown, sensors))


@dataclass(frozen=True)
class _Tables:
    """What is written beside ACQUISITION.toml."""

    flown: Trajectory
    sensors: FirstSensors | None

    def __call__(self, folder: Path) -> None:
        if self.sensors is not None:
            self.sensors.write(folder)
        for name, columns, t, values in (
            (_POSITIONS, POSITIONS, self.flown.t_position, self.flown.position),
            (_ATTITUDES, ATTITUDES, self.flown.t_attitude, self.flown.world_from_body.as_quat()),
        ):
            table: Mapping[str, ArrayLike] = dict(zip(columns, (t, *values.T), strict=True))
            write_columns(folder / name, table, dict.fromkeys(columns, "%.17g"))


def _flown(product: Product, span: tuple[float, float]) -> Trajectory:
    """Positions and attitudes over a span (s), by the metadata: the list of attitudes where there is one.

    The model's attitude is a polynomial through that list, which leaves out what the motion had beside it.
    """
    data = read_xml(product.path, WHAT)
    start, later = data.text(START), product.model.camera.first_line_time
    model = pleiades_attitude(data, start)
    axes = body_turn(product, model)
    t, attitudes = _attitudes(product, model, span, later)
    _check_span(product, span, (float(t[0]), float(t[-1])))
    places = np.arange(span[0], span[1] + _STEP, _STEP)
    orbit = pleiades_orbit(data, start)
    return Trajectory(places, orbit.positions(places - later), t, attitudes * axes)


def _attitudes(
    product: Product, model: Callable[[Array], Rotation], span: tuple[float, float], later: float
) -> tuple[Array, Rotation]:
    """Instants (s) and attitudes of the list in the metadata, else of the polynomials over the product."""
    read = read_pleiades_telemetry(product.path)
    if read is not None:
        return read.t_earth + later, read.earth_from_body
    camera = product.model.camera
    first, last = camera.times(np.array([0.0, camera.lines - 1.0])).tolist()
    t = np.arange(max(span[0], first - _CONTINUED), min(span[1], last + _CONTINUED) + _STEP, _STEP)
    return t, model(t - later)


def _check_begin(product: Product, begin: float) -> None:
    """InputError where the first band sees the first line's ground at another time than such bands do."""
    most = 2.0 * max(PRESETS["pleiades"].lags.values())
    if abs(begin) > most:
        raise InputError(
            f"{product.path}: its first band sees row 1 (ORIGIN_TIME, ORIGIN_FULL_RES_LINE) {begin:.4g} s "
            f"after the model's first line; within {most:.2g} s is expected, as bands see the ground one "
            "after the other: are these the times of this product?"
        )


def _check_span(product: Product, span: tuple[float, float], known: tuple[float, float]) -> None:
    """InputError where images are exposed outside of what is known of the attitude."""
    begin, end = span[0] + _BEYOND, span[1] - _BEYOND
    if begin < known[0] or end > known[1]:
        raise InputError(
            f"the bands are exposed from {begin:.3g} to {end:.3g} s after line 0 of {product.path.name}, "
            f"whose attitudes reach from {known[0]:.3g} to {known[1]:.3g} s; give the metadata of the "
            "product that was made of these bands, or bands cut to its lines"
        )


def _mount(pointing: object, directions: Array) -> Rotation:
    """body_from_camera of a straight line of detectors amid the looks of a product."""
    assert isinstance(pointing, FixedMount)
    ends = directions[[0, -1]] / np.linalg.norm(directions[[0, -1]], axis=1, keepdims=True)
    z = ends.sum(axis=0)
    z /= np.sqrt(z @ z)
    x = ends[1] - ends[0]
    x -= (x @ z) * z
    x /= np.sqrt(x @ x)
    return pointing.body_from_camera * Rotation.from_matrix(np.column_stack([x, np.cross(z, x), z]))


def _look(flown: Trajectory, mount: Rotation, own: float, height: float) -> tuple[float, float]:
    """Tangents ahead and to larger columns at which a band sees at `own` (s) line 0 of the product."""
    here, there = flown.at(np.array([0.0])), flown.at(np.array([own]))
    axis = (here.world_from_body * mount).apply([0.0, 0.0, 1.0])
    ground = Ellipsoid(height=height).intersect(here.position, axis)
    seen = (there.world_from_body * mount).inv().apply(ground - there.position)[0]
    return float(seen[1] / seen[2]), float(seen[0] / seen[2])


def _common(product: Product, preset: Preset, band: BandImage, mount: Rotation) -> str:
    wide = preset.wide_of(band.name)
    quaternion = ", ".join(f"{value!r}" for value in mount.as_quat().tolist())
    return f"""[acquisition]
name = {toml_string(f"raw bands of {product.name}"[:200])}
epoch = {toml_string(product.epoch)}   # t = 0

[platform]
kind = "ephemeris"
positions = {toml_string(_POSITIONS)}      # m, Earth-fixed
attitudes = {toml_string(_ATTITUDES)}
aberration = false   # the maker's attitudes hold it
light_time = false   # the maker's attitudes hold it
refraction = false   # the maker's attitudes hold it

[camera]
body_from_camera = [{quaternion}]   # the middle of the product's line

[instrument]
ifov = {preset.ifov * wide!r}
columns = {band.columns}
line_period = {preset.line_period * wide!r}   # s"""


def _band(
    preset: Preset,
    band: BandImage,
    common: BandImage,
    folder: Path,
    first: float,
    look: tuple[float, float],
) -> str:
    wide = preset.wide_of(band.name)
    lines = [
        "[[band]]",
        f"name = {toml_string(band.name)}",
        f"image = {toml_string(path_from(band.path, folder))}",
        f"image_band = {band.number}",
        f"first_line_time = {first!r}   # s from line 0 of the product; lags are known to 0.003 s",
        f"look_ahead = {math.atan(look[0]) + 0.0!r}   # rad: where it sees the same ground",
        f"offset_px = [0.0, {look[1] / (preset.ifov * wide) + 0.0!r}]   # likewise",
        f"offset_sigma_px = {preset.offset_sigma_px / wide!r}",
        f"rotation_sigma = {preset.rotation_sigma!r}",
    ]
    if wide != preset.wide_of(common.name):
        lines += [
            f"ifov = {preset.ifov * wide!r}",
            f"columns = {band.columns}",
            f"line_period = {preset.line_period * wide!r}",
        ]
    return "\n".join(lines)


def _surface(product: Product) -> str:
    sigma = 100.0 if product.rpc is None else product.rpc.height[1] / 3.0
    return (
        f"[surface]\nheight = {product.height or 0.0:.1f}   # m above the ellipsoid\n"
        f"height_sigma = {sigma:.0f}   # m: relief that is not known"
    )
