"""``[surface]`` → a Surface, and whether it covers what the cameras see.

Not here: reading the elevation raster (``io/formats/dem.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.errors import GeometryError, InputError
from sightline.geometry.camera import FrameCamera, PushbroomCamera
from sightline.geometry.earth import WGS84, from_geodetic, local_axes, to_geodetic
from sightline.geometry.surface import Dem, Ellipsoid, Infinity, Plane, Surface
from sightline.io.acquisition.acquired import InputFolder, world_kind
from sightline.io.acquisition.schema import AcquisitionFile, CameraModelPlatform, SurfaceSection
from sightline.io.formats.dem import Bounds, read_dem
from sightline.motion.band import Band
from sightline.motion.measure.windows import exposure_times

Array = NDArray[np.float64]
MovingCamera = PushbroomCamera | FrameCamera

#: Pixels per side of the grid that stands for an image.
GRID = 9
#: Degrees from straight down beyond which it is asked whether longitude and latitude are exchanged.
OBLIQUE = 50.0
#: Share of that angle which is left once they are.
NEARER = 0.6
#: Share of an image that may look beside the ground or the DEM before the whole is refused.
UNCOVERED_SHARE = 0.02
#: The same for a spinning camera or a scan mirror, whose sweeps begin and end beyond the limb.
LIMB_SHARE = 0.75
#: Largest ratio between the ground step of a line and the ground size of a pixel, either way: what is off by
#: a factor of a hundred is refused whatever the instrument.
LARGEST_STEP_RATIO = 50.0
#: The same, from which on it is asked whether that is meant.
DOUBTFUL_STEP_RATIO = 4.0
#: Sizes of images, lines or pixels that differ by less are alike, and by more are those of other pixels.
ALIKE, UNLIKE = 1.1, 1.4
#: Lines of a push-broom between two looks of one pass, at most: an hour of 3.6 ms. Blind frequencies are as
#: many, and the motion is recovered over all of the time.
MOST_LINES_APART = 1_000_000
_SAMPLING_KEYS = (
    "ifov (a tangent, pixel pitch / focal length: 1e-6 to 1e-4 of most) or directions, line_period (s), "
    'altitude (m), ground_speed (m/s); of tables the positions (m, unless [world] frame = "lonlat") and '
    "their t (s)"
)
#: Lines and columns of the grid with which common ground is looked for.
OVERLAP_GRID = (65, 33)
#: Heights (m) between which the ground of a large DEM is looked for.
SEARCH_HEIGHTS = (-500.0, 9000.0)


def build_surface(config: AcquisitionFile, files: InputFolder, cameras: Sequence[MovingCamera]) -> Surface:
    """What ``[surface]`` describes: plane, ellipsoid, elevation raster, or infinity.

    Parameters
    ----------
    config : AcquisitionFile
    files : InputFolder
        Finds the rasters.
    cameras : sequence of cameras
        Say which part of a large raster is needed.

    Returns
    -------
    Surface
    """

    def ground(surface: Surface) -> Array:
        return np.concatenate([camera.locate(image_grid(camera), surface) for camera in cameras])

    radii = body_radii(config, files)
    return surface_of(config.surface, files, ground, local=world_kind(config) == "local", radii=radii)


def assumed_ground(section: SurfaceSection) -> tuple[str, ...]:
    """What of ``[surface]`` is not given, with what is taken for it."""
    given = section.model_fields_set
    if section.kind == "infinity" or section.dem is not None:
        return ()
    out = () if "height" in given else (f"height = {section.height:g}",)
    return out if "height_sigma" in given else (*out, f"height_sigma = {section.height_sigma:g}")


def surface_of(
    section: SurfaceSection,
    files: InputFolder,
    ground: Callable[[Surface], Array],
    *,
    local: bool,
    radii: tuple[float, float] | None,
) -> Surface:
    """What a ``[surface]`` describes.

    Parameters
    ----------
    section : SurfaceSection
    files : InputFolder
        Finds the rasters.
    ground : callable
        Points (N, 3) that the cameras see of a surface: they say which part of a large raster is needed.
    local : bool
        The world is x east, y north, z up.
    radii : (equatorial, polar) or None
        m; of another body than the Earth.

    Returns
    -------
    Surface
    """
    if section.kind == "infinity":
        return Infinity()
    if section.dem is None:
        return Plane(section.height) if local else Ellipsoid(*(radii or WGS84), section.height)
    geoid = files(section.geoid) if isinstance(section.geoid, str) else section.geoid
    return read_dem(
        files(section.dem),
        datum=section.datum if "datum" in section.model_fields_set else None,
        geoid=geoid,
        local=local,
        radii=radii,
        bounds=_bounds(ground, local, radii or WGS84),
    )


def body_radii(config: AcquisitionFile, files: InputFolder) -> tuple[float, float] | None:
    """Radii of the body: of the file, else of the sensor model; None for the Earth."""
    if config.surface.radii is not None:
        return config.surface.radii
    if isinstance(config.platform, CameraModelPlatform):
        from sightline.io.formats.isd_frame import read_frame_model

        if config.frame:
            return read_frame_model(files(config.frame[0].model or "")).radii
    return files.radii


def image_grid(camera: MovingCamera) -> Array:
    """Pixels (GRID * GRID, 2) spread evenly over an image, corners included."""
    lines, columns = camera.shape
    grid = np.meshgrid(np.linspace(0, lines - 1, GRID), np.linspace(0, columns - 1, GRID), indexing="ij")
    return np.stack(grid, axis=-1).reshape(-1, 2)


def _bounds(ground: Callable[[Surface], Array], local: bool, radii: tuple[float, float]) -> Bounds | None:
    """Box around everything the cameras can see between the heights that exist."""
    boxes = []
    for height in SEARCH_HEIGHTS:
        surface: Surface = Plane(height) if local else Ellipsoid(*radii, height)
        boxes.append(_horizontal(ground(surface), local, radii))
    points = np.concatenate(boxes)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points) or (not local and np.ptp(points[:, 0]) > 180.0):
        return None
    (west, south), (east, north) = points.min(axis=0), points.max(axis=0)
    return Bounds(west, south, east, north)


def _horizontal(points: Array, local: bool, radii: tuple[float, float]) -> Array:
    """Points (N, 3) as x, y (m) or longitude, latitude (degrees), (N, 2)."""
    return points[:, :2] if local else np.degrees(to_geodetic(points, radii)[:, :2])


def check_coverage(
    path: Path,
    surface: Surface,
    cameras: Sequence[MovingCamera],
    names: Sequence[str],
    *,
    sweeps: bool = False,
    otherwise: Callable[[MovingCamera], str] = lambda _: "",
) -> None:
    """Refuse a ground that the cameras look past, or an elevation raster that ends inside the strip.

    Parameters
    ----------
    path : Path
        The TOML file, named in the message.
    surface : Surface
    cameras : sequence of cameras
    names : sequence of str
    sweeps : bool
        Whether a spin or a mirror carries them over the ground, and past its limb.
    otherwise : callable, optional
        Ends a refusal of a camera: what its attitudes would be if they were written otherwise.

    Raises
    ------
    GeometryError
        Names the uncovered share and both extents.
    InputError
        If the field is wider than the ground.
    """
    base = base_surface(surface)
    local = isinstance(base, Plane)
    points = [camera.locate(image_grid(camera), base) for camera in cameras]
    missed = [float(np.mean(~np.isfinite(p[:, 0]))) for p in points]
    worst = int(np.argmax(missed))
    if missed[worst] > (LIMB_SHARE if sweeps else UNCOVERED_SHARE):
        _refuse_wide_field(path, base, cameras[worst], names[worst])
        raise GeometryError(
            f"{path}: {100 * missed[worst]:.0f} % of {names[worst]} looks past the ground; check the "
            "attitudes (quaternions qx,qy,qz,qw of world_from_body, scalar last), the positions, [world] "
            "frame, whose axes both are in, and the mount"
            f"{_exchanged_view_of(cameras[worst], surface)}{otherwise(cameras[worst])}"
        )
    if not isinstance(surface, Dem):
        return
    ground = np.concatenate(points)
    ground = ground[np.isfinite(ground[:, 0])]
    outside = 1.0 - float(np.mean(inside_raster(surface, ground)))
    if outside > UNCOVERED_SHARE:
        radii = surface.radii
        raise GeometryError(
            f"{path}: the DEM does not cover the strip: {100 * outside:.0f} % of it lies outside; "
            f"the strip spans {_extent(_horizontal(ground, local, radii), local)}, "
            f"the DEM {_extent(_horizontal(raster_corners(surface), local, radii), local)}; "
            f"give a larger DEM or crop the images{exchanged_words(surface, ground)}"
        )


def _exchanged_view_of(camera: MovingCamera, surface: Surface) -> str:
    """`exchanged_view_words` of a camera."""
    rays, ground = camera.rays(image_grid(camera)), base_surface(surface)
    radii = (ground.a, ground.b) if isinstance(ground, Ellipsoid) else None
    return exchanged_view_words(rays.origins, rays.directions, radii)


def _refuse_wide_field(path: Path, surface: Surface, camera: MovingCamera, name: str) -> None:
    """InputError where the middle of an image sees the ground and neither of its sides does."""
    lines, columns = camera.shape
    middle, end = (lines - 1) / 2.0, columns - 1.0
    sides = np.array([[middle, 0.0], [middle, end]])
    keys = "ifov (a tangent, pixel pitch / focal length: 1e-6 to 1e-4 of most) or directions, and columns"
    if isinstance(camera, FrameCamera):
        sides = np.array([[0.0, 0.0], [lines - 1.0, end], [0.0, end], [lines - 1.0, 0.0]])
        keys = "focal_length_px, shape and distortion of [camera]"
    inside = np.isfinite(camera.locate(np.array([[middle, end / 2.0]]), surface)).all()
    if not inside or np.isfinite(camera.locate(sides, surface)[:, 0]).any():
        return
    first, last = camera.rays(sides[:2]).directions
    angle = np.degrees(np.arccos(np.clip(first @ last, -1.0, 1.0)))
    field = f"{angle:.3g} degrees" if np.isfinite(angle) else "more than its distortion allows"
    raise InputError(
        f"{path}: {name} sees the ground in its middle and past it on all sides: {columns} "
        f"columns reach over {field}; check {keys}"
    )


def base_surface(surface: Surface) -> Surface:
    """The smooth surface at the middle height of a Dem; any other surface itself."""
    if not isinstance(surface, Dem):
        return surface
    middle = float(np.mean(surface.height_range))
    return Plane(middle) if surface.crs is None else Ellipsoid(*surface.radii, middle)


def inside_raster(dem: Dem, points: Array) -> NDArray[np.bool_]:
    """Whether points (N, 3) lie within the raster's rectangle, over voids or not."""
    solid = Dem(np.zeros(dem.heights.shape), dem.transform, dem.crs, None, dem.radii)
    return solid.covers(points)


