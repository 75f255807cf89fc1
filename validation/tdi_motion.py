"""TDI chosen with the motion that ``recover`` found, against TDI chosen with the true motion.

    python validation/tdi_motion.py                       seeds 100 101, three minutes
    python validation/tdi_motion.py --seeds 0 1 2 --snr 8
    python validation/tdi_motion.py --strips 40           only how often a loss is as predicted

The strip is S1's reference scene (2000 lines of 500 columns, images rendered) with a drift of roll and pitch
four times larger and tones half as large, so that drift, not the tones, decides the number of stages and the
best number lies inside the grid; a px of yaw at the edge of so narrow a field is 4 mrad of slip, so that yaw
is an eighth. The grid is 4 to 128 stages with ratios 0.1 to 1.0; noise as in the reference example.

Per column (edge, middle, edge) and signal the table gives the number of stages chosen with the true and with
the recovered motion and the ratio of the merit that both truly have: mean over 97 lines of the strip, other
than those used to choose, by quadrature over the true motion in pixels (angles times focal length and
place in the focal plane), which shares nothing with the choice. `best` is the ratio of the recovered choice
to the best setting for those very lines. `drift only` chooses without any motion.

Offsets known: as rendered with detectors in their nominal places, given as exact. Offsets free: drawn with
1 px and 3e-4 rad and not given; then the choice by mean and by lower quantile, and the loss it predicts
(mean and 95 %) beside the true one.

How often a loss is as predicted: strips of 1200 x 300 pixels so noisy that the motion is known to .1 to
.5 px, seeds from 300 on, offsets known and free in turn. Per strip the loss of merit of its worst cell
against the choice with the true motion, beside `upper_95` of `summary.json`; the share of strips within it,
with its binomial limits (Clopper and Pearson, 95 %). Strips whose motion is known better or worse are left
out.

Shown by TDI images: the true motion averaged over the exposures of 16 or 64 stages is all that is known;
chosen as it is seen, and with the average undone as far as it can be.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import gates
import numpy as np
from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.evaluation.score import score_result
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Motion
from sightline.imaging.tdi_noise import NoiseLaw, snr
from sightline.imaging.tdi_transfer import Exposure, motion_transfer
from sightline.simulate.jitter import ConstantJitter, JitterProfile, MaternJitter, ToneJitter
from sightline.simulate.scenarios import StripScenario, line_of_sight_case
from sightline.tdi.choose import TdiChoice, choose_settings
from sightline.tdi.merit import DriftMtf
from sightline.tdi.motion_knowledge import MotionKnowledge
from sightline.tdi.motion_mtf import MotionMtf
from sightline.tdi.predict_loss import predict_loss
from sightline.tdi.scan_columns import band_camera, column_geometry, strip_span
from sightline.tdi.setting import ChoiceRules, TdiDetector, TdiGrid
from tdi.knowledge_in_memory import motion_knowledge

LINES, COLUMNS = 2000, 500
GRID = TdiGrid(np.arange(4, 129), np.arange(1, 11) / 10.0)
DETECTOR = TdiDetector(Exposure(2, 0.25), NoiseLaw(9e-6, 1.0, 12.0))
SIGNALS = np.array([20.0, 200.0, 2000.0])
#: Of many strips: lines, columns; SNR of the images, first seed, how many, and the errors (px) that count.
SMALL, NOISY, FIRST_SEED, STRIPS, ERRORS = (1200, 300), 5.0, 300, 40, (0.1, 0.5)
STATIC = (0.3, 0.3)
QUANTILE = 0.1
#: Lines over which the true merit is averaged.
JUDGED = 97


def profile() -> JitterProfile:
    """Drift of 8 px and 0.5 s, broadband 0.1 px, tones of half the reference scene; yaw an eighth."""

    def parts(size: float) -> tuple[ConstantJitter | MaternJitter | ToneJitter, ...]:
        return (
            ConstantJitter(2.0 * size),
            MaternJitter(8.0 * size, 0.5, "5/2"),
            MaternJitter.with_corner(0.10 * size, 30.0, "3/2"),
            ToneJitter(0.15 * size, 47.0),
            ToneJitter(0.075 * size, 83.0),
            ToneJitter(0.04 * size, 121.0),
        )

    return JitterProfile(parts(1.0), parts(1.0), parts(0.125))


def places(columns: int) -> np.ndarray:
    """First, middle and last column."""
    return np.array([0, columns // 2, columns - 1])


def true_merit(scenario: StripScenario) -> np.ndarray:
    """(C, S, P) true mean merit of every setting: sums over the true motion in pixels."""
    options, band = scenario.options, scenario.bands[0]
    focal = 1.0 / options.ifov
    roll, pitch, yaw = scenario.motion.at(scenario.line_times).T
    lines, columns = options.lines, options.columns
    starts = np.linspace(1.0, lines - GRID.stages[-1] - 2.0, JUDGED)
    stages, ratio = GRID.settings
    t = np.arange(lines)
    out = np.zeros((3, len(stages)))
    for c, place in enumerate(places(columns)):
        x = place - 0.5 * (columns - 1) + band.offset_px[1]
        y = band.offset_px[0] + (place - 0.5 * (columns - 1)) * band.rotation
        for start in starts:
            # the scene moves one px per line along the nominal column: a camera turned by yaw sees it lean
            dx = -focal * roll + y * yaw - yaw * (t - start)
            dy = focal * pitch + x * yaw
            h = [
                abs(
                    motion_transfer(
                        int(GRID.stages[-1]), GRID.ratios, 1.0, -band.rotation, fx, fy,
                        np.stack([dx, dy], axis=1), start, DETECTOR.exposure,
                    )
                )
                for fx, fy in ((0.5, 0.0), (0.0, 0.5))
            ]  # fmt: skip
            product = (h[0] * h[1])[:, GRID.stages - 1].T.ravel()
            out[c] += product * STATIC[0] * STATIC[1] / JUDGED
    noise = snr(SIGNALS[:, None], stages, ratio, DETECTOR.noise, DETECTOR.exposure, DETECTOR.reference)
    return out[:, None, :] * noise


def of(merit: np.ndarray, choice: TdiChoice) -> np.ndarray:
    """(C, S) merit of the settings chosen."""
    return np.take_along_axis(merit, choice.setting[..., None], axis=2)[..., 0]


@dataclass(frozen=True)
class Row:
    """Ratios of true merit of one run."""

    worst: float
    mean: float


@dataclass(frozen=True)
class Seen:
    """A strip recovered: errors of its motion, px; what is known of it, and the truth, as MTF of columns."""

    scenario: StripScenario
    errors: dict[str, float]
    recovered: MotionMtf
    true: MotionMtf
    hidden: bool


def seen(seed: int, free: bool, image_snr: float, lines: int, columns: int) -> Seen:
    """Render and recover."""
    known = {} if free else {"offset_sigma_px": 0.0, "rotation_sigma": 0.0}
    scenario = line_of_sight_case(
        "nominal", seed, profile=profile(), lines=lines, columns=columns, snr=image_snr, **known
    )
    bands = scenario.as_given()
    result = recover_line_of_sight(bands, Plane(0.0))
    score = score_result(result, scenario.truth[:, 0], scenario.truth[:, 1:])
    statics = {s.name: s.value for s in result.statics}
    sigma = {s.name: s.sigma for s in result.statics}
    camera, at = band_camera(bands, "PAN", statics), places(columns)
    geometry = column_geometry(camera, Plane(0.0), at)
    doubt = geometry.attitude_covariance([0.0, 0.0, sigma.get("PAN rotation", 0.0)], [0.0] * 3)
    scan = geometry.columns(STATIC, doubt if free else None)
    common = (GRID, DETECTOR.exposure, ChoiceRules(), strip_span(camera))
    real = column_geometry(scenario.cameras[0].with_trajectory(scenario.reference), Plane(0.0), at)
    return Seen(
        scenario,
        {name: axis.rms for name, axis in score.axes.items()},
        MotionMtf(scan, geometry, motion_knowledge(result), *common),
        MotionMtf(real.columns(STATIC), real, MotionKnowledge(scenario.motion), *common),
        result.hidden_covariance is not None,
    )


def as_predicted(strips: int) -> None:
    """Print how many strips lose no more than is predicted."""
    print(f"== loss of the worst cell beside its prediction, {SMALL[0]} x {SMALL[1]} px, SNR {NOISY:g}")
    within, judged = 0, 0
    for k in range(strips):
        strip = seen(FIRST_SEED + k, bool(k % 2), NOISY, *SMALL)
        merit = true_merit(strip.scenario)
        settings = (SIGNALS, GRID, DETECTOR, ChoiceRules())
        chosen = choose_settings(strip.recovered, *settings)
        best = of(merit, choose_settings(strip.true, *settings))
        loss = float((1.0 - of(merit, chosen) / best).max())
        predicted = predict_loss(chosen, strip.recovered)
        upper, worst = float(predicted.upper().max()), max(strip.errors.values())
        counts = ERRORS[0] <= worst <= ERRORS[1]
        judged, within = judged + counts, within + (counts and loss <= upper)
        errors = " ".join(f"{error:.2f}" for error in strip.errors.values())
        print(
            f"   seed {FIRST_SEED + k} offsets {'free ' if k % 2 else 'known'} error {errors} px: "
            f"loss {loss:.4f}, predicted mean {predicted.mean.mean():.4f}, upper_95 {upper:.4f}"
            f"{'' if counts else ' (error does not count)'}",
            flush=True,
        )
    least, most = binomial_limits(within, judged)
    print(
        f"== {within} of {judged} strips lose no more than upper_95: {within / max(judged, 1):.3f}, "
        f"{least:.3f} to {most:.3f}"
    )
    gates.check("share of strips within upper_95, upper binomial limit", most, 0.95)
    gates.check("strips whose motion is known to .1 to .5 px", judged, strips // 2)


def binomial_limits(found: int, tried: int, probability: float = 0.95) -> tuple[float, float]:
    """Of the share that `found` of `tried` come from (Clopper and Pearson)."""
    tail = 0.5 * (1.0 - probability)
    least = beta.ppf(tail, found, tried - found + 1) if found else 0.0
    return float(least), float(beta.ppf(1.0 - tail, found + 1, tried - found) if found < tried else 1.0)


def run(seed: int, free: bool, image_snr: float) -> Row:
    """Render, recover, choose, judge, print."""
    strip = seen(seed, free, image_snr, LINES, COLUMNS)
    errors = " ".join(f"{name} {error:.3f}" for name, error in strip.errors.items())
    print(
        f"seed {seed}, offsets {'free' if free else 'known'}: error of the motion, px: {errors}", flush=True
    )
    rules = ChoiceRules()
    recovered, true, geometry = strip.recovered, strip.true, strip.recovered.geometry
    merit = true_merit(strip.scenario)
    by_truth = choose_settings(true, SIGNALS, GRID, DETECTOR, rules)
    blind = choose_settings(
        DriftMtf(geometry.columns(STATIC), GRID, DETECTOR.exposure, rules), SIGNALS, GRID, DETECTOR, rules
    )
    print(f"   stages with the true motion   {by_truth.stages.tolist()}")
    worth = np.mean(of(merit, blind) / of(merit, by_truth))
    print(f"   drift only: stages {blind.stages[0, 0]}, merit {worth:.3f}")
    if strip.hidden and free:
        hidden = np.sqrt(recovered.knowledge.drift_covariance(geometry)[0, [0, 1], [0, 1]])
        print(f"   hidden: velocity {hidden[0]:.1e} px per line, slip {hidden[1]:.1e} rad (1-sigma)")
    rows = []
    for name, these in (("mean", rules), (f"quantile {QUANTILE}", replace(rules, quantile=QUANTILE))):
        if name != "mean" and not free:
            continue
        model = recovered.judged_by(these)
        choice = choose_settings(model, SIGNALS, GRID, DETECTOR, these)
        ratio = of(merit, choice) / of(merit, by_truth)
        best = of(merit, choice) / merit.max(axis=2)
        predicted = predict_loss(choice, model)
        print(f"   {name:12s} stages {choice.stages.tolist()}")
        print(
            f"   {name:12s} merit ratio: worst {ratio.min():.4f} mean {ratio.mean():.4f}; of the best for "
            f"the judged lines: worst {best.min():.4f}; loss predicted: mean {predicted.mean.mean():.4f}, "
            f"95 % {predicted.upper().max():.4f}; cells within their own 95 %: "
            f"{np.sum(1.0 - ratio <= predicted.upper())} of {ratio.size}",
            flush=True,
        )
        rows.append(Row(float(ratio.min()), float(ratio.mean())))
    return rows[0]


def seen_through_tdi(seed: int, stages: int, ratio: float = 0.8) -> None:
    """Choose with the true motion as lines of so many stages show it, and with what is restored of it."""
    scenario = line_of_sight_case(
        "nominal",
        seed,
        profile=profile(),
        lines=LINES,
        columns=COLUMNS,
        offset_sigma_px=0.0,
        rotation_sigma=0.0,
    )
    camera = scenario.nominal_cameras[0]
    geometry, rules = column_geometry(camera, Plane(0.0), places(COLUMNS)), ChoiceRules()
    period, t = scenario.options.line_period, scenario.line_times[64:-64]
    inside = ratio * ((np.arange(20) + 0.5) / 20 - 0.5)
    since = (np.arange(stages)[:, None] - 0.5 * (stages - 1) + inside).ravel() * period
    shown = np.mean([scenario.motion.at(np.clip(t + d, *scenario.motion.span)) for d in since], axis=0)
    averaged = MotionKnowledge(Motion(t, shown))
    restored, highest = averaged.without_tdi(stages, ratio, period)
    merit = true_merit(scenario)
    worth = []
    for knowledge in (MotionKnowledge(scenario.motion), averaged, restored):
        model = MotionMtf(geometry.columns(STATIC), geometry, knowledge, GRID, DETECTOR.exposure, rules)
        choice = choose_settings(model, SIGNALS, GRID, DETECTOR, rules)
        worth.append((of(merit, choice), choice.stages[1, 1]))
    best, chosen = worth[0]
    ratios = [float((each / best).min()) for each, _ in worth[1:]]
    gates.check(f"seed {seed}, {stages} stages, restored: worst merit ratio", ratios[1], 0.98)
    print(
        f"   seed {seed}, images of {stages:3d} stages, restored to {highest:.0f} Hz: stages {chosen} by the "
        f"truth; {worth[1][1]} as seen, merit ratio at worst {ratios[0]:.4f}; {worth[2][1]} restored, "
        f"{ratios[1]:.4f}",
        flush=True,
    )


def main() -> None:
    """All seeds, offsets known and free."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[100, 101])
    parser.add_argument("--snr", type=float, default=120.0)
    parser.add_argument("--strips", type=int, help="only so many small strips")
    arguments = parser.parse_args()
    np.seterr(all="ignore")
    if arguments.strips is not None:
        as_predicted(arguments.strips)
        return
    for free in (False, True):
        rows = [run(seed, free, arguments.snr) for seed in arguments.seeds]
        print(
            f"== offsets {'free' if free else 'known'}: merit with the recovered motion over that with the "
            f"true motion: worst cell {min(r.worst for r in rows):.4f}, "
            f"mean {np.mean([r.mean for r in rows]):.4f}"
        )
        worst, least = min(r.worst for r in rows), 0.99 if free else 0.999
        if arguments.snr >= 100.0:
            gates.check(
                f"offsets {'free' if free else 'known'}: worst merit over that by the truth", worst, least
            )
    print("== motion shown by TDI images, without other errors")
    for seed in arguments.seeds:
        for stages in (16, 64):
            seen_through_tdi(seed, stages)
    as_predicted(STRIPS)


if __name__ == "__main__":
    gates.run(main, __file__)
