"""What cube to make of a frame sequence: its map, its bands, and how frames see the ground.

Not here: making it (``applications/frame_cube.py``), heights of the ground (``cube_ground.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.instrument import AreaDetector
from sightline.photogrammetry.flight.outlook import overlap_of
from sightline.photogrammetry.flight.path import stretches
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.rolling_shutter import line_poses
from sightline.photogrammetry.sightings import Images
from sightline.products.cube_bands import BandLayout, camera_bands, frame_bands, line_bands
from sightline.products.cube_grid import CubeGrid, MapSystem, map_system
from sightline.products.cube_ground import UsedGround, frame_outlines, given_heights
from sightline.products.frame_cube import FrameViews, covering_grid

Array = NDArray[np.float64]

SURFACES = ("auto", "model", "given")


@dataclass(frozen=True)
class CubePlan:
    """What cube to make.

    Attributes
    ----------
    gsd : float or None
        m, side of a pixel; None: as large as pixels of the frames are on the ground.
    bands : int, tuple of float or None
        How many, or their wavelengths (nm); None: each step of a filter that has steps, else as many as leave
        each enough lines for the steps flown.
    surface : str
        "model" (heights of the points found), "given" (what the problem says), "auto".
    fill_nm : float or None
        How far beyond a band's own wavelengths lines of a filter may stand in where a step between frames was
        too long; None: less than half the band's width.
    flatten : bool
        Make the lines of a filter alike before they are resampled.
    picture : bool
        Make the pictures before and after.
    fit : bool
        Match bands against each other.
    picture_nm : (float, float, float) or None
        nm; red, green and blue of the pictures, each the band nearest to it, for false colours too. None:
        650, 550, 470 where the bands reach them, else the longest, the middle and the shortest wavelength.
    sharpness : float
        A frame less sharp than this share of the usual one is used only where no other shows a place. 0.6:
        focus and shake vary by less from frame to frame; 0 uses all alike.
    adrift : float
        Share of a frame's shorter side. A frame whose pose is interpolated is left out where its view may be
        wrong by more (1-sigma): 0.25, as one such frame would stretch the map by a part of a frame.
    surface_margin : float
        With "auto" the given surface is kept while points miss it by no more than so many times what
        they miss their own by. 1.2: a DEM as good at the points as their own surface is better between them.
    lines_per_step : float
        Steps from frame to frame that the lines of a band cover, where the number of bands is not given. 1.5:
        steps of a flight vary by less than half; more gives fewer bands with fewer gaps.
    fit_search_px : (int, int)
        px (rows, columns); how far bands may lie off each other and still be matched. 6: poses of rough
        tables leave less.
    """

    gsd: float | None = None
    bands: int | tuple[float, ...] | None = None
    surface: str = "auto"
    fill_nm: float | None = None
    flatten: bool = True
    picture: bool = True
    fit: bool = True
    picture_nm: tuple[float, float, float] | None = None
    sharpness: float = 0.6
    adrift: float = 0.25
    surface_margin: float = 1.2
    lines_per_step: float = 1.5
    fit_search_px: tuple[int, int] = (6, 6)

    def __post_init__(self) -> None:
        """Check."""
        if self.surface not in SURFACES:
            raise InputError(f"`surface` must be one of {', '.join(SURFACES)}, got {self.surface!r}")
        if self.gsd is not None and not (np.isfinite(self.gsd) and self.gsd > 0.0):
            raise InputError(f"`gsd` must be a positive number of metres, got {self.gsd}")
        nm = self.picture_nm
        if nm is not None and not (len(nm) == 3 and np.isfinite(nm).all() and min(nm) > 0.0):
            raise InputError(f"`picture_nm` must be three wavelengths (nm): red, green, blue; got {nm}")
        for name, least in (("sharpness", 0.0), ("adrift", 0.0), ("surface_margin", 1.0)):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= least):
                raise InputError(f"`{name}` must be {least:g} or more, got {getattr(self, name)}")
        if not (np.isfinite(self.lines_per_step) and self.lines_per_step >= 1.0):
            raise InputError(
                f"`lines_per_step` must be 1 or more, got {self.lines_per_step}: less leaves gaps"
            )
        if len(self.fit_search_px) != 2 or min(self.fit_search_px) < 1:
            raise InputError(f"`fit_search_px` must be two numbers of 1 px or more, got {self.fit_search_px}")


def frame_views(
    problem: SequenceProblem,
    images: Images | None = None,
    *,
    detector: AreaDetector | None = None,
    penalty: Array | None = None,
    linked: NDArray[np.intp] | None = None,
    readout_time: float | None = None,
) -> FrameViews:
    """How the frames see the world.

    Parameters
    ----------
    problem : SequenceProblem
    images : Images, optional
        Poses; the rough ones by default.
    detector : AreaDetector, optional
        With the focal length found; that of the problem by default.
    penalty : (M,), optional
        What it costs to use each frame, inf where it cannot be used; by default 0 for those with an image.
    linked : (M,), optional
        Stretch of each frame, along which its motion while it is read out is taken; by default by time.
    readout_time : float, optional
        s; that found, by default that of the problem.
    """
    images = problem.images if images is None else images
    detector = problem.detector if detector is None else detector
    penalty = np.where(problem.usable, 0.0, np.inf) if penalty is None else penalty
    readout = problem.readout_time if readout_time is None else readout_time
    position, turned = _instants(images, readout, linked)
    camera = np.stack([(turn * problem.mount).inv().as_matrix() for turn in turned], axis=1)
    return FrameViews(detector, np.stack(position, axis=1), camera, stretches(images.t), penalty)


def _instants(
    images: Images, readout_time: float, linked: NDArray[np.intp] | None
) -> tuple[list[Array], list[Rotation]]:
    """Poses of all frames when their first, middle and last lines are exposed; once where all are at once."""
    position, turned = [images.position], [images.world_from_body]
    if readout_time != 0.0:
        image = np.arange(len(images))
        for share in (0.5, 1.0):
            moved, turn = line_poses(images, image, np.full(len(images), share * readout_time), linked)
            position.append(images.position + moved)
            turned.append(images.world_from_body * turn)
    return position, turned


def map_of(problem: SequenceProblem) -> MapSystem:
    """Axes of the map: those of a flat world, or a map projection about the flight."""
    if problem.radii is None:
        return MapSystem()
    middle = np.median(problem.images.position, axis=0)
    return MapSystem(map_system(middle, problem.radii), problem.radii)


def pixel_size(problem: SequenceProblem, views: FrameViews, outline: Array) -> float:
    """m; median side of a pixel of the frames on the ground, of a whole pattern of a mosaic filter."""
    usable = np.isfinite(views.penalty) & np.isfinite(outline).all(axis=(1, 2))
    side = int(np.sqrt(outline.shape[1]))
    net = outline[usable].reshape(-1, side, side, 2)
    if not len(net):
        raise InputError("no frame that can be used looks at the ground: there is nothing to map")
    lines, columns = problem.detector.shape
    down = np.linalg.norm(np.diff(net, axis=1), axis=3) * (side - 1) / lines
    right = np.linalg.norm(np.diff(net, axis=2), axis=3) * (side - 1) / columns
    period = 1 if problem.mosaic_nm is None else max(problem.mosaic_nm.shape)
    size = period * float(np.sqrt(np.median(down) * np.median(right)))
    # three figures are enough, and make a map that is easy to name
    return float(f"{size:.3g}")


def choose_bands(
    problem: SequenceProblem, plan: CubePlan, outline: Array, gsd: float, step: float | None = None
) -> BandLayout:
    """Bands of the cube, by what the camera is and what was asked for.

    Parameters
    ----------
    problem : SequenceProblem
    plan : CubePlan
    outline : (M, n, 2)
        m; map places around each frame.
    gsd : float
        m, side of a pixel of the map.
    step : float, optional
        Pixels of the map from frame to frame; by default that of the outlines.
    """
    detector = problem.detector
    if detector.wavelength_nm is not None:
        if step is None:
            middle = np.nanmean(outline, axis=1)
            steps = np.linalg.norm(np.diff(middle, axis=0), axis=1) / gsd
            step = float(np.nanmedian(steps)) if np.isfinite(steps).any() else 1.0
        return line_bands(
            detector.wavelength_nm,
            plan.bands,
            max(step, 0.1),
            plan.fill_nm,
            lines_per_step=plan.lines_per_step,
        )
    layout = (
        rig_bands(problem)
        if problem.rig
        else frame_bands(detector.shape, problem.mosaic_nm, problem.channel_nm)
    )
    if plan.bands is None:
        return layout
    wanted = plan.bands if not isinstance(plan.bands, int) else ()
    there = [int(np.argmin(np.abs(layout.wavelength_nm - nm))) for nm in wanted]
    near = [abs(layout.wavelength_nm[k] - nm) <= 1.0 for k, nm in zip(there, wanted, strict=True)]
    if isinstance(plan.bands, int) and plan.bands == len(layout):
        return layout
    if not there or not all(near):
        raise InputError(
            f"`bands` must be among the {len(layout)} wavelengths that the camera has "
            f"({', '.join(layout.names)}), got {plan.bands}"
        )
    return layout.of(there)


def rig_bands(problem: SequenceProblem) -> BandLayout:
    """Bands of all cameras of a rig; `channel` counts the channels of all cameras in their order."""
    names, nm, cameras = [], [], []
    for number, camera in enumerate(problem.rig):
        for value in camera.channel_nm or (camera.wavelength_nm,):
            several = len(camera.channel_nm) > 1
            names.append(f"{camera.name} {value:g} nm" if several else camera.name)
            nm.append(value)
            cameras.append(number)
    return camera_bands(names, nm, cameras, problem.detector.shape[0])


def expected_cube(problem: SequenceProblem, plan: CubePlan) -> tuple[CubeGrid, BandLayout]:
    """The map and the bands that a plan would come to by the rough poses.

    Parameters
    ----------
    problem : SequenceProblem
    plan : CubePlan

    Raises
    ------
    InputError
        If the plan asks for what the camera does not see, or no frame looks at the ground.
    """
    views, system = frame_views(problem), map_of(problem)
    ground = UsedGround(given_heights(problem.surface, system), "", 0.0)
    outline, _ = frame_outlines(problem, system, ground, views)
    gsd = plan.gsd or pixel_size(problem, views, outline)
    overlap = overlap_of(problem)
    step = None if overlap is None else overlap.step / gsd
    layout = choose_bands(problem, plan, outline, gsd, step)
    return covering_grid(outline[np.isfinite(views.penalty)].reshape(-1, 2), system, gsd), layout
