"""What a ``summary.json`` holds, by the class of the result: the schema of every command's summary.

The keys that all of them have are named alike. Units are SI and radians unless a name says otherwise. A
number that is not finite is null. ``docs/formats.md`` says more of each key.

Not here: how the numbers are made (the writers beside this file).
"""

from __future__ import annotations

import functools
import operator
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

#: None: not finite, or not known.
Number = float | None
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Count = Annotated[int, Field(ge=0)]
Pair = tuple[Number, Number]


def _is(text: str) -> Any:
    """A key that is always there."""
    return Field(description=text)


def _may(text: str) -> Any:
    """A key that is left out where it does not apply."""
    return Field(default=None, description=text)


class SummaryPart(BaseModel):
    """An object of a summary: no key but those listed."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Axes(SummaryPart):
    """A number of each axis."""

    roll: Number
    pitch: Number
    yaw: Number


class ResultSummary(SummaryPart):
    """What every summary says."""

    result: str = _is("Class of the result in Python, by which sightline.open_result knows it")
    version: str = _is("Of Sightline")


class RunSummary(ResultSummary):
    """What the summary of every command says."""

    name: str = _is("Of what was read, as its file calls it")
    warnings: list[str] = _is("What to know before trusting the numbers")
    wall_seconds: Annotated[float, Field(ge=0.0)] = _is("s, of the whole run")
    peak_memory_bytes: Count | None = _is("Most memory of the process; null where the system does not say")
    inputs: dict[str, Annotated[str, Field(pattern="^[0-9a-f]{64}$")]] = _is(
        "SHA-256 of every file that was read, by its name"
    )


# --------------------------------------------------------------------------------------- recover


class FoundTone(SummaryPart):
    """A line in the spectrum of an axis."""

    axis: str
    name: str = _is("Its frequency, and what it is a multiple of")
    frequency: float = _is("Hz")
    sigma_frequency: Number = _is("Hz")
    amplitude: float = _is("rad")
    sigma_amplitude: Number = _is("rad")
    width: Number = _is("Hz; 0: steady")
    false_alarm: Number = _is("Probability of so strong a peak without a tone")
    error_frequency: Number = _is("Hz, the part of sigma that the error of the estimate makes")
    error_amplitude: Number = _is("rad, likewise")


class AxisTones(SummaryPart):
    """Tones of each axis."""

    roll: list[FoundTone]
    pitch: list[FoundTone]
    yaw: list[FoundTone]


class AxisBands(SummaryPart):
    """[low, high] Hz of each axis."""

    roll: list[tuple[float, float]]
    pitch: list[tuple[float, float]]
    yaw: list[tuple[float, float]]


class Method(SummaryPart):
    """The estimator."""

    name: str
    rms_departure_from_joint_px: Axes | None = _may("px, of an estimator beside the joint one")
    rms_stated_sigma_px: Axes | None = _may("px, the sigma that it would state by itself")


class MatchCounts(SummaryPart):
    """Windows of all pairs."""

    tried: Count
    kept: Count
    rejected: dict[str, Count] = _is("By reason")


class ImagePair(SummaryPart):
    """Windows of one pair of images."""

    images: tuple[str, str]
    lag: Number = _is("s; null: no window was kept")
    tried: Count
    kept: Count
    rejected: dict[str, Count] = _is("By reason")
    rms_before_px: Number = _is("Against the nominal cameras")
    rms_after_px: Number = _is("After the estimate")
    sigma_px: Number = _is("What the error model expects of the latter")


class Withheld(SummaryPart):
    """One axis of a pair of bands that the estimate did not use, against what it predicts of it."""

    pair: tuple[str, str]
    axis: Literal["along", "across"]
    count: Count = _is("Windows compared; none overlaps another")
    samples: Number = _is("Independent ones that they are worth")
    nees: Number = _is("Mean of (measured less predicted, over its sigma)^2: 1 where the sigmas are true")
    coverage: Share = _is("Share within 1.96 sigma: 0.95 where they are true")
    rms_px: Number = _is("Of measured less predicted")
    sigma_px: Number = _is("rms of its sigma: prediction and matches, less what they share")
    prediction_sigma_px: Number = _is("rms of the sigma of the prediction alone")
    asked: bool = _is("Left out on demand; else one that the estimate does without")


class FittedControl(SummaryPart):
    """Control points of a strip of one band."""

    points: Count = _is("Seen on the band, during its lines")
    kept: Count = _is("Not contradicted by the others")
    residual_rms_before_px: Number = _is("px, of both coordinates of those kept, against the nominal camera")
    residual_rms_px: Number = _is("px, of the same after the estimate")
    residual_sigma_px: Number = _is("px, rms of their own sigma")


class Static(SummaryPart):
    """A constant of a band."""

    name: str
    unit: str
    value: float
    sigma: Number
    prior_sigma: Number = _is("Before the images")


class UsedSensor(SummaryPart):
    """What an attitude sensor, or control points, gave."""

    name: str
    kind: str
    given: Count
    used: Count
    outliers: Count
    sigma_factor: list[Number] = _is("Per axis: by how much its sigma was enlarged")
    constants: dict[str, Pair] = _is("Its own constants: value and sigma")


class FoundRelief(SummaryPart):
    """The ground that was found."""

    file: str
    image: str = _is("Whose times its rows are of")
    rms_height: float = _is("m")
    rms_slope: float = _is("m")
    sigma_height: Number = _is("m")
    sigma_slope: Number = _is("m")


class Hidden(SummaryPart):
    """What the images cannot see."""

    table: str
    names: list[str]
    words: list[str]
    covariance: list[list[Number]] | None = _may("rad^2")


class RecoverySummary(RunSummary):
    """Of ``recover``."""

    result: Literal["LineOfSight", "FrameAttitude", "SpinAttitude"] = _is("Class of the result in Python")
    epoch: str | None = _is("UTC of t = 0")
    images: list[str] = _is("Names of bands or frames")
    reference_image: str = _is("The one whose lines motion.csv has")
    lines: Count = _is("Rows of motion.csv")
    ifov: float = _is("rad, of a pixel")
    half_field_px: float = _is("px from the middle of the field to its edge")
    half_field: float = _is("rad, likewise")
    scale: Axes = _is("rad of one px; of yaw at the edge of the field")
    method: Method = _is("The estimator")
    highest_frequency: float = _is("Hz, up to which frequencies are spoken of")
    passbands: AxisBands = _is("Hz, per axis: where a steady tone of 0.1 px would stand out by 5 sigma")
    blind_frequencies: dict[str, list[float]] = _is("Hz, per pair of images: multiples of 1 / lag")
    tones: AxisTones = _is("Of 3 sigma or more")
    tones_hardly_seen: AxisTones = _is("Below 3 sigma")
    microvibration: dict[str, Any] | None = _is("Of a strip: tones through time, smear; null of frames")
    rms_motion: Axes = _is("rad, hidden directions removed")
    rms_motion_px: Axes = _is("px, likewise")
    rms_sigma: Axes = _is("rad")
    rms_sigma_px: Axes = _is("px")
    median_sigma_px: Axes = _is("px")
    max_sigma_px: Axes = _is("px")
    absolute_sigma_px: Axes = _is("px, rms of sigma_absolute; null where nothing ties the axis")
    observed_share: Share = _is("Of the lines: matches speak of them")
    residual_rms_px: Number = _is("px, of the windows kept, after the estimate")
    residual_rms_before_px: Number = _is("px, of the same against the nominal cameras")
    residual_sigma_px: Number = _is("px, what the matches' own sigma asks for of the windows kept")
    residual_rms_rejected_px: Number = _is("px, of the windows rejected; null where there are none")
    matches: MatchCounts = _is("Windows of all pairs")
    pairs: list[ImagePair] = _is("Windows of each pair")
    withheld: list[Withheld] = _is("Pairs that the estimate did not use, predicted from it; may be empty")
    control: FittedControl | None = _may("Of a strip of one band: what its control points leave")
    relief: FoundRelief | None = _is("The ground that was found; null where none was sought")
    statics: list[Static] = _is("Offsets, rotations, scales and shapes of the bands")
    sensors: list[UsedSensor] = _is("What attitude sensors and control points gave")
    hidden_directions: Hidden | None = _is("What the images cannot see; null: all is seen")
    changes: list[Number] = _is("Change of the motion per pass, in its sigmas")
    sources: list[str] | None = _may("What orbit and attitudes are: axes, time scale, Earth orientation")
    spin: dict[str, Any] | None = _may("Of a spinning camera: rate, axis, strips, departures of exposures")


# --------------------------------------------------------------------------------------- register


class RegisteredBand(SummaryPart):
    """A band on the common grid."""

    name: str
    valid_share: Share
    type: str
    placed_by: Literal["matches", "motion", "cameras"]


class PairMisfit(SummaryPart):
    """How well two bands fit, along and across."""

    rms_px: Pair
    noise_px: Pair = _is("What the matches' own sigma makes of it")
    mean_px: Pair
    windows: Count
    kept: Count


class FittedPair(SummaryPart):
    """Two bands before and after."""

    images: tuple[str, str]
    before: PairMisfit
    after: PairMisfit


class Kernel(SummaryPart):
    """How bands were resampled."""

    taps: Count
    band: float = _is("Cycles per pixel up to which it is true")
    mask_share: float
    map_tolerance_px: float


class OfRecovery(SummaryPart):
    """The recovery whose motion was used."""

    name: str | None
    version: str | None
    reference_image: str | None


class RegistrationSummary(RunSummary):
    """Of ``register``."""

    result: Literal["Registration"] = _is("Class of the result in Python")
    onto: str = _is("The reference band")
    shape: tuple[Count, Count] = _is("Lines and columns")
    files: list[str] = _is("Names of the images")
    bands: list[RegisteredBand] = _is("Share with a value, pixels, what placed it")
    pairs: list[FittedPair] = _is("How well each pair of bands fits, before and after")
    kernel: Kernel = _is("How bands were resampled")
    motion: OfRecovery = _is("Name, version and reference image of the recovery")


class MosaicSummary(RunSummary):
    """Of ``register`` of frames of a spinning camera."""

    result: Literal["Mosaic"] = _is("Class of the result in Python")
    strips: list[str] = _is("Names of the bands of the picture")
    lines: Count = _is("Of the picture")
    columns: Count = _is("Of the picture")
    focal_length_px: float = _is("px, of the pinhole that it is of")
    files: list[str] = _is("Names of the pictures")


# --------------------------------------------------------------------------------------- layout


class CommonLag(SummaryPart):
    """Lags that go blind together."""

    frequency: float = _is("Hz")
    pairs: list[Any]
    periods: list[Any] = _is("Whole periods in each")
    mismatch: float = _is("Periods")


class RankedLayout(SummaryPart):
    """One layout."""

    name: str
    positions_px: list[float]
    positions_s: list[float]
    images: list[int] = _is("Which entry of image_sigma_px stands at each place")
    span_s: float
    worst_information: Number = _is("px^-2 per row of windows, at the worst frequency of the band")
    worst_images: Number = _is("The same in images")
    worst_frequency: Number = _is("Hz")
    sigma_px: Number
    harmonic_sigma_px: Number
    band_sigma_px: Number
    blind_frequencies: list[float] = _is("Hz")
    common_lags: list[CommonLag]


class BySpan(SummaryPart):
    """The best worst case of each span."""

    span_s: list[float]
    worst_information: list[Number]
    harmonic_sigma_px: list[Number]


class LayoutSummary(RunSummary):
    """Of ``layout``."""

    result: Literal["LayoutChoice"] = _is("Class of the result in Python")
    passband: tuple[float, float] = _is("Hz")
    detectors: Count = _is("How many")
    ranked: list[RankedLayout] = _is("Layouts found, the best first")
    compared: list[RankedLayout] = _is("Those of the file, then the published ones")
    gain_over: dict[str, Number] = _is("Worst case of the best over that of each; null: that is blind")
    by_span: BySpan = _is("The best worst case of each span")
    prior: list[dict[str, Any]] = _is("Components of the motion, by kind")
    duration: float = _is("s")
    highest_frequency: float = _is("Hz")
    tried: float = _is("Layouts gone through")
    exhaustive: bool = _is("Whether those are all on the grid")


# --------------------------------------------------------------------------------------- orient


class Angles(SummaryPart):
    """Angles of a camera about its body axes, with sigmas."""

    roll: Number
    pitch: Number
    yaw: Number
    sigma_roll: Number
    sigma_pitch: Number
    sigma_yaw: Number


class Direction(SummaryPart):
    """A combination of the angles."""

    sigma: Number = _may("rad; null: not observable")
    direction: dict[str, float] = _is("Unit vector, by names of angles")
    words: str


class Focal(SummaryPart):
    """A focal length that was refined."""

    focal_length_px: float
    sigma_px: Number


class StereoMatches(SummaryPart):
    """Matches of a pass."""

    kind: Literal["pairs", "sightings"]
    tried: Count
    kept: Count
    rejected: Count
    unchecked: Number = _is("Share of those used that others could contradict in one direction only")
    rms_px: Number


class ChiSquare(SummaryPart):
    """Whether residuals are as large as the sigmas say."""

    per_degree: Number
    sigma: Number
    verdict: str


class Heights(SummaryPart):
    """Heights of points before and after, m."""

    mean_change: Number
    rms_change: Number
    median_sigma: Number


class AngleImprovement(SummaryPart):
    """What would better the angles."""

    change: str
    sigmas: list[Number] = _is("rad, of all angles")
    ratio: list[Number] = _is("To the bounds as things are")


class OrientationSummary(RunSummary):
    """Of ``orient``."""

    result: Literal["StereoOrientation"] = _is("Class of the result in Python")
    epoch: str | None = _is("UTC of t = 0")
    method: str = _is("ml-track, ml-pair, epipolar or plane")
    cameras: list[str] = _is("Names")
    images: Count = _is("How many")
    shots: Count = _is("How many")
    points: Count = _is("How many")
    window_seconds: float = _is("s from the first image to the last")
    angles: dict[str, Angles] = _is("rad, per camera")
    principal_sigmas: list[Direction] = _is("Independent combinations, the weakest first")
    unobservable: list[Direction] = _is("Directions that are not observable")
    drift: dict[str, Angles] | None = _is("rad/s per camera; null where none was sought")
    focal_length: dict[str, Focal] | None = _is("px, per camera, where it was refined")
    bias_removed: list[list[Number]] | None = _is("rad per camera and axis, of epipolar")
    matches: StereoMatches = _is("Pairs or sightings")
    cost: Number = _is("Of the adjustment")
    degrees_of_freedom: int | None = _is("Of the adjustment")
    chi_square: ChiSquare = _is("Whether residuals are as large as the sigmas say")
    heights: Heights = _is("m, how far the points' heights moved")
    iterations: Count | None = _is("Of the estimate")
    solve_seconds: float = _is("s, of the estimate alone")
    improvements: list[AngleImprovement] | None = _may("What would better the angles, where it was reckoned")
    export_notes: list[str] | None = _may("Why an export is missing")


class SigmasAgainst(SummaryPart):
    """Bounds against one quantity."""

    quantity: str
    unit: str
    planned: Number
    values: list[Number]
    how: str
    sigmas: dict[str, list[list[Number]]] = _is("rad, by method: of every angle at every value")
    weakest: dict[str, list[Any]]


class PredictionSummary(RunSummary):
    """Of ``orient --predict``."""

    result: Literal["StereoPrediction"] = _is("Class of the result in Python")
    method: str = _is("ml-track or ml-pair")
    cameras: list[str] = _is("Names")
    points_from: str = _is("Which points, in words")
    points: Count = _is("How many")
    shots: Count = _is("How many")
    sightings: Count = _is("How many")
    baseline: Number = _is("m")
    window_seconds: float = _is("s")
    sigmas: dict[str, Axes] = _is("rad, per camera")
    principal_sigmas: list[Direction] = _is("Independent combinations, the weakest first")
    unobservable: list[Direction] = _is("Directions that are not observable")
    tables: list[SigmasAgainst] = _is("Bounds when one quantity changes")
    improvements: list[AngleImprovement] = _is("What would better the angles")


# --------------------------------------------------------------------------------------- georeference


class NotEstimated(SummaryPart):
    """A frame whose own image gives no pose."""

    frame: str
    reason: str


class ChosenFrames(SummaryPart):
    """Frames of the subset."""

    frames: list[str]
    overlap: float


class Sigmas(SummaryPart):
    """Of all frames."""

    median: Number
    largest: Number


class DatumPart(SummaryPart):
    """A constant error of the tables (table less truth)."""

    bias: float
    sigma: Number


class FarthestRow(SummaryPart):
    """The frame whose pose a table misses most."""

    frame: str
    chi_squared: Number = _is("Of three numbers")


class TablePart(SummaryPart):
    """A table of positions or attitudes beside the poses found."""

    frames: Count = _is("Of which it says something")
    numbers: Count = _is("Three a frame, three of the constant error")
    chi_squared: Number = _is("Of all of them, over their sigmas")
    chi_squared_99: Number = _is("What it exceeds by chance in one of a hundred flights at most")
    farthest: FarthestRow


class FoundFocal(SummaryPart):
    """px; the focal length that was found with the poses."""

    focal_length_px: float
    sigma_px: Number
    told_px: float = _is("As given")
    told_sigma_px: Number = _is("As given; null: not known at all")


class RigEntry(SummaryPart):
    """A camera of a rig: how it sits against the first."""

    camera: str
    wavelength_nm: Number = _is("Null: all light")
    orientation: tuple[float, float, float] = _is("rad, rotation vector about body axes")
    orientation_sigma: tuple[Number, Number, Number]
    position: tuple[float, float, float] = _is("m, body axes")
    position_sigma: tuple[Number, Number, Number]
    focal_length_px: float
    focal_length_sigma_px: Number = _is("0: kept as given")
    prior: str = _is("Where the orientation beforehand is from")
    observed: list[str] = _is("What the images know better than was given")
    held: list[str] = _is("What they do not: as given")
    images: Count = _is("That can be used")
    sightings: Count = _is("Good ones")
    rms_px: Number = _is("Of their residuals; null without any")


class SightingCounts(SummaryPart):
    """Windows followed from frame to frame."""

    tried: Count
    kept: Count
    rejected: Count
    rms_px: Number


class CubeBand(SummaryPart):
    """Shares of a band's map."""

    name: str
    wavelength_nm: Number
    coverage: Number
    passed: Number
    beyond: Number
    map_share: Number
    seams: Number
    seam_jump: Number


