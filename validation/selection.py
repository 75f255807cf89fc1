"""Selection, similarity and weighting (S1, claims 2 to 5): what each gains on a strip of mixed quality.

    python validation/selection.py --seeds 100 101

The nominal strip, whose right half has ten times its noise (a bad half of the detector): rms error per axis
in px (yaw: at the field's edge) after the hidden directions are fitted away, NEES, and windows kept.
"""

from __future__ import annotations

import argparse

import gates
import numpy as np

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.evaluation.score import score_result
from sightline.geometry.surface import Plane
from sightline.matching.select import Selection
from sightline.motion.strip.strip import RecoverOptions
from sightline.simulate.scenarios import StripScenario, line_of_sight_case

SIZE = {"lines": 1500, "columns": 700}


def choices(scenario: StripScenario) -> dict[str, RecoverOptions]:
    """What is compared; the features of the list are drawn at random."""
    rng = np.random.default_rng(0)
    shape = (scenario.options.lines, scenario.options.columns)
    features = {k: rng.uniform([0.0, 0.0], shape, (800, 2)) for k in range(len(scenario.bands))}
    return {
        "all windows, whitened, weighted": RecoverOptions(),
        "not weighted": RecoverOptions(weighting="none"),
        "images as they are": RecoverOptions(similarity="radiometric"),
        "gradients": RecoverOptions(similarity="gradient"),
        "textured windows": RecoverOptions(selection=Selection("textured")),
        "well spread, 800 of an image": RecoverOptions(selection=Selection("spread", points=800)),
        "listed, 800 of an image": RecoverOptions(selection=Selection("listed", features=features)),
        "windows of 8 x 40": RecoverOptions(window=(8, 40), step=8),
        "windows of 8 x 200": RecoverOptions(window=(8, 200), step=8),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[100, 101])
    np.seterr(all="ignore")
    print("| choice | seed | roll rms (NEES) | pitch | yaw | windows |")
    print("|---|---|---|---|---|---|")
    for seed in parser.parse_args().seeds:
        scenario = line_of_sight_case("nominal", seed, **SIZE)
        rng = np.random.default_rng([seed, 5])
        images = []
        for k in range(len(scenario.bands)):
            image = scenario.image(k).astype(float)
            half = image[:, image.shape[1] // 2 :]
            half += 10.0 * image.mean() / scenario.options.snr * rng.standard_normal(half.shape)
            images.append(image)
        bands = scenario.as_given(images)
        rms: dict[str, float] = {}
        for name, options in choices(scenario).items():
            result = recover_line_of_sight(bands, Plane(0.0), options=options)
            truth = scenario.truth
            score = score_result(result, truth[:, 0], truth[:, 1:])
            rms[name] = float(np.sqrt(np.mean([axis.rms**2 for axis in score.axes.values()])))
            nees = float(np.mean([axis.nees for axis in score.axes.values()]))
            gates.check(f"{name}, seed {seed}: NEES, mean of the axes", nees, 0.6, 1.5)
            axes = " | ".join(f"{axis.rms:.4f} ({axis.nees:.2f})" for axis in score.axes.values())
            print(f"| {name} | {seed} | {axes} | {sum(p.kept for p in result.pairs)} |", flush=True)
        best = rms["all windows, whitened, weighted"]
        gates.check(f"seed {seed}: rms not weighted over weighted", rms["not weighted"] / best, 1.5)
        gates.check(
            f"seed {seed}: rms of images as they are over whitened", rms["images as they are"] / best, 1.2
        )


if __name__ == "__main__":
    gates.run(main, __file__)
