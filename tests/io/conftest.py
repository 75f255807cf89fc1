"""A small acquisition on disk, made of plain text and arrays, that a test can spoil."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

LINES, COLUMNS = 200, 120

TOML = """
[acquisition]
name = "strip"
epoch = "2026-01-01T00:00:00Z"

[platform]
kind = "level-flight"
altitude = 700e3
ground_speed = 7000.0

[instrument]
ifov = 5e-6
columns = 120
line_period = 5e-4

[[band]]
name = "PAN"
image = "PAN.tif"
offset_sigma_px = 0.0
rotation_sigma = 0.0

[[band]]
name = "XS"
image = "XS.tif"
look_ahead = 2e-4
"""


def write_tif(path: Path, array: np.ndarray, **profile) -> Path:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        options = {"driver": "GTiff", "count": 1, "height": array.shape[0], "width": array.shape[1]}
        with rasterio.open(path, "w", dtype=array.dtype, **{**options, **profile}) as target:
            target.write(array, 1)
    return path


def noise(seed: int, shape: tuple[int, int] = (LINES, COLUMNS)) -> np.ndarray:
    return np.random.default_rng(seed).integers(100, 900, shape).astype(np.uint16)


class Folder:
    """An ACQUISITION.toml and its images; `text` may be changed before `write`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.text = TOML
        for seed, name in enumerate(("PAN", "XS")):
            write_tif(path / f"{name}.tif", noise(seed))

    def replace(self, old: str, new: str) -> Folder:
        assert old in self.text
        self.text = self.text.replace(old, new, 1)
        return self

    def add(self, text: str) -> Folder:
        self.text += text
        return self

    def write(self) -> Path:
        toml = self.path / "acquisition.toml"
        toml.write_text(self.text)
        return toml


@pytest.fixture
def folder(tmp_path) -> Folder:
    return Folder(tmp_path)