class CubePair(SummaryPart):
    """How well two bands lie on each other."""

    bands: tuple[int, int]
    rms_px: Number
    noise_px: Number
    windows: Count


class CubeEntry(SummaryPart):
    """Maps of the bands."""

    files: list[str] = _is("Names of the maps")
    shape: tuple[Count, Count] = _is("Rows and columns")
    gsd: float = _is("m")
    extent: tuple[float, float, float, float] = _is("West, south, east, north, m")
    crs: str | None = _is("WKT; null of a local world")
    surface: str = _is("The heights that were used")
    height_sigma: Number = _is("m")
    area: Number = _is("m^2 that every band could see")
    bands: list[CubeBand] = _is("Shares of each band's map")
    pairs: list[CubePair] = _is("How well bands lie on each other")
    frames_used: Count = _is("How many")
    unread: list[str] = _is("Frames that could not be read, and why")
    warnings: list[str] = _is("What to know before trusting the maps")


class FoundReadout(SummaryPart):
    """Time from the first line to the last of a rolling shutter, found with the poses."""

    seconds: float = _is("s")
    sigma: float = _is("s, 1-sigma")
    given: float = _is("s")
    given_sigma: float = _is("s, 1-sigma of what was given")


class SequenceSummary(RunSummary):
    """Of ``georeference``."""

    result: Literal["SequencePoses"] = _is("Class of the result in Python")
    epoch: str | None = _is("UTC of t = 0")
    frames: Count = _is("How many")
    sources: dict[str, Count] = _is("How many poses are solved, estimated, interpolated")
    not_estimated: list[NotEstimated] = _is("Frames whose own image gives no pose, and why")
    stretches: Count = _is("Of frames that hang together")
    subset: ChosenFrames = _is("Frames of the subset, and what they were to share")
    sigmas: dict[str, Sigmas] = _is("m and rad: median and largest of all frames")
    datum: dict[str, DatumPart | None] = _is("m and rad: constant errors of the tables; null: none sought")
    tables: dict[str, TablePart] = _is("positions, attitudes: whether they go with the poses found")
    focal_length: FoundFocal | None = _is("Where it was found with the poses")
    readout_time: FoundReadout | None = _may("Where it was found with the poses")
    scale_sigma: Number | None = _may("Relative 1-sigma of the size of the flight as a whole")
    rig: list[RigEntry] | None = _may("Cameras of a rig; null, or left out, of one camera")
    bow: list[dict[str, float]] = _is("rad: bends that were left free, by axis")
    sightings: SightingCounts = _is("Windows followed from frame to frame")
    points: Count = _is("Of the ground")
    method: str = _is("all-frames, or that of the document")
    cube: CubeEntry | None = _may("Maps of the bands; null, or left out, where none were made")
    registered: str | None = _may("Bands of a single capture on its first camera: the file")
    export_notes: list[str] | None = _may("Why an export is missing")


