"""Frames of a spinning camera that passes a planet: its lit disc with clouds, haze, terminator and blooming.

Every strip of every exposure is cut with the ellipsoid; outside of it haze fades with height. Brightness is
Lambert's, charge above the full well spills along the columns of the detector, noise is that of the levels.

Not here: which camera and planet, and the files (``io/scene/spinning.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.geometry.instrument import AreaDetector
from sightline.geometry.two_body import propagate
from sightline.simulate.option_checks import check_options
from sightline.simulate.scene import Extent, TextureLaw, layer_shape
from sightline.simulate.texture import Array, TextureLayer, random_layer

#: m/s over the speed of escape at its place, for an orbit that is bound but barely.
_SPEED = 0.99
#: px; of the camera's point spread (1-sigma).
_BLUR = 0.6
#: Heights in scale heights of the haze above which it is no longer looked for.
_HIGHEST = 12.0
#: Pixels of a texture's layer at most along a side.
_LARGEST = 2048


@dataclass(frozen=True)
class SpinningFrameOptions:
    """A raw image of a spinning camera: how it sees the planet.

    Parameters
    ----------
    exposures : int
        How many, the middle one towards the planet.
    altitude : float
        m above the point under the camera.
    latitude : float
        rad of that point, planetographic: near a quarter turn the outline is a circle, which tells no turn.
    from_noon : float
        rad of its longitude from the Sun's meridian: beyond a quarter turn the limb is a crescent.
    turn : float
        rad by which the camera is turned about the line to the planet's centre, away from the lit side.
    brightness : float
        Of the Sun in the zenith over the full well: much above 1 the day side is overexposed.
    blooming : float
        px that charge above the full well spills along the columns, both ways.
    contrast : float
        Standard deviation over mean of the clouds.
    haze : float
        m; scale height of what shines above the ellipsoid.
    noise : float
        Levels of the 8-bit code, 1-sigma.
    departure : float
        rad, 1-sigma per axis and exposure: what the body does besides spinning evenly.
    rate_error : float
        rad per exposure by which the spin departs from the published one.
    """

    exposures: int = 12
    altitude: float = 1.2e8
    latitude: float = 0.73
    from_noon: float = 0.5
    turn: float = 0.0
    brightness: float = 0.6
    blooming: float = 3.0
    contrast: float = 0.15
    haze: float = 25e3
    noise: float = 0.7
    departure: float = 2e-5
    rate_error: float = 1e-4

    WORDS: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    RANGES: ClassVar[Mapping[str, tuple[float, float]]] = {
        "exposures": (3, 60), "altitude": (2e7, 2e9), "latitude": (-1.5708, 1.5708),
        "from_noon": (-3.15, 3.15), "turn": (-0.8, 0.8), "brightness": (1e-3, 1e4), "blooming": (0.0, 30.0),
        "contrast": (0.0, 1.0), "haze": (1e3, 1e6), "noise": (0.0, 10.0), "departure": (0.0, 1e-3),
        "rate_error": (-1e-3, 1e-3),
    }  # fmt: skip

    def __post_init__(self) -> None:
        """Refuse what cannot be rendered."""
        check_options(self)


#: Named cases, and the options that make each.
SPINNING_OPTIONS: dict[str, dict[str, Any]] = {
    "junocam": {},
    "junocam-pole": {"latitude": 1.54},
    "junocam-overexposed": {"from_noon": 1.0, "brightness": 5.0},
}


@dataclass(frozen=True, eq=False)
class SpinningCamera:
    """What is known of the camera and the planet.

    Attributes
    ----------
    strips : tuple of AreaDetector
        Of one exposure, in their order; the camera's axes are the body's.
    interval : float
        s between exposures.
    turn : float
        rad of the spin about the x axis from exposure to exposure.
    radii : (float, float)
        m; of the planet, which turns about its z axis.
    mu, rate : float
        m^3/s^2, rad/s of the planet.
    sun : (3,)
        Unit vector to the Sun at t = 0, planet's axes.
    levels : (256,)
        Values behind the codes, rising; the last is the full well.
    """

    strips: tuple[AreaDetector, ...]
    interval: float
    turn: float
    radii: tuple[float, float]
    mu: float
    rate: float
    sun: Array
    levels: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class SpinningScenario:
    """One image: truth, and what is seen.

    Attributes
    ----------
    camera : SpinningCamera
    seed : int
    options : SpinningFrameOptions
    """

    camera: SpinningCamera
    seed: int
    options: SpinningFrameOptions

    @property
    def t(self) -> Array:
        """(exposures,) s."""
        return self.camera.interval * np.arange(float(self.options.exposures))

    def positions(self, t: Array) -> Array:
        """(N, 3) m at `t` (s), a polar orbit; in axes that stand still with the planet's at t = 0."""
        place = self._place
        distance = float(np.sqrt(place @ place))
        up = place / distance
        north = np.array([0.0, 0.0, 1.0]) - up[2] * up
        if north @ north < 1e-12:
            north = np.array([-1.0, 0.0, 0.0])
        north /= np.sqrt(north @ north)
        speed = _SPEED * np.sqrt(2.0 * self.camera.mu / distance)
        # closest to the centre at about one radius: the angular momentum of a parabola through it
        across = np.sqrt(2.0 * self.camera.mu * self.camera.radii[0]) / distance
        velocity = across * north - np.sqrt(max(speed**2 - across**2, 0.0)) * up
        return np.asarray(propagate(place, velocity, t, self.camera.mu)[0])

    @cached_property
    def attitudes(self) -> Rotation:
        """world_from_body of every exposure, in the axes of `positions`."""
        options, count = self.options, self.options.exposures
        turned = (self.camera.turn + options.rate_error) * (np.arange(count) - count // 2)
        even = self._middle * Rotation.from_rotvec(turned[:, None] * [1.0, 0.0, 0.0])
        rng = np.random.default_rng(np.random.SeedSequence(self.seed).spawn(3)[0])
        return even * Rotation.from_rotvec(options.departure * rng.standard_normal((count, 3)))

    def framelets(self) -> Iterator[NDArray[np.uint8]]:
        """Codes of every strip of every exposure (lines, columns), in their order in the image."""
        rng = np.random.default_rng(np.random.SeedSequence(self.seed).spawn(3)[1])
        looks = [_looks(strip) for strip in self.camera.strips]
        for k, (place, attitude) in enumerate(zip(self.positions(self.t), self.attitudes, strict=True)):
            # axes that turn with the planet, in which clouds stand still
            turning = Rotation.from_rotvec([0.0, 0.0, -self.camera.rate * self.t[k]])
            for strip, look in zip(self.camera.strips, looks, strict=True):
                shape = strip.shape
                seen = self._brightness(turning.apply(place), (turning * attitude).apply(look), turning)
                yield self._coded(seen.reshape(shape), rng)

    @property
    def _place(self) -> Array:
        """(3,) m; where the camera is at t = 0."""
        from sightline.geometry.earth import from_geodetic

        noon = np.arctan2(self.camera.sun[1], self.camera.sun[0])
        at = [noon + self.options.from_noon, self.options.latitude, self.options.altitude]
        return np.asarray(from_geodetic([at], self.camera.radii)[0])

    @property
    def _middle(self) -> Rotation:
        """world_from_body of the exposure towards the planet: its lit side lies towards smaller columns."""
        down = -self._place / np.sqrt(self._place @ self._place)
        side = self.camera.sun - (self.camera.sun @ down) * down
        if side @ side < 1e-12:
            side = np.cross(down, [0.6, 0.0, 0.8])
        side = Rotation.from_rotvec(self.options.turn * down).apply(side / np.sqrt(side @ side))
        return Rotation.from_matrix(np.stack([-side, np.cross(down, -side), down], axis=1))

    @cached_property
    def _clouds(self) -> tuple[TextureLayer, Array]:
        """Texture on the plane across the line to the centre, and its axes (2, 3), planet's axes."""
        down = -self._place / np.sqrt(self._place @ self._place)
        a = np.cross(down, [0.6, 0.0, 0.8] if abs(down[2]) < 0.9 else [1.0, 0.0, 0.0])
        a /= np.sqrt(a @ a)
        pixel = self.options.altitude / self.camera.strips[0].focal_length_px
        half = 1.05 * self.camera.radii[0]
        seed = np.random.SeedSequence(self.seed).spawn(3)[2]
        spacing, law = (0.5 * pixel, 0.5 * pixel), TextureLaw(self.options.contrast, (pixel, pixel))
        shape = layer_shape(Extent(-half, half, -half, half), spacing, _LARGEST)
        return random_layer(seed, shape, spacing, law.psd, (-half, -half)), np.stack([a, np.cross(down, a)])

    def _brightness(self, place: Array, rays: Array, turning: Rotation) -> Array:
        """(N,) over the full well, of rays (N, 3) from a place, all in the planet's turning axes."""
        axes = np.array([self.camera.radii[0], self.camera.radii[0], self.camera.radii[1]])
        sun, haze = turning.apply(self.camera.sun), self.options.haze
        u, o = rays / axes, place / axes
        square, along = (u**2).sum(axis=1), u @ o
        # squared distance of the ray from the centre, in radii
        nearest = np.maximum(o @ o - along**2 / square, 0.0)
        hit, out = nearest < 1.0, np.zeros(len(rays))
        reach = (-along - np.sqrt(np.maximum(along**2 - square * (o @ o - 1.0), 0.0))) / square
        near = hit | (nearest < (1.0 + _HIGHEST * haze / axes[0]) ** 2)
        ground = place + np.where(hit, reach, -along / square)[near, None] * rays[near]
        normal = ground / axes**2
        light = np.maximum((normal @ sun) / np.sqrt((normal**2).sum(axis=1)), 0.0)
        clouds, plane = self._clouds
        shine = light * np.maximum(1.0 + clouds.at(ground @ plane[0], ground @ plane[1]), 0.02)
        height = axes[0] * (np.sqrt(nearest[near]) - 1.0)
        out[near] = np.where(hit[near], shine, light * np.exp(-np.maximum(height, 0.0) / haze))
        return self.options.brightness * out

    def _coded(self, seen: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
        """8-bit codes of what a strip sees."""
        from scipy import ndimage

        levels, width = self.camera.levels, self.options.blooming
        charge = ndimage.gaussian_filter(seen, _BLUR, mode="nearest")
        excess = np.maximum(charge - 1.0, 0.0)
        if width > 0.0 and excess.any():
            k = np.arange(-int(8.0 * width), int(8.0 * width) + 1)
            spill = np.exp(-np.abs(k) / width)
            charge = np.minimum(charge, 1.0) + ndimage.convolve1d(
                excess, spill / spill.sum(), axis=0, mode="constant"
            )
        codes = np.interp(charge * float(levels[-1]), levels, np.arange(256.0))
        codes = codes + self.options.noise * rng.standard_normal(codes.shape)
        return np.clip(np.round(codes), 0, 255).astype(np.uint8)


def _looks(strip: AreaDetector) -> Array:
    """(lines x columns, 3) where the pixels of a strip look."""
    lines, columns = strip.shape
    line, column = np.meshgrid(np.arange(float(lines)), np.arange(float(columns)), indexing="ij")
    return strip.directions(np.column_stack([line.ravel(), column.ravel()]))