def exchanged_words(dem: Dem, points: Array) -> str:
    """A doubt, to end a refusal, where points (N, 3) beside a raster would lie on it with coordinates
    swapped."""
    if dem.crs is None or not len(points):
        return ""
    place = to_geodetic(points, dem.radii)
    lon, lat = (float(np.median(place[:, k])) for k in (0, 1))
    if abs(lon) > 0.5 * np.pi or not inside_raster(dem, from_geodetic([[lat, lon, 0.0]], dem.radii)).all():
        return ""
    return (
        f"; with longitude and latitude exchanged ({np.degrees(lat):.4f}, {np.degrees(lon):.4f}) it would "
        "lie on the DEM: are they swapped in [world] origin, or in a table?"
    )


def exchanged_view_words(origins: Array, looks: Array, radii: tuple[float, float] | None) -> str:
    """A doubt where cameras look far from straight down, or up, and about down once longitude and latitude of
    their positions are exchanged.

    Parameters
    ----------
    origins, looks : (N, 3)
        m and unit vectors, Earth-fixed axes; rows that are not finite are passed over.
    radii : (equatorial, polar) or None
        m; None: a flat world, which has no longitudes.
    """
    known = np.isfinite(origins).all(axis=1) & np.isfinite(looks).all(axis=1)
    if radii is None or not known.any():
        return ""
    place = to_geodetic(origins[known], radii)
    if np.abs(place[:, 0]).max() > 0.5 * np.pi:
        return ""  # no latitudes
    up = np.stack([local_axes(lon, lat).apply([0.0, 0.0, 1.0]) for lon, lat in place[:, :2]])
    there = np.stack([local_axes(lat, lon).apply([0.0, 0.0, 1.0]) for lon, lat in place[:, :2]])
    as_given, turned = (
        float(np.degrees(np.median(np.arccos(np.clip(-(looks[known] * v).sum(axis=1), -1.0, 1.0)))))
        for v in (up, there)
    )
    if as_given < OBLIQUE or turned > NEARER * as_given:
        return ""
    return (
        f"; the cameras look {as_given:.0f} degrees from straight down, and {turned:.0f} degrees with "
        "longitude and latitude of their positions exchanged: are the two swapped?"
    )


