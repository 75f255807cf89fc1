"""A band that looks like nothing else: registered by the motion of the others, beside matching it directly.

    python validation/weak_band.py
    python validation/weak_band.py --seeds 100 101 102 --coherence 0.4 0.25

Rendered strips of PAN, B1, B0 and NIR: amplitude correlation of NIR with PAN as given (0.4: a coherence, as
magnitude squared, of 0.16), of the others 0.97. Printed: where the cameras that a method found put ground
seen by PAN in NIR, against where the simulator's true cameras do, rms over the image, px.

- global, iterative: the whole strip recovered (`hybridise`), NIR's offset and rotation among the unknowns;
- pair: PAN and NIR alone recovered, the motion from that pair;
- windows W: NIR matched directly, window by window, about the nominal prediction: error of the windows that
  the matcher keeps, the share it keeps, and how many of those are off by more than a pixel. Each says
  something of its own place only; between them nothing is known.
"""

from __future__ import annotations

import argparse

import gates
import numpy as np

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.errors import EstimationError
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Plane
from sightline.matching.match_images import match_images
from sightline.motion.band import Band
from sightline.motion.measure.predict import MovingCamera
from sightline.motion.measure.windows import window_grid
from sightline.motion.strip.strip import RecoverOptions
from sightline.simulate.scenarios import StripScenario, line_of_sight_case

NAMES = ("PAN", "B1", "B0", "NIR")
WEAK = len(NAMES) - 1
GROUND = Plane(0.0)
WINDOWS = ((10, 100), (32, 32), (64, 64))


def check_points(scenario: StripScenario) -> np.ndarray:
    """Places (N, 2) px of PAN at which maps are compared: every seventh line, thirteen columns."""
    options = scenario.options
    lines = np.arange(10.0, options.lines - 10.0, 7.0)
    columns = np.linspace(10.0, options.columns - 11.0, 13)
    return np.stack(np.meshgrid(lines, columns, indexing="ij"), axis=-1).reshape(-1, 2)


def map_error(scenario: StripScenario, first: MovingCamera, weak: MovingCamera) -> np.ndarray:
    """Errors (N, 2) px of where `weak` sees what `first` sees."""
    points = check_points(scenario)
    true = predict_match(scenario.cameras[0], scenario.cameras[WEAK], GROUND, points)
    error = predict_match(first, weak, GROUND, points) - true
    return error[np.isfinite(error).all(axis=1)]


def show(label: str, error: np.ndarray, more: str = "") -> float:
    """Print a row; px rms, along and across together."""
    along, across = np.sqrt((error**2).mean(axis=0))
    print(
        f"    {label:18} along {along:8.4f}  across {across:8.4f}  both {np.hypot(along, across):8.4f}"
        f"  largest {np.abs(error).max():7.3f}{more}",
        flush=True,
    )
    return float(np.hypot(along, across))


def recovered(scenario: StripScenario, bands: list[Band], label: str, hybridise: str) -> float:
    """Error of the map after a recovery from `bands`, of which the first is PAN and the last NIR."""
    try:
        result = recover_line_of_sight(bands, GROUND, options=RecoverOptions(hybridise=hybridise))
    except EstimationError as error:
        print(f"    {label:18} refused: {str(error).split(':')[0]}")
        return float("inf")
    return show(label, map_error(scenario, result.cameras[0], result.cameras[-1]))


def direct(scenario: StripScenario, bands: list[Band], window: tuple[int, int]) -> float:
    """Error of single windows of NIR matched with PAN."""
    first, weak = bands[0], bands[-1]
    points = window_grid(first.image.shape, window, window[0]).centres
    predicted = predict_match(first.camera, weak.camera, GROUND, points)
    seen = np.isfinite(predicted).all(axis=1)
    found = match_images(
        first.image, weak.image, points[seen], predicted[seen], window=window, search_px=(8, 8)
    )
    true = predict_match(scenario.cameras[0], scenario.cameras[WEAK], GROUND, points[seen])
    error = (found.b - true)[found.kept]
    wrong = float((np.abs(error) > 1.0).any(axis=1).mean()) if len(error) else np.nan
    label = f"windows {window[0]} x {window[1]}"
    if len(error):
        return show(
            label, error, f"  kept {100 * found.kept.mean():5.1f} %, off by > 1 px {100 * wrong:5.1f} %"
        )
    print(f"    {label:18} none kept")
    return float("inf")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[100, 101, 102])
    parser.add_argument("--coherence", type=float, nargs="+", default=[0.4])
    parser.add_argument("--lines", type=int, default=3000)
    parser.add_argument("--columns", type=int, default=1000)
    given = parser.parse_args()
    for coherence in given.coherence:
        for seed in given.seeds:
            print(f"NIR of coherence {coherence:g}, seed {seed}: error of its place (px rms)")
            scenario = line_of_sight_case(
                "nominal", seed, lines=given.lines, columns=given.columns, names=NAMES,
                coherence_with_first=(1.0, 0.97, 0.97, coherence),
            )  # fmt: skip
            bands = scenario.as_given()
            show("nominal cameras", map_error(scenario, bands[0].camera, bands[-1].camera))
            matched = min(direct(scenario, bands, window) for window in WINDOWS)
            pair = recovered(scenario, [bands[0], bands[-1]], "pair", "global")
            for way in ("global", "iterative"):
                px, what = (
                    recovered(scenario, bands, way, way),
                    f"coherence {coherence:g}, seed {seed}, {way}",
                )
                if coherence >= 0.4:
                    gates.check(f"{what}: px rms", px, 0.0, 0.02)
                gates.check(f"{what}: over windows matched directly", px / matched, 0.0, 0.2)
                gates.check(f"{what}: over the pair alone", px / pair, 0.0, 0.6)


if __name__ == "__main__":
    gates.run(main, __file__)
