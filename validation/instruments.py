"""Every kind of instrument of S1's claims 14 to 20 and 22, rendered over a real orbit, recovered and scored.

    python validation/instruments.py --seeds 100 101 102
    python validation/instruments.py --cases staggered --seeds 0 --verbose

Through the files, as `sightline simulate`, `recover` and `score` do it. One line per kind, off-nadir angle
and axis, over all seeds: rms error in px (yaw: px at the field's edge) after the hidden directions are fitted
away, the root mean square of the stated sigma, their ratio (at most 1.2) and the mean NEES (0.8 to 1.25);
`samples` is what the errors of all seeds are worth as independent ones: the NEES of a true sigma scatters by
sqrt(2 / samples), and by more where the sigma of a strip follows what that strip showed of its spectrum;
`+-` is the standard error of the NEES as it scatters from seed to seed.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import gates
import numpy as np

from sightline.cli.recover import recover_acquisition
from sightline.evaluation.score import AXES, AxisScore, score_motion
from sightline.execution import silent
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats.tables import read_motion
from sightline.simulate.instrument_files import write_instrument
from sightline.simulate.instruments import INSTRUMENT_CASES, instrument_case

MEASURES = (
    "sightline.applications.line_of_sight",
    "sightline.applications.frame_attitude",
    "sightline.applications.spin_attitude",
)


def off_nadir_angles(case: str) -> tuple[float, ...]:
    """Degrees in the middle of the strip; from geostationary height the last lines look past the limb."""
    return (2.0, 7.6) if case.endswith("geo") else (5.0, 30.0)


def run(case: str, off_nadir: float, seed: int) -> tuple[dict[str, AxisScore], tuple[str, ...], float]:
    """Scores of the three axes, warnings, and processor seconds of one strip."""
    scenario = instrument_case(case, seed, off_nadir=np.radians(off_nadir))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_instrument(scenario, folder)
        begun = time.process_time()
        acquired = load_acquisition(folder / "acquisition.toml")
        result = recover_acquisition(acquired, silent)
        seconds = time.process_time() - begun
        truth = read_motion(folder / "truth.csv")
        score = score_motion(
            result.motion.t,
            result.motion.angles,
            result.sigma,
            truth.t,
            truth.angles,
            hidden=result.hidden,
            hidden_names=result.hidden_names,
            ifov=acquired.ifov,
            half_field_px=acquired.half_field_px,
        )
    return score.axes, result.warnings, seconds


def show(case: str, off_nadir: float, axis: str, scores: list[AxisScore], *, gate: bool = True) -> None:
    """One line of the table, by itself or with its gates."""
    rms = float(np.sqrt(np.mean([s.rms**2 for s in scores])))
    sigma = float(np.sqrt(np.mean([s.sigma**2 for s in scores])))
    nees = float(np.mean([s.nees for s in scores]))
    error = (
        float(np.std([s.nees for s in scores], ddof=1) / len(scores) ** 0.5) if len(scores) > 1 else np.nan
    )
    samples = sum(s.effective_samples for s in scores)
    print(
        f"{case:16s} {off_nadir:4.0f} deg {axis:5s} rms {rms:.4f} sigma {sigma:.4f} ratio {rms / sigma:.2f} "
        f"NEES {nees:.2f} +- {error:.2f} samples {samples:.0f}",
        flush=True,
    )
    if gate:
        label = f"{case} {off_nadir:g} deg, {axis}"
        gates.check(f"{label}: rms over sigma", rms / sigma, 0.8, 1.2)
        gates.check(f"{label}: NEES", nees, 0.8, 1.25)


def main() -> None:
    """Run all kinds, angles and seeds asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", nargs="+", default=list(INSTRUMENT_CASES))
    parser.add_argument("--seeds", nargs="+", type=int, default=[100, 101, 102])
    parser.add_argument("--verbose", action="store_true", help="every seed, with its warnings")
    arguments = parser.parse_args()
    np.seterr(all="ignore")
    for case in arguments.cases:
        for off_nadir in off_nadir_angles(case):
            found = []
            for seed in arguments.seeds:
                scores, warnings, seconds = run(case, off_nadir, seed)
                found.append(scores)
                if arguments.verbose:
                    for axis in AXES:
                        show(f"{case} {seed}", off_nadir, axis, [scores[axis]], gate=False)
                    print(f"    {seconds:.0f} s", *warnings, sep="\n    ", flush=True)
            for axis in AXES:
                show(case, off_nadir, axis, [scores[axis] for scores in found])


if __name__ == "__main__":
    gates.run(main, __file__)
