"""Focal length found with the poses of a sequence: is it right, and do all sigmas hold?

``python validation/sequence_focal.py [flights]``: flights of points (``point_flights.py``), whose
truth shares no code with the estimate; 40 of each kind take some four minutes of CPU.
The given focal length is wrong by a draw of the sigma that is given with it. What makes it observable
differs from kind to kind: heights of positions above a ground of known height; positions on a path that
climbs, whatever the ground; hardly anything; perspective alone, where heights of positions are not given.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field, replace

import gates
import numpy as np
from point_flights import FOCAL, Flight, Kind, draw
from sequence_covariance import INSIDE, errors, scaled_errors

from sightline.applications.sequence_poses import poses_of_windows
from sightline.errors import EstimationError
from sightline.photogrammetry.flight.focal import FocalStretch

PRECISE = {"place": (0.05, 0.05, 0.05), "place_bias": 0.1}


@dataclass(frozen=True)
class Setting:
    """A kind of flight, and what is given of its focal length and its heights.

    `sigma`: relative, by which the focal length is drawn wrong; `free`: nothing is said of that. `heights`:
    those of positions are given; else the estimate starts 5 m (1 sigma) off.
    """

    kind: Kind = field(default_factory=Kind)
    sigma: float = 0.0
    free: bool = False
    heights: bool = True


KINDS = {
    "known as it is": Setting(),
    "1 %, usual tables": Setting(sigma=0.01),
    "free, usual tables": Setting(sigma=0.03, free=True),
    "1 %, places to 5 cm, ground to 10 cm": Setting(Kind(hills=0.1, **PRECISE), 0.01),
    "1 %, places to 5 cm, climb of 20 m": Setting(Kind(climb=20.0, **PRECISE), 0.01),
    "1 %, flat, heights of places not given": Setting(Kind(hills=0.02), 0.01, heights=False),
    "free, flat, heights of places not given": Setting(Kind(hills=0.02), 0.03, free=True, heights=False),
}
HEADS = (
    "focal length given to", "sigma, %", "error, % rms", "error over sigma: rms, robust",
    "inside 95 %, % of flights", "squared error of poses over covariance: mean, median",
    "frames inside 95 %: x y z roll pitch yaw", "sigma of z, m", "refused",
)  # fmt: skip
Row = tuple[float, float, float, np.ndarray, float]
#: Squared errors of focal lengths over variances, of all kinds together.
squares: list[float] = []


def flight_of(seed: int, setting: Setting) -> Flight:
    """A flight whose given focal length is wrong."""
    flight, rng = draw(seed, setting.kind), np.random.default_rng([seed, 1])
    problem = flight.problem
    px = FOCAL * (1.0 + setting.sigma * rng.standard_normal())
    detector = replace(problem.detector, focal_length_px=px)
    sigma = np.inf if setting.free else setting.sigma * px
    problem = replace(problem, detector=detector, focal_length_sigma_px=sigma)
    if not setting.heights:
        place, known = np.array(problem.images.position), np.array(problem.known.position)
        place[:, 2], known[:, 2] = flight.position[:, 2] + 5.0 * rng.standard_normal(), np.inf
        images = replace(problem.images, position=place)
        problem = replace(problem, images=images, known=replace(problem.known, position=known))
    return replace(flight, problem=problem)


def solved(seed: int, setting: Setting) -> Row | None:
    """Of a flight: error of the focal length, its sigma, relative; NEES, share inside (6,), sigma of z.

    None where the estimate refuses to give a focal length.
    """
    flight = flight_of(seed, setting)
    try:
        poses, _ = poses_of_windows(flight.problem, flight.followed)
    except EstimationError:
        return None
    scaled, squared = scaled_errors(errors(flight, poses), poses.covariance)
    px = flight.problem.detector.focal_length_px
    error = (poses.detector(flight.problem.detector).focal_length_px - FOCAL) / px
    focal = poses.focal or FocalStretch(0.0, np.inf, 0.0, np.zeros(6))
    middle = poses.covariance[len(scaled) // 2, 2, 2]
    inside = (np.abs(scaled) < INSIDE).mean(axis=0)
    return error, focal.sigma, float(squared.mean()), inside, float(np.sqrt(middle))


def row(name: str, flights: int) -> str:
    """Of a kind of flight, one row of the table."""
    each = [solved(seed, KINDS[name]) for seed in range(3000, 3000 + flights)]
    found = [result for result in each if result is not None]
    gates.note(f"{name}: flights refused", str(len(each) - len(found)), *(
        (f"{flights}: perspective alone tells too little", not found) if name.startswith("free, flat")
        else ("<= 5 %", len(each) - len(found) <= 0.05 * flights)
    ))  # fmt: skip
    if not found:
        return f"| {name} | - | - | - | - | - | - | - | {flights} |"
    error, sigma, nees, share, height = (np.array(column) for column in zip(*found, strict=True))
    cells = [100.0 * np.median(sigma), 100.0 * np.sqrt((error**2).mean())]
    over = error / sigma
    if np.isfinite(sigma).all():
        squares.extend(over**2)
        gates.check(
            f"{name}: NEES of the focal length", float((over**2).mean()), *gates.nees_bounds(len(found))
        )
    # of six parameters whose datum is one draw a flight
    low, high = gates.nees_bounds(6 * len(found))
    gates.check(f"{name}: squared error of poses over covariance", float(nees.mean()), 6.0 * low, 6.0 * high)
    said = "- | - | - | - | "
    if np.isfinite(sigma).all():
        sizes = f"{np.sqrt((over**2).mean()):.2f}, {1.4826 * np.median(np.abs(over)):.2f}"
        said = f"{cells[0]:.2f} | {cells[1]:.2f} | {sizes} | {100.0 * (np.abs(over) < INSIDE).mean():.0f} | "
    inside = ", ".join(f"{100.0 * part:.0f}" for part in share.mean(axis=0))
    before = f"| {name} | {said}{nees.mean():.2f}, {np.median(nees):.2f} | {inside} | "
    return f"{before}{np.median(height):.2f} | {len(each) - len(found)} |"


def main(flights: int) -> None:
    """Print the table."""
    began = time.process_time()
    print("|" + "|".join(f" {head} " for head in HEADS) + "|")
    print("|" + " --- |" * len(HEADS))
    for name in KINDS:
        print(row(name, flights), flush=True)
    gates.check(
        "all kinds: NEES of the focal length", float(np.mean(squares)), *gates.nees_bounds(len(squares))
    )
    print(f"{flights} flights each, {time.process_time() - began:.0f} CPU s")


if __name__ == "__main__":
    gates.run(lambda: main(int(sys.argv[1]) if len(sys.argv) > 1 else 60), __file__)
