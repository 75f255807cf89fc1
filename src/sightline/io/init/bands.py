"""An ACQUISITION.toml for bands without metadata, by what is published of their instrument.

Not here: the published numbers (``presets.py``), keys and allowed values (``io/acquisition/schema.py``).
"""

from __future__ import annotations

import math
import os
import re
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from sightline.access import check_file
from sightline.errors import InputError
from sightline.io.acquisition.schema import AcquisitionFile
from sightline.io.config import validate
from sightline.io.formats.images import RasterImage, open_image
from sightline.io.init.presets import Preset
from sightline.io.names import toml_string

#: In the place of a band's name: it is left out.
_LEFT_OUT = "-"
#: How many times longer or shorter than published a lag may be: with how fast the camera sweeps the ground.
_UNLIKE = 2.0
#: px; sides of a band at least: of the smallest window that is matched.
_LEAST_SIDE = 8
#: Lines of a band that are read at a time to see whether there is anything in it.
_AT_A_TIME = 1024


@dataclass(frozen=True)
class FirstAcquisition:
    """An acquisition as it begins: its file, and in words what it rests on.

    Attributes
    ----------
    text : str
        ACQUISITION.toml.
    assumed, unknown : tuple of str
        What was assumed, each with its source; what could not be known.
    found : tuple of str
        What was found of the files, how a product agrees with itself.
    lacking : tuple of str
        Why it cannot be recovered as it is; empty where it can.
    write : callable
        Of a folder: writes what the file refers to beside the user's own files.
    """

    text: str
    assumed: tuple[str, ...]
    unknown: tuple[str, ...]
    found: tuple[str, ...] = ()
    lacking: tuple[str, ...] = ()
    write: Callable[[Path], None] = lambda _: None


@dataclass(frozen=True)
class BandImage:
    """One band of a file, and which band of the instrument it is.

    Attributes
    ----------
    path : Path
    number : int
        Of the band in the file, from 1.
    name : str
        Of the instrument's band.
    lines, columns : int
    """

    path: Path
    number: int
    name: str
    lines: int
    columns: int


def acquisition_of_bands(
    preset: Preset, bands: Sequence[BandImage], folder: Path, sign: int | None = None
) -> FirstAcquisition:
    """The acquisition of bands that come without metadata.

    Parameters
    ----------
    preset : Preset
    bands : sequence of BandImage
        As `band_images` gives them.
    folder : Path
        Where the file will lie: paths of the images are relative to it.
    sign : {1, -1}, optional
        Whether a band is exposed its lag after the first band or before it; None: not known, after it.

    Returns
    -------
    FirstAcquisition
    """
    assumed, unknown = _assumed(preset, sign), _unknown(preset, sign)
    parts = [_common(preset, bands[0])]
    parts += [_band(preset, band, bands[0], folder, 1 if sign is None else sign) for band in bands]
    parts += [
        "[surface]\nheight = 0.0                      # m, the mean of the ground",
        *search(preset, bands),
    ]
    return FirstAcquisition(acquisition_text(assumed, unknown, parts, folder), assumed, unknown)


def acquisition_text(
    assumed: Sequence[str], unknown: Sequence[str], parts: Sequence[str], folder: Path
) -> str:
    """ACQUISITION.toml of its `parts`, checked, under what it rests on; `folder` is where it will lie."""
    head = [
        "ACQUISITION.toml, by `sightline init`. Assumed:",
        *(f"- {line}" for line in assumed),
        "Not known:",
        *(f"- {line}" for line in unknown),
    ]
    text = "\n\n".join(["\n".join(f"# {line}" for line in head), *parts]) + "\n"
    validate(AcquisitionFile, tomllib.loads(text), folder / "acquisition.toml")
    return text


def band_images(preset: Preset, images: Sequence[Path], names: Sequence[str] = ()) -> list[BandImage]:
    """Every band of the images, checked.

    Parameters
    ----------
    preset : Preset
    images : sequence of Path
        One file for each band, whose name holds that of the band, or files of several bands with `names`.
    names : sequence of str, optional
        Bands of all `images` in their order; ``"-"`` leaves one out.

    Raises
    ------
    InputError
        If the bands cannot be told, are not of the preset, are fewer than two, or show other columns.
    FormatError
        If an image cannot be read.
    """
    found: list[tuple[Path, int, tuple[int, int]]] = []
    met: set[Path] = set()
    for path in images:
        if path.resolve() in met:
            raise InputError(f"{path} is given twice; give each image of the scene once")
        met.add(path.resolve())
        check_file(path, "give images of the bands")
        image = open_image(path)
        count = image.count if isinstance(image, RasterImage) else 1
        if count > 1 and not names:
            raise InputError(
                f"{path} holds {count} bands; say which they are, in their order: --bands NAME,NAME,...; "
                f"allowed: {', '.join(preset.lags)}"
            )
        found += [(path, number + 1, image.shape) for number in range(count)]
    if names and len(names) != len(found):
        raise InputError(
            f"--bands names {len(names)} bands, the images hold {len(found)}; give one name for each, or one "
            "scene at a time"
        )
    called = [_known(preset, name) for name in names] or [_in_name(preset, path) for path, _, _ in found]
    bands = [
        BandImage(path, number, name, *shape)
        for (path, number, shape), name in zip(found, called, strict=True)
        if name != _LEFT_OUT
    ]
    _check(preset, bands)
    for band in bands:
        _check_pixels(band)
    return bands


