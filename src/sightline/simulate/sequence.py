"""Flights of a filter camera over one ground: truth, what a user would know, and the frames.

What a flight is made of is in ``sequence_options.py``; files are written by ``sequence_files.py``. Nothing is
kept between frames: any of them can be rendered alone, and is the same, bit for bit, whichever came before.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.geometry.checks import frozen
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.simulate.option_checks import options_of
from sightline.simulate.scene import Extent
from sightline.simulate.sensor import Radiometry
from sightline.simulate.sequence_filter import FilterLayout, detector_response, filter_layout, filter_weights
from sightline.simulate.sequence_ground import SimulatedGround, draw_ground
from sightline.simulate.sequence_motion import Flight, draw_flight
from sightline.simulate.sequence_options import CASE_OPTIONS, SequenceOptions
from sightline.simulate.sequence_render import render_channels
from sightline.simulate.texture import Array, Array32

EPOCH = "2026-01-01T00:00:00Z"
"""UTC of t = 0."""

_MEAN_SHARE = 0.3  # of the converter's range, that the mean ground has where the detector is most sensitive
# children of the seed: flight, ground, the given poses, noise of each frame
_FLIGHT, _GROUND, _POSES, _NOISE, _RIG = range(5)


@dataclass(frozen=True, eq=False)
class SimulatedCamera:
    """One camera of a rig, as it truly is.

    Attributes
    ----------
    name : str
    detector : AreaDetector
    filter : FilterLayout
        One band.
    orientation : Rotation
        body_of_the_first_from_body.
    position, given_position : (3,) m
        Of its lens in the first camera's body, true and as a user is given it.
    """

    name: str
    detector: AreaDetector
    filter: FilterLayout
    orientation: Rotation
    position: Array
    given_position: Array


@dataclass(frozen=True, eq=False)
class SequenceScenario:
    """A flight: truth, what a user would know, and the frames.

    Parameters
    ----------
    case : str
    seed : int
    options : SequenceOptions
    detector : AreaDetector
        As given: with the wavelength of each line where the filter has one per line.
    flight : Flight
        True motion, a closed form of time.
    filter : FilterLayout
    ground : Ground
    rig : tuple of SimulatedCamera
        All cameras of a rig; empty where there is one camera.
    """

    case: str
    seed: int
    options: SequenceOptions
    detector: AreaDetector
    flight: Flight
    filter: FilterLayout
    ground: SimulatedGround
    rig: tuple[SimulatedCamera, ...] = ()

    @cached_property
    def poses(self) -> tuple[Array, Array, Rotation]:
        """True times (N,) s, positions (N, 3) m and world_from_body of all frames."""
        t, position, attitude = self.flight.poses()
        return frozen(t), frozen(position), attitude

    @cached_property
    def frames(self) -> tuple[int, ...]:
        """Numbers of the frames that are delivered, those with unreadable files among them."""
        gone = set(self.options.missing)
        return tuple(frame for frame in range(self.options.total_frames) if frame not in gone)

    @cached_property
    def radiometry(self) -> Radiometry:
        """How relative signal becomes numbers."""
        bits = self.options.bits
        return Radiometry(mean_dn=_MEAN_SHARE * 2**bits, snr=self.options.snr, bits=bits)

    @cached_property
    def _weights(self) -> list[Array32]:
        filters = [camera.filter for camera in self.rig] or [self.filter]
        return [filter_weights(layout, self.ground.spectra, self.ground.mean) for layout in filters]

    @cached_property
    def _tangents(self) -> list[Array]:
        lines, columns = self.options.shape
        line, column = np.indices((lines, columns), dtype=np.float64)
        pixels = np.column_stack([line.ravel(), column.ravel()])
        out = []
        for detector in [camera.detector for camera in self.rig] or [self.detector]:
            directions = detector.directions(pixels)
            tangents = np.ascontiguousarray(directions[:, :2] / directions[:, 2:])
            out.append(tangents.reshape(lines, columns, 2))
        return out

    @property
    def band_nm(self) -> Array:
        """nm of all bands that a user is given."""
        layouts = [camera.filter for camera in self.rig] or [self.filter]
        return np.unique(np.concatenate([layout.given_nm.ravel() for layout in layouts]))

    def line_poses(self, frame: int) -> tuple[Array, Rotation]:
        """Positions (n, 3) m and world_from_body when each line is exposed; n = 1 for all lines at once."""
        options = self.options
        t = np.array([self.flight.time(frame)])
        if options.readout_time != 0.0:
            t = t + options.readout_time * np.linspace(0.0, 1.0, options.shape[0])
        return self.flight.at(self.flight.leg_of(frame), t)

    def signal(self, frame: int, camera: int = 0) -> Array32:
        """Noiseless relative signal (channels, lines, columns) of a frame, out of focus or not."""
        position, world_from_body = self.line_poses(frame)
        if self.rig:
            position = position + world_from_body.apply(np.array(self.rig[camera].position))
            world_from_body = world_from_body * self.rig[camera].orientation
        matrices = (world_from_body * NADIR_MOUNT).as_matrix()
        light = render_channels(
            self._tangents[camera], matrices, position, self.ground, self._weights[camera], self.options.gsd
        )
        if frame in self.options.blurred:
            from scipy.ndimage import gaussian_filter

            light = gaussian_filter(light, (0.0, self.options.blur_px, self.options.blur_px))
        return light

    def image(self, frame: int, camera: int = 0) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """A frame as numbers, (channels, lines, columns), 8 bits if they suffice."""
        radiometry = self.radiometry
        dn = self.signal(frame, camera) * np.float32(radiometry.mean_dn)
        if (frame, camera) in self.options.rig_overexposed:
            dn += np.float32(2**self.options.bits)
        key = (_NOISE, frame, camera) if camera else (_NOISE, frame)
        noise = np.random.SeedSequence(self.seed, spawn_key=key)
        numbers = radiometry.digitise(dn, radiometry.mean_dn, np.random.default_rng(noise))
        return numbers.astype(np.uint8) if self.options.bits <= 8 else numbers

    def band_signal(self, x: Array, y: Array, wavelengths_nm: Array) -> Array32:
        """True noiseless numbers (..., n) that places `x`, `y` m have in bands of `wavelengths_nm` (n,).

        Through filters of the camera's width, its detector and its MTF: what a pixel of that filter that
        sees the place would read, without noise.
        """
        brightness = self.filter.at(wavelengths_nm, self.ground.spectra)
        sensitivity = detector_response(wavelengths_nm)
        weights = brightness / (brightness @ self.ground.mean)[:, None] * sensitivity[:, None]
        weights *= self.radiometry.mean_dn
        return self.ground.signal(x, y, np.ascontiguousarray(weights, dtype=np.float32))

    @cached_property
    def _given_poses(self) -> tuple[Array, Rotation, Array, Array]:
        """Positions, attitudes, and the constant biases (3,) m and (3,) rad in them."""
        options = self.options
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(_POSES,)))
        noise = rng.standard_normal((2, options.total_frames, 3))
        place_bias, turn_bias = rng.standard_normal((2, 3)) * np.array(
            [[options.position_bias_sigma], [options.attitude_bias_sigma]]
        )
        _, position, attitude = self.poses
        place = position + place_bias + options.position_sigma * noise[0]
        turned = Rotation.from_rotvec(turn_bias) * Rotation.from_rotvec(options.attitude_sigma * noise[1])
        return frozen(place), attitude * turned, frozen(place_bias), frozen(turn_bias)

    @property
    def given_positions(self) -> Array:
        """(N, 3) m: positions with their constant bias and noise."""
        return self._given_poses[0]

    @property
    def given_attitudes(self) -> Rotation:
        """world_from_body with a constant bias about body axes and noise."""
        return self._given_poses[1]

    @property
    def biases(self) -> tuple[Array, Array]:
        """The constant errors of positions (3,) m, world axes, and of attitudes (3,) rad, body axes."""
        return self._given_poses[2], self._given_poses[3]

    @cached_property
    def seen(self) -> Extent:
        """A rectangle around all that is seen."""
        return _seen(self.options, self.flight)


def sequence_case(case: str = "lvf", seed: int = 0, **overrides: Any) -> SequenceScenario:
    """A flight of one of the named cases.

    Parameters
    ----------
    case : str
        One of ``sequence_options.CASE_OPTIONS``.
    seed : int
        The same seed gives the same flight, bit for bit.
    **overrides
        Fields of :class:`~sightline.simulate.sequence_options.SequenceOptions`.

    Examples
    --------
    >>> flight = sequence_case("small", 0, frames=3, shape=(32, 48), spectra="law")
    >>> flight.image(2).shape
    (1, 32, 48)
    """
    options = sequence_options(case, **overrides)
    flight = draw_flight(options, np.random.SeedSequence(seed, spawn_key=(_FLIGHT,)))
    ground = draw_ground(options, _seen(options, flight), np.random.SeedSequence(seed, spawn_key=(_GROUND,)))
    ground = dataclasses.replace(ground, water=_water(options))
    layout = filter_layout(options)
    by_line = layout.given_nm[0, :, 0] if layout.kind in ("lvf", "stepwise") else None
    detector = AreaDetector(
        "frame", options.shape, options.focal_length_px, options.centre_px, options.distortion, by_line
    )
    rig = _draw_rig(options, detector, np.random.SeedSequence(seed, spawn_key=(_RIG,)))
    return SequenceScenario(case, seed, options, detector, flight, layout, ground, rig)


def _draw_rig(
    options: SequenceOptions, detector: AreaDetector, seed: np.random.SeedSequence
) -> tuple[SimulatedCamera, ...]:
    """Cameras of a rig: the first as the file says, the others turned, moved and with lenses of their own."""
    if options.cameras == 1:
        return ()
    rng = np.random.default_rng(seed)
    wavelengths = np.linspace(*options.wavelengths_nm, options.cameras)
    out = []
    for number, nm in enumerate(wavelengths):
        turn = options.rig_angle_sigma * rng.standard_normal(3)
        moved = options.rig_place_sigma * rng.standard_normal(3)
        stretch, shift = options.rig_lens_spread * rng.standard_normal(), rng.uniform(-4.0, 4.0, 2)
        row, column = divmod(number, 2)
        given = options.rig_spacing * np.array([-float(row), float(column), 0.0])
        if number == 0:
            turn, moved, stretch, shift = np.zeros(3), np.zeros(3), 0.0, np.zeros(2)
        line, place = detector.principal_point_px
        lens = dataclasses.replace(
            detector,
            name=f"band {number + 1}",
            focal_length_px=round(float(detector.focal_length_px * (1.0 + stretch)), 3),
            principal_point_px=(round(float(line + shift[0]), 3), round(float(place + shift[1]), 3)),
        )
        band = np.full((1, 1, 1), nm)
        layout = FilterLayout("band", band, band, options.fwhm_nm)
        out.append(
            SimulatedCamera(
                lens.name, lens, layout, Rotation.from_rotvec(turn), frozen(given + moved), frozen(given)
            )
        )
    return tuple(out)


def sequence_options(case: str = "lvf", **overrides: Any) -> SequenceOptions:
    """The options of `sequence_case`, nothing drawn; parameters as there."""
    return options_of(SequenceOptions, CASE_OPTIONS, case, overrides)


def _reach(options: SequenceOptions, flight: Flight) -> float:
    """m from the place of a frame to the farthest ground in it."""
    corner = max(
        np.hypot(line - options.centre_px[0], column - options.centre_px[1])
        for line in (0, options.shape[0] - 1)
        for column in (0, options.shape[1] - 1)
    )
    tilt = float(flight.angles.amplitude.sum(axis=1)[:2].max())
    # a tilt moves the corner by more than the middle, as the square of its slant
    slant = 1.0 + (corner / options.focal_length_px) ** 2
    if options.cameras > 1:
        # five sigmas of two axes, and lenses that see a little more
        tilt += 7.0 * options.rig_angle_sigma
        corner *= 1.0 + 4.0 * options.rig_lens_spread
    return float(
        (1.0 + options.relief) * (corner * options.gsd + 1.3 * tilt * slant * options.altitude)
        + 3.0 * options.position_jitter
        + (options.cameras > 1) * (options.cameras * options.rig_spacing + 5.0 * options.rig_place_sigma)
    )


def _seen(options: SequenceOptions, flight: Flight) -> Extent:
    ends = np.array(
        [
            np.add(leg.start, np.multiply(leg.heading, place))
            for leg in flight.legs
            for place in (0.0, (options.frames - 1) * options.step)
        ]
    )
    (west, south), (east, north) = ends.min(axis=0), ends.max(axis=0)
    return Extent(west, east, south, north).grown(_reach(options, flight))


def _water(options: SequenceOptions) -> Array:
    """(n, 2) m: stretches of y that the frames named on the first flight line see whole."""
    half = 0.5 * options.shape[0] * options.gsd * 1.15
    rows = [(first * options.step - half, last * options.step + half) for first, last in options.water]
    return np.array(rows, dtype=np.float64).reshape(-1, 2)
