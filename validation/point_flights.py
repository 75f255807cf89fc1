"""Flights of points, drawn anew by seed: truth in closed form, and what a user would be given of it.

No images: points on hills are sighted through frames with the errors that the dense stage assumes: each
sighting by itself, windows that drift while they are followed, a few gross errors, tables with noise and a
bias, a surface that is wrong. Rolls, hills, pinholes, the ellipsoid and lines exposed one after the other are
written out here; nothing is shared with the estimator but its types.
"""

from __future__ import annotations

import os
import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from scipy.spatial.transform import Rotation

from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.io.sequence.load import load_sequence
from sightline.matching.follow import Followed
from sightline.photogrammetry.flight.poses import RoughPoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.sightings import Images, Tracks

SHAPE, FOCAL, ALTITUDE, RATE = (160, 200), 250.0, 80.0, 25.0
STEP, WINDOWS, LIFE = 0.02, 60, 0.4
#: px: windows lie that far from the rim; middle of the frame.
RIM, MIDDLE = 10.0, 0.5 * (np.array(SHAPE) - 1.0)
#: px of a sighting by itself, px of drift from frame to frame, of points that two lines share.
OWN, DRIFT, CROSS = 0.06, 0.012, 0.05
#: Degrees by which the angles of a model are wrong, of all its frames and of each.
MODEL_TURN, MODEL_NOISE = 1.0, 0.1
#: m: of the hills, rms.
HILLS = 1.0
#: s between two lines; m from one to the next beside it (40 per cent of what frames show is in both).
BETWEEN, ASIDE = 10.0, 0.6 * SHAPE[1] * ALTITUDE / FOCAL
#: Frames of a line compared with the other: one in so many, each with so many, points of a pair.
CROSS_STEP, CROSS_PARTNERS, CROSS_POINTS = 6, 2, 30
#: Degrees, m above the ellipsoid: where the flight is if it is on the Earth.
LONGITUDE, LATITUDE, GROUND = 5.1, 51.2, 43.0
#: m: half an equator's diameter, and flattening, of the ellipsoid of GPS.
EQUATOR, FLATTENING = 6378137.0, 1.0 / 298.257223563


@dataclass(frozen=True)
class Kind:
    """What a flight is like, and what is given of it.

    `place` (m) and `turn` (degrees) are sigmas of the tables per axis, `place_bias` and `turn_bias` of their
    constant errors. `craft_from_body`, `craft_from_camera`: how both sit in the craft (forward, right, down),
    the camera's lines running forward. `missing`: frames without an image, from and to (excluded); `lost`:
    nothing is followed over them. `gross`: share of sightings; `understated`: true noise of a sighting over
    what is given of it.
    """

    title: str = "as simulated before"
    frames: int = 48
    place: tuple[float, float, float] = (1.0, 1.0, 1.0)
    turn: tuple[float, float, float] = (0.5, 0.5, 0.5)
    place_bias: float = 2.0
    turn_bias: float = 1.0
    on_earth: bool = False
    craft_from_body: np.ndarray | None = None
    craft_from_camera: np.ndarray | None = None
    readout: float = 0.0
    attitudes: bool = True
    second_line: float | None = None  # degrees from the first
    aside: float = 0.0
    missing: tuple[int, int] = (0, 0)
    lost: bool = False
    gross: float = 0.003
    understated: float = 1.0
    windows: int = WINDOWS  # followed at once
    noise: float = 1.0  # of windows, and their drift, in units of OWN and DRIFT
    hills: float = HILLS  # m, rms
    climb: float = 0.0  # m, from the first frame of a line to the last


@dataclass(frozen=True, eq=False)
class Flight:
    """One flight: truth and what is given of it."""

    position: np.ndarray
    matrix: np.ndarray  # world_from_body
    problem: SequenceProblem
    followed: Followed
    level: np.ndarray  # world from east, north, up
    shared: Tracks | None = None  # by both lines


class Hills:
    """A surface in closed form: sinusoids of all directions, of a Gaussian covariance over places.

    Its correlated area, the integral of the correlation over the plane, is that of a frame.
    """

    def __init__(self, rng: np.random.Generator, rms: float = HILLS) -> None:
        self.rms = rms
        area = SHAPE[0] * SHAPE[1] * (ALTITUDE / FOCAL) ** 2
        self.wave = rng.standard_normal((40, 2)) * np.sqrt(2.0 * np.pi / area)
        self.phase = rng.uniform(0.0, 2.0 * np.pi, 40)

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        angle = self.wave[:, 0] * x[..., None] + self.wave[:, 1] * y[..., None] + self.phase
        return self.rms * np.sqrt(2.0 / 40) * np.sin(angle).sum(axis=-1)


