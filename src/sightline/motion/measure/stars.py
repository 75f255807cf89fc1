"""Matched windows of one hub image, gathered into a star of observations: S1's boxes 22 to 26.

Predict where the partners show the windows of a hub, lay the partners on it, match, and write down what
measured less predicted says of the motion.

Not here: which windows of which images (``plan.py``), how one is laid on another (``laid_strips.py``), what
is done with the observations (``motion/strip/joint.py``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sightline.execution import Step, give_back_memory, in_threads, no_step
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Surface
from sightline.imaging.source import ImageSource
from sightline.matching.match_images import match_images
from sightline.matching.matches import KEPT, MASKED, NOT_CHOSEN, OUTLIER, OUTSIDE, Matches
from sightline.matching.on_geometry import within
from sightline.matching.select import chosen_windows
from sightline.matching.whitening import TILES, Whitening, gradient_filter, pair_whitening
from sightline.motion.measure.aliasing import (
    PHASE_SIGMA,
    RESPONSE_STEP,
    folding,
    in_stretches,
    phase_between,
    phase_bias,
    pooled_bias,
    response,
)
from sightline.motion.measure.laid_strips import (
    UNLIKE,
    exposed,
    fineness,
    finest_view,
    laid_on,
    parts_of_pixel,
    ratio_to_finest,
    size_in_partner,
)
from sightline.motion.measure.observations import Star, shared_image_correlation
from sightline.motion.measure.plan import MatchingPlan, mixed_stages
from sightline.motion.measure.predict import MovingCamera, StaticParameter
from sightline.motion.measure.sampled_sensitivities import sampled_sensitivities
from sightline.motion.measure.uneven_blur import displacement
from sightline.motion.measure.uneven_lines import answers, uneven
from sightline.motion.measure.windows import (
    Predictions,
    WindowGrid,
    brightest_parts,
    exposure_times,
    field_positions,
    predict_windows,
    window_grid,
)
from sightline.writing import let_go, scratch_array, scratch_copy

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Parts of the time that TDI averages over for which matches say how they change with the motion.
TDI_PARTS = 16
#: A row that lost more than this share of its windows is tried again: the estimate may have been wrong.
MOST_WRONG = 0.4
#: Columns that a tile for whitening leaves free on both sides in a narrow view: where it is searched for.
TILE_MARGIN = 12
#: Lines of such a tile, and its fewest columns.
TILE_LINES = 16
#: The filter of similarity "gradient".
GRADIENT = gradient_filter()
#: Lines squared by which the derivative along lines spreads what a low window averages over: tones of 30 to
#: 120 Hz in pitch are seen through windows of 2 (3) lines as through 2.7 (3.4).
NEIGHBOURS = 3.3
#: A star whose windows stand along less than this share of its hub looks at so many rows all over it to learn
#: how bright ground is.
MOST_SHOWN, SAMPLED_ROWS = 0.5, 64
#: Windows enough to learn whitening from; a star of fewer looks all over its image instead.
ENOUGH = 100

#: Whitening by (hub, partner); None where nothing could be learned.
Filters = dict[tuple[int, int], Whitening | None]


@dataclass(frozen=True, eq=False)
class StarRecord:
    """A star with what the report shows of its matching.

    Attributes
    ----------
    star : Star
    status : (G, K) uint8
        Why each match was kept or not (``matching.matches.STATUS_NAMES``).
    score : (G, K)
        Normalised correlation, 0 .. 1.
    filters : tuple of (Whitening or None)
        Of each pair; empty where they are not kept.
    """

    star: Star
    status: NDArray[np.uint8]
    score: Array
    filters: tuple[Whitening | None, ...] = ()


def learned_filters(records: Sequence[StarRecord]) -> Filters:
    """Filters of all pairs of these stars that kept them; without those of which too little could be seen."""
    return {
        (record.star.hub, image): one
        for record in records
        for image, one in zip(record.star.images, record.filters, strict=False)
        if one is not None
    }


@dataclass(frozen=True, eq=False)
class _Strips:
    """All strips about one hub, and how they are laid on it."""

    images: Sequence[ImageSource]
    cameras: Sequence[MovingCamera]
    surface: Surface
    hub: int
    grid: WindowGrid
    plan: MatchingPlan
    coarse: bool

    @property
    def searched(self) -> bool:
        """Whether windows are searched for: then nothing finer is known yet."""
        return max(self.plan.search_px) > 0

    @property
    def rough(self) -> bool:
        """Whether a later pass looks closer: then hundredths of a pixel are left to it."""
        return self.searched or self.plan.rough

    @cached_property
    def blurred(self) -> Sequence[MovingCamera]:
        """Cameras with which images of pixels like the hub's are laid on it."""
        return [exposed(camera) for camera in self.cameras] if self.coarse else self.cameras

    @property
    def narrow(self) -> bool:
        """Whether the windows leave a good part of the hub's lines out."""
        return self.grid.narrow(self.images[self.hub].shape[1])

    @cached_property
    def uneven(self) -> bool:
        """Whether the hub's lines are so uneven that matches must be asked how they answer."""
        return not self.rough and uneven(self.cameras[self.hub], self.surface)

    @cached_property
    def finest(self) -> int | None:
        """The image that shows what aliasing does to the hub, if any does."""
        return None if self.searched else finest_view(self.cameras, self.surface, self.hub, self.grid)

    def finer(self, partner: int) -> bool:
        """Whether a partner's pixels are finer than the hub's."""
        return parts_of_pixel(self.cameras, self.hub, partner) != (1, 1)

    def laid(self, partner: int, moved: tuple[float, float] = (0.0, 0.0)) -> ImageSource:
        """A partner on the hub's grid, `moved` px of the hub further on."""
        cameras = self.cameras if self.finer(partner) else self.blurred
        return laid_on(self.images, cameras, self.surface, self.hub, partner, moved=moved)

    def as_finest(self, partner: int, finest: int) -> tuple[ImageSource, ImageSource]:
        """Hub, and partner laid on it, as the finest image shows the ground to their pixels."""
        shown = list(self.images)
        for image in (self.hub, partner):
            shown[image] = laid_on(self.images, self.cameras, self.surface, image, finest)
        return shown[self.hub], laid_on(shown, self.blurred, self.surface, self.hub, partner)


