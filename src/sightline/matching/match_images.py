"""The one entry point of matching: points of one image found in another, with their covariance.

Not the prediction of where to look: positions come in as arrays (see `sightline.motion.measure.predict`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.execution import Step, in_threads, no_step, slices
from sightline.imaging.resample import kernel_table
from sightline.imaging.source import ImageSource
from sightline.matching import kernels, matches
from sightline.matching.correlate import (
    agreement_of_gradients,
    chance_agreement,
    pair_covariances,
    search_shift,
)
from sightline.matching.matches import Matches
from sightline.matching.patches import Block, column_parts, cut_blocks, group_windows, warp_block
from sightline.matching.whitening import Whitening, estimate_whitening
from sightline.writing import let_go, scratch_array

__all__ = ["match_images"]

#: Share of a window's pixels that may be masked.
MAX_MASKED = 0.2
#: px; largest sigma of a match in any direction.
MAX_SIGMA_PX = 0.5
_BLOCK_PIXELS = 1_500_000
#: Windows of which covariances are found at a time.
_AT_ONCE = 16384
_ITERATIONS = 12
_TOLERANCE_PX = 0.01
_MAX_SATURATED = 0.1
_MAX_GROWN = 0.5
_SQUARE_TILE = (48, 48)


def match_images(
    image_a: ImageSource,
    image_b: ImageSource,
    points_a: NDArray[np.float64],
    predicted_b: NDArray[np.float64],
    *,
    window: tuple[int, int] = (10, 100),
    affine: NDArray[np.float64] | None = None,
    search_px: tuple[int, int] = (0, 0),
    whitening: Whitening | str | None = "auto",
    max_shift_px: float = 1.5,
    max_masked: float = MAX_MASKED,
    saturation: float | None = None,
    min_score: float = 0.2,
    max_sigma_px: float = MAX_SIGMA_PX,
    both_ways: bool = False,
    threads: int | None = None,
    step: Step = no_step,
) -> Matches:
    """Points of image a found in image b to a few thousandths of a pixel, with a covariance that is true.

    Parameters
    ----------
    image_a, image_b : ImageSource
    points_a : (N, 2)
        Centres of the windows in image a, (line, column), fractions allowed. The pixels used are the window
        of whole pixels nearest to it (the centre of an even window lies between two pixels); what the
        rounding moves goes through `affine`, so the answer is for the point as given.
    predicted_b : (N, 2)
        Where each point should lie in image b.
    window : (int, int)
        Lines and columns of the window. Low and wide keeps time resolution in a pushbroom image.
    affine : (N, 2, 2), optional
        Local change of geometry: ``b = predicted_b + affine @ (pixel - point_a)``. Identity by default. Large
        ones (rotation, zoom) are warped pixel by pixel, which is slower.
    search_px : (int, int)
        Half-range of the whole-pixel search around the prediction; (0, 0) when it is good to 0.7 px.
    whitening : Whitening, "auto" or None
        Filters of the pair; "auto" estimates them at the points given; None compares the images as they are.
    max_shift_px : float
        Furthest that the sub-pixel fit may move from where it started, px.
    max_masked : float
        Largest share of unusable pixels in a window; those below it are left out of the fit.
    saturation : float, optional
        Pixel value from which on a pixel is saturated; windows with more than 10 % of these are refused.
    min_score : float
        Lowest normalised correlation of the fitted windows; windows of few pixels need 4 / sqrt(pixels).
    max_sigma_px : float
        A match whose larger principal sigma exceeds this says nothing: it is refused as textureless.
    both_ways : bool
        Whether each match must stand out from chance along lines and columns, and any direction between
        (`correlate.chance_agreement`), where nothing else will tell: stripes are refused as textureless. Low
        contrast is too, which many windows together may place.
    threads : int, optional
        Threads to use, all cores by default. The result does not depend on it.
    step : callable
        Called with the number of blocks of windows that are matched, and of all.

    Returns
    -------
    Matches
        One row per point; NaN in `b` where the point was not found, and the reason in `status`.

    Raises
    ------
    InputError
        If shapes do not agree or an option is out of range.
    EstimationError
        If ``whitening="auto"`` cannot be estimated.

    Notes
    -----
    S1, step (a): zones matched by radiometric similarity. Symmetric Gauss-Newton on whitened windows, gain
    and offset projected out (see `kernels.refine_windows`); covariance by `correlate.pair_covariances`. The
    covariance is that of b given a: the noise of both images together.

    Examples
    --------
    >>> import numpy as np
    >>> from sightline.imaging.source import ArrayImage
    >>> y, x = np.mgrid[0:60, 0:160]
    >>> scene = np.sin(0.7 * y + 0.2 * x) + np.sin(0.5 * x - 0.3 * y) + np.sin(0.9 * x + 0.4 * y)
    >>> image = ArrayImage(scene)
    >>> found = match_images(image, image, np.array([[30.0, 80.0]]), np.array([[30.3, 79.8]]), whitening=None)
    >>> bool(np.abs(found.b - found.a).max() < 1e-3)
    True
    """
    points_a, predicted_b, linear = _checked(points_a, predicted_b, affine, window, search_px)
    if isinstance(whitening, str):
        if whitening != "auto":
            raise InputError(
                f'`whitening` is "{whitening}"; "auto", None or a Whitening is allowed; '
                "see estimate_whitening"
            )
        whitening = estimate_whitening(
            image_a,
            image_b,
            points_a,
            predicted_b,
            affine=None if affine is None else linear + np.eye(2),
            tile=None if window[1] >= 4 * window[0] else _SQUARE_TILE,
            reach=(max(search_px[0], 3), max(search_px[1], 3)),
        )
    size = np.array(window)
    corner = np.floor(np.nan_to_num(points_a) - 0.5 * (size - 1) + 0.5)
    centre_a = corner + 0.5 * (size - 1)
    moved = centre_a - points_a
    centre_b = predicted_b + moved + np.einsum("nij,nj->ni", linear, moved)
    status = np.full(len(points_a), matches.OUTSIDE, np.uint8)
    parts = column_parts(linear, window)
    inside = np.zeros(len(points_a), dtype=bool)
    for some in slices(len(inside), _AT_ONCE):
        places = centre_a[some], centre_b[some], linear[some]
        inside[some] = _inside(*places, size, image_a.shape, image_b.shape)
    reach = (search_px[0] + int(np.ceil(max_shift_px)) + 1, search_px[1] + int(np.ceil(max_shift_px)) + 1)
    # a column after the other: what is pooled takes some columns of all windows
    fits = scratch_array((kernels.COLUMNS, len(points_a))).T
    for some in slices(len(fits), _AT_ONCE):
        fits[some] = np.nan
        let_go()
    turns = None if affine is None else np.broadcast_to(np.eye(2), (len(points_a), 2, 2)).copy()

    def work(job: tuple[int, NDArray[np.intp]]) -> None:
        part, rows = job
        extra = _growth(linear[rows], window) if part == 0 else (0, 0)
        wide = (reach[0] + extra[0], reach[1] + extra[1])
        taps = (None, None) if whitening is None else (whitening.taps_a, whitening.taps_b)
        cut = (taps[0], None) if part == 0 else taps
        block = cut_blocks(image_a, image_b, centre_a, centre_b, linear, rows, window, wide, cut, saturation)
        if part == 0:
            block = warp_block(block, window, reach, taps[1])
        status[rows], fits[rows] = _match_block(
            block, window, search_px, max(part, 1), max_shift_px, max_masked
        )
        if turns is not None:
            turns[rows] = block.turn
        let_go()

    jobs = [
        (int(part), group)
        for part in np.unique(parts[inside])
        for group in group_windows(
            centre_a, centre_b, np.flatnonzero(inside & (parts == part)), window,
            _BLOCK_PIXELS if part else _BLOCK_PIXELS // 20,
        )
    ]  # fmt: skip
    in_threads(work, jobs, threads, step)
    lowest = max(min_score, 4.0 / np.sqrt(window[0] * window[1]))
    chance = -np.inf
    if both_ways:
        shares = () if whitening is None else (whitening.independent_share,)
        chance = chance_agreement(window, search_px, *shares)
    return _assemble(points_a, predicted_b, fits, turns, status, lowest, chance, max_sigma_px)


def _checked(
    points_a: NDArray[np.float64],
    predicted_b: NDArray[np.float64],
    affine: NDArray[np.float64] | None,
    window: tuple[int, int],
    search_px: tuple[int, int],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Arrays as float64 and the affine less the identity, or an InputError that says what is wrong."""
    points_a = np.ascontiguousarray(points_a, dtype=np.float64)
    predicted_b = np.ascontiguousarray(predicted_b, dtype=np.float64)
    for name, points in (("points_a", points_a), ("predicted_b", predicted_b)):
        if points.ndim != 2 or points.shape[1] != 2 or len(points) != len(points_a):
            raise InputError(
                f"`{name}` must have shape (N, 2) as (line, column), the same N for both; got {points.shape} "
                f"with {len(points_a)} points in a; did you mean {name}.T?"
            )
    if min(window) < 2 or window[1] < 8:
        raise InputError(
            f"`window` is {tuple(window)}; at least 2 lines and 8 columns are needed; "
            "the default is (10, 100)"
        )
    if min(search_px) < 0:
        raise InputError(f"`search_px` is {tuple(search_px)}; 0 or more pixels are allowed; 0 = no search")
    if affine is None:
        return points_a, predicted_b, np.broadcast_to(np.zeros((2, 2)), (len(points_a), 2, 2))
    affine = np.ascontiguousarray(affine, dtype=np.float64)
    if affine.shape != (len(points_a), 2, 2):
        raise InputError(
            f"`affine` must have shape ({len(points_a)}, 2, 2), one matrix per point; got {affine.shape}; "
            "leave it out for the identity"
        )
    return points_a, predicted_b, affine - np.eye(2)


