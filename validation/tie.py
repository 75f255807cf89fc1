"""Absolute attitude from a reference orthoimage: cameras 50 px off, tied, recovered, scored.

    python validation/tie.py [--seeds 10]

Strips: bands of 500 x 300 px over real texture (one Landsat 7 band, of which every band of the strip has
its own gain and gamma) and relief of 300 m rms; the true attitude is a constant of 50 px in some direction of
roll and pitch, and 5 px of yaw at the edge of the field, away from the one given. The reference is that
texture on a grid of its own with noise of its own. `tie` finds control points of the first band, `recover`
takes them. The same strips with their first band alone, and as many control points as `tie` finds for such:
control points alone carry the motion then.

Frames: five of a matrix instrument (240 x 320 px) over the same texture and relief, likewise 50 px off, each
tied to the reference, recovered with the control points of all.

Beside them rays written out here (scipy rotations and a flat flight, no camera of the package) say where the
true line of sight of every control point lies. And references of other places (turned by half a turn,
mirrored, moved by half their size) have to be refused.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import gates
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.applications.frame_attitude import recover_frame_attitude
from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.applications.reference_tie import ALONE_POINTS, ReferenceTie, tie_to_reference
from sightline.errors import EstimationError
from sightline.evaluation.score import score_result
from sightline.geometry.camera import FrameCamera
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Dem
from sightline.geometry.trajectory import Motion
from sightline.imaging.placed import PlacedImage
from sightline.imaging.source import ArrayImage
from sightline.motion.band import Frame
from sightline.motion.results import LineOfSight
from sightline.simulate.frames import FrameScenario, frames_case
from sightline.simulate.measured import landsat_bands
from sightline.simulate.scenarios import StripScenario, line_of_sight_case
from sightline.simulate.texture import raster_layer

Array = NDArray[np.float64]

LINES, COLUMNS, OFF_PX, YAW_PX = 500, 300, 50.0, 5.0
#: px of the strip beyond which the reference reaches around it; its mean over its noise.
AROUND, SNR = 220, 200.0
AXES = ("roll", "pitch", "yaw")


def strip(seed: int) -> tuple[StripScenario, Array]:
    """A strip whose attitude is not what it is given as, and by how much (rad)."""
    scenario = line_of_sight_case(
        "relief", seed, lines=LINES, columns=COLUMNS, ground="landsat", offset_sigma_px=0.0
    )
    # the bands of the real scene are some hundredths of a pixel off each other: one of them serves all
    texture = scenario.scene.bands[0].common
    bands = tuple(replace(band, common=texture) for band in scenario.scene.bands)
    angle = np.random.default_rng([seed, 50]).uniform(0.0, 2.0 * np.pi)
    ifov = scenario.options.ifov
    off = np.array([ifov * OFF_PX * np.cos(angle), ifov * OFF_PX * np.sin(angle), YAW_PX * 2.0 / COLUMNS])
    motion = Motion(scenario.motion.t, scenario.motion.angles + off)
    return replace(scenario, motion=motion, scene=replace(scenario.scene, bands=bands)), off


def reference(scenario: StripScenario, seed: int) -> PlacedImage:
    """The ground from above, on a grid a tenth coarser than the strip's, with noise of its own."""
    step = 1.1 * min(scenario.options.gsd)
    east = (0.5 * COLUMNS + AROUND) * scenario.options.gsd[0]
    north, south = ((LINES + AROUND) * scenario.options.gsd[1], -AROUND * scenario.options.gsd[1])
    x, y = np.arange(-east, east, step) + 0.5 * step, np.arange(north, south, -step) - 0.5 * step
    pixels = np.concatenate(
        [scenario.scene.ground_brightness(0, *np.meshgrid(x, rows)) for rows in np.array_split(y, 20)]
    ).astype(np.float64)
    pixels += np.random.default_rng([seed, 51]).normal(0.0, pixels.mean() / SNR, pixels.shape)
    return PlacedImage(ArrayImage(pixels), (step, 0.0, -east, 0.0, -step, north))


def tied(scenario: StripScenario, ortho: PlacedImage, points: int | None = None) -> tuple[ReferenceTie, Dem]:
    """Control points of the first band, so many at most."""
    relief = scenario.scene.relief
    assert relief is not None
    dem = Dem(relief.heights, relief.transform)
    image, camera = ArrayImage(scenario.image(0)), scenario.nominal_cameras[0]
    return tie_to_reference([image], [camera], ortho, dem, names=[scenario.bands[0].name], points=points), dem