def matrices(roll: np.ndarray, pitch: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """level_from_craft (M, 3, 3) of a craft flying north: forward, right, down; level east, north, up."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    forward = np.stack([cp * sy, cp * cy, sp], axis=-1)
    right = np.stack([sr * sp * sy + cr * cy, sr * sp * cy - cr * sy, -sr * cp], axis=-1)
    return np.stack([forward, right, np.cross(forward, right)], axis=-1)


def about(axis: int, degrees: float) -> np.ndarray:
    """Matrix (3, 3) of a turn about an axis of the craft."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return out


class Line:
    """Even motion, and sinusoids of slow and fast jitter: a flight line from t = `begin`.

    `heading`: degrees clockwise from north, about the middle of the line; `aside`: m to the right.
    """

    def __init__(
        self, rng: np.random.Generator, frames: int, begin: float = 0.0, heading: float = 0.0,
        aside: float = 0.0, climb: float = 0.0,
    ) -> None:  # fmt: skip
        def swing(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
            return rng.uniform(low, high, (3, 1)), rng.uniform(0.0, 2.0 * np.pi, (3, 1))

        sizes = (np.radians(1.0), np.radians(0.1), 0.2)
        bands = ((0.1, 0.8), (2.7, 3.3), (0.05, 0.4))
        self.swings = [(size, *swing(*band)) for size, band in zip(sizes, bands, strict=True)]
        self.speed = STEP * SHAPE[0] * ALTITUDE / FOCAL * RATE
        self.begin, self.aside = begin, aside
        self.climb, self.length = climb, (frames - 1) / RATE
        self.middle = np.array([0.0, 0.5 * self.speed * (frames - 1) / RATE, 0.0])
        c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
        self.turned = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

    def __call__(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (M, 3) and level_from_craft (M, 3, 3) at times (M,)."""
        s = t - self.begin
        slow, fast, place = (size * np.sin(2.0 * np.pi * f * s + phase) for size, f, phase in self.swings)
        height = ALTITUDE + self.climb * (s / self.length - 0.5)
        position = np.stack([self.aside + place[0], self.speed * s + place[1], height + place[2]], axis=1)
        at = self.middle + (position - self.middle) @ self.turned.T
        return at, self.turned @ matrices(*(slow + fast))


class Camera:
    """A pinhole whose lines run forward and columns to the left, exposed one after the other."""

    def __init__(self, kind: Kind) -> None:
        self.craft_from_camera = np.eye(3) if kind.craft_from_camera is None else kind.craft_from_camera
        self.readout = kind.readout

    def pose(self, line: Line, t: float, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position and level_from_camera at the time of each line, of a frame begun at `t`."""
        position, matrix = line(t + self.readout * lines / (SHAPE[0] - 1.0))
        return position, matrix @ self.craft_from_camera

    def see(self, points: np.ndarray, line: Line, t: float) -> np.ndarray:
        """Pixels (n, 2) of points in one frame."""
        pixels = np.tile(MIDDLE, (len(points), 1))
        # the line that shows a point moves by a hundredth of what it was wrong by
        for _ in range(6 if self.readout else 1):
            position, matrix = self.pose(line, t, pixels[:, 0])
            forward, right, down = np.einsum("ni,nij->jn", points - position, matrix)
            pixels = MIDDLE + FOCAL * np.column_stack([forward / down, -right / down])
        return pixels

    def on_ground(self, pixels: np.ndarray, line: Line, t: float, hills: Hills) -> np.ndarray:
        """Where rays of pixels (n, 2) of one frame meet the hills."""
        position, matrix = self.pose(line, t, pixels[:, 0])
        x = (pixels - MIDDLE) / FOCAL
        ray = np.einsum("nij,nj->ni", matrix, np.column_stack([x[:, 0], -x[:, 1], np.ones(len(x))]))
        height = np.zeros(len(x))
        for _ in range(25):
            met = position + ray * ((height - position[:, 2]) / ray[:, 2])[:, None]
            height = hills(met[:, 0], met[:, 1])
        return met


def inside(pixels: np.ndarray) -> np.ndarray:
    """Which pixels (n, 2) lie well within the frame."""
    return ((pixels > RIM) & (pixels < np.array(SHAPE) - 1.0 - RIM)).all(axis=1)


def windows(
    rng: np.random.Generator, kind: Kind, camera: Camera, line: Line, t: np.ndarray, hills: Hills
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sightings (image, point, pixels) of windows followed from a hub till they leave or live out."""
    rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    points, hub, walk = np.empty((0, 3)), np.empty((0, 2)), np.empty((0, 2))
    name, count = np.empty(0, dtype=int), 0
    for k in range(len(t)):
        if kind.missing[0] <= k < kind.missing[1]:
            if kind.lost:
                points, hub, walk, name = points[:0], hub[:0], walk[:0], name[:0]
            continue
        seen = camera.see(points, line, t[k])
        good = inside(seen) & (np.abs(seen - hub).max(axis=1, initial=0.0) < LIFE * SHAPE[0])
        points, hub, walk, name, seen = points[good], hub[good], walk[good], name[good], seen[good]
        walk = walk + kind.noise * DRIFT * rng.standard_normal(walk.shape)
        found = seen + walk + kind.noise * OWN * rng.standard_normal(seen.shape)
        wild = rng.random(len(found)) < kind.gross
        found[wild] += rng.uniform(-3.0, 3.0, (wild.sum(), 2))
        if k % 3 == 0 and len(points) < kind.windows:
            new = rng.uniform(RIM, np.array(SHAPE) - 1.0 - RIM, (kind.windows - len(points), 2))
            points = np.concatenate([points, camera.on_ground(new, line, t[k], hills)])
            hub, walk = np.concatenate([hub, new]), np.concatenate([walk, np.zeros(new.shape)])
            name = np.concatenate([name, count + np.arange(len(new))])
            count += len(new)
            # a hub's own place is where all others are compared to
            found = np.concatenate([found, new + kind.noise * OWN * rng.standard_normal(new.shape)])
        rows.append((np.full(len(name), k), name.copy(), found))
    image, point, pixels = (np.concatenate(part) for part in zip(*rows, strict=True))
    order = np.lexsort((image, point))
    return image[order], point[order], pixels[order]


def in_common(
    rng: np.random.Generator, camera: Camera, lines: tuple[Line, Line], t: np.ndarray, hills: Hills
) -> Tracks:
    """Points that frames of both lines show, each seen in two frames."""
    frames = len(t) // 2
    image, pixels = [], []
    for k in range(0, frames, CROSS_STEP):
        new = rng.uniform(RIM, np.array(SHAPE) - 1.0 - RIM, (CROSS_POINTS, 2))
        points = camera.on_ground(new, lines[0], t[k], hills)
        there = {j: camera.see(points, lines[1], t[j]) for j in range(frames, 2 * frames, CROSS_STEP)}
        best = sorted(there, key=lambda j: -int(inside(there[j]).sum()))[:CROSS_PARTNERS]
        for j in best:
            both = inside(there[j])
            image.append(np.repeat([[k, j]], int(both.sum()), axis=0))
            pixels.append(np.stack([new[both], there[j][both]], axis=1))
    frame, place = np.concatenate(image), np.concatenate(pixels)
    place = place + CROSS * rng.standard_normal(place.shape)
    point = np.repeat(np.arange(len(frame)), 2)
    return Tracks(frame.ravel(), point, place.reshape(-1, 2), np.array(CROSS))


def motions(image: np.ndarray, point: np.ndarray, pixels: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Motion (M, 4) of each frame since the one before: shift, turn, growth by the medians of its windows."""
    out = np.full((len(before), 4), np.nan)
    for k in np.flatnonzero(before >= 0):
        here, there = np.flatnonzero(image == k), np.flatnonzero(image == before[k])
        _, a, b = np.intersect1d(point[here], point[there], return_indices=True)
        if len(a) < 4:
            continue  # all were lost in between
        x, d = pixels[there[b]] - MIDDLE, pixels[here[a]] - pixels[there[b]]
        d = d - np.median(d, axis=0)
        size = (x**2).sum(axis=1)
        far = np.linalg.norm(d, axis=1)
        weight = far < 3.0 * np.median(far)  # gross errors are mostly larger
        turn = (weight * (x[:, 0] * d[:, 1] - x[:, 1] * d[:, 0])).sum() / (weight * size).sum()
        growth = (weight * (x * d).sum(axis=1)).sum() / (weight * size).sum()
        shift = np.median(pixels[here[a]] - pixels[there[b]], axis=0)
        out[k] = *shift, turn, growth
    return out


def earth(lon: float, lat: float, height: float) -> np.ndarray:
    """Earth-fixed place (3,) m of degrees and m above the ellipsoid."""
    lon, lat = np.radians(lon), np.radians(lat)
    square = FLATTENING * (2.0 - FLATTENING)
    normal = EQUATOR / np.sqrt(1.0 - square * np.sin(lat) ** 2)
    return np.array([
        (normal + height) * np.cos(lat) * np.cos(lon), (normal + height) * np.cos(lat) * np.sin(lon),
        (normal * (1.0 - square) + height) * np.sin(lat),
    ])  # fmt: skip


def axes_of_place(lon: float, lat: float) -> np.ndarray:
    """Earth-fixed from east, north, up (3, 3), by differences of `earth`."""
    east = earth(lon + 1e-3, lat, 0.0) - earth(lon - 1e-3, lat, 0.0)
    north = earth(lon, lat + 1e-3, 0.0) - earth(lon, lat - 1e-3, 0.0)
    east, north = east / np.linalg.norm(east), north / np.linalg.norm(north)
    return np.stack([east, north, np.cross(east, north)], axis=1)


def lonlat(places: np.ndarray) -> np.ndarray:
    """Longitude, latitude (degrees), height (n, 3) of Earth-fixed places (n, 3), by Newton's steps."""
    out = np.tile([LONGITUDE, LATITUDE, GROUND], (len(places), 1))
    for row, place in zip(out, places, strict=True):
        for _ in range(3):
            change = [earth(*(row + d)) - earth(*(row - d)) for d in np.diag([1e-4, 1e-4, 1.0])]
            columns = np.stack(change, axis=1) / np.array([2e-4, 2e-4, 2.0])
            row += np.linalg.solve(columns, place - earth(*row))
    return out


def loaded(
    kind: Kind, t: np.ndarray, given: np.ndarray, attitude: Rotation, excluded: tuple[str, ...]
) -> SequenceProblem:
    """The problem of a SEQUENCE.toml with longitudes, latitudes, heights; `given` (M, 3) Earth-fixed."""
    places, quats = lonlat(given), attitude.as_quat()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        # its pixels are never looked at, but a constant one would be reported
        pixels = (np.indices(SHAPE).sum(axis=0) % 251).astype(np.uint8)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(
                home / "frame.tif", "w", "GTiff", *SHAPE[::-1], count=1, dtype="uint8"
            ) as file:
                file.write(pixels, 1)
            for k in range(len(t)):
                os.link(home / "frame.tif", home / f"frame-{k}.tif")
            problem = _read(kind, t, places, quats, home)
    return replace(problem, excluded=excluded)


def _read(kind: Kind, t: np.ndarray, places: np.ndarray, quats: np.ndarray, home: Path) -> SequenceProblem:
    """The problem, its files written into a folder."""
    turn = [str(float(np.radians(v))) for v in kind.turn]
    rows = {
        "frames": [[f"frame-{k}.tif"] for k in range(len(t))],
        "positions": [[*map(repr, map(float, p)), *map(str, kind.place)] for p in places],
        "attitudes": [[*map(repr, map(float, q)), *turn] for q in quats],
    }
    head = {
        "frames": "frame,t,image",
        "positions": "frame,t,x,y,z,sigma_x,sigma_y,sigma_z",
        "attitudes": "frame,t,qx,qy,qz,qw,sigma_roll,sigma_pitch,sigma_yaw",
    }
    for name, title in head.items():
        lines = [",".join([f"f{k}", repr(float(t[k])), *row]) for k, row in enumerate(rows[name])]
        (home / f"{name}.csv").write_text("\n".join([title, *lines]) + "\n")
    (home / "SEQUENCE.toml").write_text(
        'frames = "frames.csv"\npositions = "positions.csv"\nattitudes = "attitudes.csv"\n'
        f"position_bias_sigma = {kind.place_bias}\nattitude_bias_sigma = {np.radians(kind.turn_bias)}\n"
        '[world]\nframe = "lonlat"\n'
        f"[camera]\nfocal_length_px = {FOCAL}\nreadout_time = {kind.readout}\n"
        f"[surface]\nheight = {GROUND}\nheight_sigma = {HILLS}\n"
    )
    return load_sequence(home / "SEQUENCE.toml")


def problem_of(
    kind: Kind, t: np.ndarray, given: np.ndarray, attitude: Rotation, excluded: tuple[str, ...]
) -> SequenceProblem:
    """The problem in a flat world."""
    count = len(t)
    turn = np.radians(kind.turn) if kind.attitudes else np.full(3, np.inf)
    known = RoughPoses(
        np.tile(kind.place, (count, 1)), np.tile(turn, (count, 1)), kind.place_bias,
        np.radians(kind.turn_bias),
    )  # fmt: skip
    detector = AreaDetector("frame", SHAPE, FOCAL, (MIDDLE[0], MIDDLE[1]))
    body_from_camera = np.eye(3)
    if kind.craft_from_body is not None:
        body_from_camera = kind.craft_from_body.T
    if kind.craft_from_camera is not None:
        body_from_camera = body_from_camera @ kind.craft_from_camera
    return SequenceProblem(
        tuple(map(str, range(count))), t, (ArrayImage(np.zeros(SHAPE)),) * count, detector,
        Rotation.from_matrix(body_from_camera) * NADIR_MOUNT,
        Images(np.zeros(count), np.arange(count), t, given, attitude), known, Plane(0.0), kind.hills,
        kind.readout, 0.8, excluded,
    )  # fmt: skip


def sighted(
    rng: np.random.Generator, kind: Kind, camera: Camera, lines: list[Line], t: np.ndarray, hills: Hills
) -> Followed:
    """Windows followed along each line."""
    parts, before = [], np.arange(len(t)) - 1
    for number, line in enumerate(lines):
        first = number * kind.frames
        image, point, pixels = windows(rng, kind, camera, line, t[first : first + kind.frames], hills)
        names = parts[-1][1].max() + 1 if parts else 0
        parts.append((image + first, point + names, pixels))
        before[first] = -1
    image, point, pixels = (np.concatenate(part) for part in zip(*parts, strict=True))
    low, high = kind.missing
    if high > low:
        before[low:high], before[high] = -1, -1 if kind.lost else low - 1
    motion = motions(image, point, pixels, before)
    before[np.isnan(motion[:, 0])] = -1
    nothing = np.ones(len(t))
    return Followed(
        image, point, pixels, np.full(len(image), kind.noise * OWN / kind.understated), before,
        motion, np.bincount(image, minlength=len(t)), nothing, nothing,
        ("",) * len(t),
    )  # fmt: skip


def draw(seed: int, kind: Kind) -> Flight:
    """A flight."""
    rng = np.random.default_rng(seed)
    camera, lines = Camera(kind), [Line(rng, kind.frames, climb=kind.climb)]
    t = np.arange(kind.frames) / RATE
    if kind.second_line is not None:
        begin = t[-1] + BETWEEN
        lines.append(Line(rng, kind.frames, begin, kind.second_line, kind.aside))
        t = np.concatenate([t, begin + t])
    hills = Hills(rng, kind.hills)
    followed = sighted(rng, kind, camera, lines, t, hills)
    shared = in_common(rng, camera, (lines[0], lines[1]), t, hills) if len(lines) == 2 else None
    parts = [line(t[k * kind.frames : (k + 1) * kind.frames]) for k, line in enumerate(lines)]
    position, matrix = (np.concatenate(part) for part in zip(*parts, strict=True))
    if kind.craft_from_body is not None:
        matrix = matrix @ kind.craft_from_body
    count = len(t)
    noise = kind.place_bias * rng.standard_normal(3) + kind.place * rng.standard_normal((count, 3))
    turn = np.radians(kind.turn_bias) * rng.standard_normal(3)
    turn = turn + np.radians(kind.turn) * rng.standard_normal((count, 3))
    level = axes_of_place(LONGITUDE, LATITUDE) if kind.on_earth else np.eye(3)
    origin = earth(LONGITUDE, LATITUDE, GROUND) if kind.on_earth else np.zeros(3)
    given = origin + (position + noise) @ level.T
    position, matrix = origin + position @ level.T, level @ matrix
    if not kind.attitudes:
        # those of a model, which lies and is turned as a whole as its tables have it
        turn = np.radians(MODEL_TURN) * rng.standard_normal(3)
        turn = turn + np.radians(MODEL_NOISE) * rng.standard_normal((count, 3))
    attitude = Rotation.from_matrix(matrix) * Rotation.from_rotvec(turn)
    low, high = kind.missing
    excluded = tuple("missing" if low <= k < high else "" for k in range(count))
    problem = (loaded if kind.on_earth else problem_of)(kind, t, given, attitude, excluded)
    if not kind.attitudes:
        problem = replace(problem, start=replace(problem.images, position=position + noise[:1]))
    return Flight(position, matrix, problem, followed, level, shared)