def raster_corners(dem: Dem) -> Array:
    """The four corners of a raster as points (4, 3) of the world, at height 0."""
    rows, columns = dem.heights.shape
    a, b, c, d, e, f = dem.transform
    column, row = np.array([0.0, columns, columns, 0.0]), np.array([0.0, 0.0, rows, rows])
    x, y = a * column + b * row + c, d * column + e * row + f
    if dem.crs is None:
        return np.column_stack([x, y, np.zeros(4)])
    if dem.crs != "lonlat":
        from pyproj import CRS, Transformer

        crs = CRS.from_user_input(dem.crs)
        if crs.is_compound:
            crs = crs.sub_crs_list[0]
        x, y = Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True).transform(x, y)
    return from_geodetic(np.column_stack([np.radians(x), np.radians(y), np.zeros(4)]), dem.radii)


def _extent(xy: Array, local: bool) -> str:
    """The box around points in words."""
    (x0, y0), (x1, y1) = xy.min(axis=0), xy.max(axis=0)
    whole = [round(float(v)) for v in (x0, x1, y0, y1)]  # whole numbers have no "-0"
    if local:
        return f"x {whole[0]} to {whole[1]} m, y {whole[2]} to {whole[3]} m"
    return f"longitude {x0:.4f} to {x1:.4f}, latitude {y0:.4f} to {y1:.4f} degrees"


