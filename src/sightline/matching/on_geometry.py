"""One image found in another on the geometry that is known between them: the front of all matching.

Strips, frames, spins, stereo images, flights and maps differ in what places a pixel of one image in another.
Given that, all do the same, and do it here: lay the partner on the hub, or each window of it; find windows;
carry what was found, and its covariance, into the pixels of the partner; give each image its share of the
error.

Not here: cameras, or whatever else knows the geometry (it comes in as a function); which windows are worth a
look (``select.py``); the comparison itself (``match_images.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sightline.imaging.reduce import ReducedImage, reduced_pixels, whole_pixels
from sightline.imaging.source import ArrayImage, ImageSource, in_memory
from sightline.imaging.warp import WarpedImage, lattice_map
from sightline.matching.displacement import DisplacementField
from sightline.matching.match_images import match_images
from sightline.matching.matches import OUTSIDE, Matches
from sightline.matching.whitening import Whitening

Array = NDArray[np.float64]

#: Columns between places where the map between two images is handed to the resampler, which goes in straight
#: lines between: h px bias a window by about d h^2 / (6 f^2) for a displacement d and focal length f, 3e-4 px
#: for d = 100, h = 4 and f = 1000.
MAP_SPACING = 4
#: Change of area from hub to partner, below which a map is flat: all of a window falls in one pixel or line.
_FLAT = 1e-6


class PixelMap(Protocol):
    """Where a partner shows what a hub shows."""

    def __call__(self, pixels: Array, height: float = 0.0, /) -> Array:
        """Pixels (N, 2) of the partner for `pixels` (N, 2) of the hub, ground `height` m above that assumed.

        NaN where the partner does not see it.
        """
        ...


def resampled(
    partner: ImageSource,
    geometry: Callable[[Array], Array],
    shape: tuple[int, int],
    spacing: int = MAP_SPACING,
) -> WarpedImage:
    """A partner on the grid of a hub of a shape, resampled as it is read; the geometry is smooth."""
    return WarpedImage(partner, lattice_map(geometry), shape, spacing, smooth=False)


def lattice_points(shape: tuple[int, int], side: int) -> Array:
    """Pixels (n, 2) of an image from edge to edge, `side` along each side of it or all there are."""
    axes = [np.linspace(0.0, size - 1.0, min(size, side)) for size in shape]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


def middle_of(pixels: Array) -> Array:
    """The one of some pixels (N, 2) that is nearest to their mean, (1, 2)."""
    return np.asarray(pixels[[int(np.argmin(((pixels - pixels.mean(axis=0)) ** 2).sum(axis=1)))]])


def within(places: Array, shape: tuple[int, int], margin: float | Array = 0.0) -> NDArray[np.bool_]:
    """(N,) which places (N, 2) px lie `margin` px or more inside an image of a shape; False for NaN."""
    last = np.array(shape) - 1.0
    with np.errstate(invalid="ignore"):
        return np.asarray(((places >= margin) & (places <= last - margin)).all(axis=1))


@dataclass(frozen=True, eq=False)
class FoundWindows:
    """Windows of a hub found in a partner, (N,) of them, those that were not found too.

    Attributes
    ----------
    matches : Matches
        `a` in pixels of the hub, `b` and `covariance_px` in those of the partner.
    hub_covariance_px : (N, 2, 2)
        The covariance in pixels of the hub, px^2.
    turn : (N, 2, 2)
        Change of the partner's pixel with that of the hub.
    share : float
        Of the hub's noise in the variance of a match: the same error in all its matches.
    """

    matches: Matches
    hub_covariance_px: Array
    turn: Array
    share: float

    def variances(self) -> tuple[Array, Array]:
        """px^2 of each coordinate, (N,) each: what the partner's own noise adds, and the hub's.

        Notes
        -----
        One texture under noise of one strength: where the hub's covariance is C, the partner's own is
        ``turn C turn' / |turn|``, in pixels of the hub ``C / |turn|``.
        """
        size = np.abs(np.linalg.det(self.turn))
        share = self.share * 2.0 * size / (1.0 + size)
        there = 0.5 * np.trace(self.matches.covariance_px, axis1=1, axis2=2)
        return there * (1.0 - share), 0.5 * np.trace(self.hub_covariance_px, axis1=1, axis2=2) * share


@dataclass(frozen=True, eq=False)
class PairOnGeometry:
    """A hub, a partner and where the one shows what the other shows.

    Parameters
    ----------
    hub, partner : ImageSource
    geometry : PixelMap
    learnt : DisplacementField, optional
        What matches have shown the geometry to be off by, px of the partner over the hub.
    step : float
        px; half of what the change of the geometry is taken over.
    """

    hub: ImageSource
    partner: ImageSource
    geometry: PixelMap
    learnt: DisplacementField | None = None
    step: float = 2.0

    def where(self, pixels: Array, height: float = 0.0) -> Array:
        """Where the partner shows pixels (N, 2) of the hub, as far as is known; NaN for NaN."""
        known = np.isfinite(pixels).all(axis=1)
        places = np.full(pixels.shape, np.nan)
        if known.any():
            places[known] = self.geometry(pixels[known], height)
            places[known] += 0.0 if self.learnt is None else self.learnt.at(pixels[known])
        return places

    def turn(self, pixels: Array) -> Array:
        """Change (N, 2, 2) of that with (line, column) of the hub, px/px."""
        sides = [self.where(pixels + s) - self.where(pixels - s) for s in self.step * np.eye(2)]
        return np.stack(sides, axis=-1) / (2.0 * self.step)

    def inside(self, pixels: Array, margin: float = 0.0) -> NDArray[np.bool_]:
        """(N,) which pixels of the hub the partner shows, `margin` px or more off its rim."""
        return within(self.where(pixels), self.partner.shape, margin)

    def reduced(self, hub: int, partner: int | None = None) -> PairOnGeometry:
        """The same pair, each image reduced to means over so many pixels a side (one number: both)."""
        partner = hub if partner is None else partner
        if hub == partner == 1:
            return self

        def geometry(pixels: Array, height: float = 0.0, /) -> Array:
            return reduced_pixels(self.where(whole_pixels(pixels, hub), height), partner)

        return PairOnGeometry(_means(self.hub, hub), _means(self.partner, partner), geometry)

    def alike(self, at: Array, least: int) -> tuple[PairOnGeometry, int]:
        """The image of finer pixels reduced to about the other's, as these are at pixel `at` (1, 2).

        Returns the pair, and by how much the hub was reduced: it keeps `least` px a side.
        """
        ratio = float(np.sqrt(np.abs(np.linalg.det(self.turn(at)[0]))))
        ratio = ratio if np.isfinite(ratio) and ratio > 0.0 else 1.0
        hub = max(1, min(round(1.0 / ratio), min(self.hub.shape) // least))
        partner = max(1, min(round(ratio), min(self.partner.shape) // 2))
        return self.reduced(hub, partner), hub

    def after(self, points: Array, places: Array) -> PairOnGeometry:
        """The same pair once `points` (N, 2) of the hub were found at `places` of the partner."""
        return replace(self, learnt=DisplacementField(points, places - self.geometry(points)))

    def reach(self, pixels: Array, height_range: float) -> Array:
        """(N, 2) px; how far ground `height_range` m higher or lower is moved in the partner, at most."""
        level = self.where(pixels)
        return np.fmax(*(np.abs(self.where(pixels, h) - level) for h in (-height_range, height_range)))

    def warped(self, spacing: int = MAP_SPACING) -> WarpedImage:
        """The partner on the grid of the hub."""
        return resampled(self.partner, self.where, self.hub.shape, spacing)

    def laid(self) -> ArrayImage:
        """The same in memory: windows and tiles read it again and again."""
        return in_memory(self.warped())

    def found(
        self,
        points: Array,
        *,
        window: tuple[int, int],
        search_px: tuple[int, int] = (0, 0),
        whitening: Whitening | None,
        laid: ImageSource | None = None,
        at: Array | None = None,
        min_score: float = 0.2,
        max_sigma_px: float = 0.5,
        threads: int | None = None,
    ) -> FoundWindows:
        """Windows of the hub found in the partner.

        Parameters
        ----------
        points : (N, 2)
            Centres in the hub, px; NaN rows are not looked for.
        window, search_px : (lines, columns)
            px of the hub; the search is about where the geometry has it.
        whitening : Whitening or None
            Filters of the pair; None compares the images as they are.
        laid : ImageSource, optional
            The partner on the grid of the hub (`laid`): as exact as the map. By default each window is
            resampled by itself, with the change of the map at its centre: a map that bends within a window
            moves what is found.
        at : (N, 2), optional
            Where to look in the partner, if that is known better than by the geometry.
        min_score, max_sigma_px, threads
            As of `match_images`.
        """
        turn = self.turn(points)
        # what cannot be carried into the partner, or not back, is not looked for
        with np.errstate(invalid="ignore"):
            known = np.asarray(np.abs(np.linalg.det(turn)) > _FLAT)
        known &= np.isfinite(turn).all(axis=(1, 2))
        turn = np.where(known[:, None, None], turn, np.eye(2))
        asked = np.where(known[:, None], points, np.nan)
        share = 0.5 if whitening is None else whitening.hub_share

        def compared(image: ImageSource, start: Array, affine: Array | None) -> Matches:
            return match_images(
                self.hub, image, asked, start, affine=affine, window=window, search_px=search_px,
                whitening=whitening, min_score=min_score, max_sigma_px=max_sigma_px, threads=threads,
            )  # fmt: skip

        if laid is None:
            matches = compared(self.partner, self.where(points) if at is None else at, turn)
            there, places = matches.covariance_px, matches.b
            here = _carried(np.asarray(np.linalg.inv(turn)), there)
        else:
            start = asked
            if at is not None:
                start = asked + np.linalg.solve(turn, (at - self.where(points))[..., None])[..., 0]
            matches = compared(laid, start, None)
            here, places = matches.covariance_px, self.where(matches.b)
            there = _carried(turn, here)
            lost = matches.kept & ~np.isfinite(places).all(axis=1)
            matches = matches.with_status(lost, OUTSIDE)
        matches = replace(matches, a=points, b=places, covariance_px=there)
        return FoundWindows(matches, here, turn, share)


def _carried(turn: Array, covariance: Array) -> Array:
    """Covariances (N, 2, 2) turned by a change of pixels each."""
    return np.asarray(turn @ covariance @ np.swapaxes(turn, 1, 2))


def _means(source: ImageSource, factor: int) -> ImageSource:
    """An image reduced to means over squares."""
    return source if factor == 1 else ReducedImage(source, factor)
