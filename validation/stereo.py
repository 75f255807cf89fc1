"""Stereo orientation against its bound: as its theory promises, on scenes of our own.

    python validation/stereo.py                      everything, 100 passes each: half an hour on one core
    python validation/stereo.py --passes 20 --workers 2 --parts bound monte-carlo

bound: the Cramer-Rao bound against a dense computation with S2's own axes and angles (tests/photogrammetry).
recovery: without noise every estimator finds the angles.
monte-carlo: error over bound of ml-track and ml-pair, and mean normalised error squared (NEES, 6 expected),
in eight kinds of case; ranking; what the bias of the epipolar estimate is worth.
yaw: all estimators side by side, on a fixed ground and on ground drawn anew, 400 m of relief.
mismatches: 5 % of the matches wrong by 2 to 50 px, evenly over the ring.
gauge: one shot leaves one direction that nothing tells.

Angles are arcsec, of camera 1 where not stated otherwise. Bounds on random figures are three of their own
standard errors, derived from the number of passes. Ends with 1 where one is missed.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import sys
from pathlib import Path
from typing import Any

import gates
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

from tests.photogrammetry import s2_dense  # noqa: E402
from tests.photogrammetry.test_bound import PROTOTYPE, package  # noqa: E402

from sightline.applications.stereo_orientation import METHODS, orient  # noqa: E402
from sightline.execution import Executor, executor_from_name  # noqa: E402
from sightline.geometry.units import ARCSEC  # noqa: E402
from sightline.photogrammetry.block.bundle import bound  # noqa: E402
from sightline.photogrammetry.pair.problem import StereoProblem  # noqa: E402
from sightline.photogrammetry.sightings import sight_frames  # noqa: E402
from sightline.simulate.stereo import StereoScenario, stereo_case  # noqa: E402
from sightline.simulate.stereo_options import CASE_OPTIONS, StereoOptions  # noqa: E402

KINDS = tuple(CASE_OPTIONS)[:8]
FIRST_SEED = 7000
#: Sigmas across the epipolar line within which one pair shows no mismatch: 4.5 of both sightings together.
UNSEEN = 4.5 * np.sqrt(2.0)
#: No noise, and none given: the epipolar estimate takes out the bias that a given noise would add.
QUIET = {"noise_scale": 0.0, "sigma_position": 0.0, "sigma_attitude": 0.0, "sigma_px": 1e-6}


def row(*cells: object) -> None:
    """A line of a table."""
    print("| " + " | ".join(f"{c:.3g}" if isinstance(c, float) else str(c) for c in cells) + " |", flush=True)


def head(*cells: str) -> None:
    """Head of a table."""
    row(*cells)
    print("|" + "---|" * len(cells))


def three(values: np.ndarray) -> str:
    """Roll / pitch / yaw."""
    return " / ".join(f"{value:.3g}" for value in values[:3])


def words(options: dict[str, Any]) -> str:
    """Options as text: angles of the orbit and the field in degrees, of the noise in arcsec."""
    unit = dict.fromkeys(("inclination", "latitude", "longitude", "fov"), np.pi / 180.0)
    unit["sigma_attitude"] = ARCSEC
    shown = {k: round(v / unit.get(k, 1.0), 6) if isinstance(v, float) else v for k, v in options.items()}
    return ", ".join(
        f"{k} {v:g}" if isinstance(v, float) else f"{k} {v}" for k, v in shown.items() if v != ""
    )


# --------------------------------------------------------------------------------------------- one pass


def problem_of(scenario: StereoScenario) -> StereoProblem:
    """What is given of a pass."""
    return StereoProblem(**scenario.problem())


def bound_of(scenario: StereoScenario, pairs: bool) -> np.ndarray:
    """(6,) rad, at the true poses and points."""
    problem = problem_of(scenario)
    sightings = sight_frames(scenario.true_images, problem.detectors, problem.mounts, problem.tracks)
    angles, _ = bound(
        sightings, problem.noise, scenario.points[problem.point_names.astype(int)], priors=problem.priors,
        new_points_per_shot=pairs,
    )  # fmt: skip
    return np.sqrt(np.diag(angles.covariance()))


def trial(job: tuple[str, int, tuple[str, ...], dict[str, Any]]) -> dict[str, np.ndarray]:
    """Errors (6,) rad and NEES of each method in one pass; with mismatches how many were found as well."""
    case, seed, methods, given = job
    scenario = stereo_case(case, seed, **given)
    problem, out = problem_of(scenario), {}
    for name in methods:
        found = orient(problem, name.partition(",")[0], raw=name.endswith("raw"))
        error = (found.angles - scenario.angles).ravel()
        wrong = scenario.mismatched
        caught = found.rejected[wrong]
        along = np.zeros(0)
        if wrong.any():
            along = across_line(scenario)[wrong][~caught]
        out[name] = np.concatenate(
            [
                error,
                [
                    error @ np.linalg.solve(found.covariance, error), wrong.sum(), caught.sum(),
                    (found.rejected & ~wrong).sum(), (along < UNSEEN * scenario.options.sigma_px).sum(),
                ],
            ]
        )  # fmt: skip
    if scenario.options.scene_seed < 0:
        out["bounds"] = np.stack([bound_of(scenario, pairs) for pairs in (False, True)])
    return out


def across_line(scenario: StereoScenario) -> np.ndarray:
    """(N,) px; how far each displacement leads away from the epipolar line of the other image of its shot."""
    problem = problem_of(scenario)
    images, tracks = scenario.true_images, problem.tracks
    points = scenario.points[problem.point_names.astype(int)][tracks.point]
    image = tracks.image
    other = np.empty(len(images), dtype=np.intp)
    for shot in np.unique(images.shot):
        a, b = np.flatnonzero(images.shot == shot)
        other[a], other[b] = b, a
    ray = points - images.position[other[image]]
    body = images.world_from_body.as_matrix()[image]
    ends = []
    for step in (-1e-4, 1e-4):
        q = np.einsum("nji,nj->ni", body, points + step * ray - images.position[image])
        # nominal mount: lines forward, columns left
        ends.append(scenario.options.focal_length_px * np.stack([q[:, 0], -q[:, 1]], axis=1) / q[:, 2:])
    line = ends[1] - ends[0]
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    d = scenario.displacement
    return np.abs(d[:, 0] * line[:, 1] - d[:, 1] * line[:, 0])


def passes(
    work: Executor, case: str, count: int, methods: tuple[str, ...], **given: Any
) -> list[dict[str, np.ndarray]]:
    """All passes of a case, in order of their seeds; each case has seeds of its own."""
    first = FIRST_SEED + 1000 * list(CASE_OPTIONS).index(case)
    jobs = [(case, first + k, methods, given) for k in range(count)]
    return list(work.map(trial, jobs))


def rmse(found: list[dict[str, np.ndarray]], method: str) -> np.ndarray:
    """(6,) rad."""
    return np.sqrt(np.mean([one[method][:6] ** 2 for one in found], axis=0))


@functools.cache
def bounds(case: str) -> tuple[np.ndarray, np.ndarray]:
    """(6,) rad of ml-track and ml-pair, for a case of one ground."""
    scenario = stereo_case(case, 0)
    return bound_of(scenario, False), bound_of(scenario, True)


# ------------------------------------------------------------------------------------------------- parts


def part_bound(work: Executor, count: int) -> None:
    """The bound, and what one shot hides."""
    print("\n## bound: package beside dense computation and the prototype (its own draw of points)\n")
    head("case A", "package", "dense", "worst ratio", "prototype")
    for name, (given, prototype) in PROTOTYPE.items():
        ours = np.sqrt(np.diag(package(s2_dense.Case(), **given).covariance())) / ARCSEC
        dense = np.sqrt(np.diag(s2_dense.bound(s2_dense.Case(), s2_dense.TRUTH, **given))) / ARCSEC
        worst = float(np.abs(ours / dense - 1.0).max())
        row(name, three(ours), three(dense), f"{1.0 + worst:.4f}", three(np.array(prototype)))
        gates.check(f"bound of {name}: share off the dense one", worst, 0.0, 0.01)
    print()
    gauge = {
        2: ((84, 72, 113), (54, 21, 95)), 8: ((21, 23, 50), (13.6, 5.5, 34)),
        32: ((5.3, 6.1, 14.1), (3.5, 1.9, 9.3)), 128: ((1.6, 2.3, 5.7), (1.2, 0.8, 3.7)),
        256: ((1.2, 2.2, 6.2), (0.8, 0.5, 3.0)),
    }  # fmt: skip
    head("window (s)", "ml-pair", "prototype", "ml-track", "prototype", "weakest direction of ml-track")
    for window, was in gauge.items():
        case = s2_dense.Case(window=float(window))
        pair, track = (package(case, pairs=pairs) for pairs in (True, False))
        sigmas = [np.sqrt(np.diag(known.covariance())) / ARCSEC for known in (pair, track)]
        weak = np.round(track.directions[0], 2)
        row(
            window, three(sigmas[0]), three(np.array(was[0])), three(sigmas[1]), three(np.array(was[1])),
            f"{track.sigmas[0] / ARCSEC:.3g} along {weak.tolist()}",
        )  # fmt: skip


def part_recovery(work: Executor, count: int) -> None:
    """Recovery without noise."""
    print("\n## recovery without noise: worst angle over both cameras\n")
    limits = {
        "ml-track": ("smooth", None, 1e-3), "ml-pair": ("smooth", None, 1e-3),
        "epipolar, raw": ("smooth", None, 0.1), "epipolar": ("smooth", None, 0.1), "plane": ("white", 1, 3.0),
    }  # fmt: skip
    head("method", "relief", "roll", "pitch", "yaw", "limit")
    for method, (relief, axis, limit) in limits.items():
        if method.partition(",")[0] not in METHODS:
            continue
        # beside relief that it cannot see, the plane's weights need a noise that is more than rounding
        quiet = QUIET if method != "plane" else {**QUIET, "sigma_position": 1e-3}
        scenario = stereo_case("A_paper_T6_K64", 0, relief=relief, relief_range=200.0, **quiet)
        # without noise what linear equations leave out is gross beside it
        robust = method.startswith("ml")
        name, raw = method.partition(",")[0], method.endswith("raw")
        found = orient(problem_of(scenario), name, raw=raw, robust=robust)
        error = np.abs(found.angles - scenario.angles).max(axis=0) / ARCSEC
        of = error.max() if axis is None else error[axis]
        row(method, relief, *error.tolist(), f"{limit:g}" + (" pitch" if axis is not None else ""))
        gates.check(f"recovery by {method}, arcsec", of, 0.0, limit)


def part_monte_carlo(work: Executor, count: int) -> None:
    """Errors beside the bound, and the methods beside each other."""
    print(f"\n## error over bound, {count} passes each, seeds from {FIRST_SEED}\n")
    standard = dataclasses.asdict(StereoOptions())
    print("all: " + words(dict(list(standard.items())[: list(standard).index("noise_scale")])))
    for case in KINDS:
        print(f"{case}: {words({k: v for k, v in CASE_OPTIONS[case].items() if v != standard[k]})}")
    print()
    low, high = 1.0 - 3.0 / np.sqrt(2.0 * count), 1.1 + 3.0 / np.sqrt(2.0 * count)
    slack = 3.0 * np.sqrt(12.0 / count)
    head("case", "method", "RMSE", "bound", "RMSE / bound, six angles", "NEES")
    ratios: dict[str, list[np.ndarray]] = {"ml-track": [], "ml-pair": []}
    nees: dict[str, list[float]] = {"ml-track": [], "ml-pair": []}
    bias_rows, methods = [], ("ml-track", "ml-pair", "epipolar", "epipolar, raw")
    for case in KINDS:
        found = passes(work, case, count, methods)
        limits = dict(zip(ratios, bounds(case), strict=True))
        error = {method: rmse(found, method) for method in methods}
        for method, limit in limits.items():
            ratio, values = error[method] / limit, [float(one[method][6]) for one in found]
            ratios[method].append(ratio)
            nees[method] += values
            row(
                case, method, three(error[method] / ARCSEC), three(limit / ARCSEC),
                " ".join(f"{r:.2f}" for r in ratio), f"{np.mean(values):.2f}",
            )  # fmt: skip
            gates.check(f"{case} {method}: RMSE / bound, least of six angles", float(ratio.min()), low)
            gates.check(f"{case} {method}: RMSE / bound, largest", float(ratio.max()), 0.0, high)
            gates.check(f"{case} {method}: NEES", float(np.mean(values)), 6.0 - slack, 6.0 + slack)
        apart = limits["ml-pair"] > 1.3 * limits["ml-track"]
        worse = np.append(0.0, (error["ml-track"] / error["ml-pair"])[apart])
        gates.check(f"{case}: ml-track over ml-pair where bounds are apart, largest", worse.max(), 0.0, 1.0)
        worse = error["ml-pair"] / error["epipolar"]
        gates.check(f"{case}: ml-pair over epipolar, largest", worse.max(), 0.0, 1.15)
        worse = error["ml-pair"] / error["epipolar, raw"]
        gates.check(f"{case}: ml-pair over raw epipolar, largest", worse.max(), 0.0, 1.15)
        bias = np.mean([one["epipolar, raw"][:6] for one in found], axis=0)[[1, 4]] / ARCSEC
        left = np.mean([one["epipolar"][:6] for one in found], axis=0)[[1, 4]] / ARCSEC
        bias_rows.append((case, error["epipolar, raw"] / ARCSEC, bias, error["epipolar"] / ARCSEC, left))
    print()
    head("over all", "rms RMSE / bound", "NEES")
    for method in ratios:
        overall, mean = float(np.sqrt(np.mean(np.square(ratios[method])))), float(np.mean(nees[method]))
        row(method, f"{overall:.3f}", f"{mean:.2f}")
        gates.check(f"{method}: rms RMSE / bound over all", overall, 0.95, 1.08)
        slack = 0.35 * max(1.0, np.sqrt(100.0 / count))
        gates.check(f"{method}: NEES over all", mean, 6.0 - slack, 6.0 + slack)
    print()
    head("case", "epipolar raw RMSE", "its pitch bias, both cameras", "bias removed: RMSE", "bias left")
    for case, raw, bias, clean, left in bias_rows:
        row(case, three(raw), f"{bias[0]:.2f}, {bias[1]:.2f}", three(clean), f"{left[0]:.2f}, {left[1]:.2f}")
        if np.abs(bias).max() > 5.0:
            worse = float((clean[[1, 4]] / raw[[1, 4]]).max())
            gates.check(f"{case}: pitch of epipolar without its bias over that with it", worse, 0.0, 1.0)


def part_yaw(work: Executor, count: int) -> None:
    """All estimators side by side."""
    print(f"\n## all estimators, relief 400 m, {count} passes\n")
    head("case", "method", "RMSE camera 1", "RMSE camera 2", "yaw over ml-track's bound")
    methods = tuple(
        m
        for m in ("plane", "epipolar, raw", "epipolar", "ml-pair", "ml-track")
        if m.partition(",")[0] in METHODS
    )
    for case in ("A_paper_T6_K64", "A_random_relief_400"):
        found = passes(work, case, count, methods)
        if "bounds" in found[0]:
            limit = np.sqrt(np.mean([one["bounds"][0] ** 2 for one in found], axis=0))
        else:
            limit = bounds(case)[0]
        for method in methods:
            error = rmse(found, method)
            yaw = float(np.sqrt(np.mean(error[[2, 5]] ** 2) / np.mean(limit[[2, 5]] ** 2)))
            row(case, method, three(error / ARCSEC), three(error[3:] / ARCSEC), f"{yaw:.2f}")
            if method == "ml-track":
                all_angles = float(np.sqrt(np.mean((error / limit) ** 2)))
                gates.check(f"{case}: yaw of ml-track over its bound", yaw, 0.85, 1.15)
                gates.check(f"{case}: ml-track over its bound", all_angles, 0.85, 1.15)
        row(case, "bound of ml-track", three(limit / ARCSEC), three(limit[3:] / ARCSEC), "1")


def part_mismatches(work: Executor, count: int) -> None:
    """Gross errors."""
    print(f"\n## 5 % mismatches of 2 to 50 px, case A, {count} passes\n")
    methods = ("ml-track", "ml-pair", "epipolar")
    clean = passes(work, "A_paper_T6_K64", count, methods)
    dirty = passes(work, "A_paper_T6_K64", count, methods, mismatch_share=0.05)
    head(
        "method",
        "RMSE clean",
        "RMSE with mismatches",
        "ratio, rms of six",
        "found",
        "good ones left out",
        "missed",
        "of these along the epipolar line",
        "NEES",
    )
    for method in methods:
        before, after = rmse(clean, method), rmse(dirty, method)
        wrong, caught, good, along = np.sum([one[method][7:] for one in dirty], axis=0)
        ratio = float(np.sqrt(np.mean((after / before) ** 2)))
        nees = float(np.mean([one[method][6] for one in dirty]))
        share = caught / wrong
        row(
            method,
            three(before / ARCSEC),
            three(after / ARCSEC),
            f"{ratio:.3f}",
            f"{share:.2%}",
            int(good),
            int(wrong - caught),
            int(along),
            f"{nees:.2f}",
        )
        if method == "ml-track":
            gates.check("mismatches: ml-track over clean", ratio, 0.9, 1.10)
            gates.check("mismatches: share found", share, 0.95)
            slack = 3.0 * np.sqrt(12.0 / count)
            gates.check("mismatches: NEES of ml-track", nees, 6.0 - slack, 6.0 + slack)
    print("\nA mismatch of one pair along its epipolar line only puts its point elsewhere: no pair can tell.")


def part_gauge(work: Executor, count: int) -> None:
    """Gross mismatches."""
    print("\n## one shot\n")
    scenario = stereo_case("A_paper_T6_K64", 0, shots=1)
    head("method", "hidden directions", "share along the baseline", "other sigmas (arcsec)", "angles")
    images = scenario.images
    base = images.position[0] - images.position[1]
    base /= np.linalg.norm(base)
    axis = np.concatenate([row.T @ base for row in images.world_from_body.as_matrix()]) / np.sqrt(2.0)
    for method in METHODS:
        found = orient(problem_of(scenario), method)
        known = found.observability
        along = float(abs(known.directions[0] @ axis))
        row(
            method,
            int(known.hidden.sum()),
            f"{along:.6f}",
            np.round(known.sigmas[1:] / ARCSEC, 1).tolist(),
            np.round(found.angles.ravel() / ARCSEC, 1).tolist(),
        )
        hidden = known.directions[known.hidden]
        # the linear estimators' directions are those of the planned poses and the noisy pixels
        least = 1.0 - (1e-4 if method.startswith("ml") else 1e-2)
        hidden_nan = bool(np.isnan(found.angles.ravel()[known.touched]).all())
        good = len(hidden) >= 1 and float(np.linalg.norm(hidden @ axis)) > least and hidden_nan
        if method.startswith("ml"):
            good = good and len(hidden) == 1
        if method != "plane":
            # the plane of the ground ties the turn about the baseline, rightly or wrongly
            said = f"{len(hidden)} hidden, angles in them NaN: {hidden_nan}"
            gates.note(f"one shot, {method}: directions", said, "along the baseline, NaN", good)


PARTS = {
    "bound": part_bound, "recovery": part_recovery, "monte-carlo": part_monte_carlo, "yaw": part_yaw,
    "mismatches": part_mismatches, "gauge": part_gauge,
}  # fmt: skip


def main() -> None:
    """Print all tables; name what was missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--passes", type=int, default=100)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    given = parser.parse_args()
    with executor_from_name(str(given.workers)) as work:
        for name in given.parts:
            PARTS[name](work, given.passes)


if __name__ == "__main__":
    gates.run(main, __file__)