def check_sampling(
    path: Path, surface: Surface, cameras: Sequence[MovingCamera], names: Sequence[str]
) -> None:
    """Refuse line periods, angles and heights that cannot belong together: mistaken units show here.

    Raises
    ------
    InputError
        If the ground step between lines is beyond `LARGEST_STEP_RATIO` times the ground size of a pixel.
    """
    for camera, name in zip(cameras, names, strict=True):
        along, across = ground_steps(camera, surface)
        # the ratio itself may be beyond numbers
        if along >= LARGEST_STEP_RATIO * across or across >= LARGEST_STEP_RATIO * along:
            raise InputError(
                f"{path}: band {name}: lines are {along:.4g} m apart on the ground and pixels {across:.4g} m "
                f"wide; these cannot belong together; check {_SAMPLING_KEYS}"
            )


def sampling_doubts(
    surface: Surface, cameras: Sequence[MovingCamera], names: Sequence[str]
) -> tuple[str, ...]:
    """What to say of bands whose lines and pixels are of very unlike size on the ground."""
    steps = [ground_steps(camera, surface) for camera in cameras]
    unlike = [k for k, (a, b) in enumerate(steps) if max(a, b) >= DOUBTFUL_STEP_RATIO * min(a, b)]
    if not unlike:
        return ()
    along, across = steps[unlike[0]]
    of = "all bands" if len(unlike) == len(steps) else ", ".join(names[k] for k in unlike)
    return (
        f"{of}: lines are {along:.4g} m apart on the ground and pixels {across:.4g} m wide; if that is not "
        f"meant, check {_SAMPLING_KEYS}: with a wrong ifov every angle is wrong by as much",
    )