def judged_lags(path: Path, given: Preset, published: Preset, bands: Sequence[BandImage]) -> tuple[str, ...]:
    """What there is to say of the lags that a product gives.

    Parameters
    ----------
    path : Path
        Metadata that give them.
    given, published : Preset
        With the lags of the product, and of its instrument.
    bands : sequence of BandImage
        Whose lags are used.

    Raises
    ------
    InputError
        If two bands see the ground at one time, or one sees it at another time than the instrument can.
    """
    _check_apart(path, given, bands)
    lags = {band.name: given.lags[band.name] for band in bands if published.lags.get(band.name)}
    for name, lag in lags.items():
        if not 1.0 / _UNLIKE <= abs(lag / published.lags[name]) <= _UNLIKE:
            raise InputError(
                f"{path}: {name} sees the ground {1e3 * lag:.4g} ms after the first band; published are "
                f"{1e3 * published.lags[name]:.4g} ms, and up to {_UNLIKE:g} times more or less are taken; "
                "is the file whole, and of this instrument?"
            )
    if min(lags.values(), default=1.0) < 0.0 < max(lags.values(), default=-1.0):
        told = ", ".join(f"{name} {1e3 * lag:.4g} ms" for name, lag in lags.items())
        raise InputError(
            f"{path}: bands see the ground on both sides of the first one ({told}); one side is expected"
        )
    off = {name: abs(abs(lag) - published.lags[name]) for name, lag in lags.items()}
    most = max(off, key=lambda name: off[name], default="")
    if not most:
        return (f"lags by {path.name}: none are published of its bands",)
    said = f"lags by {path.name}, {1e3 * off[most]:.2g} ms at most ({most}) off those published"
    if published.signed and lags[most] < 0.0:
        return said, "bands see the ground before the first one: a reverse scan, which is not verified"
    return (said,)


def _check_apart(path: Path, given: Preset, bands: Sequence[BandImage]) -> None:
    """InputError where two bands see the ground at one time."""
    for a, b in combinations([band.name for band in bands], 2):
        apart = given.lags[b] - given.lags[a]
        line = given.line_period * max(given.wide_of(a), given.wide_of(b))
        if abs(apart) <= line:
            raise InputError(
                f"{path}: {a} and {b} see the ground {1e3 * apart:.3g} ms after one another, less than a "
                f"line ({1e3 * line:.3g} ms): bands of one time show no motion, and those of this "
                "instrument have lags of their own; correct the file, or leave one of them out"
            )


def _check(preset: Preset, bands: Sequence[BandImage]) -> None:
    """InputError unless these can be the bands of one strip."""
    if len(bands) < 2:
        given = bands[0].name if bands else "none"
        raise InputError(f"too few bands ({given}); motion is seen between two or more: give others too")
    for band in bands:
        if min(band.lines, band.columns) < _LEAST_SIDE:
            raise InputError(
                f"{band.path}: band {band.number} has {band.lines} lines x {band.columns} columns; "
                f"{_LEAST_SIDE} or more of each are needed for a window that can be matched"
            )
    met: dict[str, BandImage] = {}
    for band in bands:
        first = met.setdefault(band.name, band)
        if first is not band:
            raise InputError(
                f"{first.path} and {band.path} are both {band.name}; give the bands of one scene at a time"
            )
        fine, wide = preset.wide_of(band.name), preset.wide_of(bands[0].name)
        # as many pixels, less than one wide pixel apart
        if abs(band.columns * fine - bands[0].columns * wide) >= max(fine, wide):
            pixels = "" if fine == wide else f" (of {fine:g} and {wide:g} fine pixels each)"
            raise InputError(
                f"{band.path} has {band.columns} columns, {bands[0].path} {bands[0].columns}{pixels}; bands "
                "that show the same columns are expected"
            )


def _check_pixels(band: BandImage) -> None:
    """InputError where all pixels of a band are alike, or none is a number."""
    image, held = open_image(band.path, band.number), None
    for first in range(0, band.lines, _AT_A_TIME):
        last = min(first + _AT_A_TIME, band.lines)
        pixels = image.read((first, last), (0, band.columns))
        masked = image.mask((first, last), (0, band.columns))
        pixels = pixels[np.isfinite(pixels) if masked is None else np.isfinite(pixels) & ~masked]
        if len(pixels):
            held = pixels[0] if held is None else held
            if (pixels != held).any():
                return
    what = "holds no pixel that is a number" if held is None else f"holds {held:g} in every pixel"
    raise InputError(f"{band.path}: band {band.number} ({band.name}) {what}; give the band as it was exposed")