def misses(scenario: StripScenario, tie: ReferenceTie) -> Array:
    """px (N, 2), along and across: control points less where the lines of their windows look, means."""
    options = scenario.options
    out = np.zeros((len(tie.image), 2))
    for offset in np.arange(4) - 1.5:
        t = (tie.pixels[:, 0] + offset) * options.line_period
        # the point moves under the camera as the window's lines are exposed
        place = np.stack(
            [np.zeros_like(t), options.ground_speed * t, np.full_like(t, options.altitude)], axis=1
        )
        ahead = np.stack(
            [np.zeros_like(t), options.ground_speed * offset * options.line_period + 0 * t, 0 * t], 1
        )
        look = tie.ground + ahead - place
        # body axes of level flight north: x north, y east, z down
        body = np.stack([look[:, 1], look[:, 0], -look[:, 2]], axis=1)
        angles = np.stack(
            [np.interp(t, scenario.motion.t, scenario.motion.angles[:, k]) for k in range(3)], 1
        )
        seen = Rotation.from_rotvec(angles).apply(body, inverse=True)
        left = tie.pixels[:, 1] - 0.5 * (COLUMNS - 1)
        out[:, 0] += seen[:, 0] / seen[:, 2] / options.ifov / 4.0
        out[:, 1] += (-seen[:, 1] / seen[:, 2] / options.ifov - left) / 4.0
    return out


def frames_of(seed: int) -> FrameScenario:
    """Frames whose attitude is not what it is given as."""
    scenario = frames_case(
        seed, frames=5, interval=2.0, shape=(240, 320), focal_length_px=2000.0, altitude=60e3,
        ground_speed=900.0, step_sigma=1e-3, relief_rms=300.0, distortion=(0.0,),
    )  # fmt: skip
    angle = np.random.default_rng([seed, 60]).uniform(0.0, 2.0 * np.pi)
    off = np.array([OFF_PX * np.cos(angle) / 2000.0, OFF_PX * np.sin(angle) / 2000.0, YAW_PX * 2.0 / 320])
    raster = landsat_bands()[0].astype(np.float64)
    texture = raster_layer(raster / raster.mean() - 1.0, (30.0, 30.0), (-16e3, -8e3))
    bands = (replace(scenario.scene.bands[0], common=texture),)
    motion = Motion(scenario.motion.t, scenario.motion.angles + off)
    return replace(scenario, motion=motion, scene=replace(scenario.scene, bands=bands))


def frames_nees(seed: int) -> tuple[int, Array, Array, float]:
    """Control points, rms (px) and NEES of each axis, and of all angles with their covariance."""
    scenario = frames_of(seed)
    x, y = np.arange(-11e3, 11e3, 33.0) + 16.5, np.arange(16e3, -1e4, -33.0) - 16.5
    pixels = scenario.scene.ground_brightness(0, *np.meshgrid(x, y)).astype(np.float64)
    pixels += np.random.default_rng([seed, 61]).normal(0.0, pixels.mean() / SNR, pixels.shape)
    ortho = PlacedImage(ArrayImage(pixels), (33.0, 0.0, -11e3, 0.0, -33.0, 16e3))
    relief = scenario.scene.relief
    assert relief is not None
    dem = Dem(relief.heights, relief.transform)
    frames = [
        Frame(
            f"frame {k}",
            ArrayImage(scenario.image(k)),
            FrameCamera(scenario.detector, scenario.reference, FixedMount(), float(t)),
            0.0,
        )
        for k, t in enumerate(scenario.nominal_times)
    ]
    tie = tie_to_reference([f.image for f in frames], [f.camera for f in frames], ortho, dem)
    found = recover_frame_attitude(frames, dem, control_points=tie.sightings())
    error = found.motion.angles - scenario.motion.at(scenario.times)
    whole = error.ravel() @ np.linalg.solve(found.estimate.angle_covariance, error.ravel()) / error.size
    rms = np.sqrt((error**2).mean(axis=0)) / found.scale
    return len(tie.image), rms, ((error / found.absolute_sigma) ** 2).mean(axis=0), float(whole)


