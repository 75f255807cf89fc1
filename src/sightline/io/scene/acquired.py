"""An ACQUISITION.toml whose images are yet to be simulated: the cameras and keys of another, images anew.

What was measured of the real flight (attitude sensors, control points, known motion, masks) is left out: it
is not true of the simulated one.

Not here: rendering (``simulate/acquired.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sightline.access import inner_image, located, remote_name
from sightline.errors import InputError, SightlineError
from sightline.execution import Step, no_step, part_of
from sightline.geometry.surface import Infinity
from sightline.io.acquisition.load import acquisition_of_size, load_acquisition
from sightline.io.acquisition.schema import AcquisitionFile, BandSection, KnownAttitude
from sightline.io.config import read_toml, validate
from sightline.io.init.bands import path_from
from sightline.io.names import file_stems, toml_value
from sightline.simulate.acquired import AcquiredOptions, AcquiredScenario, cropped
from sightline.simulate.files import attitude_known, write_image, write_numbers

#: Names of files in the folder of a scene beside its images.
TOML, TRUTH, BAND_TRUTH = "acquisition.toml", "truth.csv", "truth-bands.csv"
#: Keys that name files, by table.
_FILES = {
    "platform": ("positions", "attitudes", "earth_orientation", "model"),
    "pointing": ("angles",),
    "instrument": ("directions",),
    "surface": ("dem", "geoid"),
    "band": ("directions", "line_times", "stages", "quality", "model"),
}
#: What these say when they name none.
_WORDS = ("along-track",)
#: Tables that are true of the real flight alone.
_MEASURED = ("attitude_sensor", "control_point", "known_motion")


@dataclass(frozen=True)
class AcquiredFile:
    """An acquisition, and how much of its images is rendered.

    Attributes
    ----------
    path : Path
    tables : mapping
        As the file has them.
    config : AcquisitionFile
    shapes, sizes : mapping
        Lines and columns of the acquisition's images, and of those that are rendered, by band.
    """

    path: Path
    tables: Mapping[str, Any]
    config: AcquisitionFile
    shapes: Mapping[str, tuple[int, int]]
    sizes: Mapping[str, tuple[int, int]]


def read_acquired(options: AcquiredOptions) -> AcquiredFile:
    """The acquisition that options name.

    Raises
    ------
    InputError
        None is named; it has frames, or no ground.
    FormatError, SpanError, GeometryError
        As `load_acquisition`.
    """
    if not options.acquisition:
        raise InputError("the acquisition whose cameras see the scene is missing; give --acquisition FILE")
    path = Path(options.acquisition)
    raw = read_toml(path)
    config = validate(AcquisitionFile, raw, path)
    if not config.band:
        raise InputError(
            f"{path}: has no [[band]]: bands of line detectors are simulated; "
            "for frames: simulate line-of-sight --case frames"
        )
    given = load_acquisition(path, look=False, describe=True)
    if isinstance(given.surface, Infinity):
        raise InputError(f'{path}: [surface] kind = "infinity": there is no ground to render; give a height')
    shapes = [band.camera.shape for band in given.bands]
    if given.absent and config.platform.kind != "camera-model":
        # nothing says how many lines there are
        longer = max(1.0, options.lines / shapes[0][0])
        shapes = [(int(np.ceil(lines * longer - 1e-9)), columns) for lines, columns in shapes]
    sizes = cropped(shapes, options.lines, options.columns)
    names = [band.name for band in config.band]
    by_name = (dict(zip(names, of, strict=True)) for of in (shapes, sizes))
    file = AcquiredFile(path, raw, config, *by_name)
    for band in config.band:
        _refuse_cut_tables(file, band)
    return file


def _refuse_cut_tables(file: AcquiredFile, band: BandSection) -> None:
    """InputError where fewer lines or columns are rendered than a table of the band has."""
    whole, size = file.shapes[band.name], file.sizes[band.name]
    stages = band.stages if isinstance(band.stages, str) else None
    directions = band.directions or (None if band.ifov else file.config.instrument.directions)
    of_lines = {"line_times": band.line_times, "stages": stages}
    of_columns = {"directions": directions, "stages": stages, "quality": band.quality, "pieces": band.pieces}
    for axis, word, keys in ((0, "lines", of_lines), (1, "columns", of_columns)):
        named = [key for key, value in keys.items() if value is not None]
        if named and size[axis] < whole[axis]:
            raise InputError(
                f"{file.path}: {named[0]} of band {band.name} is of {whole[axis]} {word}, {size[axis]} would "
                f"be rendered; give --{word} {next(iter(file.shapes.values()))[axis]}, or an acquisition of "
                "the part"
            )


def acquired_scenario(
    file: AcquiredFile, seed: int, options: AcquiredOptions, place: Path
) -> AcquiredScenario:
    """The strip of an acquisition, read as `recover` will read it; `place` is a folder without its images."""
    toml = place / TOML
    toml.write_text(acquired_toml(file, seed, place), encoding="utf-8")
    try:
        given = acquisition_of_size(toml, file.sizes)
    except SightlineError as error:
        lines, columns = next(iter(file.sizes.values()))
        said = f"{file.path}, its first {lines} lines and {columns} columns"
        raise type(error)(str(error).replace(str(toml), said)) from error
    return AcquiredScenario(given.bands, given.surface, seed, options)


def write_acquired(
    scenario: AcquiredScenario, file: AcquiredFile, folder: Path, out: Path, step: Step = no_step
) -> dict[str, Path]:
    """Render a strip of the cameras of an acquisition.

    Parameters
    ----------
    scenario : AcquiredScenario
    file : AcquiredFile
    folder : Path
        Exists; files of the same names are replaced.
    out : Path
        Where the files will lie: their paths are written as from there.
    step : callable
        Called with the number of lines that are rendered, and of all.

    Returns
    -------
    dict of str to Path
        What was written, by file name.
    """
    written = []
    for index, name in enumerate(_images(file)):
        camera = scenario.cameras[index]
        lines = part_of(step, index, len(scenario.cameras))
        written.append(write_image(folder / name, camera.shape, scenario.chunks(index), lines))
    written.append(write_numbers(folder / TRUTH, "t,roll,pitch,yaw", scenario.truth))
    written.append(_write_band_truth(folder / BAND_TRUTH, scenario))
    toml = folder / TOML
    toml.write_text(acquired_toml(file, scenario.seed, out, attitude_known(scenario.truth)), encoding="utf-8")
    return {path.name: path for path in [toml, *written]}


def acquired_toml(
    file: AcquiredFile, seed: int, place: Path, attitude: Mapping[str, float] | None = None
) -> str:
    """The ACQUISITION file of the strip, its paths as seen from the folder `place`.

    `attitude` says how well the attitude is known, by key of [platform], where the file does not.
    """
    found = {name: table for name, table in file.tables.items() if name not in _MEASURED}
    header = {
        key: value
        for key, value in found.pop("acquisition", {}).items()
        if key not in ("control_points", "control_sigma_px")
    }
    name = f"simulated: {file.config.acquisition.name}, seed {seed}"[:500]
    found = {"acquisition": {**header, "name": name}, **found}
    for table, keys in _FILES.items():
        rows = found.get(table, {})
        each = rows if isinstance(rows, list) else [rows]
        moved = [_moved(row, keys, file.path.parent, place) for row in each]
        if table in found:
            found[table] = moved if isinstance(rows, list) else moved[0]
    if attitude and isinstance(file.config.platform, KnownAttitude):
        found["platform"] = {**attitude, **found["platform"]}
    found["band"] = [
        _band_table(file, row, image) for row, image in zip(found["band"], _images(file), strict=True)
    ]
    if "files" in found:
        allowed = found["files"].get("allow", [])
        found["files"] = {"allow": [path_from(file.path.parent / folder, place) for folder in allowed]}
    if "features" in found.get("matching", {}):
        kept = found["matching"].items()
        found["matching"] = {key: value for key, value in kept if key not in ("select", "features")}
    return "\n".join(_toml_lines(found))


def acquired_files(file: AcquiredFile) -> list[str]:
    """Names of all files of the strip."""
    return [TOML, *_images(file), TRUTH, BAND_TRUTH]


def _images(file: AcquiredFile) -> list[str]:
    """Names of the images of all bands."""
    return [f"{stem}.tif" for stem in file_stems(band.name for band in file.config.band)]


def _moved(row: Mapping[str, Any], keys: Sequence[str], folder: Path, place: Path) -> dict[str, Any]:
    """A table whose files are named as seen from `place` in place of `folder`."""
    moved = dict(row)
    for key in keys:
        name = row.get(key)
        if isinstance(name, str) and name not in _WORDS:
            path = located(folder, name)
            # addresses, and what lies within archives, are where they are
            moved[key] = (
                path_from(path, place)
                if remote_name(path) is None and inner_image(path) is None
                else str(path)
            )
    return moved


def _band_table(file: AcquiredFile, row: Mapping[str, Any], image: str) -> dict[str, Any]:
    """A ``[[band]]`` of the simulated image, which may be a part of the acquisition's."""
    band = {key: value for key, value in row.items() if key not in ("image_band", "mask")}
    band = {"name": band["name"], **band, "image": image}
    whole, size = file.shapes[band["name"]], file.sizes[band["name"]]
    if size == whole:
        return band
    if file.config.platform.kind == "camera-model":
        band.setdefault("first_pixel", [0, 0])
    elif size[1] < whole[1]:
        band["columns"] = size[1]  # a shorter detector about the same middle
    return band


def _toml_lines(found: Mapping[str, Any]) -> Iterator[str]:
    """Tables of keys as TOML has them."""
    for name, table in found.items():
        for row in table if isinstance(table, list) else [table]:
            yield f"[[{name}]]" if isinstance(table, list) else f"[{name}]"
            yield from (f"{key} = {toml_value(value)}" for key, value in row.items())
            yield ""


def _write_band_truth(path: Path, scenario: AcquiredScenario) -> Path:
    """Offsets, rotations and scales of the detector lines as they truly are."""
    rows = ["name,offset_line_px,offset_column_px,rotation,scale"]
    for band, true in zip(scenario.given, scenario.bands, strict=True):
        numbers = (*true.offset_px, true.rotation, true.scale)
        rows.append(",".join([band.name, *(repr(float(value)) for value in numbers)]))
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path