def _growth(linear: NDArray[np.float64], window: tuple[int, int]) -> tuple[int, int]:
    """How much further than its own half-size a warped window reaches in image b, px."""
    half = 0.5 * np.array(window) + 40.0
    grown = np.abs(linear) @ half
    line, column = np.ceil(grown.max(axis=0)).astype(int)
    return int(line), int(column)


def _inside(
    centre_a: NDArray[np.float64],
    centre_b: NDArray[np.float64],
    linear: NDArray[np.float64],
    size: NDArray[np.int64],
    shape_a: tuple[int, int],
    shape_b: tuple[int, int],
) -> NDArray[np.bool_]:
    """Windows that lie in both images (in b as predicted, half a pixel of grace) and are finite."""
    finite = np.isfinite(centre_a).all(axis=1) & np.isfinite(centre_b).all(axis=1)
    finite &= np.isfinite(linear).all(axis=(1, 2))
    half = 0.5 * (size - 1)
    half_b = half + np.abs(np.nan_to_num(linear)) @ half
    a, b = np.nan_to_num(centre_a, nan=-1e9), np.nan_to_num(centre_b, nan=-1e9)
    fits_a = np.all((a - half >= 0) & (a + half <= np.array(shape_a) - 1), axis=1)
    fits_b = np.all((b - half_b >= -0.5) & (b + half_b <= np.array(shape_b) - 0.5), axis=1)
    return finite & fits_a & fits_b