def keys_left_out(surface: Surface, bands: Sequence[Band]) -> tuple[str, ...]:
    """What to say of bands of coarser or finer pixels than the first has that seem to have its keys.

    Their images then have as many lines and columns fewer or more, and lines or pixels no larger or smaller.
    """
    first, of = bands[0], dict[str, list[str]]()
    own = ground_steps(first.camera, surface)
    for band in bands[1:]:
        fewer = np.array(first.camera.shape) / np.array(band.camera.shape)
        ratio = float(np.sqrt(fewer.prod()))
        if abs(np.log(ratio)) < np.log(UNLIKE) or np.ptp(np.log(fewer)) > np.log(ALIKE):
            continue
        sizes = zip(("line_period", "ifov"), ground_steps(band.camera, surface), own, strict=True)
        keys = [key for key, a, b in sizes if a < ALIKE * b and b < ALIKE * a]
        if keys:
            count, size = (ratio, "larger") if ratio > 1.0 else (1.0 / ratio, "smaller")
            what = " and ".join(keys)
            words = (
                f"{count:.2g} times {'fewer' if ratio > 1.0 else 'more'} lines and columns than "
                f"{first.name}, and the same {what}: if pixels are {size} there, a [[band]] takes its own "
                "line_period, and ifov or directions"
            )
            of.setdefault(words, []).append(band.name)
    return tuple(f"{', '.join(names)}: {words}" for words, names in of.items())


def ground_steps(camera: MovingCamera, surface: Surface) -> tuple[float, float]:
    """How far apart lines are on the ground, and how wide pixels (m), in the middle of an image.

    NaN for a photograph, in the sky, and where the camera looks past the ground.
    """
    if not isinstance(camera, PushbroomCamera) or isinstance(surface, Infinity):
        return float("nan"), float("nan")
    line, column = (camera.lines - 1) / 2.0, (camera.columns - 1) / 2.0
    spots = np.array([[line, column], [line + 1.0, column], [line, column + 1.0]])
    here, ahead, aside = camera.locate(spots, base_surface(surface))
    # square to the line of sight: near the limb of a planet the ground itself is stretched without end
    look = camera.rays(spots[:1]).directions[0]
    along, across = (
        float(np.linalg.norm(step - look * (look @ step))) for step in (ahead - here, aside - here)
    )
    return (along, across) if np.isfinite(along + across) else (float("nan"), float("nan"))


def check_seen(path: Path, surface: Surface, cameras: Sequence[MovingCamera]) -> None:
    """Refuse a body that no image of a spinning camera sees.

    Raises
    ------
    GeometryError
        If all images look past the ground.
    """
    if not any(np.isfinite(camera.locate(image_grid(camera), surface)).any() for camera in cameras):
        raise GeometryError(
            f"{path}: no image sees the ground; check attitude (world_from_body at t = 0, scalar last), "
            "axis, rate (rad/s, right-handed about the axis) and the positions"
        )


