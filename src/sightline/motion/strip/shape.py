"""Whether a detector line is as its directions say: what matches leave over the columns of the field.

A bent line, or CCDs that meet in steps, shift the windows of every row alike. What a row as a whole does is
motion, offset, rotation and magnification: it is taken out, row by row, whatever the motion was found to be.

Not here: the parameters of a shape (``motion/statics.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from sightline.estimation.robust import robust_sigmas
from sightline.geometry.conjugate import predict_match
from sightline.matching.matches import KEPT
from sightline.motion.band import Band
from sightline.motion.measure.plan import LEAST_WIDTH
from sightline.motion.measure.predict import MovingCamera
from sightline.motion.measure.stars import StarRecord
from sightline.motion.statics import BEND_DEGREES, band_statics, measure_of_shapes
from sightline.motion.strip.estimate import StripState
from sightline.motion.strip.joint import nodes_on
from sightline.motion.strip.strip import RecoverOptions, Shapes, Strip, window_columns

Array = NDArray[np.float64]

#: Probability with which a strip of straight lines is taken for one of others, px (rms over the columns) from
#: which a shape is taken where none is given, and from which what is left is warned of. (Textures of two
#: colours differ by 0.01 to 0.04 px, by much the same in all columns.)
CHANCE, TAKEN_PX, LEAST_PX = 1e-4, 0.03, 0.02
#: At most so many groups of columns are tested, by the scatter of so many stretches of the strip.
GROUPS, STRETCHES = 16, 64
#: Windows further from their row than so many times the usual are no match of it.
FAR = 5.0
#: px; error of the mean of windows that a step divides: they match where their texture is.
DIVIDED = 0.01
#: Fewest rows of windows, and windows of a column, that say anything; windows side by side that tell bends
#: from steps.
FEW_ROWS, FEW_COLUMNS = 6, 8
#: Most places at which a step is tried.
MOST_PLACES = 2000
#: Lines at which the columns of two bands are compared.
PLACES = 5


@dataclass(frozen=True)
class Departure:
    """How one band departs from another over the columns.

    Attributes
    ----------
    chance : float
        Probability of one as large in the strip where both are straight.
    size_px : float
        rms over the columns, noise taken off.
    borders : tuple of int
        Columns of the other image (its hub) at which steps explain it better than bends do; empty: bends.
    steps : tuple of int
        Columns of the best steps, whether or not bends explain it better.
    either : bool
        Whether it was too coarse a look to tell bends from steps.
    profile : (C, 2)
        px; mean departure of each group of columns along and across.
    """

    chance: float
    size_px: float
    borders: tuple[int, ...]
    steps: tuple[int, ...]
    either: bool
    profile: Array


def line_departures(
    records: Sequence[StarRecord], left: Sequence[Array], height_sigma: float = 0.0
) -> dict[tuple[int, int], Departure]:
    """Departures of the pairs (hub, partner) of the largest star, as far as enough is matched to tell.

    Parameters
    ----------
    records : sequence of StarRecord
    left : sequence of (G, K, 2)
        px; what the estimate leaves of every star.
    height_sigma : float
        m; what is not known of the ground: along an axis where it moves windows by as much as they depart,
        the ground may be what bends.

    Notes
    -----
    Hotelling's T^2 of the means of groups of columns, by their scatter between stretches of the strip: the
    law is F where these are independent, whatever sigma matches state; fewer are counted where neighbours are
    alike. The chance is that of all tests.
    """
    at = max(range(len(records)), key=lambda k: records[k].status.size)
    record, residual = records[at], left[at]
    found: dict[tuple[int, int], Departure] = {}
    tests = 2 * len(record.star.images)
    for pair, image in enumerate(record.star.images):
        beside = _beside_rows(record, residual, pair)
        if beside is None:
            continue
        values, u = _by_stretch(beside)
        profile = values.mean(axis=0)
        noise = values.var(axis=0, ddof=1) / len(values)
        squares = np.maximum((profile**2 - noise).mean(axis=0), 0.0)
        ground = height_sigma * np.median(np.abs(record.star.by_height[:, pair]), axis=0)
        tested = squares >= ground**2
        chance = min((_chance(values[..., axis], u) for axis in np.flatnonzero(tested)), default=1.0)
        size = float(np.sqrt(squares[tested].sum()))
        steps, bent = _steps(beside)
        found[record.star.hub, image] = Departure(
            min(tests * chance, 1.0), size, () if bent else steps, steps, bent and beside.coarse, profile
        )
    return found


@dataclass(frozen=True)
class _BesideRows:
    """What matches of a pair leave beside what their rows do, of rows and columns of windows that match.

    left (R, C, 2) px, NaN where nothing is matched; u (C,) places in the field, -1 .. 1; columns (C,) of the
    hub, in windows so `width` px wide.
    """

    left: Array
    u: Array
    columns: Array
    width: float

    @property
    def coarse(self) -> bool:
        """Whether so few windows lie side by side that bends and steps look alike."""
        return len(self.u) < FEW_COLUMNS


def _beside_rows(record: StarRecord, residual: Array, pair: int) -> _BesideRows | None:
    """Residuals of a pair less constant and slope of each row; None where too little is matched."""
    star = record.star
    rows, blocks = star.shape
    r = residual[:, pair].reshape(rows, blocks, 2)
    ok = (record.status[:, pair] == KEPT).reshape(rows, blocks) & np.isfinite(r).all(axis=2)
    counts = ok.sum(axis=0)
    seen = counts >= 0.5 * counts.max(initial=1)
    ok, r, u = (
        ok[:, seen],
        np.where(ok[..., None], r, 0.0)[:, seen],
        star.field.reshape(rows, blocks)[0, seen],
    )
    if len(u) < 3:
        return None
    for _ in range(3):
        ok &= ok.sum(axis=1, keepdims=True) >= max(3, len(u) // 2)
        if not ok.any():
            return None
        left = r - _row_lines(r, ok, u)
        ok &= (np.abs(left) <= FAR * robust_sigmas(left[ok], 0)).all(axis=2)
    used = ok.any(axis=1)
    if used.sum() < FEW_ROWS or (ok.sum(axis=0) < FEW_ROWS).any():
        return None
    columns = star.pixels.reshape(rows, blocks, 2)[0, seen, 1]
    width = float(star.window[1]) if star.window else float(np.diff(columns).mean())
    return _BesideRows(np.where(ok[..., None], left, np.nan)[used], u, columns, width)


def _by_stretch(beside: _BesideRows) -> tuple[Array, Array]:
    """Means (B, C, 2) px of stretches of the strip and groups of columns, and places (C,) of the groups."""
    rows, blocks = beside.left.shape[:2]
    groups = min(blocks, GROUPS, max(rows // 3, 3))
    parts = np.array_split(np.arange(blocks), groups)
    stretches = np.array_split(np.arange(rows), min(STRETCHES, max(rows // 4, min(rows, 3 * groups))))
    filled = np.nan_to_num(beside.left)
    weight = np.isfinite(beside.left[..., 0])
    count = np.array([[weight[s][:, p].sum() for p in parts] for s in stretches], dtype=float)
    total = np.array([[filled[s][:, p].sum(axis=(0, 1)) for p in parts] for s in stretches])
    whole = (count > 0).all(axis=1)
    places = np.array([beside.u[p].mean() for p in parts])
    if whole.sum() < 2:
        return np.zeros((2, groups, 2)), places
    return total[whole] / count[whole][..., None], places


def _row_lines(r: Array, ok: NDArray[np.bool_], u: Array) -> Array:
    """Constant and slope of each row (rows, blocks, 2), by its windows that are `ok`."""
    n = np.maximum(ok.sum(axis=1), 1)[:, None]
    x = (np.where(ok, u, 0.0).sum(axis=1, keepdims=True) / n)[..., None]
    mean = np.where(ok[..., None], r, 0.0).sum(axis=1, keepdims=True) / n[..., None]
    apart = np.where(ok, u - x[..., 0], 0.0)[..., None]
    square = np.maximum((apart**2).sum(axis=1, keepdims=True), 1e-12)
    slope = (apart * (r - mean)).sum(axis=1, keepdims=True) / square
    return np.asarray(mean + slope * (u[None, :, None] - x))


def _beyond_lines(u: Array) -> Array:
    """(C, C - 2) orthonormal: what of values at places `u` (C,) is no constant and no slope."""
    q, _ = np.linalg.qr(np.stack([np.ones_like(u), u], axis=1), mode="complete")
    return np.asarray(q[:, 2:])


def _chance(values: Array, u: Array) -> float:
    """Probability that means over (B,) of values (B, C) depart from a line as far as they do."""
    y = values @ _beyond_lines(u)
    n, p = y.shape
    if n <= p + 1 or not y.any():
        return 1.0
    mean, scatter = y.mean(axis=0), np.atleast_2d(np.cov(y, rowvar=False))
    if np.linalg.matrix_rank(scatter) < p:
        return 1.0
    left = (y - mean) / y.std(axis=0)
    alike = max(float((left[1:] * left[:-1]).sum() / (left**2).sum()), 0.0)
    square = n * (1.0 - alike) / (1.0 + alike) * float(mean @ np.linalg.solve(scatter, mean))
    return float(fdtrc(p, n - p, square * (n - p) / (p * (n - 1))))


def _steps(beside: _BesideRows) -> tuple[tuple[int, ...], bool]:
    """Columns of the hub at which steps explain what is left of a pair; whether bends do better.

    As many as pay for their two sizes and their place (Schwarz's criterion).
    """
    u, columns, width = beside.u, beside.columns, beside.width
    q = _beyond_lines(u)
    # columns err on their own: their scatter is that between rows
    mean = np.nanmean(beside.left, axis=0)
    noise = np.nanvar(beside.left, axis=0, ddof=1) / np.isfinite(beside.left).sum(axis=0) + DIVIDED**2
    whiten = [np.linalg.inv(np.linalg.cholesky(q.T @ (noise[:, a, None] * q))) for a in range(2)]
    data = [whiten[a] @ (q.T @ mean[:, a]) for a in range(2)]
    price = float(np.log(beside.left.size))
    apart = max(1, round((columns[-1] - columns[0]) / MOST_PLACES))
    candidates = np.arange(int(columns[0]), int(columns[-1]) + 1, apart)
    share = np.clip((columns[:, None] - candidates) / width + 0.5, 0.0, 1.0)
    along = [whiten[a] @ (q.T @ share) for a in range(2)]

    def without(chosen: Sequence[int]) -> tuple[list[Array], list[Array]]:
        """Data and candidates less what the chosen steps explain."""
        out, rest = [], []
        for a in range(2):
            basis, _ = np.linalg.qr(along[a][:, list(chosen)])
            out.append(data[a] - basis @ (basis.T @ data[a]))
            rest.append(along[a] - basis @ (basis.T @ along[a]))
        return out, rest

    def best(chosen: Sequence[int]) -> tuple[int, float]:
        """The candidate that explains most beside the chosen ones, and how much."""
        left, rest = without(chosen)
        gain = np.zeros(len(candidates))
        for a in range(2):
            size = (rest[a] ** 2).sum(axis=0)
            usable = size > 1e-6 * (along[a] ** 2).sum(axis=0).max()
            gain += np.where(usable, (left[a] @ rest[a]) ** 2 / np.where(usable, size, 1.0), 0.0)
        for other in chosen:  # no CCD is shorter than a window
            gain[abs(candidates - candidates[other]) < width] = 0.0
        at = int(np.argmax(gain))
        return at, float(gain[at])

    chosen: list[int] = []
    while len(chosen) < len(u) // 3:
        at, gain = best(chosen)
        if gain < 3.0 * price:
            break
        chosen.append(at)
    for k in (*range(len(chosen)), *range(len(chosen))):
        chosen[k] = best(chosen[:k] + chosen[k + 1 :])[0]
    degrees = [n for n in BEND_DEGREES if n < len(u)]
    bends = np.stack([np.polynomial.Legendre.basis(n)(u) for n in degrees], axis=1)
    costs = []
    for count in range(1, len(degrees) + 1):
        cost = 2.0 * count * price
        for a in range(2):
            basis, _ = np.linalg.qr(whiten[a] @ (q.T @ bends[:, :count]))
            cost += float(((data[a] - basis @ (basis.T @ data[a])) ** 2).sum())
        costs.append(cost)
    left, _ = without(chosen)
    stepped = sum(float((part**2).sum()) for part in left) + 3.0 * len(chosen) * price
    return tuple(sorted(int(candidates[k]) for k in chosen)), not chosen or min(costs) <= stepped


def _without_columns(band: Band) -> bool:
    """Whether a band is made of CCDs of which it does not say where they meet."""
    return band.shape == "pieces" and not band.pieces and band.shape_sigma_px > 0.0


def ask_for_shapes(strip: Strip, state: StripState) -> bool:
    """Whether shapes are to be looked for: CCDs without columns, or matches that show one."""
    measure = measure_of_shapes(strip.bands)
    if any(_without_columns(band) for k, band in enumerate(strip.bands) if k != measure):
        return True
    found = line_departures(state.records, state.post_px, state.height_sigma)
    return any(
        one.chance < CHANCE and one.size_px > TAKEN_PX and strip.bands[image].shape is None
        for (_, image), one in found.items()
    )


def unknown_shapes(
    strip: Strip, records: Sequence[StarRecord], cameras: Sequence[MovingCamera], height_sigma: float
) -> Shapes:
    """Shapes that are not given of the bands, as far as `records` of narrow windows show them."""
    found = line_departures(records, [record.star.residual_px for record in records], height_sigma)
    out = []
    for (hub, image), one in found.items():
        band = strip.bands[image]
        borders = columns_in(strip, cameras, hub, image, one.borders or one.steps)
        if _without_columns(band):
            if not borders:
                continue
            out.append((image, "pieces", borders, one.size_px))
        elif band.shape is None and one.chance < CHANCE and one.size_px > TAKEN_PX:
            shape = "pieces" if one.borders else "polynomial"
            out.append((image, shape, borders if one.borders else (), one.size_px))
    return tuple(out)


def with_shapes(strip: Strip, shapes: Shapes) -> Strip:
    """The strip with detector lines of these shapes, and what they depart by among its parameters."""
    if not shapes:
        return strip
    bands = list(strip.bands)
    for image, shape, columns, _ in shapes:
        bands[image] = replace(bands[image], shape=shape, pieces=columns)
    return replace(strip, bands=tuple(bands), parameters=tuple(band_statics(bands)), shapes=shapes)


def windows_over_bends(options: RecoverOptions, bands: Sequence[Band]) -> RecoverOptions:
    """Options with windows narrow enough to tell the bends of a short line from its turn and its stretch.

    A window sees the mean of a bend over its columns: that of three windows side by side is hardly told from
    a slope. A width that was asked for stays.
    """
    height, width = options.window
    bent = [band.camera.columns for band in bands if band.shape == "polynomial"]
    if (
        not bent
        or "window" in options.asked
        or width not in (RecoverOptions().window[1], window_columns(bands))
    ):
        return options
    return replace(options, window=(height, min(width, max(min(bent) // FEW_COLUMNS, LEAST_WIDTH))))


def _taken(strip: Strip, image: int, shape: str, columns: tuple[int, ...], size_px: float) -> str:
    """What to say of a shape that was found and taken."""
    key = f'shape = "{shape}"' + (f", pieces = {list(columns)}" if columns else "")
    return (
        f"{strip.bands[image].name} departs from a straight line by {size_px:.2g} px rms over the columns, "
        f'which is no chance, and is taken for what it shows: its [[band]] may say {key}, or shape = "line" '
        "where it is known to be one"
    )


def shape_warnings(strip: Strip, state: StripState) -> list[str]:
    """What to say of bands that depart from their directions, and the key that would mend each."""
    out = [_taken(strip, *one) for one in strip.shapes]
    out += [
        f'{band.name} is given as "pieces", but no steps are found over its columns: it is taken as a line; '
        "give the first columns of its CCDs: pieces = [..]"
        for image, band in enumerate(strip.bands)
        if _without_columns(band) and image != measure_of_shapes(strip.bands)
    ]
    cameras = strip.cameras(nodes_on(state.estimate, strip.grid), state.estimate.statics)
    for (hub, image), one in line_departures(state.records, state.post_px, state.height_sigma).items():
        if one.chance > CHANCE or one.size_px < LEAST_PX:
            continue
        borders = columns_in(strip, cameras, hub, image, one.borders)
        key = f'shape = "pieces", pieces = {list(borders)}' if borders else 'shape = "polynomial"'
        key += ', or "pieces" if it is made of CCDs' if one.either else ""
        largest = float(np.abs(one.profile).max())
        out.append(
            f"{strip.bands[image].name} departs from its shape beside {strip.bands[hub].name}: "
            f"{one.size_px:.2g} px rms over the columns are left, up to {largest:.2g} px, which detectors of "
            f"that shape leave once in {1.0 / max(one.chance, 1e-15):.2g} strips; its [[band]] may say {key}"
        )
    return out


def columns_in(
    strip: Strip, cameras: Sequence[MovingCamera], hub: int, image: int, columns: Sequence[int]
) -> tuple[int, ...]:
    """Columns of another image that see what `columns` of a hub do, as good as they are seen."""
    if not columns:
        return ()
    lines = np.linspace(0.0, strip.nominal[hub].lines - 1.0, PLACES + 2)[1:-1]
    pixels = np.stack(np.meshgrid(lines, np.asarray(columns, dtype=float), indexing="ij"), axis=-1)
    places = predict_match(cameras[hub], cameras[image], strip.surface, pixels.reshape(-1, 2))
    middle = np.nanmedian(places[:, 1].reshape(len(lines), -1), axis=0)
    last = strip.nominal[image].columns - 1
    return tuple(int(c) for c in np.unique(np.rint(middle[np.isfinite(middle)])) if 0 < c <= last)
