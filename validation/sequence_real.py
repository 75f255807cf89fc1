"""Poses of two real sequences: frames left out and estimated again, beside the solution on all.

Run: python validation/sequence_real.py [iss | brighton | lines]   (SIGHTLINE_DATA: folder of the data sets)

A frame is left out in two ways: (a) of the subset, so that its place and angles are not given and no point
rests on it, but its image is looked at (the dense stage of S4); (b) altogether, so that its pose is
interpolated. Both solutions use a part of the data of the other: with the same weights the covariance of
their difference is C(less) - C(all), not the sum (the error of the solution on all is uncorrelated with that
difference, as the solution could be bettered otherwise).

Not in the sigmas: errors of the lens (given to the ISS set by ``sightline recover``; Brighton's focal length
by EXIF, no distortion), times cut to the second beyond what the path is found to be rough, clouds that drift.
"""

from __future__ import annotations

import os
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import gates
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from sightline.applications.sequence_poses import SequencePoses, georeference_sequence
from sightline.geometry.checks import Array
from sightline.io.sequence.load import load_sequence
from sightline.photogrammetry.block.point_priors import PointPriors, level_axes
from sightline.photogrammetry.flight.poses import FramePoses, adjust_frames
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.solver import SequenceSolver
from sightline.photogrammetry.flight.start import begun
from sightline.photogrammetry.flight.table_check import table_fits
from sightline.photogrammetry.frame_cameras import frame_cameras
from sightline.photogrammetry.sightings import Images, Tracks, sight_frames

DATA = Path(os.path.expandvars("$SIGHTLINE_DATA"))
ISS = """frames = "{folder}"
altitude = 420e3                 # general knowledge; EXIF says longitude and latitude alone
position_sigma = 100.0           # m; positions lie that near to an even flight
[camera]                         # as `sightline recover` finds it
shape = [972, 1296]
focal_length_px = 1032.0
principal_point_px = [443.4, 664.2]
distortion = [0.0172, 0.0262, -0.00048, 0.00258, -0.0585]
[surface]
height = 1000.0
height_sigma = 800.0
"""
BRIGHTON = """frames = "{folder}"
position_sigma = 5.0             # m, GPS
attitude_sigma = 0.035           # rad, gimbal
[camera]
focal_length_px = 2311.0         # 20 mm of EXIF against the diagonal of the whole sensor (4000 x 3000)
[surface]                        # 40 m below, by the height above take-off
height = 161.0
height_sigma = 3.0
"""


@dataclass(frozen=True, eq=False)
class Solved:
    """A sequence solved, with what is needed to solve it again with less."""

    problem: SequenceProblem
    found: SequencePoses
    images: Images
    tracks: Tracks
    priors: PointPriors

    def again(self, tracks: Tracks, without: Array, roughness: Array | None) -> FramePoses:
        """Poses from fewer sightings, nothing given of some frames."""
        p, known = self.problem, self.problem.known
        out = np.isin(np.arange(len(p)), without)[:, None]
        less = replace(
            known,
            position=np.where(out, np.inf, known.position),
            attitude=np.where(out, np.inf, known.attitude),
        )
        sightings = sight_frames(self.images, [p.detector], [p.mount], tracks)
        points = self.found.poses.points[: int(tracks.point.max()) + 1]
        return adjust_frames(
            self.images, sightings, less, priors=self.priors, points=points, start=self.found.poses,
            roughness=roughness, robust=False,
        )  # fmt: skip


def solve(name: str, toml: str, frames: slice = slice(None)) -> Solved:
    """A data set, solved on all its frames or on some."""
    with tempfile.TemporaryDirectory() as folder:
        path, own = Path(folder) / "sequence.toml", Path(folder) / name
        own.mkdir()
        for image in sorted((DATA / name).glob("*.[jJ][pP][gG]"))[frames]:
            (own / image.name).symlink_to(image)
        path.write_text(toml.format(folder=own))
        problem = load_sequence(path)
        return _solved(name, problem)


