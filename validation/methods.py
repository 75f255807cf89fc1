"""S1's five estimators (claim 6) on the same rendered strips, beside each other and their bound.

    python validation/methods.py [--seeds 100 101 102] [--lines 3000] [--columns 1000]

One strip per seed is matched and solved once; from its angular differences every method makes a motion, as
`sightline recover --method` does. One line per method and axis, over all seeds: rms error in px (yaw: at the
field's edge), that over the joint estimate's, the sigma that the result states, NEES, the share of lines
within 95 %, and the sigma that the method by itself would have stated.
"""

from __future__ import annotations

import argparse

import gates
import numpy as np

from sightline.applications.line_of_sight import joint_line_of_sight
from sightline.evaluation.score import AXES, score_result
from sightline.execution import silent
from sightline.geometry.surface import Plane
from sightline.motion.results import LineOfSight
from sightline.motion.strip.checks import checked
from sightline.motion.strip.methods import by_method
from sightline.motion.strip.strip import METHODS, RecoverOptions, prepared
from sightline.simulate.scenarios import line_of_sight_case

#: NEES of every method, mean over the seeds.
HONEST = (0.7, 1.4)


def results(seed: int, size: dict[str, int]) -> tuple[dict[str, LineOfSight], np.ndarray]:
    """The motion by every method, and the truth (t, roll, pitch, yaw)."""
    scenario = line_of_sight_case("nominal", seed, **size)
    options = RecoverOptions()
    strip = checked(prepared(scenario.as_given(), Plane(0.0), options), options)
    strip, state, joint = joint_line_of_sight(strip, options, 0.0, silent)
    found = {"joint": joint}
    found |= {method: by_method(strip, state, joint, method) for method in METHODS if method != "joint"}
    return found, scenario.truth


def main() -> None:
    """Score every method, print the table, and say whether sigma is true and the joint estimate the best."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", nargs="+", type=int, default=[100, 101, 102])
    parser.add_argument("--lines", type=int, default=3000)
    parser.add_argument("--columns", type=int, default=1000)
    given = parser.parse_args()
    size = {"lines": given.lines, "columns": given.columns}
    rows: dict[tuple[str, str], list[tuple[float, ...]]] = {}
    for seed in given.seeds:
        found, truth = results(seed, size)
        for method, result in found.items():
            scored = score_result(result, truth[:, 0], truth[:, 1:]).axes
            own = result.sigma if result.method is None else result.method.stated_sigma
            for k, axis in enumerate(AXES):
                one = scored[axis]
                stated = float(np.mean((own[:, k] / result.scale[k]) ** 2))
                row = (one.rms**2, one.sigma**2, one.nees, one.coverage_95, stated)
                rows.setdefault((method, axis), []).append(row)
    print(f"nominal case, {given.lines} x {given.columns} px, seeds {given.seeds}")
    print("| method | axis | rms, px | over joint | sigma | NEES | within 95 % | own sigma |")
    print("|---|---|---|---|---|---|---|---|")
    for (method, axis), values in rows.items():
        error, variance, nees, coverage, stated = np.mean(values, axis=0)
        ratio = float(np.sqrt(error / np.mean([row[0] for row in rows["joint", axis]])))
        print(
            f"| {method} | {axis} | {error**0.5:.4f} | {ratio:.2f} | {variance**0.5:.4f} | {nees:.2f} | "
            f"{100.0 * coverage:.1f} % | {stated**0.5:.4f} |"
        )
        gates.check(f"{method}, {axis}: NEES", nees, *HONEST)
        gates.check(f"{method}, {axis}: rms over that of the joint estimate", ratio, 1.0)


if __name__ == "__main__":
    gates.run(main, __file__)
