"""System S4: the cube of a frame sequence, from its poses and the ground.

Every band becomes an orthomosaic, and all of them lie on one map: each pixel from the frame in which its band
saw it best. How well bands then lie on each other is matched anew.

Not here: what is planned of it (``products/cube_plan.py``), resampling (``products/frame_cube.py``), files
(``io/results/cube_files.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.applications.sequence_poses import INTERPOLATED, SequencePoses
from sightline.errors import computes
from sightline.execution import CpuClock, one_blas_thread, silent
from sightline.geometry.checks import ReadOnlyArrays
from sightline.imaging.source import ImageSource
from sightline.photogrammetry.flight.path import stretches
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.rig import RigOffsets, given_offsets
from sightline.photogrammetry.flight.solver import ground_distances
from sightline.photogrammetry.sightings import Images
from sightline.products.cube_bands import BandLayout, frame_bands
from sightline.products.cube_fit import PairFit, error_map, fit_pairs
from sightline.products.cube_grid import CubeGrid, MapSystem
from sightline.products.cube_ground import UsedGround, choose_ground, frame_outlines, given_heights
from sightline.products.cube_plan import CubePlan, choose_bands, frame_views, map_of, pixel_size
from sightline.products.cube_store import CubeStore, MemoryStore
from sightline.products.cube_tally import (
    CubePicture,
    CubeTally,
    picture_bands,
    picture_factor,
    picture_grid,
)
from sightline.products.frame_cube import (
    CubeMaker,
    FilledTile,
    FrameViews,
    MapTile,
    covering_grid,
    line_gain,
    tiles_of,
)
from sightline.result import Result, makes_result

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

#: What it costs to use a frame without a pose of its own image, or one out of focus.
_GUESSED, _BLURRED = 1e4, 1e2
#: Share of the ground passed over from which on gaps are not worth a warning.
#: Tiles that are filled side by side, whatever the number of threads.
AT_ONCE = 4
_GAPS = 0.99


@dataclass(frozen=True, eq=False, repr=False)
class CubeSummary(Result, ReadOnlyArrays):
    """What a cube is like.

    Attributes
    ----------
    names : tuple of str
        B, of the bands.
    wavelength_nm : (B,)
        NaN: all light.
    grid : CubeGrid
        Of the map.
    surface : str
        Which heights were used, and why.
    height_sigma : float
        m; what points miss the surface by, robust rms.
    coverage : (B,)
        Share of the ground that every band could see that has a value: of places which, in one frame or
        another, lay on lines of every band; NaN where there is none.
    passed : (B,)
        The same of all ground that the lines of every band passed over, in gaps between frames too.
    beyond : (B,)
        Share of the values that come from lines next to the band's own.
    whole : (B,)
        Share of the map that has a value.
    area : float
        m^2 of the ground that every band could see.
    seams : (B,)
        Share of neighbouring pixels that come from two frames.
    seam_jump : (B,)
        What values jump by there beyond what they differ by elsewhere, rms, over the mean of the band.
    pairs : (P, 2) int
        Bands that were matched with each other.
    pair_rms_px : (P,)
        px rms per axis of where they lie on each other; NaN: too little in common.
    pair_noise_px : (P,)
        px; what the matches' own sigma makes of it.
    pair_windows : (P,) int
    error_map : (h, w)
        px, rms over the pairs; NaN: nothing matched.
    rgb : (3,) int
        Bands of the pictures.
    after, before : (h, w, 3) uint8
        Made of them by the poses found, and by the rough ones; of no size where none were asked for.
    frames_used : int
    unread : tuple of str
        Frames that could not be read, and why.
    seconds : dict of str to float
        CPU time of each stage.
    warnings : tuple of str
    """

    names: tuple[str, ...]
    wavelength_nm: Array
    grid: CubeGrid
    surface: str
    height_sigma: float
    coverage: Array
    passed: Array
    beyond: Array
    whole: Array
    area: float
    seams: Array
    seam_jump: Array
    pairs: NDArray[np.intp]
    pair_rms_px: Array
    pair_noise_px: Array
    pair_windows: NDArray[np.intp]
    error_map: Array
    rgb: NDArray[np.intp]
    after: NDArray[np.uint8]
    before: NDArray[np.uint8]
    frames_used: int
    unread: tuple[str, ...]
    seconds: dict[str, float]
    warnings: tuple[str, ...]

    @property
    def gsd(self) -> float:
        """m, side of a pixel."""
        return self.grid.gsd

    @property
    def picture_gsd(self) -> float:
        """m, side of a pixel of the pictures, which show only the part where all three bands have values."""
        return self.grid.gsd * picture_factor(self.grid.shape)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """West, south, east, north of the map, m."""
        return self.grid.extent


@makes_result
@one_blas_thread
@computes("maps of the bands")
def assemble_cube(
    problem: SequenceProblem,
    found: SequencePoses,
    plan: CubePlan | None = None,
    store: CubeStore | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> CubeSummary:
    """Orthomosaics of all bands on one map.

    Parameters
    ----------
    problem : SequenceProblem
    found : SequencePoses
    plan : CubePlan, optional
    store : CubeStore, optional
        Takes the pixels; by default they are held in memory and lost.
    progress : callable, optional
        Called with the stage, what is done of it (tiles, pairs of bands) and all of that.

    Returns
    -------
    CubeSummary

    Raises
    ------
    InputError
        If no frame can be used, or the plan asks for wavelengths that no line sees.
    """
    plan = CubePlan() if plan is None else plan
    store = MemoryStore() if store is None else store
    clock = CpuClock()
    report = silent if progress is None else progress
    report("cube: ground", 0, 1)
    views = found_views(problem, found, plan)
    system = map_of(problem)
    ground = choose_ground(problem, found.poses, found.tracks, system, plan.surface, plan.surface_margin)
    clock.note("ground")
    outline, reach = frame_outlines(problem, system, ground, views)
    gsd = plan.gsd or pixel_size(problem, views, outline)
    layout = choose_bands(problem, plan, outline, gsd)
    if problem.rig:
        return _of_rig(problem, found, plan, store, report, clock, (views, ground, system, gsd, layout))
    grid = covering_grid(outline[np.isfinite(views.penalty)].reshape(-1, 2), system, gsd)
    channels = images_of(problem)
    report("cube: lines made alike", 0, 1)
    by_line = problem.detector.wavelength_nm is not None and plan.flatten
    gain = line_gain(channels, problem.detector.shape[0]) if by_line else None
    clock.note("lines made alike")
    maker = CubeMaker(grid, layout, views, reach, ground.heights, channels, gain)
    tally = _filled(maker, store, grid, layout, plan, report)
    clock.note("tiles")
    before = _before(problem, plan, tally, grid, layout, ground, channels, gain, report)
    clock.note("picture by the rough poses")
    fits = _fits(store, layout, plan, report)
    clock.note("bands matched")
    unread = tuple(f"{problem.frames[k]}: {why}" for k, why in sorted(maker.unread.items()))
    summary = _summary(problem, layout, grid, ground, tally, before, fits, unread, clock.seconds)
    lost = int((problem.usable & np.isinf(views.penalty)).sum())
    if not lost:
        return summary
    are = "frame is" if lost == 1 else "frames are"
    words = (
        f"{lost} {are} not used: no pose could be estimated from their images, and their tables are too rough"
    )
    return replace(summary, warnings=(*summary.warnings, words))


def _filled(
    maker: CubeMaker | RigCubeMaker,
    store: CubeStore,
    grid: CubeGrid,
    layout: BandLayout,
    plan: CubePlan,
    report: Callable[[str, int, int], None],
) -> CubeTally:
    """All tiles made and stored, and what was counted of them."""
    tally = CubeTally(layout, grid, picture_bands(layout, plan.picture_nm) if plan.picture else ())
    store.begin(grid, layout)
    tiles = tiles_of(grid, layout)
    for begin in range(0, len(tiles), AT_ONCE):
        some = tiles[begin : begin + AT_ONCE]
        for tile, filled in zip(some, maker.fill(some), strict=True):
            if filled is None:
                store.write(
                    tile.row, tile.column, np.full((len(layout), tile.rows, tile.columns), np.nan, np.float32)
                )
            else:
                store.write(tile.row, tile.column, filled.values)
                tally.add(filled)
        report("cube", begin + len(some), len(tiles))
    return tally


def _fits(
    store: CubeStore, layout: BandLayout, plan: CubePlan, report: Callable[[str, int, int], None]
) -> list[PairFit]:
    """Bands matched with each other."""
    bands = [store.source(b) for b in range(len(layout))] if plan.fit else []
    return fit_pairs(
        bands, layout.wavelength_nm, lambda *done: report("cube: bands matched", *done),
        search_px=plan.fit_search_px,
    )  # fmt: skip


def _of_rig(
    problem: SequenceProblem,
    found: SequencePoses,
    plan: CubePlan,
    store: CubeStore,
    report: Callable[[str, int, int], None],
    clock: CpuClock,
    made: tuple[FrameViews, UsedGround, MapSystem, float, BandLayout],
) -> CubeSummary:
    """Orthomosaics of the bands of all cameras of a rig, each from its own images."""
    first, ground, system, gsd, layout = made
    offsets = given_offsets(problem.rig) if found.rig is None else found.rig.offsets
    images = replace(
        problem.images, position=found.poses.position, world_from_body=found.poses.world_from_body
    )
    views = rig_views(problem, images, offsets, first.penalty)
    outlines = [frame_outlines(problem, system, ground, view) for view in views]
    places = [o[np.isfinite(v.penalty)].reshape(-1, 2) for (o, _), v in zip(outlines, views, strict=True)]
    grid = covering_grid(np.concatenate(places), system, gsd)
    maker = RigCubeMaker(problem, grid, layout, views, [reach for _, reach in outlines], ground)
    tally = _filled(maker, store, grid, layout, plan, report)
    clock.note("tiles")
    coarse = picture_grid(grid)
    picture = CubePicture(coarse, len(tally.rgb))
    if plan.picture:
        rough = rig_views(problem, problem.images, given_offsets(problem.rig), None)
        given = UsedGround(
            given_heights(ground.level or problem.surface, system), "", 0.0, level=ground.level
        )
        reaches = [frame_outlines(problem, system, given, view)[1] for view in rough]
        three = layout.of(tally.rgb)
        before = RigCubeMaker(problem, coarse, layout, rough, reaches, given)
        tiles = tiles_of(coarse, three)
        for begin in range(0, len(tiles), AT_ONCE):
            for filled in before.fill(tiles[begin : begin + AT_ONCE]):
                if filled is not None:
                    picture.add(filled, tally.rgb)
    clock.note("picture by the rough poses")
    fits = _fits(store, layout, plan, report)
    clock.note("bands matched")
    unread = tuple(f"{problem.frames[k]}: {why}" for k, why in sorted(maker.unread.items()))
    return _summary(problem, layout, grid, ground, tally, picture, fits, unread, clock.seconds)


def rig_views(
    problem: SequenceProblem, captures: Images, offsets: RigOffsets, penalty: Array | None
) -> list[FrameViews]:
    """How the images of each camera of a rig see the world.

    Parameters
    ----------
    problem : SequenceProblem
    captures : Images
        Poses of the body.
    offsets : RigOffsets
    penalty : (M,) or None
        What it costs to use each capture; a camera's image that cannot be used costs inf.
    """
    count, whole = len(captures), offsets.images(captures)
    out = []
    for c, camera in enumerate(problem.rig):
        rows = slice(c * count, (c + 1) * count)
        turn = (whole.world_from_body[rows] * camera.mount).inv().as_matrix()
        # of the first camera the penalty says too that its image is lost, which is no fault of the others
        cost = np.zeros(count) if penalty is None else np.where(problem.usable, penalty, 0.0)
        out.append(
            FrameViews(
                offsets.detector(c, camera.detector),
                whole.position[rows][:, None],
                turn[:, None],
                stretches(captures.t),
                np.where(camera.usable, cost, np.inf),
            )
        )
    return out


class RigCubeMaker:
    """Fills tiles of a map from the cameras of a rig, each band from its own."""

    def __init__(
        self,
        problem: SequenceProblem,
        grid: CubeGrid,
        layout: BandLayout,
        views: Sequence[FrameViews],
        reaches: Sequence[Array],
        ground: UsedGround,
    ) -> None:
        self._layout, self._makers, self._bands, first = layout, [], [], 0
        for camera, view, reach in zip(problem.rig, views, reaches, strict=True):
            nm = camera.channel_nm
            own = frame_bands(view.detector.shape, None, nm or (camera.wavelength_nm,))
            sources = camera.channels if nm else (camera.sources,)
            self._makers.append(CubeMaker(grid, own, view, reach, ground.heights, sources))
            self._bands.append(first + own.channel)
            first += len(own)

    @property
    def unread(self) -> dict[int, str]:
        """Captures of which an image could not be read, and why."""
        return {frame: why for maker in self._makers for frame, why in maker.unread.items()}

    def fill(self, tiles: Sequence[MapTile]) -> list[FilledTile | None]:
        """All bands of some tiles, on threads; None where no image shows one."""
        by_camera = [maker.fill(tiles) for maker in self._makers]
        return [self._together(*each) for each in zip(tiles, *by_camera, strict=True)]

    def _together(self, tile: MapTile, *parts: FilledTile | None) -> FilledTile | None:
        """What the cameras show of a tile, as one."""
        if all(part is None for part in parts):
            return None
        flat, size = (tile.rows, tile.columns), sum(len(bands) for bands in self._bands)
        values = np.full((size, *flat), np.nan, dtype=np.float32)
        view = np.full((len(parts), *flat), -1, dtype=np.int32)
        passed, beyond = (np.zeros((len(parts), *flat), dtype=np.bool_) for _ in range(2))
        for c, (part, bands) in enumerate(zip(parts, self._bands, strict=True)):
            if part is not None:
                values[bands] = part.values
                view[c], passed[c], beyond[c] = part.view[0], part.passed[0], part.beyond[0]
        return FilledTile(tile, values[self._layout.channel], view, passed, beyond)


def found_views(problem: SequenceProblem, found: SequencePoses, plan: CubePlan | None = None) -> FrameViews:
    """How the frames see the world by the poses found.

    Frames without windows, and those out of focus, are used where no other shows a place; frames
    whose view nobody knows are not used.
    """
    images = replace(
        problem.images, position=found.poses.position, world_from_body=found.poses.world_from_body
    )
    penalty = np.where(problem.usable, 0.0, np.inf)
    penalty += _GUESSED * (np.array(found.source) == INTERPOLATED)
    plan = CubePlan() if plan is None else plan
    penalty[_adrift(problem, found, plan.adrift)] = np.inf
    sharpness = found.followed.sharpness
    usual = np.nanmedian(sharpness) if np.isfinite(sharpness).any() else np.nan
    penalty += _BLURRED * (sharpness < plan.sharpness * usual)
    detector = found.poses.detector(problem.detector)
    readout = found.poses.readout_time(problem.readout_time)
    return frame_views(
        problem, images, detector=detector, penalty=penalty, linked=found.stretch, readout_time=readout
    )


def _adrift(problem: SequenceProblem, found: SequencePoses, most: float) -> NDArray[np.bool_]:
    """Frames (M,) without poses of their own whose view nobody knows: one of them would stretch the map.

    Sigmas beyond those of the frames that were solved, whose datum is that of all, are compared with the
    ground that a frame shows.
    """
    guessed = np.array(found.source) == INTERPOLATED
    far = float(np.median(ground_distances(problem)))
    sigma = np.sqrt(np.einsum("kii->ki", found.poses.covariance))
    moved = np.hypot(np.linalg.norm(sigma[:, :3], axis=1), far * np.linalg.norm(sigma[:, 3:], axis=1))
    known = moved[~guessed]
    if not guessed.any() or not np.isfinite(known).any():
        return np.zeros(len(problem), dtype=np.bool_)
    side = far * min(problem.detector.shape) / problem.detector.focal_length_px
    beyond = np.sqrt(np.maximum(moved**2 - np.median(known[np.isfinite(known)]) ** 2, 0.0))
    # frames between a subset's by a curve have no sigma: they are where the curve is
    return np.asarray(guessed & np.isfinite(moved) & (beyond > most * side))


def images_of(problem: SequenceProblem) -> list[Sequence[ImageSource]]:
    """Images of each channel, one per frame."""
    if problem.channels and problem.channel_nm:
        return [[images[k] for images in problem.channels] for k in range(len(problem.channel_nm))]
    return [problem.sources]


def _before(
    problem: SequenceProblem,
    plan: CubePlan,
    tally: CubeTally,
    grid: CubeGrid,
    layout: BandLayout,
    ground: UsedGround,
    channels: Sequence[Sequence[ImageSource]],
    gain: Array | None,
    report: Callable[[str, int, int], None],
) -> CubePicture:
    """The picture that the rough poses make, on the surface given or level ground nearer to the points."""
    grid = picture_grid(grid)
    picture = CubePicture(grid, len(tally.rgb))
    if not plan.picture:
        return picture
    views = frame_views(problem)
    system = grid.system
    given = UsedGround(given_heights(ground.level or problem.surface, system), "", 0.0, level=ground.level)
    _, reach = frame_outlines(problem, system, given, views)
    three = layout.of(tally.rgb)
    maker = CubeMaker(grid, three, views, reach, given.heights, channels, gain)
    tiles = tiles_of(grid, three)
    for begin in range(0, len(tiles), AT_ONCE):
        some = tiles[begin : begin + AT_ONCE]
        for filled in maker.fill(some):
            if filled is not None:
                picture.add(filled, range(len(three)))
        report("cube: picture by the rough poses", begin + len(some), len(tiles))
    return picture


def _summary(
    problem: SequenceProblem,
    layout: BandLayout,
    grid: CubeGrid,
    ground: UsedGround,
    tally: CubeTally,
    before: CubePicture,
    fits: Sequence[PairFit],
    unread: tuple[str, ...],
    seconds: dict[str, float],
) -> CubeSummary:
    window = tally.picture.window()
    after, limits = tally.picture.image()
    pairs = tally.seams[:, [0, 2]]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = tally.total / tally.values
        inside, across = (tally.seams[:, k + 1] / tally.seams[:, k] for k in (0, 2))
        jump = np.sqrt(np.maximum(across - inside, 0.0)) / np.abs(mean)
        coverage = tally.of_seen / (tally.seen or np.nan)
        passed = tally.of_passed / (tally.passed or np.nan)
        beyond = tally.beyond / tally.values
        seams = pairs[:, 1] / pairs.sum(axis=1)
    return CubeSummary(
        names=layout.names,
        wavelength_nm=layout.wavelength_nm,
        grid=grid,
        surface=ground.words,
        height_sigma=ground.sigma,
        coverage=coverage,
        passed=passed,
        beyond=beyond,
        whole=tally.values / (grid.shape[0] * grid.shape[1]),
        area=tally.seen * grid.gsd**2,
        seams=seams,
        seam_jump=jump,
        pairs=np.array([fit.bands for fit in fits], dtype=np.intp).reshape(-1, 2),
        pair_rms_px=np.array([fit.rms_px for fit in fits]),
        pair_noise_px=np.array([fit.noise_px for fit in fits]),
        pair_windows=np.array([fit.windows for fit in fits], dtype=np.intp),
        error_map=error_map(fits, grid.shape),
        rgb=np.array(tally.rgb, dtype=np.intp),
        after=after[window],
        before=before.image(limits if len(limits) else None)[0][window],
        frames_used=len(tally.used),
        unread=unread,
        seconds=seconds,
        warnings=tuple(_warnings(layout, passed, fits, unread, tally)),
    )


def _warnings(
    layout: BandLayout, passed: Array, fits: Sequence[PairFit], unread: tuple[str, ...], tally: CubeTally
) -> list[str]:
    """What a user should know."""
    out = []
    if unread:
        out.append(f"{len(unread)} frames could not be read for the cube; the first, {unread[0]}")
    if tally.passed == 0:
        out.append("no ground was passed over by the lines of every band: the flight is too short for that")
    elif passed.min() < _GAPS:
        worst = int(np.argmin(passed))
        out.append(
            f"band {layout.names[worst]} misses {100 * (1 - passed[worst]):.1f} % of the ground that every "
            "band passed over: frames are missing, or steps between them were longer than its lines; for the "
            "latter ask for fewer bands or a larger fill_nm"
        )
    blind = sum(not np.isfinite(fit.rms_px) for fit in fits)
    if blind:
        out.append(
            f"{blind} of {len(fits)} pairs of bands look too unlike each other to be compared: how they fit "
            "is known by the bands between them alone"
        )
    return out
