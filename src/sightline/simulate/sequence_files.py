"""Writes a simulated flight of a filter camera as a user would receive it, with its truth beside it.

Given: ``sequence.toml``; ``frames.csv`` (frame,t,image) and the folder ``frames`` it names; ``positions.csv``
(frame,t,x,y,z,sigma_x,sigma_y,sigma_z) and ``attitudes.csv`` (frame,t,qx,qy,qz,qw,sigma_roll,sigma_pitch,
sigma_yaw), whose sigma is that of the noise alone, without the constant bias; ``dem.tif`` where it is given.

Truth, which nothing but a score should read: ``poses-truth.csv`` (frame,t,x,y,z,qx,qy,qz,qw, at the exposure
of line 0), ``rig-truth.csv`` (of a rig: camera,roll,pitch,yaw,x,y,z,focal_length_px against the first camera;
its ``frames.csv`` is capture,camera,t,image), ``truth-lines.csv`` (the same for the first, middle and last
line of each frame: frame,line,t,...) with a rolling shutter, ``truth-biases.csv`` (quantity,x,y,z),
``truth-focal.csv`` (camera,focal_length_px) where a wrong one is given, ``truth-dem.tif``,
``truth-bands.tif`` (numbers that a few bands should have at every place, without noise; the wavelength of
each in its description and in its tag ``wavelength_nm``) and ``truth-scene.json`` (case, seed, options, where
the spectra are from).

Beside the keys that every reader of SEQUENCE.toml knows, ``[sequence]`` holds ``name`` and ``epoch``, and
``[camera]`` one of ``wavelength_nm`` (one per line), ``mosaic_nm`` (rows of a pattern that repeats from pixel
[0, 0]: pixel (line, column) sees ``mosaic_nm[line % rows][column % columns]``) and ``channel_nm`` (one per
band of the image); none of them: panchromatic. ``docs/formats.md`` describes all of them.
"""

from __future__ import annotations

import dataclasses
import json
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.execution import Progress, Step, silent, stepped, steps_of
from sightline.geometry.rotations import to_quat_xyzw
from sightline.simulate.files import write_dem, write_rows
from sightline.simulate.sequence import EPOCH, SequenceScenario
from sightline.simulate.sequence_options import SequenceOptions
from sightline.simulate.texture import Array
from sightline.writing import whole_raster

FORMATS = ("tif", "png")
_SUBSET_OVERLAP = 0.8
_BLOCK_ROWS = 256
#: m; how well ground without relief is said to be known: 0 would say that its height is not.
_FLAT_SIGMA = 0.1
_POSE = "x,y,z,qx,qy,qz,qw"


def write_sequence(
    scenario: SequenceScenario,
    folder: Path,
    *,
    image_format: str = "tif",
    dem: bool = False,
    truth_bands: int = 5,
    progress: Progress = silent,
) -> dict[str, Path]:
    """Render `scenario` into `folder`, frame by frame.

    Parameters
    ----------
    scenario : SequenceScenario
    folder : Path
        Exists; files of the same names are replaced.
    image_format : str
        One of `FORMATS`.
    dem : bool
        Give the relief; otherwise its mean and how far the heights scatter about it.
    truth_bands : int
        Bands of ``truth-bands.tif``; 0: it is not written.
    progress : callable
        Called with a stage, how much of it is done, and how much it is.

    Returns
    -------
    dict of str to Path
        What was written, by file name; the frames as their folder.
    """
    step = steps_of(progress, f"rendering {len(scenario.frames)} frames")
    if scenario.rig:
        written = _write_captures(scenario, folder, image_format, step)
    else:
        written = [_write_frames(scenario, folder / "frames", image_format, step)]
        images = [f"frames/{_frame_name(frame, image_format)}" for frame in scenario.frames]
        t = scenario.poses[0][list(scenario.frames)].tolist()
        rows = zip(scenario.frames, t, images, strict=True)
        written.append(write_rows(folder / "frames.csv", "frame,t,image", rows))
    written += _write_given_poses(scenario, folder)
    if dem:
        written.append(
            write_dem(folder / "dem.tif", scenario.ground.relief.heights, scenario.ground.relief.transform)
        )
    written += _write_truth(scenario, folder)
    if truth_bands:
        step = steps_of(progress, "rendering the truth of some bands")
        written.append(_write_truth_bands(scenario, folder / "truth-bands.tif", truth_bands, step))
    toml = folder / "sequence.toml"
    toml.write_text(sequence_toml(scenario, dem=dem))
    return {path.name: path for path in [toml, *written]}


