"""Rigs: offsets and poses of simulated ones against the truth, bands of a real capture against each other.

Five cameras, 40 captures, offsets given to 5 mm and 1 degree: error over covariance of offsets and of poses,
pooled over seeds, and how well bands lie on each other on the map. The truth of offsets and poses is the
simulator's; where bands lie is matched anew on the maps. The simulator gives the mean height of the very
ground that is seen, which nobody knows: it is drawn here as far off as its sigma says of a ground that is
wrong over a frame alike.

The real capture (rededge_capture in SIGHTLINE_DATA) has no truth. Its bands are laid on the first camera by
offsets found in it, and compared by the correlation coefficient of gradient magnitudes (OpenCV's ECC, which
shares nothing with the matching here). In the near infrared contrasts are turned round, which that cannot
follow: it is judged by windows that were left out of the adjustment.
``rigs.py [seeds] [captures] [first seed]``
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import gates
import numpy as np

from sightline.applications.frame_cube import assemble_cube
from sightline.applications.rig_bands import registered_bands
from sightline.applications.sequence_poses import SequencePoses, georeference_sequence
from sightline.io.sequence.load import load_sequence
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.products.cube_plan import CubePlan
from sightline.simulate.sequence import SequenceScenario, sequence_case
from sightline.simulate.sequence_files import write_sequence

#: The real capture lies over orchards at 105 m, as maps have it, flown at 174.5 m.
REAL = "[surface]\nheight = 105.0\nheight_sigma = 10.0\n"
#: Small frames, so that ten flights take minutes.
SMALL = {"shape": (180, 240), "focal_length_px": 270.0}
#: Child of the seed that heights are drawn by.
HEIGHTS = 1
#: Bands that have the contrasts of the first.
ALIKE = ("Green", "Red", "Red edge")


def errors(scenario: SequenceScenario, found: SequencePoses) -> tuple[np.ndarray, np.ndarray]:
    """Squared errors over covariances: of offsets of each camera but the first (6), of poses (6)."""
    assert found.rig is not None
    offsets, rig = found.rig.offsets, []
    for c, camera in enumerate(scenario.rig[1:], start=1):
        turn = (camera.orientation.inv() * offsets.orientation[c]).as_rotvec()
        error = np.concatenate([turn, offsets.position[c] - camera.position])
        rig.append(float(error @ np.linalg.solve(offsets.covariance[c, :6, :6], error)))
    _, position, attitude = scenario.poses
    kept = list(scenario.frames)
    turn = (attitude[kept].inv() * found.poses.world_from_body).as_rotvec()
    error = np.concatenate([found.poses.position - position[kept], turn], axis=1)
    solved = np.linalg.solve(found.poses.covariance, error[..., None])[..., 0]
    return np.array(rig), (error * solved).sum(axis=1)


def relative(scenario: SequenceScenario, found: SequencePoses) -> float:
    """px; rms over the cameras of what the angles found are off by, in the middle of a frame over the ground.

    With the lever arm: over ground at the usual height both go together.
    """
    assert found.rig is not None
    offsets, out = found.rig.offsets, []
    for c, camera in enumerate(scenario.rig[1:], start=1):
        turn = (camera.orientation.inv() * offsets.orientation[c]).as_rotvec()
        moved = (offsets.position[c] - camera.position)[:2] / scenario.options.altitude
        # forward by pitch and by x, right by -roll and by y
        off = np.array([turn[1] + moved[0], -turn[0] + moved[1]])
        out.append(off * camera.detector.focal_length_px)
    return float(np.sqrt(np.mean(np.square(out))))


def height_error(scenario: SequenceScenario) -> float:
    """m; a draw of what the given height is off by: relief that goes together over the area of a frame."""
    relief, options = scenario.ground.relief, scenario.options
    side = options.altitude / options.focal_length_px
    frames = relief.heights.size * float(np.prod(relief.posting)) / (float(np.prod(options.shape)) * side**2)
    draw = float(np.random.default_rng([HEIGHTS, scenario.seed]).standard_normal())
    return draw * float(relief.heights.std()) / max(frames, 1.0) ** 0.5


def flight(seed: int, captures: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """NEES of the offsets of each camera and of the poses, px of pairs of bands and of offsets."""
    scenario = sequence_case("rig", seed, frames=captures, **SMALL)
    with tempfile.TemporaryDirectory() as name:
        write_sequence(scenario, Path(name), truth_bands=0)
        problem = load_sequence(Path(name) / "sequence.toml")
        problem = replace(problem, surface=problem.surface.raised(height_error(scenario)))
        found = georeference_sequence(problem)
        cube = assemble_cube(problem, found, CubePlan(picture=False))
    rig, poses = errors(scenario, found)
    return rig, poses, cube.pair_rms_px, relative(scenario, found)


def simulated(seeds: int, captures: int, begin: int) -> None:
    """Pooled figures of simulated flights."""
    rigs, poses, pairs, off = [], [], [], []
    for seed in range(begin, begin + seeds):
        began = time.process_time()
        rig, pose, pair, px = flight(seed, captures)
        rigs.append(rig)
        poses.append(pose)
        pairs.append(pair)
        off.append(px)
        print(
            f"seed {seed}: offsets {rig.mean() / 6:.2f}, poses {pose.mean() / 6:.2f}, bands "
            f"{np.nanmin(pair):.3f} to {np.nanmax(pair):.3f} px, offsets off by {px:.3f} px; "
            f"{time.process_time() - began:.0f} CPU s",
            flush=True,
        )
    title = f"{seeds} rigs of 5 cameras, {captures} captures"
    gates.check(f"{title}: NEES of the offsets / 6", float(np.mean(rigs)) / 6.0, 0.8, 1.25)
    gates.check(f"{title}: NEES of the poses / 6", float(np.mean(np.concatenate(poses))) / 6.0, 0.8, 1.25)
    rms = float(np.sqrt(np.nanmean(np.concatenate(pairs) ** 2)))
    gates.check(f"{title}: bands on the map, px rms", rms, 0.0, 0.1)
    gates.check(f"{title}: offsets on the ground, px rms", float(np.sqrt(np.mean(np.square(off)))), 0.0, 0.1)


def gradient(image: np.ndarray) -> np.ndarray:
    """Magnitude of the gradient, of the mean 1."""
    import cv2

    smooth = cv2.GaussianBlur(np.nan_to_num(image, nan=float(np.nanmedian(image))), (0, 0), 1.5)
    size = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    return np.asarray(size / size.mean(), dtype=np.float32)


def ecc_shift(first: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """px by which `other` lies off `first` (rms of line and column), and their correlation; by ECC."""
    import cv2

    warp = np.eye(2, 3, dtype=np.float32)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-7)
    score, warp = cv2.findTransformECC(first, other, warp, cv2.MOTION_TRANSLATION, stop, None, 5)
    return float(np.hypot(*warp[:, 2])), float(score)


def parts(image: np.ndarray) -> list[np.ndarray]:
    """Nine parts of an image, its rim left out."""
    lines, columns = image.shape
    edge = 60
    down, right = (np.linspace(edge, n - edge, 4).astype(int) for n in (lines, columns))
    return [image[down[i] : down[i + 1], right[j] : right[j + 1]] for i in range(3) for j in range(3)]


def real(folder: Path) -> None:
    """The real capture."""
    with tempfile.TemporaryDirectory() as name:
        toml = Path(name) / "one.toml"
        toml.write_text(f'frames = "{folder}"\n{REAL}')
        problem = load_sequence(toml)
    found = georeference_sequence(problem)
    assert found.rig is not None
    sigma = np.degrees(found.rig.offsets.sigma[:, :3])
    names = found.rig.offsets.names
    for c in range(1, len(names)):
        turned = np.degrees(found.rig.offsets.orientation[c].as_rotvec())
        print(
            f"{names[c]}: " + ", ".join(f"{v:.4f} +- {s:.4f}" for v, s in zip(turned, sigma[c], strict=True))
        )
    gates.check("rededge_capture: largest sigma of an angle, degrees", float(sigma[1:].max()), 0.0, 0.05)
    bands = {band.name: whole(band.source) for band in registered_bands(problem, found)}
    first = gradient(bands["Blue"])
    for name in ALIKE:
        other = gradient(bands[name])
        shifts = [ecc_shift(a, b)[0] for a, b in zip(parts(first), parts(other), strict=True)]
        over, score = ecc_shift(first[60:-60, 60:-60], other[60:-60, 60:-60])
        print(f"{name} on Blue: ECC {score:.2f}, parts off by {np.round(shifts, 2).tolist()} px")
        gates.check(f"rededge_capture: {name} on Blue, px", over, 0.0, 0.3)
        gates.check(
            f"rededge_capture: {name} on Blue, median of nine parts, px", float(np.median(shifts)), 0.0, 0.3
        )
    left_out(problem, found)


def whole(source: object) -> np.ndarray:
    """All pixels of a source, NaN where there are none."""
    lines, columns = source.shape  # type: ignore[attr-defined]
    pixels = np.array(source.read((0, lines), (0, columns)))  # type: ignore[attr-defined]
    bad = source.mask((0, lines), (0, columns))  # type: ignore[attr-defined]
    if bad is not None:
        pixels[bad] = np.nan
    return pixels


def left_out(problem: SequenceProblem, found: SequencePoses) -> None:
    """Near infrared on the first camera, by windows that the adjustment did not use."""
    from sightline.imaging.source import ArrayImage
    from sightline.matching.match_images import match_images
    from sightline.matching.select import grid_points

    bands = registered_bands(problem, found)
    first, other = bands[0].source, next(band.source for band in bands if band.name == "NIR")
    points = grid_points(first.shape, window=(41, 41), step=(30, 30))
    assert found.rig is not None
    used = found.tracks.pixels
    # windows of the adjustment are 21 px wide, these 41: none that shares a pixel with one
    near = np.abs(points[:, None] - used[None]).max(axis=2).min(axis=1) < 31.0
    points = points[~near]
    match = match_images(ArrayImage(whole(first)), ArrayImage(np.nan_to_num(whole(other))), points, points,
                         window=(41, 41), search_px=(3, 3))  # fmt: skip
    kept = match.kept
    off = match.b[kept] - points[kept]
    middle = np.median(off, axis=0)
    spread = 1.4826 * np.median(np.abs(off - middle), axis=0)
    print(f"NIR on Blue: {int(kept.sum())} windows left out, off by {np.round(middle, 3).tolist()} px in the "
          f"middle, scatter {np.round(spread, 3).tolist()} px")  # fmt: skip
    gates.check("rededge_capture: NIR on Blue by windows left out, px", float(np.hypot(*middle)), 0.0, 0.3)
    gates.check("rededge_capture: NIR windows left out", float(kept.sum()), 20.0)


def main() -> None:
    """All figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("seeds", nargs="?", type=int, default=10, help="simulated flights")
    parser.add_argument("captures", nargs="?", type=int, default=40, help="captures of each")
    parser.add_argument("first", nargs="?", type=int, default=300, help="seed of the first flight")
    given = parser.parse_args()
    if given.seeds:
        simulated(given.seeds, given.captures, given.first)
    data = os.environ.get("SIGHTLINE_DATA")
    if data is None:
        raise SystemExit("SIGHTLINE_DATA names the folder of the real data")
    real(Path(data) / "rededge_capture")


if __name__ == "__main__":
    gates.run(main, __file__)
