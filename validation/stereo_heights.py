"""Heights before and after the angles of a stereo series are taken out: S2's figures 1 and 2.

    python validation/stereo_heights.py                     40 passes, two minutes
    python validation/stereo_heights.py --passes 10 --figure heights.html

Case A (S2's table 6: 500 km, separation 70 s, 64 shots in 64 s, 300 points, 0.1 px, positions 7.5 m, jitter
1.8 arcsec), smooth relief of 400 m; constant errors of 36 arcsec with signs drawn anew in each pass, and the
ground too. Points are triangulated shot by shot under the angles of each estimator, nothing taken out of
single shots. Per shot: mean over the points of a shot of the height error, rms over shots and passes; what is
not known of that shot's poses leaves 14 m in it whatever the angles. Trend: a straight line over the shots
through these means, rms along it. Scatter: standard deviation over the shots at one point. Multi-view: error
of a point by all shots, rms over points and passes, by the same rays, and as the estimator itself gives the
points.

Ends with an error if ml-track's trend or its multi-view heights are beyond 5 m rms.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import gates
import numpy as np

from sightline.applications.stereo_heights import heights_of, stereo_heights
from sightline.applications.stereo_orientation import METHODS, StereoOrientation, orient
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.photogrammetry.triangulate import triangulate
from sightline.simulate.stereo import StereoScenario, stereo_case

#: What the prototype's own simulation gave (section 5): trend rms and scatter, m.
EARLIER = {
    "none": (162.0, 32.0),
    "epipolar, raw": (63.0, 15.0),
    "epipolar": (np.nan, np.nan),
    "plane": (23.5, 14.0),
    "ml-pair": (19.0, 14.0),
    "ml-track": (3.9, 14.0),
    "true angles": (1.8, 14.0),
}
TARGET = 5.0
FIRST_SEED = 5000


@dataclass
class Errors:
    """Of one estimator, a value per pass."""

    per_shot: list[float]
    trend: list[float]
    scatter: list[float]
    rays: list[float]
    own: list[float]


def orientations(
    problem: StereoProblem, scenario: StereoScenario, methods: list[str]
) -> dict[str, StereoOrientation]:
    """Every estimator's result; no angles at all; the true ones."""
    found = {"epipolar, raw": orient(problem, "epipolar", raw=True)}
    found |= {method: orient(problem, method) for method in methods}
    some = found["ml-track"]
    known = {"covariance": np.zeros((6, 6)), "rejected": np.zeros(len(some.rejected), dtype=bool)}
    out = {"none": replace(some, angles=np.zeros((2, 3)), **known), **found}
    out["true angles"] = replace(some, angles=scenario.angles, **known)
    return out


def judge(problem: StereoProblem, found: StereoOrientation, true: np.ndarray, own: bool) -> tuple[float, ...]:
    """Per shot, trend, scatter, multi-view error by rays, and by the estimator's own points, m."""
    used = ~found.rejected
    met = triangulate(problem.sightings(), np.array(found.angles), used=used)
    rays = heights_of(met.position, problem.radii) - true
    by_rays = replace(found, points=met.position, point_covariance=met.covariance)
    heights = stereo_heights(problem, by_rays, true)
    line = np.polyval(
        np.polyfit(heights.t - heights.t.mean(), heights.shot_after, 1), heights.t - heights.t.mean()
    )
    adjusted = heights_of(found.points, problem.radii) - true if own else np.array([np.nan])
    rms = (float(np.sqrt(np.nanmean(e**2))) if np.isfinite(e).any() else np.nan for e in (rays, adjusted))
    per_shot, trend = (float(np.sqrt(np.mean(v**2))) for v in (heights.shot_after, line))
    return per_shot, trend, heights.scatter_after, *rms


def available(problem: StereoProblem) -> list[str]:
    """The estimators, by name."""
    return [method for method in ("epipolar", "plane", "ml-pair", "ml-track") if method in METHODS]


def number(value: float) -> str:
    """A number of the prototype, or nothing."""
    return f"{value:g}" if np.isfinite(value) else ""


