"""Writes a simulated pass of synchronous cameras as a user would receive it, with its truth beside it.

Files: ``stereo.toml``, ``cameras.csv``, ``matches.csv`` (or ``observations.csv``, or ``images.csv`` and the
frames it names, in which points are yet to be found), where they are given
``dem.tif`` and ``control_points.csv``; and the truth, which nothing but a score should read:
``orientation-truth.csv``, ``truth-cameras.csv``, ``truth-points.csv``, ``truth-mismatches.csv``, where they
differ from zero ``truth-rates.csv`` and ``truth-focal.csv``. Their contents are described in
``docs/formats.md``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sightline.errors import InputError
from sightline.execution import Step, no_step
from sightline.geometry.surface import Dem
from sightline.photogrammetry.block.point_priors import ControlPoints
from sightline.photogrammetry.sightings import Images
from sightline.simulate.files import write_dem, write_rows
from sightline.simulate.stereo import EPOCH, StereoScenario
from sightline.simulate.stereo_images import Sensor, write_stereo_images
from sightline.simulate.texture import Array


def write_stereo(
    scenario: StereoScenario,
    folder: Path,
    *,
    control_points: int = 0,
    control_sigma: float = 1.0,
    images: bool = False,
    step: Step = no_step,
) -> dict[str, Path]:
    """Write `scenario` into `folder`.

    Parameters
    ----------
    scenario : StereoScenario
    folder : Path
        Exists; files of the same names are replaced.
    control_points : int
        Also write and name so many points of known coordinates.
    control_sigma : float
        m, how well they are known.
    images : bool
        Render the frames and write these in place of points.
    step : callable
        Called with the number of frames that are rendered, and of all.

    Returns
    -------
    dict of str to Path
        What was written, by file name.
    """
    if images and control_points:
        raise InputError("control points name points, which are not written with images; leave them out")
    written = [_write_cameras(folder / "cameras.csv", scenario, scenario.images)]
    written += _write_frames(folder, scenario, step) if images else [_write_points(folder, scenario)]
    if scenario.height_prior is not None and isinstance(scenario.surface, Dem):
        dem = scenario.surface
        written.append(write_dem(folder / "dem.tif", dem.heights, dem.transform, "EPSG:4326"))
    if control_points:
        known = scenario.control_points(control_points, control_sigma)
        written.append(_write_control(folder / "control_points.csv", known))
    written += _write_truth(folder, scenario, points=not images)
    toml = folder / "stereo.toml"
    table = "images.csv" if images else None
    toml.write_text(stereo_toml(scenario, control_points=control_points > 0, images=table))
    return {path.name: path for path in [toml, *written]}


def stereo_toml(scenario: StereoScenario, *, control_points: bool = False, images: str | None = None) -> str:
    """The STEREO file of a pass: what a user would know, never the truth.

    `control_points` as in :func:`write_stereo`; `images` names a table of images in place of points found.
    """
    options = scenario.options
    dem = scenario.height_prior is not None and isinstance(scenario.surface, Dem)
    points = "observations" if options.by_sighting else "matches"
    detector = scenario.given_detectors[0]
    lines = [
        'cameras = "cameras.csv"',
        f'images = "{images}"' if images else f'{points} = "{points}.csv"',
        *(['dem = "dem.tif"', f"dem_sigma = {options.dem_sigma!r}"] if dem else []),
        *(['control_points = "control_points.csv"'] if control_points else []),
        "",
        "[stereo]",
        f'name = "simulated {scenario.case}, seed {scenario.seed}"',
        f'epoch = "{EPOCH}"',
        "",
        "[camera]",
        f"shape = [{detector.shape[0]}, {detector.shape[1]}]",
        f"focal_length_px = {detector.focal_length_px!r}",
        *(['focal_length = "estimate"'] if options.focal_error else []),
        f"principal_point_px = [{detector.principal_point_px[0]!r}, {detector.principal_point_px[1]!r}]",
        'mount = "nominal"',
        "",
        "[noise]",
        *([] if images else [f"sigma_px = {options.sigma_px!r}"]),
        f"sigma_position = {options.sigma_position!r}",
        f"sigma_attitude = {options.sigma_attitude!r}",
        f'attitude_knowledge = "{options.attitude_knowledge}"',
    ]
    if options.attitude_knowledge == "from-position":
        lines.append(f"aim_point = {scenario.pair.aim_point.tolist()!r}")
    return "\n".join([*lines, *_surface_lines(scenario)]) + "\n"


def _surface_lines(scenario: StereoScenario) -> list[str]:
    lines = []
    if scenario.options.earth == "sphere":
        lines.append(f"radii = {list(scenario.pair.radii)!r}")
    if scenario.height_prior is not None and not isinstance(scenario.surface, Dem):
        lines += ["height = 0.0", f"height_sigma = {scenario.options.dem_sigma!r}"]
    return ["", "[surface]", *lines] if lines else []


def _write_cameras(path: Path, scenario: StereoScenario, images: Images) -> Path:
    """``cameras.csv``: one row per image, shot after shot of camera after camera."""
    numbers = np.column_stack([images.t, images.position, images.world_from_body.as_quat()]).tolist()
    names = scenario.cameras
    rows = (
        [names[camera], shot, *values]
        for camera, shot, values in zip(images.camera, images.shot, numbers, strict=True)
    )
    return write_rows(path, "camera,shot,t,x,y,z,qx,qy,qz,qw", rows)


def _write_points(folder: Path, scenario: StereoScenario) -> Path:
    """``matches.csv``, or ``observations.csv`` where sightings are listed one by one."""
    tracks, images = scenario.tracks, scenario.images
    camera, shot = images.camera[tracks.image], images.shot[tracks.image]
    if scenario.options.by_sighting:
        names = np.array(scenario.cameras)[camera]
        rows = zip(names, shot, tracks.point, *tracks.pixels.T.tolist(), strict=True)
        return write_rows(folder / "observations.csv", "camera,shot,point,line,column", rows)
    # both cameras' sightings come by shot and point, and each has its partner
    first, second = (np.flatnonzero(camera == number) for number in (0, 1))
    pixels = np.hstack([tracks.pixels[first], tracks.pixels[second]])
    rows = zip(shot[first], tracks.point[first], *pixels.T.tolist(), strict=True)
    return write_rows(folder / "matches.csv", "shot,point,line_1,column_1,line_2,column_2", rows)


def _write_frames(folder: Path, scenario: StereoScenario, step: Step) -> list[Path]:
    """``images.csv`` and the frames it names."""
    level = scenario.pair.aim_point, scenario.pair.world_from_local
    return list(
        write_stereo_images(
            folder,
            scenario.cameras,
            scenario.true_images,
            scenario.detectors,
            scenario.mounts,
            (scenario.surface, *level),
            Sensor(),
            scenario.seed,
            step,
        ).values()
    )


def _write_control(path: Path, known: ControlPoints) -> Path:
    rows = zip(*known.position.T.tolist(), known.sigma.tolist(), known.point, strict=True)
    return write_rows(path, "x,y,z,sigma,point", rows)


def _write_truth(folder: Path, scenario: StereoScenario, *, points: bool) -> list[Path]:
    def angles(name: str, values: Array) -> Path:
        rows = ([camera, *row] for camera, row in zip(scenario.cameras, values.tolist(), strict=True))
        return write_rows(folder / name, "camera,roll,pitch,yaw", rows)

    written = [
        angles("orientation-truth.csv", scenario.angles),
        _write_cameras(folder / "truth-cameras.csv", scenario, scenario.true_images),
    ]
    if points:
        written += [
            write_rows(
                folder / "truth-points.csv",
                "point,x,y,z",
                ([point, *place] for point, place in enumerate(scenario.points.tolist())),
            ),
            _write_mismatches(folder / "truth-mismatches.csv", scenario),
        ]
    if scenario.options.drift:
        written.append(angles("truth-rates.csv", scenario.rates))
    if scenario.options.focal_error:
        focal = [d.focal_length_px for d in scenario.detectors]
        rows = zip(scenario.cameras, focal, strict=True)
        written.append(write_rows(folder / "truth-focal.csv", "camera,focal_length_px", rows))
    return written


def _write_mismatches(path: Path, scenario: StereoScenario) -> Path:
    """``truth-mismatches.csv``: which sightings are wrong, and by how many pixels."""
    wrong = np.flatnonzero(scenario.mismatched)
    image = scenario.tracks.image[wrong]
    names = np.array(scenario.cameras)[scenario.images.camera[image]]
    shot, point = scenario.images.shot[image], scenario.tracks.point[wrong]
    rows = zip(names, shot, point, *scenario.displacement[wrong].T.tolist(), strict=True)
    return write_rows(path, "camera,shot,point,line,column", rows)