def _solved(name: str, problem: SequenceProblem) -> Solved:
    """The same of a problem, while its images are there."""
    found = georeference_sequence(problem)
    poses = found.poses
    images = begun(problem, found.followed).images
    given = np.isfinite(problem.known.attitude).all(axis=1)
    turns = [images.world_from_body[k] if given[k] else poses.world_from_body[k] for k in range(len(problem))]
    images = replace(images, world_from_body=Rotation.concatenate(turns))
    good = np.flatnonzero(~poses.rejected)
    tracks = found.tracks[good]
    heights = SequenceSolver(problem, found.followed).heights()
    assert heights is not None  # both files tell how rough the ground is
    print(f"\n{name}: {len(problem)} frames, CPU s:", {k: round(v, 1) for k, v in found.seconds.items()})
    for line in found.warnings:
        print("  !", line)
    size, stated = (np.sqrt((x**2).mean()) for x in (poses.residual_px[good], tracks.sigma_px))
    print(
        f"  {len(good)} sightings of {len(np.unique(tracks.point))} points, {poses.rejected.mean():.1%} "
        f"left out; residuals {size:.3f} px rms, stated {stated:.3f} px"
    )
    above = heights.above(poses.points[np.isfinite(poses.points).all(axis=1)])[0]
    print(
        "  ground above the surface, m: quantiles 5, 50, 95 %", np.quantile(above, [0.05, 0.5, 0.95]).round(1)
    )
    return Solved(problem, found, images, tracks, PointPriors(heights, None))


def fewer(tracks: Tracks, without: Array, *, looked_at: bool) -> Tracks:
    """Sightings of points that two other frames show; of frames left out too where they are looked at."""
    out = np.isin(tracks.image, without)
    resting = np.bincount(tracks.point, ~out, minlength=int(tracks.point.max()) + 1) >= 2
    return tracks[resting[tracks.point] & (looked_at | ~out)]


def difference(less: FramePoses, whole: FramePoses) -> tuple[Array, Array]:
    """Pose (M, 6) of one solution less that of the other: m, rad; and its 1-sigma, of nested data."""
    turn = (whole.world_from_body.inv() * less.world_from_body).as_rotvec()
    d = np.concatenate([less.position - whole.position, turn], axis=1)
    variance = np.einsum("kii->ki", less.covariance) - np.einsum("kii->ki", whole.covariance)
    return d, np.sqrt(np.maximum(variance, 0.0))


def image_px(solved: Solved, a: FramePoses, b: FramePoses, frame: int) -> float:
    """px rms by which ground that one solution places is elsewhere in the frame by the other."""
    p = solved.problem
    lines, columns = p.detector.shape
    grid = np.meshgrid(np.linspace(0, lines - 1, 5), np.linspace(0, columns - 1, 5), indexing="ij")
    places = np.stack(grid, axis=-1).reshape(-1, 2)
    one, two = (
        frame_cameras(
            replace(p.images, position=x.position, world_from_body=x.world_from_body), [p.detector], [p.mount]
        )[frame]
        for x in (a, b)
    )
    return float(np.sqrt(((two.project(one.locate(places, p.surface)) - places) ** 2).sum(axis=1).mean()))


def report(solved: Solved, less: FramePoses, whole: FramePoses, frames: Array, words: str) -> None:
    """Differences of some frames, their sigmas, and how many are within two of them."""
    d, sigma = difference(less, whole)
    unit = np.array([1.0] * 3 + [180.0 / np.pi] * 3)
    size = np.sqrt(np.einsum("kii->ki", less.covariance))
    print(f"  {words}: x y z (m), roll pitch yaw (deg)")
    for k in frames:
        px = image_px(solved, less, whole, int(k))
        print(
            f"    {solved.problem.frames[k]}: differs by {_row(d[k] * unit)}; "
            f"sigma of that {_row(sigma[k] * unit)}; of the pose {_row(size[k] * unit)}; {px:.2f} px"
        )
    within = np.abs(d[frames]) <= 2.0 * sigma[frames]
    rms = np.sqrt((d[frames] ** 2).mean(axis=0)) * unit
    px = np.sqrt(np.mean([image_px(solved, less, whole, int(k)) ** 2 for k in frames]))
    share = f"{within.sum()} of {within.size} = {within.mean():.1%}"
    gates.check(
        f"{solved.problem.frames[0]} and others, {words}: within 2 sigma, %", 100.0 * within.mean(), 90.0
    )
    print(f"    rms {_row(rms)}, {px:.2f} px; within 2 sigma: {share}")


def _row(values: Array) -> str:
    return " ".join(f"{v:.3g}" for v in values)


def iss() -> None:
    """Every second frame left out."""
    solved = solve("iss_astropi_a", ISS)
    left = np.arange(1, len(solved.problem), 2)
    rough = solved.found.poses.roughness
    whole = solved.again(solved.tracks, np.array([], dtype=int), rough)
    looked = solved.again(fewer(solved.tracks, left, looked_at=True), left, rough)
    report(solved, looked, whole, left, "(a) left out of the subset, its image looked at")
    blind = solved.again(fewer(solved.tracks, left, looked_at=False), left, None)
    report(solved, blind, whole, left, "(b) left out altogether, interpolated")


