"""Microvibration of a recovered strip → ``smear.csv`` and its part of ``summary.json``.

Not here: how it is found (``evaluation/microvibration.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sightline.evaluation.microvibration import microvibration, smear_px
from sightline.io.formats.tables import ANGLES, write_columns
from sightline.motion.observability import Passbands
from sightline.motion.results import LineOfSight
from sightline.motion.tones import DetectedTone


def microvibration_summary(
    result: LineOfSight, tones: tuple[DetectedTone, ...], bands: Mapping[str, Passbands]
) -> dict[str, Any]:
    """Tones through time, close pairs, what is above the passbands and the smear of the lines, in px.

    Parameters
    ----------
    result : LineOfSight
        Of a strip.
    tones : tuple of DetectedTone
    bands : mapping
        Axis -> passbands, Hz.
    """
    found = microvibration(result, tones, {axis: list(bands[axis]) for axis in ANGLES})
    scale = dict(zip(ANGLES, result.scale.tolist(), strict=True))
    smear = found.smear
    return {
        "tones": [
            {
                "axis": h.tone.axis,
                "frequency": h.tone.frequency,
                "t": h.t.tolist(),
                "amplitude_px": (h.amplitude / scale[h.tone.axis]).tolist(),
                "sigma_px": h.sigma / scale[h.tone.axis],
                "phase": h.phase.tolist(),
                "variation_px": h.variation / scale[h.tone.axis],
                "steady_chance": h.steady_chance,
            }
            for h in found.histories
        ],
        "close_pairs": [
            {
                "axis": p.axis,
                "frequencies": list(p.frequencies),
                "sigma_frequencies": list(p.sigma_frequencies),
                "amplitudes_px": [a / scale[p.axis] for a in p.amplitudes],
                "sigma_amplitudes_px": [a / scale[p.axis] for a in p.sigma_amplitudes],
                "misfit": p.misfit,
            }
            for p in found.pairs
        ],
        "above_passband": {
            axis: {"from": edge, "rms_px": rms / scale[axis]} for axis, (edge, rms) in found.above.items()
        },
        "smear_px": {
            axis: {
                "rms": float(np.sqrt(np.mean(smear.px[:, k] ** 2))),
                "max": float(np.abs(smear.px[:, k]).max()),
                "sigma": float(smear.sigma_px[k]),
                "mtf_at_nyquist": float(smear.mtf_at_nyquist[k]),
            }
            for k, axis in enumerate(ANGLES)
        },
    }


def write_smear(path: Path, result: LineOfSight, found: Mapping[str, Any]) -> None:
    """``smear.csv``: px that the image moves during each line, beside the nominal scan.

    Parameters
    ----------
    path : Path
    result : LineOfSight
    found : mapping
        As `microvibration_summary` gives it.
    """
    px = smear_px(result)
    columns = {"t": result.motion.t, **{axis: px[:, k] for k, axis in enumerate(ANGLES)}}
    for axis in ANGLES:
        columns[f"sigma_{axis}"] = np.full(len(px), found["smear_px"][axis]["sigma"])
    write_columns(path, columns)
