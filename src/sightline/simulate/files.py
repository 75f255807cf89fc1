"""Writes a simulated strip as a user would receive it, with its truth beside it.

Files: ``acquisition.toml`` and the images it names (12-bit numbers in 16-bit GeoTIFF), optionally
``dem.tif``, ``star_tracker.csv`` and ``gyro.csv``; and the truth, ``truth.csv`` (motion at every line) and
``truth-bands.csv`` (offsets and rotations of the detector lines), which nothing but a score should read.
Their contents are described in ``docs/formats.md``.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.execution import Step, no_step, part_of, stepped
from sightline.simulate.frames import FrameScenario
from sightline.simulate.scenarios import StripScenario
from sightline.simulate.scene import Relief
from sightline.simulate.strip_options import StripOptions
from sightline.simulate.texture import Array
from sightline.writing import whole_raster

CONTROL_POINTS = "control_points.csv"
#: rad and rad/s: what an ACQUISITION file that says nothing of them means (its schema; a test compares).
ATTITUDE_KNOWN = {"attitude_sigma": 1e-2, "rate_sigma": 1e-3}


def write_strip(
    scenario: StripScenario,
    folder: Path,
    *,
    dem: bool = True,
    star_tracker: bool = False,
    gyro: bool = False,
    control_points: int = 0,
    step: Step = no_step,
) -> dict[str, Path]:
    """Render `scenario` into `folder`.

    Parameters
    ----------
    scenario : StripScenario
    folder : Path
        Exists; files of the same names are replaced.
    dem : bool
        Write ``dem.tif`` where the scene has relief, and name it in the TOML; otherwise the TOML gives the
        mean height and, as ``height_sigma``, the standard deviation of the relief about it.
    star_tracker, gyro : bool
        Also write and name the attitude tables.
    control_points : int
        Also write and name so many ground control points, known to a metre.
    step : callable
        Called with the number of lines that are rendered, and of all.

    Returns
    -------
    dict of str to Path
        What was written, by file name.
    """
    written: list[Path] = []
    for index, band in enumerate(scenario.bands):
        path = folder / f"{band.name}.tif"
        lines = part_of(step, index, len(scenario.bands))
        write_image(path, scenario.shapes[index], scenario.chunks(index), lines)
        written.append(path)
        counts = scenario.options.column_stages(index)
        if counts is not None and (counts != counts[0]).any():
            rows = enumerate(counts.tolist())
            written.append(write_rows(folder / _stage_table(band.name), "column,stages", rows))
    relief = scenario.scene.relief
    if relief is not None and dem:
        written.append(write_dem(folder / "dem.tif", relief.heights, relief.transform))
    header = "t,roll,pitch,yaw"
    written.append(write_numbers(folder / "truth.csv", header, scenario.truth))
    written.append(_write_band_truth(folder / "truth-bands.csv", scenario))
    sensors = []
    if star_tracker:
        written.append(write_numbers(folder / "star_tracker.csv", header + ",sigma", scenario.star_tracker()))
        sensors.append(("star-tracker", "star_tracker.csv"))
    if gyro:
        columns = "t_start,t_end,roll,pitch,yaw,sigma"
        written.append(write_numbers(folder / "gyro.csv", columns, scenario.gyro()))
        sensors.append(("gyro", "gyro.csv"))
    if control_points > 0:
        written.append(_write_control(folder / CONTROL_POINTS, *scenario.control_points(control_points)))
    toml = folder / "acquisition.toml"
    text = acquisition_toml(scenario, dem=dem, sensors=sensors, control_points=control_points > 0)
    toml.write_text(text)
    return {path.name: path for path in [toml, *written]}


def acquisition_toml(
    scenario: StripScenario,
    *,
    dem: bool = True,
    sensors: Sequence[tuple[str, str]] = (),
    control_points: bool = False,
) -> str:
    """The ACQUISITION file of a strip: what a user would know, never the truth.

    `sensors` are pairs of kind and table file; `dem` as in :func:`write_strip`.
    """
    options = scenario.options
    lines = [
        "[acquisition]",
        f'name = "simulated {scenario.case}, seed {scenario.seed}"',
        'epoch = "2026-01-01T00:00:00Z"',
        *([f'control_points = "{CONTROL_POINTS}"'] if control_points else []),
        "",
        "[platform]",
        'kind = "level-flight"',
        *(f"{name} = {sigma!r}" for name, sigma in attitude_known(scenario.truth).items()),
        f"altitude = {options.altitude!r}",
        f"ground_speed = {options.ground_speed!r}",
        "",
        "[instrument]",
        f"ifov = {options.ifov!r}",
        f"columns = {options.columns}",
        f"line_period = {options.line_period!r}",
    ]
    for index, band in enumerate(scenario.bands):
        lines += [
            "",
            "[[band]]",
            f'name = "{band.name}"',
            f'image = "{band.name}.tif"',
            f"look_ahead = {band.look_ahead!r}",
            "offset_px = [0.0, 0.0]",
            f"offset_sigma_px = {options.offset_sigma_px!r}",
            "rotation = 0.0",
            f"rotation_sigma = {options.rotation_sigma!r}",
            *([f"scale_sigma = {options.scale_sigma!r}"] if options.scale_sigma else []),
            *(f"{key} = {_toml(value)}" for key, value in scenario.shape_known(index).items()),
            f"first_line_time = {options.first_time(index)!r}",
            *_own_size(options, index),
            *_stages(options, index),
        ]
    lines += ["", "[surface]", *_surface_lines(scenario.scene.relief, dem)]
    for kind, table in sensors:
        lines += ["", "[[attitude_sensor]]", f'kind = "{kind}"', f'table = "{table}"']
    return "\n".join(lines) + "\n"


def attitude_known(truth: Array) -> dict[str, float]:
    """How well the attitude is known, by key of [platform], where it moves further than is taken for granted.

    Some px at the edge of a narrow field are a yaw, and a rate of yaw, that few platforms have.

    Parameters
    ----------
    truth : (N, 4)
        s, rad; instants, roll, pitch, yaw.
    """
    t, angles = truth[:, 0], truth[:, 1:]
    mean, even = np.abs(np.polynomial.polynomial.polyfit(t - t.mean(), angles, 1)).max(axis=1)
    said = {}
    for (name, usual), most in zip(ATTITUDE_KNOWN.items(), (mean, even), strict=True):
        if most > usual:
            digit = 10.0 ** np.floor(np.log10(most))
            said[name] = float(f"{np.ceil(most / digit) * digit:.0e}")
    return said


def _toml(value: str | float | tuple[int, ...]) -> str:
    """A value as TOML writes it."""
    if isinstance(value, str):
        return f'"{value}"'
    return repr(list(value)) if isinstance(value, tuple) else repr(value)


def _own_size(options: StripOptions, band: int) -> list[str]:
    """Keys of a band whose pixels are not those of the instrument."""
    along, across = options.ratios(band)
    if along == across == 1.0:
        return []
    return [
        f"ifov = {options.ifov * across!r}",
        f"columns = {options.shape(band)[1]}",
        f"line_period = {options.line_period * along!r}",
    ]


def _stages(options: StripOptions, band: int) -> list[str]:
    """Keys of a band with TDI; what differs from column to column is in a table."""
    if not options.stages:
        return []
    alike = len(set(options.stages)) == 1
    said = str(options.stages[0]) if alike else f'"{_stage_table(options.names[band])}"'
    return [f"stages = {said}", f'time_reference = "{options.time_reference}"']


def _stage_table(band: str) -> str:
    """Name of the table of the stages of a band's columns."""
    return f"{band}_stages.csv"


