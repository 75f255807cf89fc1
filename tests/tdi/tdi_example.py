"""A line of columns whose slip and velocity change along it, like the field of a yaw-steered camera."""

from __future__ import annotations

import numpy as np

from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure
from sightline.tdi.choose import TdiChoice, choose_settings
from sightline.tdi.merit import DriftMtf
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid


def field(
    count: int = 40,
    signals: int = 16,
    *,
    column: np.ndarray | None = None,
    slip: np.ndarray | None = None,
    covariance: np.ndarray | None = None,
    full_well: float = np.inf,
    grid: TdiGrid | None = None,
    top: float = 8000.0,
    **rules: object,
) -> tuple[DriftMtf, TdiChoice]:
    """Model and choice; the grid is coarse, so that a search in numpy takes little time."""
    x = np.linspace(-1.0, 1.0, count)
    slip = np.radians(0.1 + 1.2 * x) if slip is None else slip
    column = np.arange(count, dtype=float) if column is None else column
    columns = ScanColumns(column, 0.999 + 0.004 * x**2, slip, np.full((count, 2), 0.2), covariance)
    grid = grid or TdiGrid(np.arange(3, 97, 3), np.arange(1, 11) * 0.1)
    detector = TdiDetector(Exposure(2, 0.25), NoiseLaw(9e-6, 1.0, 12.0), full_well_sum=full_well)
    model = DriftMtf(columns, grid, detector.exposure, ChoiceRules(**rules))
    return model, choose_settings(model, np.geomspace(1.0, top, signals), grid, detector, model.rules)