def sequence_toml(scenario: SequenceScenario, *, dem: bool = False) -> str:
    """The SEQUENCE file of a flight: what a user would know, not the truth; `dem` as in `write_sequence`."""
    options = scenario.options
    lines = ['frames = "frames.csv"']
    if options.position_sigma > 0.0:
        lines += ['positions = "positions.csv"', f"position_bias_sigma = {options.position_bias_sigma!r}"]
    if options.attitude_sigma > 0.0:
        lines += ['attitudes = "attitudes.csv"', f"attitude_bias_sigma = {options.attitude_bias_sigma!r}"]
    lines += [
        "",
        "[sequence]",
        f'name = "simulated {scenario.case}, seed {scenario.seed}"',
        f'epoch = "{EPOCH}"',
        "",
        "[world]",
        'frame = "local"',
        "",
        *(_rig_lines(scenario) if scenario.rig else _camera_lines(scenario)),
        "[subset]",
        f"overlap = {_SUBSET_OVERLAP!r}",
        "",
        "[surface]",
    ]
    heights = scenario.ground.relief.heights
    if dem:
        lines += ['dem = "dem.tif"', "height_sigma = 0.0"]
    else:
        sigma = max(float(heights.std()), _FLAT_SIGMA)
        lines += [f"height = {float(heights.mean()):.3f}", f"height_sigma = {sigma:.3f}"]
    return "\n".join(lines) + "\n"


def _camera_lines(scenario: SequenceScenario) -> list[str]:
    """``[camera]``."""
    options = scenario.options
    return [
        "[camera]",
        f"shape = [{options.shape[0]}, {options.shape[1]}]",
        f"focal_length_px = {options.given_focal_length_px!r}",
        *_focal_sigma(options),
        f"principal_point_px = [{options.centre_px[0]!r}, {options.centre_px[1]!r}]",
        f"distortion = {list(options.distortion)!r}",
        'mount = "nominal"',
        *_filter_lines(scenario),
        *([f"readout_time = {options.readout_time!r}"] if options.readout_time else []),
        "",
    ]


def _rig_lines(scenario: SequenceScenario) -> list[str]:
    """``[[camera]]`` of each camera of a rig."""
    options, lines = scenario.options, []
    for number, camera in enumerate(scenario.rig):
        lens = camera.detector
        lines += [
            "[[camera]]",
            f'name = "{camera.name}"',
            f"shape = [{options.shape[0]}, {options.shape[1]}]",
            f"focal_length_px = {lens.focal_length_px / (1.0 + options.focal_error)!r}",
            *(_focal_sigma(options) if number == 0 else []),
            f"principal_point_px = [{lens.principal_point_px[0]!r}, {lens.principal_point_px[1]!r}]",
            f"distortion = {list(lens.distortion)!r}",
            f"wavelength_nm = {float(camera.filter.given_nm[0, 0, 0])!r}",
        ]
        if number:
            lines += [
                "orientation_offset = [0.0, 0.0, 0.0]",
                f"orientation_offset_sigma = {options.rig_angle_sigma!r}",
                f"position_offset = {camera.given_position.tolist()!r}",
                f"position_offset_sigma = {options.rig_place_sigma!r}",
            ]
        lines.append("")
    return lines


