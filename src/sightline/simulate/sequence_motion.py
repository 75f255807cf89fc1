"""How a camera is flown: straight lines to and fro, and sinusoids of attitude and position about them.

Everything is a closed form of time: there is no interpolation between the truth and a pose. Interpolating
between some of the poses is what the sizes are measured by (``unseen_motion``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.geometry.rotations import from_roll_pitch_yaw
from sightline.simulate.sequence_options import ANCHOR_STRIDE, REFERENCE_RATE, SequenceOptions
from sightline.simulate.texture import Array

_SLOW_HZ, _SLOW_COUNT = (0.1, 0.8), 4  # at the reference rate, one sinusoid in each part of the range
_FAST_HZ = (2.7, 3.3)
_FAST_SHARE = 0.3  # amplitude of the fast sinusoid over `jitter`: 0.1 of 0.335 degrees
_POSITION_HZ = (0.05, 0.4)
_SETTLING = 2.0  # s of straight flight before the first and after the last frame of a line


@dataclass(frozen=True)
class Leg:
    """One flight line.

    Parameters
    ----------
    start : (float, float)
        m, x and y of the first frame.
    heading : (float, float)
        Unit vector east and north.
    t : float
        s of the first frame.
    """

    start: tuple[float, float]
    heading: tuple[float, float]
    t: float


@dataclass(frozen=True, eq=False)
class Sinusoids:
    """Three functions of time, each a sum of sinusoids.

    Parameters
    ----------
    frequency : (3, n) Hz
    amplitude : (3, n)
    phase : (3, n) rad
    """

    frequency: Array
    amplitude: Array
    phase: Array

    def at(self, t: Array) -> Array:
        """Values (N, 3) at times (N,) s."""
        angle = 2.0 * np.pi * self.frequency * np.asarray(t)[:, None, None] + self.phase
        return np.asarray((self.amplitude * np.sin(angle)).sum(axis=2))


@dataclass(frozen=True, eq=False)
class Flight:
    """Poses of a body (x forward, y right, z down) in local axes (east, north, up) at any time.

    Parameters
    ----------
    legs : tuple of Leg
    frames : int
        Of each leg.
    altitude, speed, frame_rate : float
        m, m/s, Hz
    angles : Sinusoids
        rad: roll, pitch, yaw from the heading.
    places : Sinusoids
        m from the line, world axes.
    """

    legs: tuple[Leg, ...]
    frames: int
    altitude: float
    speed: float
    frame_rate: float
    angles: Sinusoids
    places: Sinusoids

    def leg_of(self, frame: int) -> int:
        """Flight line on which a frame was taken."""
        return frame // self.frames

    def time(self, frame: int) -> float:
        """s, exposure of a frame (of its line 0, with a rolling shutter)."""
        leg, place = divmod(frame, self.frames)
        return self.legs[leg].t + place / self.frame_rate

    def at(self, leg: int, t: Array) -> tuple[Array, Rotation]:
        """Positions (N, 3) m and world_from_body at times (N,) s of flight line `leg`."""
        line, t = self.legs[leg], np.asarray(t, dtype=np.float64)
        along = self.speed * (t - line.t)
        position = self.places.at(t)
        position[:, 0] += line.start[0] + along * line.heading[0]
        position[:, 1] += line.start[1] + along * line.heading[1]
        position[:, 2] += self.altitude
        east, north = line.heading
        # body x along the heading, y to its right, z down
        level = Rotation.from_matrix([[east, north, 0.0], [north, -east, 0.0], [0.0, 0.0, -1.0]])
        return position, level * from_roll_pitch_yaw(*self.angles.at(t).T)

    def poses(self) -> tuple[Array, Array, Rotation]:
        """Times (N,), positions (N, 3) and world_from_body of all frames."""
        t, places, attitudes = [], [], []
        for leg, line in enumerate(self.legs):
            times = line.t + np.arange(self.frames) / self.frame_rate
            position, attitude = self.at(leg, times)
            t.append(times)
            places.append(position)
            attitudes.append(attitude)
        return np.concatenate(t), np.concatenate(places), Rotation.concatenate(attitudes)


def draw_flight(options: SequenceOptions, seed: np.random.SeedSequence) -> Flight:
    """The flight plan of `options`, and its departures from it drawn by `seed`."""
    angle_rng, place_rng = (np.random.default_rng(child) for child in seed.spawn(2))
    pace = options.frame_rate / REFERENCE_RATE
    return Flight(
        tuple(_plan(options)),
        options.frames,
        options.altitude,
        options.speed,
        options.frame_rate,
        _draw_angles(options, pace, angle_rng),
        _draw_places(options, pace, place_rng),
    )


def _plan(options: SequenceOptions) -> list[Leg]:
    """Lines to and fro, north first, from west to east; then those across."""
    length = (options.frames - 1) * options.step
    half_circle = 0.5 * np.pi * options.spacing / options.speed
    duration = length / options.speed + half_circle + 2.0 * _SETTLING
    legs = []
    for line in range(options.flight_lines):
        north = line % 2 == 0
        start = (line * options.spacing, 0.0 if north else length)
        legs.append(Leg(start, (0.0, 1.0 if north else -1.0), line * duration))
    middle = 0.5 * (options.flight_lines - 1) * options.spacing
    for line in range(options.cross_lines):
        east = line % 2 == 0
        start = (
            middle - (0.5 if east else -0.5) * length,
            length * (line + 0.5) / options.cross_lines,
        )
        legs.append(Leg(start, (1.0 if east else -1.0, 0.0), len(legs) * duration))
    return legs


def _in_parts(low: float, high: float, count: int, rng: np.random.Generator) -> Array:
    """Frequencies (3, count), one in each of `count` equal parts of the octaves from `low` to `high`."""
    place = (np.arange(count) + rng.uniform(size=(3, count))) / count
    return np.asarray(low * (high / low) ** place)


def _draw_angles(options: SequenceOptions, pace: float, rng: np.random.Generator) -> Sinusoids:
    """Slow sinusoids of equal amplitude and a fast one; together they leave `options.jitter` to guess."""
    slow = pace * _in_parts(*_SLOW_HZ, _SLOW_COUNT, rng)
    fast = pace * rng.uniform(*_FAST_HZ, (3, 1))
    gap = ANCHOR_STRIDE / options.frame_rate
    of_fast = _FAST_SHARE * options.jitter * unseen_motion(fast, gap)
    rest = np.sqrt(np.maximum(options.jitter**2 - (of_fast**2).sum(axis=1), 0.0))
    size = rest / np.sqrt((unseen_motion(slow, gap) ** 2).sum(axis=1))
    amplitude = np.hstack(
        [np.repeat(size[:, None], _SLOW_COUNT, axis=1), np.full((3, 1), _FAST_SHARE * options.jitter)]
    )
    return Sinusoids(np.hstack([slow, fast]), amplitude, rng.uniform(0.0, 2.0 * np.pi, amplitude.shape))


def _draw_places(options: SequenceOptions, pace: float, rng: np.random.Generator) -> Sinusoids:
    frequency = pace * _in_parts(*_POSITION_HZ, 3, rng)
    # the sum of three sinusoids of amplitude a has the rms a sqrt(3 / 2)
    amplitude = np.full(frequency.shape, options.position_jitter * np.sqrt(2.0 / 3.0))
    return Sinusoids(frequency, amplitude, rng.uniform(0.0, 2.0 * np.pi, frequency.shape))


def unseen_motion(frequency: Array, gap: float) -> Array:
    """What linear interpolation between samples `gap` s apart leaves of sinusoids of amplitude 1, rms.

    Notes
    -----
    For the phase p and the place s between two samples, w = 2 pi f gap, the error is the real part of
    ``exp(ip) (exp(iws) - (1 - s) - s exp(iw))``; its mean square over p and s is integrated here.
    """
    s = np.linspace(0.0, 1.0, 401)
    w = 2.0 * np.pi * np.asarray(frequency)[..., None] * gap
    error = np.exp(1j * w * s) - (1.0 - s) - s * np.exp(1j * w)
    return np.sqrt(0.5 * np.trapezoid(np.abs(error) ** 2, s, axis=-1))
