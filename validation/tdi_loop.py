"""The loop closed: MTF and SNR predicted for a TDI strip as weights of its matches.

    python validation/tdi_loop.py --seeds 100 101

The nominal strip, whose columns slip more and more from the centre outwards while all have the TDI setting of
the centre column: the scene smears over up to 12 pixels at the edges, with the noise of every other column.
MTF and SNR are predicted as `sightline tdi` does and written as a band's `quality` table; rms error per axis
in px (yaw: at the field's edge) after the hidden directions are fitted away, NEES, windows kept. "None" is
without any weights; "predicted" with those of MTF and SNR; "covariance" with what each match says of itself.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import gates
import numpy as np
from numpy.typing import NDArray

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.evaluation.score import score_result
from sightline.geometry.surface import Plane
from sightline.imaging.tdi_noise import NoiseLaw, snr
from sightline.imaging.tdi_transfer import Exposure, drift_transfer
from sightline.io.acquisition.quality import read_match_sigma
from sightline.io.formats.tables import write_columns
from sightline.motion.strip.strip import RecoverOptions
from sightline.simulate.scenarios import StripScenario, line_of_sight_case

Array = NDArray[np.float64]
SIZE = {"lines": 1500, "columns": 700}
STAGES, SIGNAL = 96, 400.0
#: Smear of the edge columns, px, and the share of the half-field that does not slip.
SMEAR, STILL = 12.0, 0.3
#: Cycles per pixel at which matches of windows learn most on smeared ground.
FREQUENCY = 0.15


def slip_of(columns: int) -> Array:
    """Slip angle (C,) rad: none in the middle, growing to the edges."""
    x = np.abs(np.linspace(-1.0, 1.0, columns))
    return np.asarray(np.arctan(SMEAR / STAGES * np.maximum(x - STILL, 0.0) / (1.0 - STILL)))


def smeared(scenario: StripScenario, slip: Array, rng: np.random.Generator) -> list[Array]:
    """Images of all bands, each column spread over the pixels that the scene crosses in all stages."""
    images = []
    for band in range(len(scenario.bands)):
        sharp = scenario.image(band).astype(float)
        out, kept = np.empty_like(sharp), np.empty(sharp.shape[1])
        for c in range(sharp.shape[1]):
            width = max(STAGES * float(np.tan(slip[c])), 1e-9)
            reach = int(np.ceil(0.5 * width + 0.5))
            at = np.arange(-reach, reach + 1)
            # share of the smear that falls on each pixel
            share = np.clip(np.minimum(at + 0.5, 0.5 * width) - np.maximum(at - 0.5, -0.5 * width), 0.0, None)
            share /= share.sum()
            out[:, c] = sharp[:, np.clip(c + at, 0, sharp.shape[1] - 1)] @ share
            kept[c] = np.sum(share**2)
        # the smear must not smooth the noise: what it took of its variance is given back
        level = sharp.mean() / scenario.options.snr
        images.append(out + level * np.sqrt(1.0 - kept) * rng.standard_normal(out.shape))
    return images


def predicted_sigma(slip: Array) -> Array:
    """(columns, 2) relative sigma of matches, through the table that a user would give."""
    columns = np.arange(len(slip))
    law, exposure = NoiseLaw(read=12.0), Exposure()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "quality.csv"
        write_columns(
            path,
            {
                "column": columns,
                "mtf_x": np.abs(drift_transfer(STAGES, 1.0, 1.0, slip, FREQUENCY, 0.0)),
                "mtf_y": np.abs(drift_transfer(STAGES, 1.0, 1.0, slip, FREQUENCY, 0.0)),
                "snr": np.full(len(slip), float(snr(SIGNAL, STAGES, 1.0, law, exposure))),
            },
        )
        return read_match_sigma(path, len(slip))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[100, 101])
    np.seterr(all="ignore")
    print("| weights | seed | roll rms (NEES) | pitch | yaw | windows |")
    print("|---|---|---|---|---|---|")
    for seed in parser.parse_args().seeds:
        scenario = line_of_sight_case("nominal", seed, **SIZE)
        slip = slip_of(SIZE["columns"])
        images = smeared(scenario, slip, np.random.default_rng([seed, 9]))
        sigma = predicted_sigma(slip)
        bands = [replace(band, match_sigma=sigma) for band in scenario.as_given(images)]
        rms: dict[str, float] = {}
        for weighting in ("none", "predicted", "covariance"):
            result = recover_line_of_sight(bands, Plane(0.0), options=RecoverOptions(weighting=weighting))
            score = score_result(result, scenario.truth[:, 0], scenario.truth[:, 1:])
            rms[weighting] = float(np.sqrt(np.mean([axis.rms**2 for axis in score.axes.values()])))
            if weighting != "none":
                nees = float(np.mean([axis.nees for axis in score.axes.values()]))
                gates.check(f"seed {seed}, {weighting}: NEES, mean of the axes", nees, 0.8, 1.3)
            axes = " | ".join(f"{axis.rms:.4f} ({axis.nees:.2f})" for axis in score.axes.values())
            print(f"| {weighting} | {seed} | {axes} | {sum(p.kept for p in result.pairs)} |", flush=True)
        for weighting in ("predicted", "covariance"):
            gates.check(
                f"seed {seed}: rms by {weighting} over that of none", rms[weighting] / rms["none"], 0.0, 0.75
            )


if __name__ == "__main__":
    gates.run(main, __file__)