class CubeResultSummary(ResultSummary, CubeEntry):
    """Of maps written by themselves in Python."""

    result: Literal["CubeSummary"] = _is("Class of the result in Python")


# --------------------------------------------------------------------------------------- tdi, noise


class Spread(SummaryPart):
    """Least, mean and most."""

    min: Number
    mean: Number
    max: Number


class TdiSummary(RunSummary):
    """Of ``tdi``."""

    result: Literal["TdiResult"] = _is("Class of the result in Python")
    columns: Count = _is("How many")
    signals: Count = _is("How many")
    settings: Count = _is("Stages x ratios")
    model: str = _is("exact or patent")
    merit: str = _is("As asked")
    frequencies: list[float] = _is("Cycles per px, as asked")
    scan_velocity: Spread = _is("px per line period, over the columns")
    slip: Spread = _is("rad, over the columns")
    stages: Spread = _is("Of the choice")
    integration_ratio: Spread = _is("Of the choice")
    mtf_x: Spread = _is("Of the choice")
    mtf_y: Spread = _is("Of the choice")
    snr: Spread = _is("Of the choice")
    limits: dict[str, Count] = _is("Cells by what decided them")
    infeasible: Count = _is("Cells in which no setting keeps all limits")
    steady: dict[str, Any] | None = _is("What hysteresis and max_step did; null without")
    other_ways: list[dict[str, Any]] = _is("Relative merit of simpler choices")
    table: dict[str, Any] = _is("certified_loss, bytes and more of the table of words")
    motion: dict[str, Any] | None = _is("Of --motion; else null")
    predicted_loss: dict[str, Any] | None = _is("Merit lost to what is not known; null: all is exact")
    signal_image: dict[str, Any] | None = _may("Of --signals")


