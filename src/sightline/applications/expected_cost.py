"""What a run will take, by sizes alone: seconds of a processor and bytes of memory, before it is begun.

Rates were measured; each stands beside the run that it is from. They distinguish a minute from a day, not one
minute from two: texture, noise and the number of passes do the rest.

Not here: what single keys may hold (``io/quantities.py``).
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sightline.errors import InputError
from sightline.execution import machine_memory, size_words, time_words
from sightline.motion.frames.errors import HELD
from sightline.motion.layout.search import EXHAUSTIVE, MOST_CELLS, choices, expected_trials
from sightline.motion.measure.windows import window_grid

if TYPE_CHECKING:
    from sightline.applications.tdi_choice import TdiProblem
    from sightline.geometry.surface import Surface
    from sightline.motion.band import Band, Frame
    from sightline.motion.frames.passes import FrameOptions
    from sightline.motion.layout.information import RowNoise
    from sightline.motion.layout.search import Candidates
    from sightline.motion.strip.strip import RecoverOptions
    from sightline.photogrammetry.flight.problem import SequenceProblem
    from sightline.photogrammetry.pair.problem import StereoProblem

#: Bytes that Python and the libraries take before anything is read (runs of the smallest cases).
BASE_BYTES = 0.35e9
#: s from which a run is warned of, and share of the memory.
LONG, LARGE = 3600.0, 0.5
#: s beyond which a run is refused: nobody waits for a year.
ENDLESS = 365.0 * 86400.0


@dataclass(frozen=True)
class Cost:
    """What a run takes.

    Attributes
    ----------
    seconds : float
        Of one processor.
    bytes : float
        Of memory, at most at one time.
    of : str
        What it is so much for, with the keys that say so.
    disk : float
        Bytes of files, before compression, where these are worth a word.
    """

    seconds: float
    bytes: float
    of: str
    disk: float = 0.0

    def then(self, other: Cost) -> Cost:
        """Of one after the other."""
        parts = [part for part in (self.of, other.of) if part]
        return Cost(
            self.seconds + other.seconds,
            max(self.bytes, other.bytes),
            " and ".join(parts),
            self.disk + other.disk,
        )

    @property
    def words(self) -> str:
        """``"some 3 min of a processor and 0.6 GB of memory, for 30,000 columns x ..."``."""
        time, size = time_words(max(self.seconds, 1.0)), size_words(self.bytes)
        return f"some {time} of a processor and {size} of memory, for {self.of}"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know before an hour, or half of the memory, is spent; none for a smaller run."""
        there, said = machine_memory(), []
        if self.seconds > LONG:
            said.append(f"this will take some {time_words(self.seconds)} of a processor, for {self.of}")
        if self.bytes > LARGE * there:
            said.append(
                f"this will take some {size_words(self.bytes)} of the {size_words(there)} of memory that may "
                f"be used, for {self.of}"
            )
        return tuple(said)

    def lacks_room(self, folder: Path) -> str:
        """That the files have no room on the disk of a folder, in words; "" where they have."""
        place = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
        free = shutil.disk_usage(place).free
        if self.disk <= free:
            return ""
        return (
            f"{folder}: the files need {size_words(self.disk)}, {size_words(free)} are free there, for "
            f"{self.of}; give less at once, or a folder on another disk with --out"
        )

    def check(self) -> None:
        """InputError for what this machine cannot hold, and nobody can wait for."""
        there = machine_memory()
        if self.bytes > there:
            raise InputError(
                f"{self.of} would take {size_words(self.bytes)} of memory, {size_words(there)} may be used; "
                "give less at once, or use a larger machine"
            )
        if self.seconds > ENDLESS:
            raise InputError(
                f"{self.of} would take {time_words(self.seconds)} of a processor; give less at once"
            )