@dataclass(frozen=True, eq=False)
class _Partner:
    """Windows of a hub in one partner: where they should be, what is compared, how they move.

    `moved`: where all that moves them is known; `by_hub`, `by_partner` (G, 2, 3) px/rad.
    """

    image: int
    predicted: Predictions
    size: tuple[float, float]
    seen: Flags
    laid: ImageSource
    whitening: Whitening | None
    moved: Flags
    by_hub: NDArray[np.float32]
    by_partner: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class _Moves:
    """What moves the windows of a hub in all partners, as a `Star` has it."""

    by_hub: NDArray[np.float32]
    by_partner: NDArray[np.float32]
    by_static: NDArray[np.float32]
    by_height: NDArray[np.float32]

    @classmethod
    def empty(cls, windows: int, pairs: int, statics: int) -> _Moves:
        """Zeros of all shapes."""
        shapes = ((3,), (3,), (statics,), ())
        return cls(*(scratch_array((windows, pairs, 2, *shape), np.float32) for shape in shapes))

    def put(self, pair: int, some: slice, values: Array) -> None:
        """Those of some windows in one partner, (n, 2, 7 + Q) as `sampled_sensitivities` gives them."""
        self.by_hub[some, pair], self.by_partner[some, pair] = values[..., 0:3], values[..., 3:6]
        self.by_height[some, pair], self.by_static[some, pair] = values[..., 6], values[..., 7:]
        let_go()


@dataclass(frozen=True, eq=False)
class _Measured:
    """What one partner says of some windows: residual (n, 2) px, its covariance (n, 2, 2), status and score.

    `blur` (n, 2) px is what was taken off for jitter within the stages of TDI, `uneven` (n, 2, 2, 3, B)
    px/rad how it changes (`Star.uneven`).
    """

    residual: Array
    blur: Array
    uneven: NDArray[np.float32] | None
    covariance: Array
    status: NDArray[np.uint8]
    score: Array