class NamedFigure(SummaryPart):
    """One figure of a detector's noise."""

    name: str
    unit: str
    value: Number
    sigma: Number = _is("Null of a bound")
    relation: Literal["=", "<=", ">="]
    how: str


class ImageFigures(SummaryPart):
    """Figures of one image."""

    name: str
    figures: list[NamedFigure]


class NoiseTable(SummaryPart):
    """The [noise] of a TDI.toml."""

    gain: Number
    shot: Number
    read: Number
    dark: Number
    output: Number
    column_fixed: Number


class NoiseColumns(SummaryPart):
    """The column pattern."""

    count: Count
    flagged: dict[str, Count]
    rms_gain: Number


class NoiseExposure(SummaryPart):
    """Frames of one exposure."""

    name: str = _is("Of the first frame")
    frames: Count
    signal: Number = _is("DN above the level without light")
    variance: Number = _is("DN^2 between frames, rounding taken off; null: cut off")
    sigma: Number = _is("Of the variance; null: cut off")
    cut: Number = _is("Share of pixels that are cut off")
    used: bool = _is("For the conversion gain")


class ColumnsAlike(SummaryPart):
    """Whether columns differ by more than their sigma."""

    alike: bool = _is("Not seen to differ, at 3 sigma")
    chi_square: Number
    freedom: Count
    scatter: Number = _is("rms beyond their sigma")
    upper: Number = _is("Its upper limit, 2 sigma")