def search_cost(candidates: Candidates, noise: RowNoise) -> Cost:
    """Of a search for layouts.

    Some 4 million layouts a second are judged where each is improved (8 and 16 detectors on 961 places, 8 on
    4001), a hundred million where all are gone through.
    """
    trials = expected_trials(candidates, noise)
    rate = 1e8 if choices(candidates, noise) <= EXHAUSTIVE else 4e6
    return Cost(
        20.0 + trials / rate,
        BASE_BYTES + 16.0 * MOST_CELLS,
        f"{len(noise.sigma_px)} detectors on {len(candidates.t):,} places (detectors, span, step_px, lines)",
    )


def tdi_cost(problem: TdiProblem) -> Cost:
    """Of ``choose_tdi`` and its files.

    1,000 columns x 16 signals x 620 settings took 8 s and 0.48 GB; 30,000 x 64 x 2,520 50 s and 1.03 GB;
    100,000 x 64 x 620 52 s and 1.05 GB; 20,000 x 500 x 620 62 s and 1.09 GB. Where columns are unlike in
    noise, each kind is judged by itself: 100 kinds x 2,520 settings took 5 s.
    """
    columns, signals, settings = len(problem.columns), len(problem.signals), len(problem.grid)
    cells, kinds = float(columns) * signals, len(problem.detector.kinds)
    steady = problem.hysteresis > 0.0 or problem.largest_step is not None
    return Cost(
        8.0 + 6e-9 * cells * settings + 2e-6 * cells + 2e-5 * kinds * settings,
        BASE_BYTES
        + 0.1e9
        + 6.0 * columns * settings
        + 48.0 * cells
        + (0.4e9 if kinds else 0.0)
        + (5.0 * kinds * signals * settings if steady else 0.0),
        f"[columns] {columns:,} x [signals] {signals:,} x [grid] {settings:,} settings",
    )


def strip_cost(bands: Sequence[Band], options: RecoverOptions, surface: Surface | None = None) -> Cost:
    """Of ``recover_line_of_sight`` and its files.

    Four bands of 6,000 lines x 3,000 columns took 53 s and 0.63 GB; of 300 columns, whose motion is solved on
    the fine grid in every pass, 3,000 lines 26 s and 12,000 lines 91 s: 0.27 us for a pixel of a pair, and 2
    or 5.5 ms for a line. Memory is 1.9 bytes for a pixel of a pair at most. The solution costs the square of
    the longest lag, which `surface` lets be known: 1,640 lines on nodes two lines apart took some 400 s of
    3,200 lines, on nodes five lines apart 20 s.
    """
    finest = min(band.camera.detector.line_period for band in bands)
    columns = max(band.image.shape[1] for band in bands)
    # of the finest image: coarse ones last as many times longer
    lines = max(round(band.image.shape[0] * band.camera.detector.line_period / finest) for band in bands)
    pairs = len(options.pairs) or len(bands) * (len(bands) - 1) // 2
    pixels = float(lines) * columns * pairs
    (height, width), usual = options.window, 4.0
    rows = height / (usual * max(options.step / usual, 0.25))
    # the window of the first pass with its search, over the pixels that it stands for
    first = (options.first_window[0] + 2 * options.search_px[0]) * (
        options.first_window[1] + 2 * options.search_px[1]
    )
    searched = first / (2.0 * options.first_window[0] * options.first_window[1]) / 1.5
    windows = 100.0 / width * usual / options.step
    from sightline.motion.strip.strip import longest_lag, suited

    wide = columns // width > options.draft_blocks
    each = 2e-3 if wide else 5.5e-3
    solved = 0.0
    if surface is not None and pairs:
        lag = longest_lag([band.camera for band in bands], surface)
        nodes = 3.0 / suited(options, bands, surface).grid_lines
        solved = (0.3 if wide else 1.0) * 9e-9 * nodes * (lines + lag) * (nodes * lag) ** 2
    return Cost(
        12.0 + solved + each * lines + 0.27e-6 * pixels * (0.9 * max(rows, 0.1) + 0.1 * searched),
        BASE_BYTES + 0.2e9 + 1.9 * pixels * max(windows, 0.05) + 200.0 * first,
        f"{len(bands)} bands of {lines:,} lines x {columns:,} columns in {pairs:,} "
        f"{'pair' if pairs == 1 else 'pairs'}"
        if pairs
        else f"one band of {lines:,} lines x {columns:,} columns, by its control points",
    )