def _share_in_windows(
    flags: NDArray[np.bool_], corner: NDArray[np.int64], window: tuple[int, int]
) -> NDArray[np.float64]:
    """Share of flagged pixels in each window, by summed areas of the columns that have any."""
    h, w = window
    low = np.clip(corner, 0, np.array(flags.shape) - np.array(window))
    out = np.zeros(len(corner))
    before = np.concatenate([[0], np.cumsum(flags.any(axis=0))])
    some = np.flatnonzero(before[low[:, 1] + w] > before[low[:, 1]])
    if not len(some):
        return out
    # few windows stand where anything is flagged: at the sides of an image, beside a cloud
    columns = np.zeros(flags.shape[1], dtype=bool)
    for x in np.unique(low[some, 1]):
        columns[x : x + w] = True
    place = np.cumsum(columns) - 1
    total = np.zeros((flags.shape[0] + 1, int(columns.sum()) + 1), np.int64)
    np.cumsum(np.cumsum(flags[:, columns], axis=0, dtype=np.int64), axis=1, out=total[1:, 1:])
    y, x = low[some, 0], place[low[some, 1]]
    out[some] = (total[y + h, x + w] - total[y, x + w] - total[y + h, x] + total[y, x]) / (h * w)
    return out


def _match_block(
    block: Block,
    window: tuple[int, int],
    search_px: tuple[int, int],
    parts: int,
    max_shift_px: float,
    max_masked: float,
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Statuses and fits of the windows of one block."""
    n = len(block.rows)
    status = np.full(n, matches.KEPT, np.uint8)
    fits = np.full((n, kernels.COLUMNS), np.nan)
    corner_b = np.rint(block.centre - 0.5 * (np.array(window) - 1)).astype(np.int64)
    for flags, corner, limit, reason in (
        (block.full_a, block.corner, _MAX_SATURATED, matches.SATURATED),
        (block.full_b, corner_b, _MAX_SATURATED, matches.SATURATED),
        (block.given_a, block.corner, max_masked, matches.MASKED),
        (block.given_b, corner_b, max_masked, matches.MASKED),
        (block.bad_a, block.corner, _MAX_GROWN, matches.MASKED),
        (block.bad_b, corner_b, _MAX_GROWN, matches.MASKED),
    ):
        if flags.size:
            over = _share_in_windows(flags, corner, window) > limit
            status[over & (status == matches.KEPT)] = reason
    todo = np.flatnonzero(status == matches.KEPT)
    start = np.zeros((n, 2))
    if max(search_px) > 0 and len(todo):
        start[todo], found = search_shift(
            block.fa, block.fb, block.corner[todo], block.centre[todo], window, search_px
        )
        status[todo[~found]] = matches.NO_CONVERGENCE
        todo = todo[found]
    if len(todo):
        out = np.empty((len(todo), kernels.COLUMNS))
        kernels.refine_windows(
            block.fa, block.fb, block.bad_a, block.bad_b, block.corner[todo], block.centre[todo],
            block.linear[todo], start[todo], (int(window[0]), int(window[1])), kernel_table(), parts,
            _ITERATIONS, _TOLERANCE_PX, max_shift_px, out,
        )  # fmt: skip
        fits[todo] = out
        reasons = (matches.TEXTURELESS, matches.OUTSIDE, matches.NO_CONVERGENCE, matches.KEPT)
        codes = np.array(reasons, np.uint8)
        status[todo] = codes[np.clip(out[:, 14], -2, 1).astype(int) + 2]
    return status, fits


def _assemble(
    points_a: NDArray[np.float64],
    predicted_b: NDArray[np.float64],
    fits: NDArray[np.float64],
    turns: NDArray[np.float64] | None,
    status: NDArray[np.uint8],
    min_score: float,
    chance: float,
    max_sigma_px: float,
) -> Matches:
    """Matches from fits: thresholds of quality, common factors of the covariance."""
    kept = status == matches.KEPT
    score, b = scratch_array((len(fits),)), scratch_array((len(fits), 2))
    for some in slices(len(fits), _AT_ONCE):
        score[some] = np.where(kept[some], np.clip(fits[some, 9], 0.0, 1.0), np.nan)
        low = kept[some] & ~(score[some] >= min_score)
        alike = agreement_of_gradients(fits[some]) >= chance
        status[some][low] = matches.LOW_SCORE
        status[some][kept[some] & ~low & ~alike] = matches.TEXTURELESS
        let_go()
    covariance = pair_covariances(fits, status == matches.KEPT)
    for some in slices(len(fits), _AT_ONCE):
        own, shift = covariance[some], fits[some, :2]
        if turns is not None:
            own = turns[some] @ own @ turns[some].transpose(0, 2, 1)
            shift = np.einsum("nij,nj->ni", turns[some], shift)
        weak = ~(matches.largest_sigma(own) <= max_sigma_px)
        status[some][(status[some] == matches.KEPT) & weak] = matches.TEXTURELESS
        fitted = kept[some, None] & np.isfinite(fits[some, :2])
        b[some] = np.where(fitted, predicted_b[some] + shift, np.nan)
        covariance[some] = np.where(fitted[:, :1, None], own, np.nan)
        let_go()
    for array in (b, covariance, score, status):
        array.setflags(write=False)
    return Matches(points_a, b, covariance, score, status)
