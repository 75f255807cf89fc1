"""A detector's noise → ``noise.toml``, ``tdi.toml``, ``columns.csv``, ``summary.json``.

They are described in ``docs/formats.md``.

Not here: where the figures come from (``applications/detector_noise.py``).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sightline.applications.detector_noise import (
    DEAD,
    GAIN_UNKNOWN,
    OFFSET_UNKNOWN,
    OUTLYING,
    DetectorNoise,
    PhotonTransfer,
)
from sightline.imaging.strip_noise import NoiseFigure
from sightline.io.acquisition.acquired import sha256
from sightline.io.formats.tables import write_columns
from sightline.io.results.line_of_sight import peak_memory, write_json
from sightline.version import VERSION
from sightline.writing import whole_text

#: Every file that is written.
NOISE_FILES = ("columns.csv", "noise.toml", "summary.json", "tdi.toml")
#: Columns of ``columns.csv`` beside the usual ones, of photon transfer.
TRANSFER_COLUMNS = ("sigma_gain", "sigma_offset", "electrons_per_dn", "sigma_electrons_per_dn")
#: Bits of the flags of ``columns.csv``.
FLAGS = {"gain_unknown": GAIN_UNKNOWN, "offset_unknown": OFFSET_UNKNOWN, "dead": DEAD, "outlying": OUTLYING}


def write_noise(
    folder: Path, noise: DetectorNoise, inputs: Sequence[Path], *, wall_seconds: float
) -> dict[str, Any]:
    """Write every file of a detector's noise; gives the summary.

    Parameters
    ----------
    folder : Path
        Exists.
    noise : DetectorNoise
    inputs : sequence of Path
        Files that were read.
    wall_seconds : float
        s; of the whole command so far.
    """
    whole_text(folder / "noise.toml", noise_toml(noise))
    whole_text(folder / "tdi.toml", tdi_toml(noise))
    numbers = np.arange(len(noise.gain))
    columns: dict[str, ArrayLike] = {
        "column": numbers,
        "gain": noise.gain,
        "offset": noise.offset,
        "flags": noise.flags,
    }
    if noise.transfer is not None:
        columns |= {name: getattr(noise.transfer, name) for name in TRANSFER_COLUMNS}
    write_columns(folder / "columns.csv", columns)
    summary = summarize_noise(noise, inputs, wall_seconds=wall_seconds)
    write_json(folder / "summary.json", summary)
    return summary


def noise_toml(noise: DetectorNoise) -> str:
    """The ``[noise]`` table of a TDI.toml, with how well each figure is known."""
    law, unit = noise.law, noise.unit
    known = [f"# {figure}" for figure in noise.figures]
    for image in noise.images:
        known += [f"# {_one_line(image.name)}:", *(f"#   {figure}" for figure in image.figures)]
    keys = [
        ("gain", law.gain, "A of a line, relative variance"),
        ("shot", law.shot, f"B, variance per {unit} of signal"),
        ("read", law.read, f"C, {unit} rms of each line: charge is summed and read once"),
        ("dark", law.dark, f"D, variance in {unit}^2 of each line at an integration ratio of 1, at most"),
        ("output", law.output, f"C_out, {unit} rms, once per sum"),
        ("column_fixed", law.column_fixed, "A_col, relative variance common to a column's lines"),
    ]
    return "\n".join(
        [
            f"# Noise of {noise.stages} TDI stage{'s' if noise.stages > 1 else ''}, by `sightline noise`;",
            f"# {_unit(noise)}.",
            "# Values with their sigma, bounds of 2 sigma:",
            *known,
            "",
            "[noise]",
            *(f"{key} = {value:.4g}".ljust(30) + f"# {said}" for key, value, said in keys),
            "",
        ]
    )


def _unit(noise: DetectorNoise) -> str:
    """What signals are counted in."""
    if noise.electrons_per_dn is not None:
        return f"in electrons, {noise.electrons_per_dn:g} per DN"
    return "in DN: signals and full wells beside it must be in DN too (--electrons-per-dn gives electrons)"


def _one_line(name: str) -> str:
    """A name that cannot end a comment."""
    return " ".join(name.split())


def tdi_toml(noise: DetectorNoise) -> str:
    """A TDI.toml of the noise; all else in it is a placeholder and says so."""
    well = (
        "" if noise.full_well_sum is None else f"full_well_sum = {noise.full_well_sum:.4g}  # largest value\n"
    )
    return f"""{noise_toml(noise)}
[grid]                              # a placeholder: settings among which to choose
stages = [8, 16, 32, 64, 128]
integration_ratio = [0.25, 0.5, 0.75, 1.0]

[head]
stages = 0                          # the signal is measured elsewhere

[columns]
count = {len(noise.gain)}                         # in step with the clock: the motion is not estimated here

[signals]                           # {noise.unit} of one line: what the images span
from = {noise.signals[0]:.4g}
to = {noise.signals[1]:.4g}
count = 32
integration_ratio = 1.0

[mtf]                               # placeholders: not estimated here
aperture_x = 1.0
aperture_y = 1.0
diffusion_sigma_px = 0.0
optics_mtf = 1.0

[choice]
model = "exact"
merit = "product"
{well}"""


def summarize_noise(noise: DetectorNoise, inputs: Sequence[Path], *, wall_seconds: float) -> dict[str, Any]:
    """The content of ``summary.json``."""
    names = Counter(path.name for path in inputs)
    return {
        "name": ", ".join(image.name for image in noise.images),
        "result": "DetectorNoise",
        "version": VERSION,
        "unit": noise.unit,
        "stages": noise.stages,
        "electrons_per_dn": noise.electrons_per_dn,
        "noise": asdict(noise.law),
        "signals": list(noise.signals),
        "full_well_sum": noise.full_well_sum,
        "figures": [_figure(figure) for figure in noise.figures],
        "images": [
            {"name": image.name, "figures": [_figure(figure) for figure in image.figures]}
            for image in noise.images
        ],
        "columns": {
            "count": len(noise.gain),
            "flagged": {name: int((noise.flags & bit != 0).sum()) for name, bit in FLAGS.items()},
            "rms_gain": float(np.sqrt(np.mean((noise.gain - 1.0) ** 2))),
        },
        "photon_transfer": None if noise.transfer is None else _transfer(noise.transfer),
        "warnings": list(noise.warnings),
        "wall_seconds": wall_seconds,
        "peak_memory_bytes": peak_memory(),
        "inputs": {path.name if names[path.name] == 1 else str(path): sha256(path) for path in inputs},
    }


def _transfer(found: PhotonTransfer) -> dict[str, Any]:
    """What only frames of even light say: the exposures, and whether columns differ."""
    return {
        "exposures": [
            {
                "name": one.name,
                "frames": one.frames,
                "signal": one.signal,
                "variance": None if one.variance is None else one.variance.value,
                "sigma": None if one.variance is None else one.variance.sigma,
                "cut": one.cut,
                "used": one.used,
            }
            for one in found.exposures
        ],
        "columns": {name: {"alike": one.alike, **asdict(one)} for name, one in found.alike.items()},
    }


def _figure(figure: NoiseFigure) -> dict[str, Any]:
    """A figure as JSON: its name, unit, value, sigma (null of a bound), relation and how."""
    return {**asdict(figure), "name": figure.name.strip()}
