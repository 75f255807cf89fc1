"""What every simulated strip has, whatever instrument took it: times, truth, images, what a user is given.

Not here: how a strip is drawn (``scenarios.py``, ``instruments.py``), frames (``frames.py``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.trajectory import Motion
from sightline.imaging.source import ArrayImage
from sightline.motion.band import Band

Array = NDArray[np.float64]


class _Options(Protocol):
    @property
    def lines(self) -> int: ...
    @property
    def line_period(self) -> float: ...
    @property
    def offset_sigma_px(self) -> float: ...
    @property
    def rotation_sigma(self) -> float: ...


class _Named(Protocol):
    @property
    def name(self) -> str: ...


class RenderedStrip(ABC):
    """Line detectors that scan one scene.

    Attributes
    ----------
    options
        Number of lines, s per line, and sizes of what is not known of the detectors.
    bands
        The detector lines, by name.
    motion : Motion
        True motion of the line of sight.
    """

    options: _Options
    bands: tuple[_Named, ...]
    motion: Motion

    @property
    @abstractmethod
    def nominal_cameras(self) -> tuple[PushbroomCamera, ...]:
        """The cameras as the ACQUISITION file gives them: no motion, nominal detectors."""

    @abstractmethod
    def chunks(self, band: int) -> Iterator[tuple[int, NDArray[np.uint16]]]:
        """Image of one band as (first line, block of lines), top to bottom; again alike at every call."""

    @property
    def line_times(self) -> Array:
        """(lines,) s, of every band; where they differ, of the finest."""
        return np.arange(self.options.lines, dtype=np.float64) * self.options.line_period

    @property
    def truth(self) -> Array:
        """(N, 4) t, roll, pitch, yaw at every line."""
        t = self.truth_times
        return np.column_stack([t, self.motion.at(t)])

    @property
    def truth_times(self) -> Array:
        """(N,) s, where the truth is written."""
        return self.line_times

    def image(self, band: int) -> NDArray[np.uint16]:
        """Image of one band, (lines, columns)."""
        return np.concatenate([block for _, block in self.chunks(band)])

    def as_given(self, images: Sequence[NDArray[np.generic]] | None = None) -> list[Band]:
        """The strip as a user has it: images, nominal cameras, and how well these are known.

        Parameters
        ----------
        images : sequence of (lines, columns), optional
            In place of the rendered ones.
        """
        rendered: Sequence[NDArray[np.generic]]
        rendered = images or [self.image(band) for band in range(len(self.bands))]
        knowledge = {
            name: getattr(self.options, name)
            for name in ("offset_sigma_px", "rotation_sigma", "scale_sigma")
            if getattr(self.options, name, 0.0) > 0.0 or name != "scale_sigma"
        }
        return [
            Band(band.name, ArrayImage(image), camera, **knowledge, **self.shape_known(k))
            for k, (band, image, camera) in enumerate(
                zip(self.bands, rendered, self.nominal_cameras, strict=True)
            )
        ]

    def shape_known(self, band: int) -> dict[str, Any]:
        """What a user knows of the shape of a detector line, as keys of its band."""
        return {}