def _surface_lines(relief: Relief | None, dem: bool) -> list[str]:
    if relief is None:
        return ["height = 0.0", "height_sigma = 0.0"]
    if dem:
        return ['dem = "dem.tif"', "height_sigma = 0.0"]
    mean, sigma = float(relief.heights.mean()), float(relief.heights.std())
    return [f"height = {mean:.3f}", f"height_sigma = {sigma:.3f}"]


def write_image(
    path: Path,
    shape: tuple[int, int],
    chunks: Iterator[tuple[int, NDArray[np.uint16]]],
    step: Step = no_step,
) -> Path:
    """A single-band 16-bit TIFF without georeferencing, written chunk by chunk, its lines counted."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning
    from rasterio.windows import Window

    profile = {"driver": "GTiff", "dtype": "uint16", "count": 1, "height": shape[0], "width": shape[1]}
    with warnings.catch_warnings():
        # an image in sensor geometry has no georeferencing, by nature
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with whole_raster(path) as draft, rasterio.open(draft, "w", **profile) as target:
            for first, block in chunks:
                target.write(block, 1, window=Window(0, first, shape[1], block.shape[0]))
                step(first + block.shape[0], shape[0])
    return path


def write_dem(path: Path, heights: Array, transform: Sequence[float], crs: str | None = None) -> Path:
    """Heights as a float64 GeoTIFF; without a coordinate system in local metres (x east, y north).

    Parameters
    ----------
    path : Path
    heights : (rows, columns)
        m.
    transform : (6,)
        Coefficients a, b, c, d, e, f: x = a column + b row + c, y = d column + e row + f.
    crs : str, optional
        Such as "EPSG:4326": longitude, latitude.
    """
    import rasterio
    from rasterio.transform import Affine

    rows, columns = heights.shape
    profile = {
        "driver": "GTiff",
        "dtype": "float64",
        "count": 1,
        "height": rows,
        "width": columns,
        "crs": crs,
        "transform": Affine(*transform),
    }
    with whole_raster(path) as draft, rasterio.open(draft, "w", **profile) as target:
        target.write(heights, 1)
    return path


def write_rows(path: Path, header: str, rows: Iterable[Iterable[object]]) -> Path:
    """A CSV whose numbers read back to the same float64."""
    text = (",".join(map(str, row)) for row in rows)
    path.write_text("\n".join([header, *text]) + "\n")
    return path


def write_numbers(path: Path, header: str, table: Array) -> Path:
    """A CSV of numbers that read back to the same float64."""
    rows = [",".join(repr(float(value)) for value in row) for row in table]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def _write_control(path: Path, images: Sequence[str], table: Array) -> Path:
    rows = [
        ",".join([*(repr(float(v)) for v in row[:4]), image, *(repr(float(v)) for v in row[4:])])
        for image, row in zip(images, table, strict=True)
    ]
    path.write_text("\n".join(["x,y,z,sigma,image,line,column", *rows]) + "\n")
    return path


def _write_band_truth(path: Path, scenario: StripScenario) -> Path:
    rows = ["name,lag,look_ahead,offset_line_px,offset_column_px,rotation"]
    rows += [
        f"{band.name},{band.lag!r},{band.look_ahead!r},{band.offset_px[0]!r},{band.offset_px[1]!r},"
        f"{band.rotation!r}"
        for band in scenario.bands
    ]
    path.write_text("\n".join(rows) + "\n")
    return path


def write_frames(
    scenario: FrameScenario, folder: Path, *, estimate_camera: bool = False, step: Step = no_step
) -> dict[str, Path]:
    """Render a sequence of frames into `folder`: images, ``acquisition.toml``, ``truth.csv``, DEM if any.

    Parameters
    ----------
    scenario : FrameScenario
    folder : Path
        Exists; files of the same names are replaced.
    estimate_camera : bool
        Write the focal length 1 % off, with the distortion and itself left to be estimated.
    step : callable
        Called with the number of frames that are rendered, and of all.

    Returns
    -------
    dict of str to Path
        What was written, by file name. ``truth-frames.csv`` holds each frame's written and true time.
    """
    written: list[Path] = []
    names = [f"frame-{index:03d}.tif" for index in range(scenario.options.frames)]
    for index, name in enumerate(stepped(names, step)):
        written.append(write_image(folder / name, scenario.options.shape, scenario.chunks(index)))
    if scenario.scene.relief is not None:
        relief = scenario.scene.relief
        written.append(write_dem(folder / "dem.tif", relief.heights, relief.transform))
    written.append(write_numbers(folder / "truth.csv", "t,roll,pitch,yaw", scenario.truth))
    times = np.column_stack([scenario.nominal_times, scenario.times])
    written.append(write_numbers(folder / "truth-frames.csv", "time_written,time_true", times))
    toml = folder / "acquisition.toml"
    toml.write_text(frames_toml(scenario, names, estimate_camera=estimate_camera))
    return {path.name: path for path in [toml, *written]}


def frames_toml(scenario: FrameScenario, images: Sequence[str], *, estimate_camera: bool = False) -> str:
    """The ACQUISITION file of a sequence of frames; arguments as in :func:`write_frames`."""
    options = scenario.options
    focal = options.focal_length_px * (1.01 if estimate_camera else 1.0)
    distortion = '"estimate"' if estimate_camera else repr(list(options.distortion))
    lines = [
        "[acquisition]",
        f'name = "simulated frames, seed {scenario.seed}"',
        'epoch = "2026-01-01T00:00:00Z"',
        "",
        "[platform]",
        'kind = "level-flight"',
        f"altitude = {options.altitude!r}",
        f"ground_speed = {options.ground_speed!r}",
        "",
        "[camera]",
        f"shape = [{options.shape[0]}, {options.shape[1]}]",
        f"focal_length_px = {focal!r}",
        f"principal_point_px = [{options.centre_px[0]!r}, {options.centre_px[1]!r}]",
        f"distortion = {distortion}",
    ]
    if estimate_camera:
        lines.append(f"focal_length_sigma_px = {0.02 * options.focal_length_px!r}")
    for name, t in zip(images, scenario.nominal_times, strict=True):
        lines += ["", "[[frame]]", f'image = "{name}"', f"time = {float(t)!r}"]
        lines.append(f"time_sigma = {options.time_sigma!r}")
    lines += ["", "[surface]", *_surface_lines(scenario.scene.relief, dem=True)]
    return "\n".join(lines) + "\n"
