"""A strip seen by the cameras of an acquisition, whatever they were read from, with a motion put on top.

The cameras are those that the acquisition gives; offsets, rotations and scales of its detector lines are
drawn as uncertain as its bands say that they are, the motion and the texture of the ground from the seed.

Not here: reading the acquisition and writing that of the images (``io/scene/acquired.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.pointing import ScanMirror
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.motion.band import Band
from sightline.simulate.earth_view import ViewPlane, earth_chunks
from sightline.simulate.jitter import nominal_profile
from sightline.simulate.option_checks import MOST_COLUMNS, MOST_LINES, check_options
from sightline.simulate.scenarios import GROUND_MARGIN_PX, MOTION_MARGIN_LINES, motion_profile
from sightline.simulate.scene import Scene, TextureLaw, scene_layers
from sightline.simulate.sensor import Radiometry
from sightline.simulate.strip_options import MOTIONS
from sightline.simulate.texture import Array


@dataclass(frozen=True)
class AcquiredOptions:
    """A strip of the cameras of an acquisition.

    Parameters
    ----------
    acquisition : str
        ACQUISITION.toml whose cameras see the scene.
    lines, columns : int
        Most lines and columns of the first band: the first of the acquisition's images; of other bands as
        many in proportion.
    coherence : float
        Amplitude correlation of the textures of any two bands.
    gains, gammas : tuple of float
        Factor and exponent of the brightness of each band; empty: all 1.
    snr : float
        Mean over noise.
    contrast : float
        Standard deviation over mean of the ground.
    mtf_nyquist : float
        System MTF at half a cycle per pixel of the finest band.
    motion : str
        One of those of a strip.
    """

    acquisition: str = ""
    lines: int = 1500
    columns: int = 640
    coherence: float = 0.97
    gains: tuple[float, ...] = ()
    gammas: tuple[float, ...] = ()
    snr: float = 120.0
    contrast: float = 0.2
    mtf_nyquist: float = 0.15
    motion: str = "nominal"

    WORDS: ClassVar[Mapping[str, tuple[str, ...]]] = {"motion": MOTIONS}
    RANGES: ClassVar[Mapping[str, tuple[float, float]]] = {
        "lines": (16, MOST_LINES), "columns": (16, MOST_COLUMNS), "coherence": (0.01, 1.0),
        "gains": (0.01, 3.0), "gammas": (0.1, 3.0), "snr": (0.1, 1e5), "contrast": (0.0, 10.0),
        "mtf_nyquist": (1e-3, 0.9),
    }  # fmt: skip

    def __post_init__(self) -> None:
        """Refuse what cannot be rendered."""
        check_options(self)


@dataclass(frozen=True)
class LineTruth:
    """How a detector line truly departs from what the acquisition says of it.

    Parameters
    ----------
    offset_px : (float, float)
        Forward and towards larger columns.
    rotation : float
        rad.
    scale : float
        Relative.
    """

    offset_px: tuple[float, float]
    rotation: float
    scale: float

    @classmethod
    def drawn(cls, band: Band, rng: np.random.Generator, *, first: bool) -> LineTruth:
        """As far off as the band says that it may be; scales are beside that of the first band."""
        line, column, turn, stretch = rng.standard_normal(4).tolist()
        size = band.offset_sigma_px
        scale = 0.0 if first else band.scale_sigma * stretch
        return cls((size * line, size * column), band.rotation_sigma * turn, scale)


@dataclass(frozen=True, eq=False)
class AcquiredScenario:
    """The strip: truth and images.

    Parameters
    ----------
    given : tuple of Band
        Of the acquisition: cameras of the size that is rendered.
    surface : Surface
        The ground.
    seed : int
    options : AcquiredOptions
    """

    given: tuple[Band, ...]
    surface: Surface
    seed: int
    options: AcquiredOptions

    def __post_init__(self) -> None:
        """Refuse options of other bands."""
        for name in ("gains", "gammas"):
            count = len(getattr(self.options, name))
            if count not in (0, len(self.given)):
                raise InputError(
                    f"`{name}` must be one of each of the {len(self.given)} bands of the acquisition, or "
                    f"none, got {count}"
                )

    @cached_property
    def bands(self) -> tuple[LineTruth, ...]:
        """What is true of each detector line."""
        rng = np.random.default_rng(self._streams["detectors"])
        return tuple(LineTruth.drawn(band, rng, first=k == 0) for k, band in enumerate(self.given))

    @cached_property
    def nominal_cameras(self) -> tuple[PushbroomCamera, ...]:
        """Without the motion, as the acquisition says."""
        return tuple(band.camera for band in self.given)

    @cached_property
    def motion(self) -> Motion:
        """True motion of the line of sight, over the exposures of all bands."""
        cameras = self.nominal_cameras
        step = min(camera.detector.line_period for camera in cameras)
        ends = np.array([camera.times(np.array([0.0, camera.lines - 1.0])) for camera in cameras])
        # those of the last camera's own edge too: half of its line, and the lines from which poses bend; and
        # the stages of its lines
        more = MOTION_MARGIN_LINES * max(camera.detector.line_period for camera in cameras)
        more += max(max(camera.reach) for camera in cameras)
        count = int(np.ceil((ends[:, 1].max() - ends[:, 0].min() + 2.0 * more) / step))
        t = ends[:, 0].min() - more + step * np.arange(count + 1)
        name = self.options.motion
        profile = nominal_profile() if name == "nominal" else motion_profile(name)
        return profile.draw(t, self._rad_per_px, self._streams["motion"])[0]

    @property
    def _rad_per_px(self) -> Array:
        """(3,) rad: roll of one column, pitch of one line, yaw of the smaller of both where it moves most.

        That is at the edge of the field, and all over a field that lies aside of the axis of yaw: behind a
        mirror, and of the first columns of many.
        """
        camera = self.nominal_cameras[0]
        across = camera.detector.pixel_step
        along = across * float(self._pixels[0, 1] / self._pixels[0, 0])
        aside = float(np.linalg.norm(camera.detector.tangents, axis=1).max())
        lever = 1.0 if isinstance(camera.pointing, ScanMirror) else aside
        return np.array([across, along, min(across, along) / lever])

    @cached_property
    def cameras(self) -> tuple[PushbroomCamera, ...]:
        """The true cameras."""
        return tuple(
            replace(
                camera,
                detector=camera.detector.adjusted(*true.offset_px, true.rotation, true.scale),
                trajectory=camera.trajectory.with_motion(self.motion),
            )
            for camera, true in zip(self.nominal_cameras, self.bands, strict=True)
        )

    @property
    def truth(self) -> Array:
        """(N, 4) t, roll, pitch, yaw at every line of the first band.

        Its lines are gone on before and after, from the first exposure of any band to the last.
        """
        camera = self.nominal_cameras[0]
        ends = np.array([c.times(np.array([0.0, c.lines - 1.0])) for c in self.nominal_cameras])
        period = (ends[0, 1] - ends[0, 0]) / (camera.lines - 1.0)
        before, after = (ends[0, 0] - ends.min()) / period, (ends.max() - ends[0, 1]) / period
        # what is less than a thousandth of a line outside is rounding
        more = np.ceil(np.array([before, after]) - 1e-3)
        t = camera.times(np.arange(-more[0], camera.lines + more[1]))
        return np.column_stack([t, self.motion.at(t)])

    @cached_property
    def plane(self) -> ViewPlane:
        """Coordinates in which the ground's brightness is given."""
        return ViewPlane.of(self.nominal_cameras[0], self.surface.intersect)

    @cached_property
    def _pixels(self) -> Array:
        """(bands, 2) m of one column and one line of each band."""
        planes = [ViewPlane.of(camera, self.surface.intersect) for camera in self.nominal_cameras]
        return np.array([plane.pixel for plane in planes])

    @cached_property
    def scene(self) -> Scene:
        """The ground, drawn when first asked for."""
        options, count = self.options, len(self.given)
        finest = (float(self._pixels[:, 0].min()), float(self._pixels[:, 1].min()))
        extent = self.plane.extent(list(self.nominal_cameras), GROUND_MARGIN_PX)
        law = TextureLaw(options.contrast, finest, options.mtf_nyquist)
        gains, gammas = options.gains or (1.0,) * count, options.gammas or (1.0,) * count
        weights = (options.coherence**0.5,) * count
        return Scene(*scene_layers(self._streams["texture"], extent, law, weights, gains, gammas))

    def chunks(self, band: int) -> Iterator[tuple[int, NDArray[np.uint16]]]:
        """Image of one band as (first line, block of lines), top to bottom; again alike at every call.

        Its pixels are means over as many points as fit of the pixels of the finest band, of every TDI stage.
        """
        noise = self._streams["noise"].spawn(len(self.given))[band]
        columns, lines = (int(n) for n in np.rint(self._pixels[band] / self._pixels.min(axis=0)))
        yield from earth_chunks(
            self.cameras[band],
            self.scene,
            self.plane,
            band,
            Radiometry(snr=self.options.snr),
            noise,
            (lines, columns),
        )

    @property
    def _streams(self) -> dict[str, np.random.SeedSequence]:
        """The independent random streams, by purpose."""
        purposes = ("motion", "detectors", "texture", "noise")
        return dict(zip(purposes, np.random.SeedSequence([self.seed, 21]).spawn(len(purposes)), strict=True))


def cropped(shapes: Sequence[tuple[int, int]], lines: int, columns: int) -> list[tuple[int, int]]:
    """Sizes (lines, columns) of images of which no more is kept of the first, of others in proportion."""
    shares = [min(1.0, most / size) for most, size in zip((lines, columns), shapes[0], strict=True)]
    return [
        (max(1, int(np.ceil(n * shares[0] - 1e-9))), max(1, int(np.ceil(m * shares[1] - 1e-9))))
        for n, m in shapes
    ]