def match_star(
    images: Sequence[ImageSource],
    cameras: Sequence[MovingCamera],
    surface: Surface,
    hub: int,
    partners: tuple[int, ...],
    grid: WindowGrid,
    statics: Sequence[StaticParameter],
    plan: MatchingPlan,
    before: StarRecord | None = None,
    step: Step = no_step,
    filters: Filters | None = None,
) -> StarRecord:
    """Match one hub's windows in all its partners and write down what they say.

    `step` is called with the number of windows that are done, and of all. `filters` are those of pairs that
    were learned before; what is learned here is added.

    Windows that `before`, the same star of an earlier pass, found to be wrong are not tried again: clouds
    among them would spoil the whitening and the pooled errors of the good ones.
    """
    ratio = ratio_to_finest(cameras, hub)
    strips = _Strips(images, cameras, surface, hub, grid, plan.coarser(ratio), ratio[0] > UNLIKE)
    g, k = grid.count, len(partners)
    wrong = found_wrong(before, hub, grid, k)
    chosen = chosen_windows(images[hub], hub, grid.centres, grid.window, plan.selection)
    moves = _Moves.empty(g, k, len(statics))
    # what matching another star has freed would stay beside what is laid for this one
    give_back_memory()
    found = _prepared(strips, partners, statics, wrong, filters, moves)
    give_back_memory()
    camera, predicted = cameras[hub], [partner.predicted for partner in found]
    tdi_hub, tdi = _tdi(cameras, hub, partners, grid, predicted)
    # written as they come: of a long strip what all pairs say is large
    residual, covariance = scratch_array((g, k, 2)), scratch_array((g, k, 2, 2))
    blur = None if tdi is None else scratch_array((g, k, 2))
    offsets = None
    if tdi_hub is not None and tdi is not None and not strips.searched:
        offsets = _offsets(camera, grid, max(float(tdi_hub.max()), float(np.nanmax(tdi, initial=0.0))))
    uneven = None if offsets is None else scratch_array((g, k, 2, 2, 3, len(offsets)), np.float32)
    status, score = scratch_array((g, k), np.uint8), scratch_array((g, k))
    # one pair after the other: its blocks are matched on threads, and only so many are held at a time
    for j, partner in enumerate(found):

        def blocks(done: int, total: int, j: int = j) -> None:
            step(j * g + done * g // total, k * g)

        points = np.where((partner.seen & ~wrong[:, j] & chosen)[:, None], grid.centres, np.nan)
        for some, one in _measured(strips, partner, points, offsets, blocks):
            residual[some, j], covariance[some, j], score[some, j] = one.residual, one.covariance, one.score
            not_chosen = partner.seen[some] & ~chosen[some]
            status[some, j] = np.where(not_chosen, np.uint8(NOT_CHOSEN), one.status)
            if blur is not None:
                blur[some, j] = one.blur
            if uneven is not None and one.uneven is not None:
                uneven[some, j] = one.uneven
            let_go()
    duration, stretch = _duration(camera, grid, exposed=strips.coarse)
    weight = scratch_array((g, k))
    weight[:] = 1.0
    t = scratch_array((g, k))
    for j, places in enumerate(predicted):
        t[:, j] = places.t
    star = Star(
        hub=hub,
        images=partners,
        shape=grid.shape,
        pixels=grid.centres,
        t_hub=scratch_copy(exposure_times(camera, grid.centres)),
        t=t,
        duration=duration,
        stretch=stretch,
        tdi_hub=tdi_hub,
        tdi=tdi,
        coarseness=ratio[0],
        fineness=fineness(cameras, hub, partners),
        residual_px=residual,
        blur_px=blur,
        uneven=uneven,
        uneven_at=offsets,
        covariance_px=covariance,
        by_hub=moves.by_hub,
        by_partner=moves.by_partner,
        by_static=moves.by_static,
        by_height=moves.by_height,
        field=scratch_copy(field_positions(grid.centres[:, 1], images[hub].shape[1])),
        correlation=shared_image_correlation(k),
        weight=weight,
        brightness=_brightness(before, images[hub], hub, grid),
        brightness_elsewhere=_brightness_elsewhere(before, images[hub], grid, strips.plan.step),
        window=grid.window,
        chosen=None if plan.selection.way == "all" else chosen,
    )
    return StarRecord(star, status, score, tuple(partner.whitening for partner in found))


def _prepared(
    strips: _Strips,
    partners: tuple[int, ...],
    statics: Sequence[StaticParameter],
    wrong: Flags,
    filters: Filters | None,
    moves: _Moves,
) -> list[_Partner]:
    """Of all partners where they should show the windows, what is compared; into `moves` how it moves."""
    cameras, hub, grid = strips.cameras, strips.hub, strips.grid
    predicted = predict_windows(cameras, hub, partners, strips.surface, grid)
    mixed = mixed_stages(cameras[hub], grid.centres, grid.window)
    sizes = [size_in_partner(cameras, hub, partner, grid.window) for partner in partners]
    seen = [
        np.isfinite(one.b[:, 0]) & ~mixed & ~mixed_stages(cameras[partner], one.b, size)
        for one, partner, size in zip(predicted, partners, sizes, strict=True)
    ]
    laid = [strips.laid(partner) for partner in partners]
    usable = [good & ~wrong[:, j] for j, good in enumerate(seen)]
    known = {} if filters is None else filters

    def whitening(j: int) -> Whitening | None:
        if (hub, partners[j]) in known and not strips.narrow:
            return known[hub, partners[j]]
        return _whitening(strips, laid[j], grid.centres[usable[j]])

    def sensitivity(j: int) -> Flags:
        moved = np.ones(grid.count, dtype=bool)
        for some, values in sampled_sensitivities(
            cameras, hub, partners[j], strips.surface, grid, seen[j], statics, predicted[j].b, sizes[j][1]
        ):
            moves.put(j, some, values)
            moved[some] = np.isfinite(values).all(axis=(1, 2))
        return moved

    whitenings = in_threads(whitening, range(len(partners)))
    whitenings = _with_phase_bias(strips, whitenings, partners, laid, predicted, usable)
    if filters is not None and not strips.narrow:
        filters.update(_both_ways(cameras, hub, partners, whitenings))
    moved = in_threads(sensitivity, range(len(partners)))
    by_hub, by_partner = (np.moveaxis(by, 1, 0) for by in (moves.by_hub, moves.by_partner))
    return [
        _Partner(*parts)
        for parts in zip(
            partners, predicted, sizes, seen, laid, whitenings, moved, by_hub, by_partner, strict=True
        )
    ]


def _whitening(strips: _Strips, laid: ImageSource, points: Array) -> Whitening | None:
    """Filters for a hub and an image laid on it: learned at `points`, or all over where they are few."""
    image, plan, grid = strips.images[strips.hub], strips.plan, strips.grid
    if plan.similarity != "whitened":
        return GRADIENT if plan.similarity == "gradient" else None
    if strips.narrow:
        return _narrow_whitening(image, laid, grid, plan)
    if len(points) < ENOUGH:
        points = plan.grid(image.shape).centres
        points = points[np.linspace(0, len(points) - 1, min(ENOUGH, len(points))).astype(int)]
    return pair_whitening(image, laid, points, most_tiles=TILES)


def _with_phase_bias(
    strips: _Strips,
    whitenings: list[Whitening | None],
    partners: Sequence[int],
    laid: Sequence[ImageSource],
    predicted: Sequence[Predictions],
    usable: Sequence[Flags],
) -> list[Whitening | None]:
    """Filters with what aliasing adds to matches of like images through them, as far as these tell it."""
    hub, grid, image = strips.hub, strips.grid, strips.images[strips.hub]
    plain = strips.plan.similarity == "whitened" and not strips.rough and not strips.narrow
    if not plain or strips.uneven or strips.finest is not None:
        return whitenings
    centres = grid.centres
    # rows that share no pixel
    apart = math.ceil(grid.window[0] / max(float(np.diff(grid.lines[:2]).sum()), 1.0))
    rows = np.repeat(np.arange(len(grid.lines)) % apart == 0, len(grid.columns))
    sizes, sigmas = np.zeros((len(partners), 2)), np.full((len(partners), 2), np.inf)
    for j, filters in enumerate(whitenings):
        some = np.flatnonzero(usable[j] & rows)
        if filters is None or filters.phase_bias is not None or not len(some):
            continue
        if not _alike(strips.cameras, hub, partners[j]):
            continue
        some = some[in_stretches(len(some))]
        points, other = centres[some], laid[j]

        def matched(through: Whitening, points: Array = points, other: ImageSource = other) -> Matches:
            return match_images(image, other, points, points, window=grid.window, whitening=through)

        phase = phase_between(points, predicted[j].b[some], predicted[j].affine[some])
        sizes[j], sigmas[j] = phase_bias(matched, filters, phase)
    found = np.stack([pooled_bias(*one) for one in zip(sizes.T, sigmas.T, strict=True)], axis=1)
    told = np.asarray((sigmas <= PHASE_SIGMA).any(axis=1))
    return [
        replace(one, phase_bias=(float(along), float(across))) if one is not None and known else one
        for one, (along, across), known in zip(whitenings, found, told, strict=True)
    ]


def _measured(
    strips: _Strips, partner: _Partner, points: Array, offsets: Array | None, step: Step
) -> Iterator[tuple[slice, _Measured]]:
    """Windows of the hub, `points` (G, 2) or NaN, found in one partner: measured less predicted.

    What is found is in pixels of the hub, on whose grid the partner lies; the map's change takes it into the
    partner. Yields which windows, and what they say: some rows at a time where no window asks the others.
    """
    cameras, hub, grid, plan = strips.cameras, strips.hub, strips.grid, strips.plan

    def matched(image: ImageSource, step: Step = no_step, own: ImageSource = strips.images[hub]) -> Matches:
        return match_images(
            own, image, points, points, window=grid.window, search_px=plan.search_px,
            whitening=partner.whitening, step=step,
        )  # fmt: skip

    matches = matched(partner.laid, step)
    finer = strips.finer(partner.image)
    tdi = any(getattr(cameras[image], "stages", None) is not None for image in (hub, partner.image))
    pooled = finer or strips.finest is not None or tdi or plan.weighting != "covariance"
    unlike = finer or strips.uneven or strips.finest is not None
    shares = None
    if strips.uneven and not finer:

        def laid_by(other: Sequence[MovingCamera]) -> Matches:
            return matched(laid_on(strips.images, other, strips.surface, hub, partner.image))

        whole = partner.by_partner, partner.predicted.affine
        shares = answers(strips.blurred, partner.image, matches, *whole, laid_by)
    for some in [slice(0, grid.count)] if pooled else grid.stretches():
        good = matches.kept[some] & partner.moved[some] & partner.seen[some]
        centres, b, t = points[some], partner.predicted.b[some], partner.predicted.t[some]
        affine, by = partner.predicted.affine[some], (partner.by_hub[some], partner.by_partner[some])
        turn = affine[good]
        if finer and not strips.searched:
            steps = ((RESPONSE_STEP, 0.0), (0.0, RESPONSE_STEP))
            moved = [matched(strips.laid(partner.image, moved=further)) for further in steps]
            turn = turn @ np.linalg.inv(response(matches, moved)[good])
        elif shares is not None:
            share = shares[some][good]
            turn = turn / np.stack([share, np.ones(len(share))], axis=1)[:, :, None]
        shift, uncertain = matches.b[some][good] - centres[good], matches.covariance_px[some][good]
        if strips.finest is not None and not finer:
            own, laid = strips.as_finest(partner.image, strips.finest)
            fold = matched(laid, own=own)
            folded, unknown = folding(shift, fold.b[good] - fold.a[good], fold.kept[good], centres[good, 0])
            shift, uncertain = shift - folded, uncertain + unknown
        bias = None if unlike or partner.whitening is None else partner.whitening.phase_bias
        if bias is not None and any(bias):
            phase = phase_between(centres[good], b[good], affine[good])
            shift = shift - np.array(bias) * np.sin(2.0 * np.pi * phase)
        blurred, changes = np.zeros(shift.shape), None
        if not strips.searched:
            blurred, changes = displacement(
                cameras,
                (hub, partner.image),
                (centres[good], b[good]),
                (exposure_times(cameras[hub], centres[good]), t[good]),
                (by[0][good], by[1][good]),
                affine[good],
                partner.whitening,
                grid.window[0],
                offsets=offsets,
            )
        residual, covariance = np.full((len(good), 2), np.nan), np.tile(np.eye(2), (len(good), 1, 1))
        blur = np.zeros((len(good), 2))
        blur[good] = np.einsum("nij,nj->ni", turn, blurred)
        residual[good] = np.einsum("nij,nj->ni", turn, shift) - blur[good]
        uneven = None
        if offsets is not None:
            uneven = np.zeros((len(good), 2, 2, 3, len(offsets)), dtype=np.float32)
            if changes is not None:
                uneven[good] = np.einsum("nij,nsjab->nsiab", turn, changes)
        covariance[good] = turn @ uncertain @ np.swapaxes(turn, 1, 2)
        if plan.weighting != "covariance" and good.any():
            mean = 0.5 * np.einsum("nii->n", covariance[good]).mean()
            places = np.stack([centres[good, 1], b[good, 1]])
            covariance[good] = mean * _relative(plan, (hub, partner.image), places)
        # a window lies in the image up to half a pixel beyond its rim
        beyond = ~within(b, strips.images[partner.image].shape, np.array(partner.size) / 2.0 - 1.0)
        status = np.where(beyond & (matches.status[some] == MASKED), np.uint8(OUTSIDE), matches.status[some])
        yield some, _Measured(residual, blur, uneven, covariance, status, matches.score[some])


def _both_ways(
    cameras: Sequence[MovingCamera], hub: int, partners: Sequence[int], found: Sequence[Whitening | None]
) -> Filters:
    """Filters of pairs of a hub by (hub, partner), and with either as hub where their pixels are like."""
    out: Filters = {}
    for partner, one in zip(partners, found, strict=True):
        out[hub, partner] = one
        if _alike(cameras, hub, partner):
            out[partner, hub] = None if one is None else one.swapped()
    return out


def _alike(cameras: Sequence[MovingCamera], one: int, other: int) -> bool:
    """Whether the pixels of two images are as large as each other."""
    return {parts_of_pixel(cameras, *pair) for pair in ((one, other), (other, one))} == {(1, 1)}


def _relative(plan: MatchingPlan, pair: tuple[int, int], columns: Array) -> Array:
    """(N, 2, 2) covariance of matches at `columns` (2, N) of a pair, of mean variance 1, as predicted."""
    variance = np.zeros((columns.shape[1], 2))
    for image, at in zip(pair, columns, strict=True):
        sigma = plan.predicted[image] if plan.weighting == "predicted" and plan.predicted else None
        if sigma is None:
            variance += 1.0
        else:
            variance += sigma[np.clip(np.rint(at), 0, len(sigma) - 1).astype(np.intp)] ** 2
    return np.asarray((variance / variance.mean())[:, :, None] * np.eye(2))


def found_wrong(before: StarRecord | None, hub: int, grid: WindowGrid, pairs: int) -> NDArray[np.bool_]:
    """(G, K): windows that an earlier pass matched and threw out; none in rows that lost most of theirs."""
    none = np.zeros((grid.count, pairs), dtype=bool)
    if before is None or not _same_windows(before, hub, grid) or before.star.t.shape != none.shape:
        return none
    wrong = (before.star.weight == 0.0) & ((before.status == KEPT) | (before.status == OUTLIER))
    by_row = wrong.reshape(*grid.shape, pairs)
    return np.asarray((by_row & (by_row.mean(axis=1, keepdims=True) < MOST_WRONG)).reshape(none.shape))


def _same_windows(before: StarRecord, hub: int, grid: WindowGrid) -> bool:
    """Whether an earlier pass cut these very windows from the same image."""
    return before.star.hub == hub and np.array_equal(before.star.pixels, grid.centres)


def blurred_by(record: StarRecord, cameras: Sequence[MovingCamera], surface: Surface) -> Star:
    """The star with what `cameras` have matches displaced by within the stages of TDI, and how it changes.

    In the geometry of like pixels. Residuals are those of the star, less what it had of that before.
    """
    star = record.star
    if star.blur_px is None or star.uneven_at is None:
        return star
    assert star.window is not None
    lines = star.pixels[:: star.shape[1], 0]
    grid = WindowGrid(star.window, lines, star.pixels[: star.shape[1], 1])
    blur, uneven = (
        np.zeros(star.residual_px.shape),
        np.zeros((*star.t.shape, 2, 2, 3, len(star.uneven_at)), np.float32),
    )
    predicted = predict_windows(cameras, star.hub, star.images, surface, grid)
    for k, (partner, found) in enumerate(zip(star.images, predicted, strict=True)):
        good = np.isfinite(star.residual_px[:, k, 0])
        shift, changes = displacement(
            cameras,
            (star.hub, partner),
            (star.pixels[good], found.b[good]),
            (star.t_hub[good], found.t[good]),
            (star.by_hub[good, k], star.by_partner[good, k]),
            found.affine[good],
            record.filters[k] if record.filters else None,
            star.window[0],
            offsets=star.uneven_at,
        )
        blur[good, k] = np.einsum("nij,nj->ni", found.affine[good], shift)
        if changes is not None:
            uneven[good, k] = np.einsum("nij,nsjab->nsiab", found.affine[good], changes)
    residual = star.residual_px + star.blur_px - blur
    return replace(star, residual_px=residual, blur_px=blur, uneven=uneven)


def _brightness(before: StarRecord | None, image: ImageSource, hub: int, grid: WindowGrid) -> Array:
    """(G,) brightness of each window in the hub; read once for passes that cut the same windows."""
    if before is not None and before.star.brightness is not None and _same_windows(before, hub, grid):
        return before.star.brightness
    return scratch_copy(brightest_parts(image, grid))


def _brightness_elsewhere(
    before: StarRecord | None, image: ImageSource, grid: WindowGrid, step: int
) -> Array | None:
    """(M,) brightness of such windows all over the hub; None where those of the grid show most of it.

    The ends of a strip, which stars of their own see, may be all cloud: what ground is like the rest tells.
    """
    if np.ptp(grid.lines) > MOST_SHOWN * image.shape[0]:
        return None
    if before is not None and before.star.window == grid.window:
        return before.star.brightness_elsewhere
    everywhere = window_grid(image.shape, grid.window, step)
    some = np.linspace(0, len(everywhere.lines) - 1, min(SAMPLED_ROWS, len(everywhere.lines))).astype(int)
    return brightest_parts(image, replace(everywhere, lines=everywhere.lines[some]))


def _narrow_whitening(
    image: ImageSource, laid: ImageSource, grid: WindowGrid, plan: MatchingPlan
) -> Whitening | None:
    """Whitening filters from tiles in the middle of a narrow view, of a size that fits in."""
    first, last = grid.sides
    tile = (min(TILE_LINES, image.shape[0] // 2), int(last - first) - 2 * TILE_MARGIN)
    lines = plan.grid(image.shape).lines
    points = np.stack([lines, np.full(len(lines), 0.5 * (first + last - 1.0))], axis=1)
    if tile[1] < TILE_LINES:
        return None
    return pair_whitening(image, laid, points, tile=tile, most_tiles=TILES)


def _tdi(
    cameras: Sequence[MovingCamera],
    hub: int,
    partners: Sequence[int],
    grid: WindowGrid,
    predicted: Sequence[Predictions],
) -> tuple[Array | None, Array | None]:
    """Times (G,) and (G, K) s that TDI averages over in hub and partners; None where none has TDI."""

    def times(image: int, pixels: Array) -> Array:
        camera = cameras[image]
        return camera.integration(pixels) if isinstance(camera, PushbroomCamera) else np.zeros(len(pixels))

    if all(getattr(cameras[image], "stages", None) is None for image in (hub, *partners)):
        return None, None
    there = [times(image, p.b) for image, p in zip(partners, predicted, strict=True)]
    return times(hub, grid.centres), np.stack(there, axis=1)


def _offsets(camera: MovingCamera, grid: WindowGrid, tdi: float) -> Array:
    """(B,) s beside the middle of an exposure: over stages of `tdi` s, the window's lines and one beside."""
    assert isinstance(camera, PushbroomCamera)
    period = camera.detector.line_period
    step = max(tdi / TDI_PARTS, period)
    half = math.ceil((0.5 * (tdi + grid.window[0] * period) + period) / step)
    return step * np.arange(-half, half + 1.0)


def _duration(camera: MovingCamera, grid: WindowGrid, *, exposed: bool) -> tuple[float, float]:
    """Length (s) of the boxcar that spreads as the window's h line centres do, and what is added along lines.

    That is sqrt(h^2 - 1) line periods. With the exposure of each line, which coarse lines average over, it is
    h; and shifts along the lines, found by comparing neighbours, are averaged over NEIGHBOURS more. Of four
    of the finest lines both are some per cent, and left out.
    """
    if not isinstance(camera, PushbroomCamera):
        return 0.0, 0.0
    ends = exposure_times(camera, np.array([[0.0, 0.0], [camera.lines - 1.0, 0.0]]))
    period = (ends[1] - ends[0]) / max(camera.lines - 1, 1)
    lines = grid.window[0]
    # the exposure of TDI is averaged over beside the window
    square = lines**2 - (0.0 if exposed and camera.stages is None else 1.0)
    spread = math.sqrt(square)
    stretch = math.sqrt(square + NEIGHBOURS) - spread if exposed else 0.0
    return float(period * spread), float(period * stretch)
