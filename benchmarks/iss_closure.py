"""Real frames of the ISS: do pairs of one lag tell the same attitudes as chains of neighbours?

Run: python benchmarks/iss_closure.py [ACQUISITION.toml]

Without an argument the acquisition is made by examples/iss_frames.py from
``$SIGHTLINE_DATA/iss_astropi_a``. All lags together calibrate the camera; then the attitudes are solved
from pairs 6 s apart alone, and from longer ones alone.
There is no attitude truth: agreement within the claimed sigmas is what can be shown.
"""

from __future__ import annotations

import runpy
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from motion.frame_closure import Closure, closure
from sightline.applications.frame_attitude import FrameAttitude, recover_frame_attitude
from sightline.geometry.surface import Surface
from sightline.io.acquisition.load import load_acquisition

EXAMPLE = Path(__file__).parents[1] / "examples" / "iss_frames.py"
LAGS = (2, 3, 5)


def acquisition_file() -> Path:
    """The file named on the command line, or one made from the photographs."""
    if len(sys.argv) > 1:
        return Path(sys.argv[1])
    out = Path(tempfile.mkdtemp(prefix="iss-frames-"))
    argv, sys.argv = sys.argv, [str(EXAMPLE), str(out)]
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    sys.argv = argv
    return out / "acquisition.toml"


def whitened_square(compared: Closure) -> float:
    """Mean square of the differences in units of their joint covariance."""
    d = compared.difference.ravel()
    return float(d @ np.linalg.solve(compared.covariance, d)) / d.size


def print_residuals(result: FrameAttitude) -> None:
    """Residual rms per lag, line and column, px."""
    print("| lag | windows | rms line px | rms column px |\n|---|---|---|---|")
    for lag in sorted({image - record.star.hub for record in result.records for image in record.star.images}):
        parts = [
            after[record.star.present[:, k], k]
            for record, after in zip(result.records, result.after_px, strict=True)
            for k, image in enumerate(record.star.images)
            if image - record.star.hub == lag
        ]
        found = np.concatenate(parts)
        line, column = np.sqrt((found**2).mean(axis=0))
        print(f"| {lag} | {len(found)} | {line:.3f} | {column:.3f} |")


def print_closure(result: FrameAttitude, surface: Surface) -> None:
    """Chained against direct increments, px (yaw: at the field's edge), with their sigmas."""
    print(
        "\n| lag | axis | rms difference px | sigma of it | sigma chained | sigma direct | mean square "
        "| all axes, joint covariance |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for lag in LAGS:
        compared = closure(result.stars, result.estimate, surface, lag)
        for axis, name in enumerate(("roll", "pitch", "yaw")):
            values = (compared.difference, compared.sigma, compared.chained_sigma, compared.direct_sigma)
            numbers = [np.sqrt((v[:, axis] ** 2).mean()) / result.scale[axis] for v in values]
            joint = f"{whitened_square(compared):.2f}" if axis == 0 else ""
            cells = " | ".join(f"{number:.4f}" for number in numbers)
            print(f"| {lag} | {name} | {cells} | {compared.mean_square[axis]:.2f} | {joint} |")


def main() -> None:
    """Recover, print residuals, the camera found and the closure of lags."""
    path = acquisition_file()
    if not path.exists():
        return  # the example has said what is missing
    acquired = load_acquisition(path)
    begin = time.perf_counter()
    result = recover_frame_attitude(
        acquired.frames, acquired.surface, lens=acquired.lens, height_sigma=acquired.height_sigma
    )
    print(f"{len(result.motion.t)} frames in {time.perf_counter() - begin:.0f} s, changes per pass (sigma): "
          + ", ".join(f"{change:.2f}" for change in result.changes))  # fmt: skip
    detector = result.cameras[0].detector
    for static in result.statics:
        if not static.name.endswith("time"):
            print(f"{static.name}: change {static.value:.4g} +- {static.sigma:.2g} {static.unit}")
    print(f"focal length {detector.focal_length_px:.1f} px, principal point {detector.principal_point_px}")
    field = result.estimate.unknowns.field
    print(f"lens field {field.sigma_px:.3f} px; errors per lag in the matcher's sigma: "
          f"{np.round(np.sqrt(np.diag(result.estimate.noise.gamma)), 2).tolist()}")  # fmt: skip
    for warning in result.warnings:
        print(f"warning: {warning}")
    print_residuals(result)
    print_closure(result, acquired.surface)


if __name__ == "__main__":
    main()
