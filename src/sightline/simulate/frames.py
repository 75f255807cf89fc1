"""Frames of a matrix instrument over one scene: the truth for lines of sight recovered from photographs.

The platform flies straight and level; its attitude takes a random walk from frame to frame. Pushbroom
strips are in ``scenarios.py``; files are written by ``files.py``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.trajectory import Motion, Trajectory
from sightline.simulate.option_checks import check_options, options_of
from sightline.simulate.scene import Extent, Scene, TextureLaw, random_relief, scene_layers
from sightline.simulate.sensor import Radiometry, render_chunks
from sightline.simulate.texture import Array

_NODE_STEP = 4  # columns between exact rays: fine enough for any lens distortion


@dataclass(frozen=True)
class FrameCaseOptions:
    """What a sequence of frames is made of; the defaults resemble a camera at a window of the ISS.

    Parameters
    ----------
    frames : int
        How many.
    interval : float
        s between frames.
    shape : (int, int)
        px, lines and columns of a frame; lines run forward.
    focal_length_px : float
        px
    principal_point_px : (float, float) or None
        px, line and column; left out: the middle of the frame.
    distortion : tuple of float
        k1, k2, p1, p2, k3 in normalised coordinates.
    altitude : float
        m
    ground_speed : float
        m/s
    step_sigma : float
        rad, of the random walk of each axis from frame to frame.
    time_sigma : float
        s, error of the time written for each frame.
    snr : float
        Mean over noise.
    contrast : float
        Standard deviation over mean of the ground.
    mtf_nyquist : float
        System MTF at half a cycle per pixel.
    relief_rms : float
        m; 0 is the plane z = 0.
    """

    frames: int = 10
    interval: float = 6.0
    shape: tuple[int, int] = (768, 1024)
    focal_length_px: float = 3600.0
    principal_point_px: tuple[float, float] | None = None
    distortion: tuple[float, ...] = (-0.05,)
    altitude: float = 420e3
    ground_speed: float = 7200.0
    step_sigma: float = 1e-3
    time_sigma: float = 0.0
    snr: float = 80.0
    contrast: float = 0.2
    mtf_nyquist: float = 0.15
    relief_rms: float = 0.0

    WORDS: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    RANGES: ClassVar[Mapping[str, tuple[float, float]]] = {
        "frames": (2, 10_000), "interval": (1e-4, 1e4), "shape": (16, 40_000), "focal_length_px": (10.0, 1e7),
        "principal_point_px": (-1e6, 1e6), "distortion": (-100.0, 100.0), "altitude": (1.0, 1e8),
        "ground_speed": (0.01, 1e5), "step_sigma": (0.0, 0.05), "time_sigma": (0.0, 1e4), "snr": (0.1, 1e5),
        "contrast": (0.0, 10.0), "mtf_nyquist": (1e-3, 0.9), "relief_rms": (0.0, 5000.0),
    }  # fmt: skip

    def __post_init__(self) -> None:
        """Refuse what cannot be rendered."""
        check_options(self)
        if self.interval <= 4.0 * self.time_sigma:
            raise InputError(
                f"`time_sigma` is too large: {self.time_sigma:g} s with frames every {self.interval:g} s; "
                "it must stay below a quarter of the interval, or frames change places"
            )

    @property
    def gsd(self) -> float:
        """m of one pixel at the nadir of the plane z = 0."""
        return self.altitude / self.focal_length_px

    @property
    def centre_px(self) -> tuple[float, float]:
        """The principal point, (line, column)."""
        middle = (0.5 * (self.shape[0] - 1), 0.5 * (self.shape[1] - 1))
        return self.principal_point_px or middle


@dataclass(frozen=True, eq=False)
class FrameScenario:
    """A sequence of frames: truth, what a user would know, and the images.

    Parameters
    ----------
    seed : int
    options : FrameOptions
    detector : AreaDetector
    reference : Trajectory
        As planned, without the motion.
    motion : Motion
        True motion, knots at the true times of the frames.
    nominal_times : (count,) s, as written in the ACQUISITION file
    times : (count,) s, true
    scene : Scene
    radiometry : Radiometry
    """

    seed: int
    options: FrameCaseOptions
    detector: AreaDetector
    reference: Trajectory
    motion: Motion
    nominal_times: Array
    times: Array
    scene: Scene
    radiometry: Radiometry

    @cached_property
    def cameras(self) -> tuple[FrameCamera, ...]:
        """The true cameras, one per frame."""
        trajectory = self.reference.with_motion(self.motion)
        return tuple(FrameCamera(self.detector, trajectory, FixedMount(), float(t)) for t in self.times)

    @property
    def truth(self) -> Array:
        """(count, 4) true t, roll, pitch, yaw of every frame."""
        return np.column_stack([self.times, self.motion.at(self.times)])

    def chunks(self, frame: int) -> Iterator[tuple[int, NDArray[np.uint16]]]:
        """One frame as (first line, block of lines), top to bottom."""
        noise = np.random.SeedSequence(self.seed).spawn(4)[3].spawn(frame + 1)[frame]
        yield from render_chunks(
            self.cameras[frame], self.scene, 0, self.options.shape, self.radiometry, noise, _NODE_STEP
        )

    def image(self, frame: int) -> NDArray[np.uint16]:
        """One frame, (lines, columns)."""
        return np.concatenate([block for _, block in self.chunks(frame)])


def frames_case(seed: int = 0, **overrides: Any) -> FrameScenario:
    """A sequence of frames with known truth; `overrides` are fields of :class:`FrameOptions`.

    Examples
    --------
    >>> frames_case(0, count=2, shape=(48, 64)).image(1).shape
    (48, 64)
    """
    options = options_of(FrameCaseOptions, {"frames": {}}, "frames", overrides)
    motion_seed, texture_seed, relief_seed, _ = np.random.SeedSequence(seed).spawn(4)
    nominal_times, times, motion = _draw_motion(options, motion_seed)
    margin = options.interval
    return FrameScenario(
        seed,
        options,
        AreaDetector("frame", options.shape, options.focal_length_px, options.centre_px, options.distortion),
        Trajectory.level_flight(
            options.altitude, options.ground_speed, -margin, float(nominal_times[-1]) + margin
        ),
        motion,
        nominal_times,
        times,
        _draw_scene(options, motion, texture_seed, relief_seed),
        Radiometry(snr=options.snr),
    )


def _draw_motion(options: FrameCaseOptions, seed: np.random.SeedSequence) -> tuple[Array, Array, Motion]:
    """Nominal times, true times, and a random walk with knots at (and one interval beyond) the true times."""
    rng = np.random.default_rng(seed)
    nominal = options.interval * np.arange(options.frames, dtype=np.float64)
    times = nominal + options.time_sigma * rng.standard_normal(options.frames)
    walk = np.cumsum(options.step_sigma * rng.standard_normal((options.frames + 2, 3)), axis=0)
    knots = np.concatenate([[times[0] - options.interval], times, [times[-1] + options.interval]])
    return nominal, times, Motion(knots, walk)


def _draw_scene(
    options: FrameCaseOptions,
    motion: Motion,
    texture_seed: np.random.SeedSequence,
    relief_seed: np.random.SeedSequence,
) -> Scene:
    gsd = options.gsd
    law = TextureLaw(options.contrast, (gsd, gsd), options.mtf_nyquist)
    # the diagonal of the frame covers any yaw; the walk moves it about by angle x altitude
    reach = 0.6 * float(np.hypot(*options.shape)) * gsd + options.altitude * float(
        np.abs(motion.angles).max()
    )
    track = options.ground_speed * options.interval * options.frames
    extent = Extent(-reach, reach, -reach - 1e-9, track + reach)
    texture, bands = scene_layers(texture_seed, extent, law, (1.0,), (1.0,), (1.0,))
    relief = None
    if options.relief_rms > 0.0:
        posting = max(30.0, 2.0 * gsd)
        relief = random_relief(relief_seed, extent, options.relief_rms, posting, 60.0 * posting)
    return Scene(texture, bands, relief)
