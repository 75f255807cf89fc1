"""The loop closed: MTF and SNR predicted for a TDI strip as weights of its matches.

    python validation/tdi_loop.py --seeds 100 101

The nominal strip, whose columns slip more and more from the centre outwards while all have the TDI setting of
the centre column: the scene smears over up to 12 pixels at the edges, with the noise of every other column.
MTF and SNR are predicted as `sightline tdi` does and written as a band's `quality` table; rms error per axis
in px (yaw: at the field's edge) after the hidden directions are fitted away, NEES, windows kept. "None" is
without any weights; "predicted" with those of MTF and SNR; "covariance" with what each match says of itself.

Second table, the loop itself: a strip is recovered; TDI is chosen for its motion, the wells of the outer
thirds of the columns being so small that they hold fewer stages (`[noise] table`); the next strip is imaged
stage by stage with `choice.csv`, other ground and motion, each column with the noise that was predicted for
it; it is recovered, the stages read from `choice.csv`; TDI is chosen again. The last column is the merit that
settings by the recovered motion have over that of settings by the true one, in the worst column. Strips of
1200 x 390 pixels; the motion is that of `tdi_motion.py`, but for its tones.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path

import gates
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.evaluation.score import score_result
from sightline.geometry.surface import Plane
from sightline.imaging.tdi_noise import NoiseLaw, snr
from sightline.imaging.tdi_transfer import Exposure, drift_transfer
from sightline.io.acquisition.quality import read_match_sigma
from sightline.io.acquisition.stages import read_stages
from sightline.io.formats.tables import write_columns
from sightline.io.results.tdi import write_choice
from sightline.motion.band import Band
from sightline.motion.results import LineOfSight
from sightline.motion.strip.hyper import KnownContent
from sightline.motion.strip.strip import RecoverOptions
from sightline.simulate.jitter import ConstantJitter, JitterProfile, MaternJitter
from sightline.simulate.scenarios import StripScenario, line_of_sight_case
from sightline.tdi.choose import TdiChoice, choose_settings, merit_of
from sightline.tdi.hysteresis import steady_choice
from sightline.tdi.motion_knowledge import MotionKnowledge
from sightline.tdi.motion_mtf import MotionMtf
from sightline.tdi.scan_columns import band_camera, column_geometry, strip_span
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid
from tdi.knowledge_in_memory import motion_knowledge

Array = NDArray[np.float64]
SIZE = {"lines": 1500, "columns": 700}
STAGES, SIGNAL = 96, 400.0
#: Smear of the edge columns, px, and the share of the half-field that does not slip.
SMEAR, STILL = 12.0, 0.3
#: Cycles per pixel at which matches of windows learn most on smeared ground.
FREQUENCY = 0.15


def profile() -> JitterProfile:
    """Drift of 8 px in 0.5 s and broadband jitter of 0.1 px; yaw, by its pixels at the edge, an eighth."""

    def parts(size: float) -> tuple[ConstantJitter | MaternJitter, ...]:
        broadband = MaternJitter.with_corner(0.10 * size, 30.0, "3/2")
        return ConstantJitter(2.0 * size), MaternJitter(8.0 * size, 0.5, "5/2"), broadband

    return JitterProfile(parts(1.0), parts(1.0), parts(0.125))


def rates_known(yaw_px: float, seconds: float, columns: int) -> KnownContent:
    """How fast yaw may turn: of a narrow field pixels at the edge are more than the rates taken for usual.

    Of a Matern 5/2 drift of so many pixels and seconds the rate has a sigma of sqrt(5/3) times their ratio.
    """
    return KnownContent(rate_sigma=max(2.0 * np.sqrt(5.0 / 3.0) * yaw_px / seconds / (columns - 1), 1e-3))


def slip_of(columns: int) -> Array:
    """Slip angle (C,) rad: none in the middle, growing to the edges."""
    x = np.abs(np.linspace(-1.0, 1.0, columns))
    return np.asarray(np.arctan(SMEAR / STAGES * np.maximum(x - STILL, 0.0) / (1.0 - STILL)))


def smeared(scenario: StripScenario, slip: Array, rng: np.random.Generator) -> list[Array]:
    """Images of all bands, each column spread over the pixels that the scene crosses in all stages."""
    images = []
    for band in range(len(scenario.bands)):
        sharp = scenario.image(band).astype(float)
        out, kept = np.empty_like(sharp), np.empty(sharp.shape[1])
        for c in range(sharp.shape[1]):
            width = max(STAGES * float(np.tan(slip[c])), 1e-9)
            reach = int(np.ceil(0.5 * width + 0.5))
            at = np.arange(-reach, reach + 1)
            # share of the smear that falls on each pixel
            share = np.clip(np.minimum(at + 0.5, 0.5 * width) - np.maximum(at - 0.5, -0.5 * width), 0.0, None)
            share /= share.sum()
            out[:, c] = sharp[:, np.clip(c + at, 0, sharp.shape[1] - 1)] @ share
            kept[c] = np.sum(share**2)
        # the smear must not smooth the noise: what it took of its variance is given back
        level = sharp.mean() / scenario.options.snr
        images.append(out + level * np.sqrt(1.0 - kept) * rng.standard_normal(out.shape))
    return images


def predicted_sigma(slip: Array) -> Array:
    """(columns, 2) relative sigma of matches, through the table that a user would give."""
    columns = np.arange(len(slip))
    law, exposure = NoiseLaw(read=12.0), Exposure()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "quality.csv"
        write_columns(
            path,
            {
                "column": columns,
                "mtf_x": np.abs(drift_transfer(STAGES, 1.0, 1.0, slip, FREQUENCY, 0.0)),
                "mtf_y": np.abs(drift_transfer(STAGES, 1.0, 1.0, slip, FREQUENCY, 0.0)),
                "snr": np.full(len(slip), float(snr(SIGNAL, STAGES, 1.0, law, exposure))),
            },
        )
        return read_match_sigma(path, len(slip))


@dataclass(frozen=True)
class Detector:
    """A detector whose outer thirds fill early, and what it may be set to."""

    grid: TdiGrid = field(default_factory=lambda: TdiGrid(np.array([8, 16, 32, 64]), np.array([1.0])))
    law: NoiseLaw = field(default_factory=lambda: NoiseLaw(1e-5, 1.0, 12.0))
    #: Sum of 16 and of 32 stages of the loop's signal with a third of room.
    wells: tuple[float, float] = (1.33 * 16 * SIGNAL, 1.33 * 32 * SIGNAL)

    def of(self, columns: ScanColumns) -> tuple[ScanColumns, TdiDetector]:
        """Its columns, and what each of their kinds is like."""
        third = np.minimum(3 * np.arange(len(columns)) // len(columns), 2)
        plain = TdiDetector(noise=self.law)
        kinds = tuple(replace(plain, full_well_sum=well) for well in self.wells)
        return replace(columns, kind=(third == 1).astype(np.intp)), replace(plain, kinds=kinds)


def chosen(
    detector: Detector, bands: list[Band], knowledge: MotionKnowledge, statics: dict[str, float]
) -> tuple[TdiChoice, MotionMtf]:
    """The choice for a motion, and the MTF of columns behind it."""
    camera = band_camera(bands, bands[0].name, statics)
    geometry = column_geometry(replace(camera, stages=None), Plane(0.0))
    columns, kinds = detector.of(geometry.columns((0.3, 0.3)))
    model = MotionMtf(
        columns, geometry, knowledge, detector.grid, kinds.exposure, ChoiceRules(), strip_span(camera)
    )
    free = choose_settings(model, np.array([SIGNAL]), detector.grid, kinds, ChoiceRules())
    return steady_choice(model, free, 0.02).choice, model


def imaged(scenario: StripScenario, snr_of_column: Array, rng: np.random.Generator) -> list[Array]:
    """Images of all bands with the noise of each column."""
    images = []
    for band in range(len(scenario.bands)):
        clear = scenario.image(band).astype(float)
        images.append(clear + clear.mean() / snr_of_column * rng.standard_normal(clear.shape))
    return images


def loop(seed: int) -> dict[str, float]:
    """One turn of the loop, from motion to motion; NEES, mean of the axes, by the weights of matches."""
    found: dict[str, float] = {}
    detector, size = Detector(), {"lines": 1200, "columns": 390, "profile": profile()}
    first = line_of_sight_case("nominal", seed, **size)
    known = rates_known(1.0, 0.5, size["columns"])
    before = recover_line_of_sight(first.as_given(), Plane(0.0), known=known)
    statics = {s.name: s.value for s in before.statics}
    choice, _ = chosen(detector, first.as_given(), motion_knowledge(before), statics)
    columns = np.arange(size["columns"])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "choice.csv"
        write_choice(path, choice)
        stages = read_stages(path, len(columns), SIGNAL)[0].astype(int)
    scenario = line_of_sight_case(
        "nominal",
        seed + 1000,
        stages=tuple(stages.tolist()),
        time_reference="first-stage",
        snr=3000.0,
        **size,
    )
    images = imaged(scenario, choice.snr[:, 0], np.random.default_rng([seed, 11]))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "quality.csv"
        # MTF of motion at the frequency of matches: averaged over the stages, by the motion that is known
        table = {"column": columns, "snr": choice.snr[:, 0]}
        mtf = np.clip(choice.mtf[:, 0] / choice.columns.static_mtf, 1e-3, 1.0) ** (2.0 * FREQUENCY) ** 2
        write_columns(path, {**table, "mtf_x": mtf[:, 0], "mtf_y": mtf[:, 1]})
        sigma = read_match_sigma(path, len(columns))
    bands = [replace(band, match_sigma=sigma) for band in scenario.as_given(images)]
    counts = "/".join(str(n) for n in stages[np.append(True, np.diff(stages) != 0)])
    for weighting in ("none", "predicted", "covariance"):
        options = RecoverOptions(weighting=weighting)
        after = recover_line_of_sight(bands, Plane(0.0), known=known, options=options)
        score = score_result(after, scenario.truth[:, 0], scenario.truth[:, 1:])
        found[weighting] = float(np.mean([axis.nees for axis in score.axes.values()]))
        ratio = merit_ratio(detector, scenario, bands, after)
        axes = " | ".join(f"{axis.rms:.4f} ({axis.nees:.2f})" for axis in score.axes.values())
        kept = sum(p.kept for p in after.pairs)
        print(f"| {weighting} | {seed} | {counts} | {axes} | {kept} | {ratio:.4f} |", flush=True)
        gates.check(f"loop, seed {seed}, {weighting}: merit over that by the truth", ratio, 0.99)
    return found


def merit_ratio(detector: Detector, scenario: StripScenario, bands: list[Band], result: LineOfSight) -> float:
    """Merit of the settings by a recovered motion over that of those by the truth, worst column."""
    statics = {s.name: s.value for s in result.statics}
    by_motion, _ = chosen(detector, bands, motion_knowledge(result), statics)
    by_truth, true = chosen(detector, bands, MotionKnowledge(scenario.motion), statics)
    merits = [
        merit_of(true, c.signals, c.setting, c.grid, c.detector, c.rules) for c in (by_motion, by_truth)
    ]
    return float((merits[0] / merits[1]).min())


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[100, 101])
    np.seterr(all="ignore")
    print("| weights | seed | roll rms (NEES) | pitch | yaw | windows |")
    print("|---|---|---|---|---|---|")
    seeds = parser.parse_args().seeds
    for seed in seeds:
        scenario = line_of_sight_case("nominal", seed, **SIZE)
        slip = slip_of(SIZE["columns"])
        images = smeared(scenario, slip, np.random.default_rng([seed, 9]))
        sigma = predicted_sigma(slip)
        bands = [replace(band, match_sigma=sigma) for band in scenario.as_given(images)]
        rms: dict[str, float] = {}
        known = rates_known(2.0, 1.0, SIZE["columns"])
        for weighting in ("none", "predicted", "covariance"):
            options = RecoverOptions(weighting=weighting)
            result = recover_line_of_sight(bands, Plane(0.0), known=known, options=options)
            score = score_result(result, scenario.truth[:, 0], scenario.truth[:, 1:])
            rms[weighting] = float(np.sqrt(np.mean([axis.rms**2 for axis in score.axes.values()])))
            if weighting != "none":
                nees = float(np.mean([axis.nees for axis in score.axes.values()]))
                gates.check(f"seed {seed}, {weighting}: NEES, mean of the axes", nees, 0.8, 1.3)
            axes = " | ".join(f"{axis.rms:.4f} ({axis.nees:.2f})" for axis in score.axes.values())
            print(f"| {weighting} | {seed} | {axes} | {sum(p.kept for p in result.pairs)} |", flush=True)
        for weighting in ("predicted", "covariance"):
            gates.check(
                f"seed {seed}: rms by {weighting} over that of none", rms[weighting] / rms["none"], 0.0, 0.75
            )
    print()
    print(
        "| weights | seed | stages | roll rms (NEES) | pitch | yaw | windows | merit over that by the truth |"
    )
    print("|---|---|---|---|---|---|---|---|")
    found = [loop(seed) for seed in seeds]
    for weighting in ("predicted", "covariance"):
        pooled = float(np.mean([of_seed[weighting] for of_seed in found]))
        gates.check(f"loop, {weighting}: NEES, mean of axes and seeds", pooled, 0.8, 1.25)


if __name__ == "__main__":
    gates.run(main, __file__)