def wrong(ortho: PlacedImage) -> dict[str, PlacedImage]:
    """The same texture where it is not."""
    pixels = ortho.source.read((0, ortho.shape[0]), (0, ortho.shape[1]))
    turned = {"turned": pixels[::-1, ::-1], "mirrored": pixels[:, ::-1]}
    turned["elsewhere"] = np.roll(pixels, (pixels.shape[0] // 2, pixels.shape[1] // 2), axis=(0, 1))
    return {
        name: PlacedImage(ArrayImage(np.ascontiguousarray(one)), ortho.transform)
        for name, one in turned.items()
    }


def scored(
    scenario: StripScenario, found: LineOfSight, pooled: dict[str, list[float]]
) -> tuple[str, str, str]:
    """Absolute rms, sigma and NEES in words; the last are added to the `pooled` ones."""
    truth = scenario.truth
    worth = score_result(found, truth[:, 0], truth[:, 1:4]).absolute
    for axis in AXES:
        pooled[axis].append(worth[axis].nees)
    rms, sigma, nees = (
        " / ".join(f"{getattr(worth[a], k):.3f}" for a in AXES) for k in ("rms", "sigma", "nees")
    )
    return rms, sigma, nees


def main() -> None:
    """Print a line per strip, then the pooled figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    given = parser.parse_args()
    print("| frames | points | absolute rms (px) | NEES | of all angles with their covariance |")
    print("|---|---|---|---|---|")
    of_frames = []
    for seed in range(given.seeds):
        count, rms_px, nees_of, whole = frames_nees(seed)
        of_frames.append(nees_of)
        said = [" / ".join(f"{v:.{d}f}" for v in values) for values, d in ((rms_px, 4), (nees_of, 2))]
        print(f"| {seed} | {count} | {said[0]} | {said[1]} | {whole:.2f} |", flush=True)
    print()
    print("| strip | points | off found (px) | NEES of points | absolute rms (px) | sigma | NEES |")
    print("|---|---|---|---|---|---|---|")
    pooled: dict[str, list[float]] = {axis: [] for axis in AXES}
    alone: dict[str, list[float]] = {axis: [] for axis in AXES}
    points: list[float] = []
    refused = tried = 0
    for seed in range(given.seeds):
        scenario, _ = strip(seed)
        ortho = reference(scenario, seed)
        tie, dem = tied(scenario, ortho)
        miss = misses(scenario, tie)
        # what the window's lines saw is compared: the error is the match's alone
        points.append(float((miss**2 / tie.match_sigma_px**2).mean()))
        found = recover_line_of_sight(scenario.as_given(), dem, control_points=tie.sightings())
        rms, sigma, nees = scored(scenario, found, pooled)
        off = " / ".join(f"{v:+.1f}" for v in np.median(tie.offset_px, axis=0))
        print(
            f"| {seed} | {len(tie.image)} | {off} | {points[-1]:.2f} | {rms} | {sigma} | {nees} |", flush=True
        )
        more, _ = tied(scenario, ortho, ALONE_POINTS)
        found = recover_line_of_sight(scenario.as_given()[:1], dem, control_points=more.sightings())
        rms, sigma, nees = scored(scenario, found, alone)
        print(f"| {seed}, one band | {len(more.image)} | | | {rms} | {sigma} | {nees} |", flush=True)
        for one in wrong(ortho).values():
            tried += 1
            try:
                tied(scenario, one)
            except EstimationError:
                refused += 1
    for of, found_nees in (("strips", pooled), ("strips of one band", alone)):
        every = [value for values in found_nees.values() for value in values]
        what = f"absolute attitude of {given.seeds} {of}, pooled NEES"
        gates.check(what, float(np.mean(every)), 0.8, 1.25)
        for axis in AXES:
            gates.note(f"{of}, of {axis}", f"{np.mean(found_nees[axis]):.3g}", "part of it", True)
    gates.check(
        f"absolute attitude of {given.seeds} x 5 frames, pooled NEES", float(np.mean(of_frames)), 0.8, 1.25
    )
    gates.check("control points beside rays written out here, NEES", float(np.mean(points)), 0.8, 1.25)
    gates.check("wrong references that are refused, of all", refused / tried, 1.0, 1.0)


if __name__ == "__main__":
    gates.run(main, __file__)