class NoiseTransfer(SummaryPart):
    """Photon transfer of frames of even light."""

    exposures: list[NoiseExposure] = _is("By signal")
    columns: dict[str, ColumnsAlike] = _is("conversion (DN/e-), gain (1), offset (DN; with dark frames)")


class NoiseSummary(RunSummary):
    """Of ``noise``."""

    result: Literal["DetectorNoise"] = _is("Class of the result in Python")
    unit: Literal["e-", "DN"] = _is("What signals are counted in")
    stages: Count = _is("TDI stages of the images")
    electrons_per_dn: Number = _is("Null: not known")
    noise: NoiseTable = _is("The law, as TDI.toml has it")
    signals: list[Number] = _is("Of one line: least and most of the images")
    full_well_sum: Number = _is("Null: not seen")
    figures: list[NamedFigure] = _is("Of all images together")
    images: list[ImageFigures] = _is("Of each image")
    columns: NoiseColumns = _is("The column pattern")
    photon_transfer: NoiseTransfer | None = _may("Of frames of even light; else null")


# --------------------------------------------------------------------------------------- match


class ShiftFigures(SummaryPart):
    """Windows of two images, and their shifts (lines, columns) on the whole."""

    images: tuple[str, str] = _is("Names")
    geometry: Literal["map", "pixels"] = _is("How the second was laid on the first")
    window: tuple[Count, Count] = _is("px of the first image; lines and columns")
    step: tuple[Count, Count] = _is("px from one window to the next")
    first: tuple[float, float] = _is("px; centre of the first window")
    grid: tuple[Count, Count] = _is("Rows and columns of windows")
    reduced: Count = _is("px a side of the first image that were averaged: those of the second are as large")
    common_px: Pair = _is("px; shift of the whole image, about which windows were sought")
    common_strength: Number = _is("Sigmas by which it stands out; null: it was not searched")
    median_px: Pair = _is("px, of the windows kept")
    mean_px: Pair = _is("px")
    rms_px: Pair = _is("px")
    scatter_px: Pair = _is("px; standard deviation of the windows")
    sigma_px: Pair = _is("px; median sigma of a window")
    windows: MatchCounts = _is("How many")