def brighton() -> None:
    """Each frame left out in turn; yaw beside the gimbal's."""
    solved = solve("drone_brighton_lines12", BRIGHTON)
    rough = solved.found.poses.roughness
    whole = solved.again(solved.tracks, np.array([], dtype=int), rough)
    count = len(solved.problem)
    up, east, north = level_axes(solved.images.position, solved.problem.radii)
    level = Rotation.from_matrix(np.stack([north, east, -up], axis=-1))
    gimbal = (level.inv() * solved.images.world_from_body).as_euler("ZYX")[:, 0]
    yaws, sigmas, within = np.empty((count, 3)), np.empty((count, 3)), []
    for k in range(count):
        looked = solved.again(fewer(solved.tracks, np.array([k]), looked_at=True), np.array([k]), rough)
        blind = solved.again(fewer(solved.tracks, np.array([k]), looked_at=False), np.array([k]), None)
        d, sigma = difference(looked, whole)
        within.append(np.abs(d[k]) <= 2.0 * sigma[k])
        for n, poses in enumerate((whole, looked, blind)):
            yaw = (level.inv() * poses.world_from_body).as_euler("ZYX")[k, 0]
            yaws[k, n] = np.degrees((yaw - gimbal[k] + np.pi) % (2.0 * np.pi) - np.pi)
            sigmas[k, n] = np.degrees(np.sqrt(poses.covariance[k, 5, 5]))
    gates.check("Brighton, (a): within 2 sigma, %", 100.0 * float(np.mean(within)), 90.0)
    print(f"  (a) beside the solution on all: within 2 sigma {np.mean(within):.1%} of {np.size(within)}")
    print("  yaw less the gimbal's, deg: on all frames; (a) left out, its image looked at; (b) interpolated")
    for k in range(count):
        words = "; ".join(f"{y:+.2f} +- {s:.2f}" for y, s in zip(yaws[k], sigmas[k], strict=True))
        print(f"    {solved.problem.frames[k]}: {words}; (a) less all {yaws[k, 1] - yaws[k, 0]:+.3f}")
    for line in (np.arange(6), np.arange(6, 12)):
        middle, spread = np.median(yaws[line], axis=0), yaws[line].std(axis=0, ddof=1)
        print(f"    line of {solved.problem.frames[line[0]]}: median {_row(middle)}, scatter {_row(spread)}")


def brighton_lines() -> None:
    """Either line by itself: its length beside GPS, chi-square of the tables, its poses beside both lines."""
    toml = BRIGHTON.replace("position_sigma = 5.0", "position_sigma = 3.0")  # what GPS is good to in a line
    both = solve("drone_brighton_lines12", toml)
    for number, frames in enumerate((slice(0, 6), slice(6, 12)), start=1):
        one = solve("drone_brighton_lines12", toml, frames)
        found, gps = (
            np.linalg.norm(np.diff(x, axis=0), axis=1).sum()
            for x in (one.found.poses.position, one.problem.images.position)
        )
        gates.check(f"Brighton, line {number}: length over GPS", float(found / gps), 0.95, 1.05)
        for fit in table_fits(replace(one.problem, images=one.images), one.found.poses):
            most = float(chi2.isf(0.01, fit.numbers))
            gates.check(f"Brighton, line {number}: chi-square of {fit.name}", fit.chi_squared, 0.0, most)
        turn = (both.found.poses.world_from_body[frames].inv() * one.found.poses.world_from_body).as_rotvec()
        moved = one.found.poses.position - both.found.poses.position[frames]
        # of the line alone: what both lines know beside it makes the difference smaller, not larger
        sigma = np.sqrt(np.einsum("kii->ki", one.found.poses.covariance))
        worst = float((np.abs(np.concatenate([moved, turn], axis=1)) / sigma).max())
        gates.check(f"Brighton, line {number}: beside both lines, sigmas", worst, 0.0, 3.0)


def main() -> None:
    """Both sets, or those named."""
    parts = {"iss": iss, "brighton": brighton, "lines": brighton_lines}
    for name in sys.argv[1:] or parts:
        parts[name]()


if __name__ == "__main__":
    if not (DATA / "iss_astropi_a").is_dir():
        sys.exit(f"no photographs in {DATA}; set SIGHTLINE_DATA to the folder of real data")
    gates.run(main, __file__)