def main() -> None:
    """Print the table, and draw the figure where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--passes", type=int, default=40)
    parser.add_argument("--figure", help="an HTML file for S2's figures 1 and 2")
    given = parser.parse_args()
    errors: dict[str, Errors] = {}
    for seed in range(FIRST_SEED, FIRST_SEED + given.passes):
        scenario = stereo_case("A_random_relief_400", seed, signs="random")
        problem = StereoProblem(**scenario.problem())
        true = heights_of(scenario.points[problem.point_names.astype(int)], problem.radii)
        for name, found in orientations(problem, scenario, available(problem)).items():
            values = judge(problem, found, true, name.startswith("ml-"))
            row = errors.setdefault(name, Errors([], [], [], [], []))
            for into, value in zip(
                (row.per_shot, row.trend, row.scatter, row.rays, row.own), values, strict=True
            ):
                into.append(value)
    print(f"{given.passes} passes of case A with random signs and ground, seeds from {FIRST_SEED}; m")
    print(
        "| angles taken out | trend | prototype | multi-view | as adjusted | scatter | prototype | per shot |"
    )
    print("|---|---|---|---|---|---|---|---|")
    rms = {}
    for name, row in errors.items():
        shot, trend, scatter, rays, own = (float(np.sqrt(np.mean(np.square(v)))) for v in vars(row).values())
        rms[name] = trend, rays
        adjusted = f"{own:.1f}" if np.isfinite(own) else ""
        print(
            f"| {name} | {trend:.1f} | {number(EARLIER[name][0])} | {rays:.1f} | {adjusted} | "
            f"{scatter:.1f} | {number(EARLIER[name][1])} | {shot:.1f} |"
        )
    if given.figure:
        draw(given.figure)
    for what, value in zip(("trend", "multi-view"), rms["ml-track"], strict=True):
        gates.check(f"{what} of ml-track, m", value, 0.0, TARGET)


def draw(path: str) -> None:
    """S2's figures 1 and 2: mean height error of each shot, before and after, and the scatter over points."""
    from sightline.report.figure import Figure
    from sightline.report.marks import Between, Line
    from sightline.report.page import Page, Section
    from sightline.report.style import AFTER, AXIS_COLOURS, BEFORE

    signs = {
        "pitch errors of one sign": ((1.0, -1.0, 1.0), (-1.0, -1.0, 1.0)),
        "pitch errors of opposite signs": ((1.0, -1.0, 1.0), (-1.0, 1.0, 1.0)),
    }
    figure = Figure(2, 2, height=220)
    for col, (what, angles) in enumerate(signs.items()):
        scenario = stereo_case(
            "A_random_relief_400", FIRST_SEED,
            angles=tuple(tuple(36.0 * sign * np.pi / 648000.0 for sign in row) for row in angles),
        )  # fmt: skip
        problem = StereoProblem(**scenario.problem())
        true = heights_of(scenario.points[problem.point_names.astype(int)], problem.radii)
        found = orient(problem)
        heights = stereo_heights(problem, found, true)
        other = stereo_heights(problem, orient(problem, "epipolar", raw=True), true)
        shot = heights.shot + 1
        for row, when, name, values, colour in (
            (0, "before", "as planned", heights.shot_before, BEFORE),
            (1, "after", "ml-track", heights.shot_after, AFTER),
        ):
            panel, sigma = figure[row, col], heights.shot_sigma
            panel.title, panel.y.title = f"{when}: {what}", "height error (m)"
            panel.add(
                Between(x=shot, low=values - sigma, high=values + sigma, colour=colour),
                Line(x=shot, y=values, name=name, colour=colour, width=2.0),
            )
        epipolar = {"name": "epipolar, as S2 has it", "colour": AXIS_COLOURS[1], "width": 2.0}
        figure[1, col].add(Line(x=shot, y=other.shot_after, **epipolar))
        figure[1, col].x.title = "shot"
    said = "Mean height error of each shot; the band is ± the scatter over its points."
    section = Section("heights", "Height error of each shot, before and after", [said, figure])
    Page("S2's figures 1 and 2", "height errors", "", [], [], [section], "").write(Path(path))


if __name__ == "__main__":
    gates.run(main, __file__)
