"""A spinning camera worked out by hand, sharing no code with the package: rays in closed form.

Camera axes = body axes: x to larger columns, y to larger lines, z ahead. The body turns about `axis` by
`rate` per exposure; strip s has the optical axis at line `axis_lines[s]` of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


def turn(vector: np.ndarray) -> np.ndarray:
    """Rodrigues' rotation matrix of a rotation vector (3,)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k


@dataclass(frozen=True)
class SpinningCamera:
    """Truth: all that decides where a pixel looks."""

    focal: float
    column: float
    axis_lines: tuple[float, ...]
    axis: np.ndarray
    rate: float
    departures: np.ndarray  # (n, 3) rad
    attitude: np.ndarray  # (3, 3)

    def world_from_body(self, exposure: int) -> np.ndarray:
        unit = self.axis / np.linalg.norm(self.axis)
        return self.attitude @ turn(self.rate * exposure * unit) @ turn(self.departures[exposure])

    def directions(self, exposure: int, strip: int, lines: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """World directions (..., 3), not normalised to the package's liking but of unit length."""
        y = (lines - self.axis_lines[strip]) / self.focal
        x = (columns - self.column) / self.focal
        body = np.stack(np.broadcast_arrays(x, y, 1.0), axis=-1)
        body /= np.linalg.norm(body, axis=-1, keepdims=True)
        return body @ self.world_from_body(exposure).T

    def pixel(self, exposure: int, strip: int, toward: np.ndarray) -> np.ndarray:
        """(N, 2) line, column at which world vectors (N, 3) are seen."""
        body = toward @ self.world_from_body(exposure)
        line = self.axis_lines[strip] + self.focal * body[:, 1] / body[:, 2]
        return np.column_stack([line, self.column + self.focal * body[:, 0] / body[:, 2]])


class Texture:
    """A sky of plane waves over direction cosines: known at every direction without interpolation.

    The highest of them have 5 px per cycle at the focal length given.
    """

    def __init__(self, seed: int, focal: float, waves: int = 160) -> None:
        rng = np.random.default_rng(seed)
        size = 2.0 * np.pi * focal / np.exp(rng.uniform(np.log(5.0), np.log(60.0), waves))
        vector = rng.normal(size=(waves, 3))
        self.waves = vector / np.linalg.norm(vector, axis=1, keepdims=True) * size[:, None]
        self.phase = rng.uniform(0.0, 2.0 * np.pi, waves)
        self.height = size**-0.6
        self.height /= np.sqrt((self.height**2).sum() / 2.0)

    def __call__(self, directions: np.ndarray) -> np.ndarray:
        flat = directions.reshape(-1, 3)
        out = np.zeros(len(flat))
        for wave, phase, height in zip(self.waves, self.phase, self.height, strict=True):
            out += height * np.cos(flat @ wave + phase)
        return out.reshape(directions.shape[:-1])