def frames_cost(
    frames: Sequence[Frame], surface: Surface, options: FrameOptions, height_sigma: float
) -> Cost:
    """Of ``recover_frame_attitude`` and its files.

    5 frames of 768 x 1024 px (190 windows, lags of 1 to 5) took 21 s, 20 of them 19 s and 0.38 GB: half a
    millisecond for a window at a lag, and less. What windows of one image share is asked of each two of them:
    3 such frames took 8 s of a processor and 0.39 GB with a step of 20 px, 31 s and 0.78 GB with 10. Heights
    are one dense solution of all windows: 15 s for 900.
    """
    count, (lines, columns) = len(frames), frames[0].image.shape
    step = options.spacing(options.window, (lines, columns), count, height_sigma)
    windows = float(np.prod(window_grid((lines, columns), options.window, step, columns_step=step).shape))
    lags = [lag for lag in options.lags if lag < count]
    shares = [_common_share(frames, surface, lag) for lag in lags]
    matches = windows * sum(share * (count - lag) for share, lag in zip(shares, lags, strict=True))
    unknowns = 4.0 * count + 50.0
    used = windows * (max(shares) + sum(shares))  # in one image, as a hub and as a partner
    turns = 3.0 + 4.0 * min(options.passes, 3)
    of = f"{count:,} frames of {lines:,} lines x {columns:,} columns, {windows:,.0f} windows each"
    seconds = 12.0 + 5e-4 * matches + 2e-8 * turns * count * used**2 + 1e-8 * matches * unknowns**2
    size = 100.0 * lines * columns + (1000.0 + 80.0 * unknowns) * matches + 56.0 * min(used**2, HELD)
    if height_sigma > 0.0:
        heights = windows * (count - 1)
        seconds += 10.0 + 4e-9 * heights**3
        size += 56.0 * heights**2
        of += ", their heights unknown (height_sigma)"
    return Cost(seconds, BASE_BYTES + size, of + ("" if options.step is None else " ([matching] step)"))


def _common_share(frames: Sequence[Frame], surface: Surface, lag: int) -> float:
    """Mean share of a frame that another sees too, so many frames later, by the nominal cameras."""
    lines, columns = frames[0].image.shape
    places = np.stack(
        np.meshgrid(*(np.linspace(0.0, size - 1.0, 8) for size in (lines, columns))), axis=-1
    ).reshape(-1, 2)
    asked = np.unique(np.linspace(0, len(frames) - 1 - lag, 20).astype(int))
    seen = []
    for k in asked:
        found = frames[k + lag].camera.project(frames[k].camera.locate(places, surface))
        with np.errstate(invalid="ignore"):
            seen.append(((found >= 0.0) & (found <= np.array([lines, columns]) - 1.0)).all(axis=1).mean())
    return float(np.mean(seen))


def spin_cost(frames: Sequence[Frame], windows: float, lags: int) -> Cost:
    """Of ``recover_spin_attitude`` with so many windows a frame, and lags: by the rates for frames."""
    matches = float(len(frames)) * windows * min(lags, len(frames) - 1)
    lines, columns = frames[0].image.shape
    return Cost(
        12.0 + 5e-4 * matches,
        BASE_BYTES + 100.0 * float(lines) * columns + 1000.0 * matches,
        f"{len(frames):,} frames of {lines:,} lines x {columns:,} columns",
    )


def orientation_cost(problem: StereoProblem) -> Cost:
    """Of ``orient`` and its files.

    64 shots of 300 points by two cameras took 12 s and 0.34 GB, of 20,000 points 73 s and 1.8 GB; 256 of
    3,000 42 s and 3.2 GB; 512 of 1,500 24 s and 1.7 GB; 1,024 of 300 9 s and 0.63 GB.
    """
    sightings = len(problem.tracks)
    return orientation_cost_of(sightings, f"{sightings:,} sightings in {len(problem.images):,} images")