class RasterMatchSummary(RunSummary, ShiftFigures):
    """Of ``match``."""

    result: Literal["RasterMatches"] = _is("Class of the result in Python")


class BandPair(ShiftFigures):
    """Two bands of a file."""

    suffix: str = _is("End of the names of their files")


class BandMatchSummary(RunSummary):
    """Of ``match --bands``."""

    result: Literal["BandMatches"] = _is("Class of the result in Python")
    bands: list[str] = _is("Names")
    pairs: list[BandPair] = _is("Of the pairs that were matched")


class TiedImage(SummaryPart):
    """An image that was tied to a reference."""

    name: str
    points: Count = _is("Control points of it")
    offset_px: Pair = _is("px (lines, columns), median: the image less its camera as given")
    strength: Number = _is("Sigmas by which the shift that its windows share stands out")
    sigma_px: Pair = _is("px; median sigma of a match")
    windows: MatchCounts = _is("How many")


class TieSummary(RunSummary):
    """Of ``tie``."""

    result: Literal["ReferenceTie"] = _is("Class of the result in Python")
    reference: str = _is("Name of its file")
    points: Count = _is("Control points in all")
    control_sigma_px: float = _is("px; of the pixels of all")
    sigma: Number = _is("m; median of the control points")
    images: list[TiedImage] = _is("That were tied")
    left_out: dict[str, str] = _is("Images that were not, and why")