def check_overlap(
    path: Path,
    surface: Surface,
    cameras: Sequence[MovingCamera],
    names: Sequence[str],
    *,
    still: bool = False,
) -> None:
    """Refuse images that share no ground with any other, or see it all at the same instant unless `still`.

    Raises
    ------
    GeometryError
        Names the image.
    InputError
        Where the instant is the same, of bands with TDI stages.
    """
    moving = False
    for k, camera in enumerate(cameras):
        others = sorted((j for j in range(len(cameras)) if j != k), key=lambda j: abs(j - k))
        lags: list[float] = []
        for j in others:
            lags += _lags(camera, cameras[j], surface)
            if np.any(np.abs(lags) > _least_lag(camera)):
                moving = True
                break
        if not lags:
            keys = "first_line_time, look_ahead (forward positive) and ifov"
            if isinstance(camera, FrameCamera):
                keys = "the times of the frames, altitude and speed, and focal_length_px"
            raise GeometryError(
                f"{path}: {names[k]} shares no ground with any other image; check {keys}"
                f"{_ahead_words(camera, [cameras[j] for j in others], surface)}"
            )
        if isinstance(camera, PushbroomCamera):
            apart = float(np.min(np.abs(lags)))
            if apart > MOST_LINES_APART * camera.detector.line_period:
                raise GeometryError(
                    f"{path}: {names[k]} sees ground {apart:.4g} s before or after any other image does, "
                    f"which is more than {MOST_LINES_APART:,} of its lines; images of one pass are expected: "
                    "check first_line_time, or the times of the sensor models"
                )
    if not moving and not still:
        staged = [
            f"{name} ({int(np.max(camera.stages))})"
            for name, camera in zip(names, cameras, strict=True)
            if isinstance(camera, PushbroomCamera) and camera.stages is not None
        ]
        if staged:
            raise InputError(
                f"{path}: all images see the same ground at the same time (lag 0), {', '.join(staged)} over "
                "TDI stages: stages make no lag, so motion cannot be seen; two bands or more that see it at "
                "unlike times are needed: check look_ahead, first_line_time and time_reference"
            )
        raise GeometryError(
            f"{path}: all images see the same ground at the same time (lag 0), so motion cannot be seen; "
            "check look_ahead and first_line_time"
        )


def _ahead_words(camera: MovingCamera, others: Sequence[MovingCamera], surface: Surface) -> str:
    """How far a detector looks ahead, to end a refusal: angles in degrees show here."""
    if not isinstance(camera, PushbroomCamera) or isinstance(surface, Infinity):
        return ""
    middle = camera.detector.directions[camera.columns // 2]
    # camera y is to later lines
    ahead = float(np.arctan2(middle[1], middle[2]))
    here = camera.locate((np.array([camera.shape]) - 1.0) / 2.0, base_surface(surface))[0]
    apart = [
        float(
            np.linalg.norm(
                other.locate((np.array([other.shape]) - 1.0) / 2.0, base_surface(surface))[0] - here
            )
        )
        for other in others
    ]
    apart = [distance for distance in apart if np.isfinite(distance)]
    if not apart:
        return ""
    return (
        f"; it looks {ahead:.3g} rad ahead, {np.degrees(ahead):.3g} degrees, and its middle sees ground "
        f"{min(apart) / 1e3:.3g} km from that of the nearest other: are its angles in rad?"
    )


def _least_lag(camera: MovingCamera) -> float:
    """s; lags up to half a line are none."""
    return 0.5 * camera.detector.line_period if isinstance(camera, PushbroomCamera) else 0.0


def _common(camera: MovingCamera, other: MovingCamera, surface: Surface) -> tuple[Array, Array]:
    """Pixels of a grid over `camera` and where `other` sees their ground; NaN rows where it does not."""
    # the middles of equal parts of the image, which reaches half a pixel beyond the middles of its ends
    parts = [
        (np.arange(count) + 0.5) / count * size - 0.5
        for size, count in zip(camera.shape, OVERLAP_GRID, strict=True)
    ]
    pixels = np.stack(np.meshgrid(*parts, indexing="ij"), axis=-1).reshape(-1, 2)
    seen = other.project(camera.locate(pixels, base_surface(surface)))
    seen[~np.all((seen >= -0.5) & (seen <= np.array(other.shape) - 0.5), axis=1)] = np.nan
    return pixels, seen


def shared_ground(camera: MovingCamera, other: MovingCamera, surface: Surface) -> float:
    """Share (0 to 1) of the ground under `camera`'s image that `other`'s shows too."""
    return float(np.mean(np.isfinite(_common(camera, other, surface)[1][:, 0])))


def _lags(camera: MovingCamera, other: MovingCamera, surface: Surface) -> list[float]:
    """Lags (s) of a few points that both images see: empty where they share no ground."""
    pixels, seen = _common(camera, other, surface)
    both = np.isfinite(seen[:, 0])
    return [float(v) for v in exposure_times(other, seen[both]) - exposure_times(camera, pixels[both])]