def _known(preset: Preset, name: str) -> str:
    """The preset's own name of a band; a dash stays one."""
    for known in (*preset.lags, _LEFT_OUT):
        if name.strip().casefold() == known.casefold():
            return known
    raise InputError(
        f"--bands {name!r} is no band of the preset; allowed: {', '.join(preset.lags)}; {_LEFT_OUT} leaves a "
        f"band out{'; ' if preset.without else ''}{preset.without}"
    )


def _in_name(preset: Preset, path: Path) -> str:
    """The band that the name of a file holds as a word of its own."""
    words = {word.casefold() for word in re.split(r"[^A-Za-z0-9]+", path.stem)}
    held = [name for name in preset.lags if name.casefold() in words]
    if len(held) != 1:
        said = f"names {' and '.join(held)}" if held else "names no band of the preset"
        raise InputError(
            f"{path}: the file's name {said}; allowed: {', '.join(preset.lags)}; say which bands the images "
            "are, in their order: --bands NAME,NAME,..."
        )
    return held[0]


def _assumed(preset: Preset, sign: int | None) -> tuple[str, ...]:
    first = next(iter(preset.lags))
    order = "before" if sign == -1 else "after"
    given = "" if sign is None else " (--lag-sign)"
    flight = "straight and level flight over flat ground at height 0"
    return (
        f"{preset.instrument}",
        *preset.sources,
        f"each band is exposed its lag {order} {first}{given}, and looks where it then sees the same ground",
        "line 0 of every image shows the same ground, the columns lie about the middle of the view: bands "
        f"are placed to {preset.offset_sigma_px:g} px and turned to {preset.rotation_sigma:g} rad (1-sigma)",
        flight if not preset.wide else f"{flight}; bands of wide pixels see as wide a field as the fine ones",
    )


def _unknown(preset: Preset, sign: int | None) -> tuple[str, ...]:
    lags = (
        "sign of the lags: staggered detectors look in turn the other way (--lag-sign -). Three bands on one "
        "grid fit either way; of four or more `recover` says where the other sign lays the fourth better"
    )
    return (
        *([lags] if sign is None and not preset.signed else []),
        *(
            []
            if preset.epoch
            else ["epoch: when t = 0 was; times count from line 0 of the band without a lag"]
        ),
        "attitude and orbit: what is recovered is the motion about an even flight, not where the ground lies",
    )


def _common(preset: Preset, first: BandImage) -> str:
    """What all bands have alike but for those of other pixels."""
    wide = preset.wide_of(first.name)
    head = f"[acquisition]\nepoch = {toml_string(preset.epoch)}\n\n" if preset.epoch else ""
    return f"""{head}[platform]
kind = "level-flight"
altitude = {preset.altitude!r}               # m
ground_speed = {preset.ground_speed:.8g}          # m/s

[instrument]
ifov = {preset.ifov * wide:.8g}             # {preset.pixel * wide:g} m / altitude
columns = {first.columns}
line_period = {preset.line_period * wide:.10g}              # s"""


def _band(preset: Preset, band: BandImage, first: BandImage, folder: Path, sign: int) -> str:
    """One band and its image."""
    lag = sign * preset.lags[band.name]
    # 0.0 - 0.0 is not -0.0
    ahead = 0.0 - math.atan(lag * preset.ground_speed / preset.altitude)
    known = f"lag {lag:g} +- {abs(lag) * preset.lag_sigma:.2g} s" if lag else "lags count from here"
    if lag and not preset.lag_sigma:
        known = f"lag {lag:g} s, by the time stamps"
    wide = preset.wide_of(band.name)
    own = (
        ""
        if wide == preset.wide_of(first.name)
        else f"""
ifov = {preset.ifov * wide:.8g}             # {preset.pixel * wide:g} m / altitude
columns = {band.columns}
line_period = {preset.line_period * wide:.10g}"""
    )
    return f"""[[band]]
name = {toml_string(band.name)}
image = {toml_string(path_from(band.path, folder))}
image_band = {band.number}
first_line_time = {lag + 0.0!r}           # s; {known}
look_ahead = {ahead!r} # rad, -atan(lag x speed / altitude)
offset_sigma_px = {preset.offset_sigma_px / wide!r}
rotation_sigma = {preset.rotation_sigma!r}{own}"""


def search(preset: Preset, bands: Sequence[BandImage]) -> list[str]:
    """[matching] of bands of unlike pixels, whose places differ by many of the fine ones; none of others."""
    wide = {preset.wide_of(band.name) for band in bands}
    if len(wide) == 1:
        return []
    far = math.ceil(3.0 * math.sqrt(2.0) * preset.offset_sigma_px / min(wide))
    return [f"[matching]\nsearch_px = [{far}, {far}]   # 3 sigma of the places of two bands, fine pixels"]


def path_from(image: Path, folder: Path) -> str:
    """Where a file is as seen from a folder; its whole path where ``..`` may lead elsewhere."""
    whole, base = Path(os.path.abspath(image)), Path(os.path.abspath(folder))
    if base.resolve() != base or whole.anchor != base.anchor:  # behind a link, on another drive
        return whole.as_posix()
    return Path(os.path.relpath(whole, base)).as_posix()
