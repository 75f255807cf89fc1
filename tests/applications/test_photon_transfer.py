"""Photon transfer of frames whose gain, noise and pattern are known, and of a camera with a published result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from sightline.applications.photon_transfer import even_exposures, photon_transfer
from sightline.imaging.source import ArrayImage

LINES, COLUMNS = 160, 192
#: Electrons of the exposures, with pairs of frames; of one there are more.
EXPOSURES, STACK, DEEP = (300.0, 1200.0, 2500.0, 4000.0, 5500.0), 3, 8


@dataclass(frozen=True)
class Camera:
    """DN per electron, of each column; electrons of the dark noise and of its part common to a row; level."""

    gain: float = 0.3
    uneven: float = 0.0
    read: float = 8.0
    rows: float = 2.0
    level: float = 40.0
    dsnu: float = 1.5
    prnu: float = 5e-3
    top: float = 4095.0
    drift: float = 1e-3

    def response(self) -> np.ndarray:
        rng = np.random.default_rng(5)
        shading = 0.02 * np.linspace(-1.0, 1.0, COLUMNS) ** 2
        return 1.0 + shading + self.prnu * rng.standard_normal((LINES, COLUMNS))

    def offsets(self) -> np.ndarray:
        return self.dsnu * np.random.default_rng(6).standard_normal((LINES, COLUMNS))

    def frame(self, rng: np.random.Generator, electrons: float) -> np.ndarray:
        light = electrons * self.response() * (1.0 + self.drift * rng.standard_normal() * (electrons > 0.0))
        charge = rng.poisson(light) + self.offsets()
        charge = charge + self.read * rng.standard_normal(charge.shape)
        charge += self.rows * rng.standard_normal((LINES, 1))
        gain = self.gain * (1.0 + self.uneven * (np.arange(COLUMNS) % 2 * 2 - 1))
        return np.clip(np.round(self.level + gain * charge), 0.0, self.top)

    def frames(self, seed: int, exposures=EXPOSURES) -> tuple[list[ArrayImage], list[ArrayImage]]:
        rng = np.random.default_rng(seed)
        bright = [
            ArrayImage(self.frame(rng, one))
            for k, one in enumerate(exposures)
            for _ in range(DEEP if k == STACK else 2)
        ]
        return bright, [ArrayImage(self.frame(rng, 0.0)) for _ in bright]


def transferred(bright, dark, dark_level=None, **more):
    names = [f"frame {k}" for k in range(len(bright))]
    groups = even_exposures(names, bright, dark, dark_level)
    assert groups is not None
    return photon_transfer(names, bright, groups, dark, dark_level, lambda *_: None, **more)


def by_name(found):
    return {figure.name.strip(): figure for figure in found.figures}


def test_every_figure_is_as_far_from_the_truth_as_its_sigma_says():
    camera, seeds = Camera(), 20
    response = camera.response()
    signal = EXPOSURES[STACK]
    truth = {
        "K": camera.gain,
        "dark noise": np.hypot(camera.read, camera.rows),
        "PRNU": 100.0 * response.std() / response.mean(),
        "of pixels": 100.0 * camera.prnu,
        "DSNU": camera.offsets().std(),
        "rows that jump together": camera.rows,
    }
    errors = {name: [] for name in truth}
    for seed in range(seeds):
        found = transferred(*camera.frames(seed))
        assert found.unit == "e-" and found.law.shot == 1.0 and found.warnings == ()
        for name, figure in by_name(found).items():
            if name in truth:
                errors[name].append((figure.value - truth[name]) / figure.sigma)
        assert found.law.output == pytest.approx(truth["dark noise"], rel=0.03)
        assert found.transfer.exposures[STACK].signal == pytest.approx(
            signal * camera.gain * response.mean(), rel=3e-3
        )
    for name, scaled in errors.items():
        # 20 seeds: a chi-square of 7.4 to 40 in 99 %
        assert 7.4 / seeds < np.mean(np.square(scaled)) < 40.0 / seeds, name