def orientation_cost_of(sightings: float, of: str) -> Cost:
    """The same of so many sightings, in words of the caller's."""
    return Cost(8.0 + 2.5e-5 * sightings, BASE_BYTES + 1000.0 * sightings, of)


def prediction_cost(cameras: int, shots: int, points: int) -> Cost:
    """Of ``predict_plan``, which asks for some ninety bounds of up to four times as many shots or points.

    32 shots of 300 points took 6 s and 0.32 GB, of 3,000 points 58 s and 0.74 GB.
    """
    from sightline.applications.stereo_prediction import MOST_POINTS, MOST_SHOTS, MOST_TABLED

    sightings = float(cameras) * shots * points
    more = max(min(4.0, MOST_SHOTS / shots), min(4.0, MOST_POINTS / points), 1.0)
    each = 2.7e-4 if sightings <= MOST_TABLED else 4e-5
    return Cost(
        6.0 + each * sightings,
        BASE_BYTES + 1000.0 * sightings * more,
        f"[plan] {shots:,} shots x {points:,} points x {cameras:,} cameras",
    )


def flight_cost(problem: SequenceProblem) -> Cost:
    """Of ``georeference_sequence``, maps left out.

    10,000 frames of 160 x 200 px took 151 s and 0.34 GB (``docs/validation.md``): 15 ms and 8 kB a frame,
    27 ms and 115 kB up to a thousand, which are solved at once; reading adds 20 ns a pixel, four times over.
    """
    frames, pixels = len(problem), float(problem.detector.shape[0]) * problem.detector.shape[1]
    each = 0.015 if frames >= 1000 else 0.027
    return Cost(
        8.0 + frames * (each + 8e-8 * pixels),
        BASE_BYTES + (115e3 * min(frames, 1000) + 8e3 * frames) + 60.0 * pixels,
        f"{frames:,} frames of {problem.detector.shape[0]:,} lines x {problem.detector.shape[1]:,} columns",
    )


#: Values of all maps together, 4 bytes each before compression: a country at ten centimetres has so many.
MOST_MAPPED = 1e12


def maps_cost(frames: int, shape: tuple[int, int], grid: tuple[int, int], bands: int) -> Cost:
    """Of the maps of a flight: `frames` of `shape` px laid on a map of `grid` px in so many bands.

    200 frames of 480 x 320 px took 47 ms each and 9 s besides (``docs/validation.md``): 0.3 us for a pixel of
    a frame, as much again for one of the maps, written and compressed.
    """
    seen, made = float(frames) * shape[0] * shape[1], float(grid[0]) * grid[1] * bands
    if made > MOST_MAPPED:
        raise InputError(
            f"[cube] {_maps(bands)} of {grid[0]:,} rows x {grid[1]:,} columns: {size_words(4.0 * made)} "
            "before compression; give a larger gsd (m), fewer bands, or correct positions and heights"
        )
    return Cost(
        3e-7 * (seen + made),
        BASE_BYTES + 0.3e9,
        f"[cube] {_maps(bands)} of {grid[0]:,} rows x {grid[1]:,} columns (gsd)",
        4.0 * made,
    )


def _maps(bands: int) -> str:
    """So many maps, in words."""
    return f"{bands:,} map{'s' if bands != 1 else ''}"


def rendering_cost(pixels: float, ground: float, of: str) -> Cost:
    """Of a simulated strip or flight of so many pixels in all its images, over so many of the ground.

    Four bands of 3,000 x 4,000 px took 10 s and 1 GB, three of 1,500 x 640 behind a mirror 5 s, 400 frames of
    512 x 640 px 25 s and 0.53 GB.
    """
    return Cost(2.0 + 5e-7 * pixels, BASE_BYTES + 55.0 * ground, of)