# --------------------------------------------------------------------------------------- batch


class BatchEntry(SummaryPart):
    """One input."""

    name: str = _is("Of its folder")
    file: str = _is("As it was given")
    command: str = _is("That it is for; empty: there is none")
    state: Literal["done", "failed"]
    status: Count = _is("Exit status of the command")
    message: str = _is("Why it failed; empty: it did not")
    warnings: Count = _is("How many its own summary has")
    wall_seconds: Annotated[float, Field(ge=0.0)]
    peak_memory_bytes: Count | None
    figures: dict[str, Number] = _is("Its main numbers, as the columns of results.csv")


class BatchSummary(RunSummary):
    """Of ``batch``."""

    result: Literal["Batch"] = _is("Class of the result in Python")
    done: Count = _is("Inputs whose command ended well, now or in an earlier batch")
    failed: Count = _is("All others")
    jobs: list[BatchEntry] = _is("Every input, in the order in which they were given")


# --------------------------------------------------------------------------------------- score


class AxisErrors(SummaryPart):
    """Errors of one axis."""

    unit: str
    rms: Number
    max: Number
    sigma: Number
    nees: Number
    effective_samples: Number
    nees_low: Number
    nees_high: Number
    coverage_95: Number


class ScoreSummary(ResultSummary):
    """Of a score of a motion that is written in Python."""

    result: Literal["Score"] = _is("Class of the result in Python")
    lines: Count = _is("How many")
    hidden_directions_removed: list[str] = _is("Names")
    left_out: list[str] = _is("The same in words")
    roll: AxisErrors = _is("Errors less the hidden directions")
    pitch: AxisErrors = _is("Likewise")
    yaw: AxisErrors = _is("Likewise")
    absolute: dict[str, AxisErrors] = _is("Errors of the whole angles, of axes with a finite sigma_absolute")


#: All of them.
SUMMARIES: tuple[type[ResultSummary], ...] = (
    RecoverySummary, RegistrationSummary, MosaicSummary, LayoutSummary, OrientationSummary, PredictionSummary,
    SequenceSummary, CubeResultSummary, TdiSummary, NoiseSummary, RasterMatchSummary,
    BandMatchSummary, TieSummary, ScoreSummary, BatchSummary,
)  # fmt: skip


@functools.cache
def _adapter() -> TypeAdapter[Any]:
    any_of: Any = functools.reduce(operator.or_, SUMMARIES)
    return TypeAdapter(Annotated[any_of, Field(discriminator="result")])


def summary_schema() -> dict[str, Any]:
    """JSON Schema of every ``summary.json``: one of these, by its ``result``."""
    return _adapter().json_schema(mode="serialization")


def check_summary(text: str) -> ResultSummary:
    """A ``summary.json`` as one of `SUMMARIES`; pydantic's ValidationError where it is none."""
    checked: ResultSummary = _adapter().validate_json(text, strict=True)
    return checked
