"""Rendered frames with known truth: errors of the attitudes and of the lens against their sigmas, over seeds.

Run: python benchmarks/frames_validation.py [SEEDS]

NEES is the squared error in its covariance per degree of freedom, hidden part removed: 1 where sigmas
are true.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np

from sightline.applications.frame_attitude import FrameAttitude, recover_frame_attitude
from sightline.geometry.camera import FrameCamera
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.motion.band import Frame, LensKnowledge
from sightline.motion.frames.hidden import relative_covariance, without
from sightline.simulate.frames import FrameScenario, frames_case

FIRST_SEED = 100
WIDE = {"frames": 6, "shape": (288, 384), "focal_length_px": 600.0, "interval": 4.0, "step_sigma": 2e-3}
NARROW = {"frames": 5, "shape": (256, 320), "focal_length_px": 1200.0, "interval": 3.0}
#: name -> (what is rendered, what is known of the lens, nominal focal length or None, height sigma)
CASES: dict[str, tuple[dict[str, Any], LensKnowledge, float | None, float]] = {
    "lens known, narrow field": (NARROW, LensKnowledge(), None, 0.0),
    "lens known, wide field": (WIDE, LensKnowledge(), None, 0.0),
    "lens unknown, wide field": (WIDE, LensKnowledge(400.0, 0.0, 0.2), 900.0, 0.0),
    "times known to 5 ms": ({**WIDE, "time_sigma": 5e-3}, LensKnowledge(), None, 0.0),
    "relief 300 m, unknown": ({**WIDE, "relief_rms": 300.0}, LensKnowledge(), None, 300.0),
}


def recover(
    scene: FrameScenario, lens: LensKnowledge, focal: float | None, height_sigma: float
) -> FrameAttitude:
    """Recover a scene; with a nominal focal length the lens is given without distortion."""
    true = scene.detector
    nominal = true if focal is None else AreaDetector("frame", true.shape, focal, true.principal_point_px)
    frames = [
        Frame(
            f"f{k}",
            ArrayImage(scene.image(k).astype(np.float32)),
            FrameCamera(nominal, scene.reference, FixedMount(), float(t)),
            scene.options.time_sigma,
        )
        for k, t in enumerate(scene.nominal_times)
    ]
    return recover_frame_attitude(frames, Plane(0.0), lens=lens, height_sigma=height_sigma)


def scored(result: FrameAttitude, scene: FrameScenario) -> tuple[np.ndarray, float]:
    """Relative errors (n, 3) in px, and NEES."""
    n = len(result.motion.t)
    scale = np.tile(result.scale, n)
    error = without(result.motion.angles - scene.truth[:, 1:], result.hidden, result.scale)
    covariance = relative_covariance(result.estimate.angle_covariance, result.hidden, result.scale)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    seen = values > 1e-9 * values.max()
    square = (vectors.T @ (error.ravel() / scale))[seen] ** 2 / values[seen]
    return error / result.scale, float(square.mean())


def lens_errors(result: FrameAttitude, scene: FrameScenario) -> str:
    """Errors of focal length and k1 in units of their sigmas."""
    true, found = scene.detector, result.cameras[0].detector
    sigma = {static.name: static.sigma for static in result.statics}
    out = []
    if "focal length" in sigma:
        out.append(f"f {(found.focal_length_px - true.focal_length_px) / sigma['focal length']:+.1f}")
    if "distortion k1" in sigma:
        out.append(f"k1 {(found.distortion[0] - true.distortion[0]) / sigma['distortion k1']:+.1f}")
    return " ".join(out)


def main() -> None:
    """Print one row per case."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    print("| case | rms error px (roll, pitch, yaw) | sigma px | NEES | lens errors in sigmas | s |")
    print("|---|---|---|---|---|---|")
    for name, (options, lens, focal, height_sigma) in CASES.items():
        errors, sigmas, nees, lenses, begin = [], [], [], [], time.perf_counter()
        for seed in range(FIRST_SEED, FIRST_SEED + seeds):
            scene = frames_case(seed, **options)
            result = recover(scene, lens, focal, height_sigma)
            error, square = scored(result, scene)
            errors.append(error)
            sigmas.append(result.sigma / result.scale)
            nees.append(square)
            lenses.append(lens_errors(result, scene))
        rms, sigma = (np.sqrt((np.concatenate(v) ** 2).mean(axis=0)) for v in (errors, sigmas))
        cells = ["  ".join(f"{value:.4f}" for value in part) for part in (rms, sigma)]
        seconds = (time.perf_counter() - begin) / seeds
        printed = "; ".join(filter(None, lenses))
        print(f"| {name} | {cells[0]} | {cells[1]} | {np.mean(nees):.2f} | {printed} | {seconds:.1f} |")


if __name__ == "__main__":
    main()