def _write_captures(scenario: SequenceScenario, folder: Path, image_format: str, step: Step) -> list[Path]:
    """Images of all cameras of a rig, their table, and how the cameras truly sit."""
    (folder / "frames").mkdir(exist_ok=True)
    rows = []
    for frame in stepped(scenario.frames, step):
        for number, camera in enumerate(scenario.rig):
            if (frame, number) in scenario.options.rig_missing:
                continue
            name = f"frames/capture-{frame:05d}-{number + 1}.{image_format}"
            _write_image(folder / name, scenario.image(frame, number))
            if frame in scenario.options.unreadable:
                path = folder / name
                path.write_bytes(path.read_bytes()[: path.stat().st_size // 4])
            rows.append([frame, camera.name, scenario.flight.time(frame), name])
    truth = [
        [c.name, *c.orientation.as_rotvec().tolist(), *c.position.tolist(), c.detector.focal_length_px]
        for c in scenario.rig
    ]
    return [
        folder / "frames",
        write_rows(folder / "frames.csv", "capture,camera,t,image", rows),
        write_rows(folder / "rig-truth.csv", "camera,roll,pitch,yaw,x,y,z,focal_length_px", truth),
    ]


def _focal_sigma(options: SequenceOptions) -> list[str]:
    """How well the focal length is known, where a wrong one is given."""
    if not options.focal_error:
        return []
    return [f"focal_length_sigma_px = {abs(options.focal_error) * options.given_focal_length_px!r}"]


def _filter_lines(scenario: SequenceScenario) -> list[str]:
    kind, given_nm = scenario.filter.kind, np.round(scenario.filter.given_nm, 3)
    if kind == "pan":
        return []
    if kind == "rgb":
        return [f"channel_nm = {given_nm[:, 0, 0].tolist()!r}"]
    if kind == "mosaic":
        return [f"mosaic_nm = {given_nm[0].tolist()!r}"]
    return [f"wavelength_nm = {given_nm[0, :, 0].tolist()!r}"]


def _frame_name(frame: int, image_format: str) -> str:
    return f"frame-{frame:05d}.{image_format}"


def _write_frames(scenario: SequenceScenario, folder: Path, image_format: str, step: Step) -> Path:
    folder.mkdir(exist_ok=True)
    for frame in stepped(scenario.frames, step):
        path = folder / _frame_name(frame, image_format)
        _write_image(path, scenario.image(frame))
        if frame in scenario.options.unreadable:
            # as a card pulled out too early leaves it
            path.write_bytes(path.read_bytes()[: path.stat().st_size // 4])
    return folder


def _write_image(path: Path, image: NDArray[np.generic]) -> None:
    """An image (channels, lines, columns) of 8 or 16 bits without georeferencing."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    channels, lines, columns = image.shape
    profile = {"dtype": image.dtype.name, "count": channels, "height": lines, "width": columns}
    profile["driver"] = "PNG" if path.suffix == ".png" else "GTiff"
    if channels == 3:
        profile["photometric"] = "RGB"
    with warnings.catch_warnings():
        # an image in sensor geometry has no georeferencing, by nature
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with whole_raster(path) as draft, rasterio.open(draft, "w", **profile) as target:
            target.write(image)


def _write_given_poses(scenario: SequenceScenario, folder: Path) -> list[Path]:
    """Given positions and attitudes of the frames that are delivered."""
    options, frames = scenario.options, list(scenario.frames)
    t = scenario.poses[0][frames]
    written = []
    for sigma, name, header, values in (
        (options.position_sigma, "positions", "x,y,z,sigma_x,sigma_y,sigma_z", scenario.given_positions),
        (
            options.attitude_sigma,
            "attitudes",
            "qx,qy,qz,qw,sigma_roll,sigma_pitch,sigma_yaw",
            to_quat_xyzw(scenario.given_attitudes),
        ),
    ):
        if sigma > 0.0:
            table = np.column_stack([t, values[frames], np.full((len(frames), 3), sigma)]).tolist()
            rows = ([frame, *row] for frame, row in zip(frames, table, strict=True))
            written.append(write_rows(folder / f"{name}.csv", f"frame,t,{header}", rows))
    return written


def _write_truth(scenario: SequenceScenario, folder: Path) -> list[Path]:
    frames = list(scenario.frames)
    t, position, attitude = scenario.poses
    table = np.column_stack([t, position, to_quat_xyzw(attitude)])[frames].tolist()
    rows = ([frame, *row] for frame, row in zip(frames, table, strict=True))
    place, turn = scenario.biases
    written = [
        write_rows(folder / "poses-truth.csv", f"frame,t,{_POSE}", rows),
        write_rows(
            folder / "truth-biases.csv",
            "quantity,x,y,z",
            [["position", *place.tolist()], ["attitude", *turn.tolist()]],
        ),
        write_dem(folder / "truth-dem.tif", scenario.ground.relief.heights, scenario.ground.relief.transform),
        _write_scene(scenario, folder / "truth-scene.json"),
    ]
    if scenario.options.focal_error:
        row = [["1", scenario.options.focal_length_px]]
        written.append(write_rows(folder / "truth-focal.csv", "camera,focal_length_px", row))
    if scenario.options.readout_time:
        written.append(_write_lines(scenario, folder / "truth-lines.csv"))
    return written


def _write_lines(scenario: SequenceScenario, path: Path) -> Path:
    """True poses of the first, the middle and the last line of every frame."""
    last = scenario.options.shape[0] - 1
    lines = np.array([0.0, 0.5 * last, last])
    rows = []
    for frame in scenario.frames:
        t = scenario.flight.time(frame) + scenario.options.readout_time * lines / last
        position, attitude = scenario.flight.at(scenario.flight.leg_of(frame), t)
        table = np.column_stack([lines, t, position, to_quat_xyzw(attitude)]).tolist()
        rows += [[frame, *row] for row in table]
    return write_rows(path, f"frame,line,t,{_POSE}", rows)


def _write_scene(scenario: SequenceScenario, path: Path) -> Path:
    spectra = scenario.ground.spectra
    content = {
        "case": scenario.case,
        "seed": scenario.seed,
        "options": dataclasses.asdict(scenario.options),
        "spectra": {
            "from": spectra.name,
            "wavelength_nm": spectra.wavelength_nm.tolist(),
            "brightness": spectra.brightness.tolist(),
            "share": spectra.share.tolist(),
        },
        "gsd": scenario.options.gsd,
        "speed": scenario.options.speed,
    }
    path.write_text(json.dumps(content, indent=1) + "\n")
    return path


def truth_wavelengths(scenario: SequenceScenario, count: int) -> Array:
    """(n,) nm of the bands of ``truth-bands.tif``: `count` of those that the filter has, evenly chosen."""
    there = scenario.band_nm
    return there[np.unique(np.linspace(0, len(there) - 1, min(count, len(there))).round().astype(int))]


def _write_truth_bands(scenario: SequenceScenario, path: Path, count: int, step: Step) -> Path:
    """True numbers of a few bands over all that is seen, a ground pixel apart, block by block."""
    import rasterio
    from rasterio.transform import Affine
    from rasterio.windows import Window

    wavelengths = truth_wavelengths(scenario, count)
    gsd, seen = scenario.options.gsd, scenario.seen
    columns, rows = (int(np.ceil(length / gsd)) for length in seen.size)
    profile = {
        "driver": "GTiff",
        "dtype": "float32",
        "count": len(wavelengths),
        "height": rows,
        "width": columns,
        "transform": Affine(gsd, 0.0, seen.west, 0.0, -gsd, seen.north),
        "tiled": True,
        "bigtiff": "if_safer",
    }
    x = seen.west + gsd * (np.arange(columns) + 0.5)
    with whole_raster(path) as draft, rasterio.open(draft, "w", **profile) as target:
        for band, nm in enumerate(wavelengths, start=1):
            target.set_band_description(band, "all light" if np.isnan(nm) else f"{nm:.3f} nm")
            target.update_tags(band, wavelength_nm="" if np.isnan(nm) else f"{nm:.3f}")
        for first in stepped(range(0, rows, _BLOCK_ROWS), step):
            y = seen.north - gsd * (np.arange(first, min(first + _BLOCK_ROWS, rows)) + 0.5)
            east, north = np.meshgrid(x, y)
            block = scenario.band_signal(east, north, wavelengths)
            window = Window(0, first, columns, len(y))
            target.write(np.moveaxis(block, 2, 0), window=window)
    return path
