"""What is asked of a strip that its images cannot give: refused in one sentence before anything is matched.

Not here: what single keys may hold (``io/acquisition/schema.py``), what was found (``warnings.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.estimation.prior import TabulatedPsd
from sightline.execution import slices
from sightline.imaging.source import ImageSource
from sightline.matching.on_geometry import within
from sightline.motion.band import Band
from sightline.motion.measure.laid_strips import ratio_to_finest, size_in_partner
from sightline.motion.measure.plan import hub_windows, mixed_stages
from sightline.motion.measure.windows import WindowGrid, predict_windows
from sightline.motion.sensors import AttitudeSensor
from sightline.motion.strip.hyper import FEWEST_ROWS, KnownContent
from sightline.motion.strip.strip import RecoverOptions, Strip, window_columns

Array = NDArray[Any]

#: Tones nearer than this share of the lowest frequency that a strip holds are one.
SAME_TONE = 0.1
#: Windows of the first pass that must find their ground in another image.
FEWEST_WINDOWS = 20
#: Rows of windows that are asked where they lie: evenly spread, of however long a strip.
ROWS_ASKED = 200
#: Lines that two images must have alike to be compared whole, and lines that are then compared at a time.
LINES_COMPARED, LINES_AT_ONCE = 9, 512
#: Pixels that must be seen by two images to be compared, and how many roundings they must vary by (1 sigma).
FEWEST_COMPARED, DISTINCT = 100, 10.0
#: rad; angles of the motion are small: control points further from where the cameras see them are mistakes.
FARTHEST = 0.1


def checked(strip: Strip, options: RecoverOptions) -> Strip:
    """The strip with its known tones sorted, each once.

    Raises
    ------
    InputError
        Names the key, its value and what is allowed: tones or a spectrum that these lines cannot hold,
        windows that do not fit in the images, listed features that lie outside, control points out of place,
        stages over most of the strip.
    EstimationError
        If too few windows see the same ground in two images, or none has a neighbour in its row.
    """
    _check_stages(strip)
    if options.weighting == "predicted" and all(band.match_sigma is None for band in strip.bands):
        raise InputError(
            '`weighting` of [matching] is "predicted", but no band says what to expect; give a [[band]] its '
            "quality, or leave weighting out"
        )
    if len(strip.bands) > 1:
        _check_windows(strip, options)
        _check_common_ground(strip, options)
        _check_compensated(strip, options)
        _check_features(strip, options)
    _check_control(strip)
    return replace(strip, known=known_content(strip))


def check_images(strip: Strip) -> None:
    """InputError where two images that show something are the same, or one is another times a gain."""
    known: list[tuple[Band, Array]] = []
    for band in strip.bands:
        lines, columns = band.image.shape
        rows = np.unique(np.linspace(0, lines - 1, LINES_COMPARED).astype(int)).tolist()
        seen = np.concatenate([band.image.read((row, row + 1), (0, columns)) for row in rows])
        if (seen == seen.flat[0]).all() or not np.isfinite(seen).any():
            continue
        for other, there in known:
            if other.image.shape != band.image.shape:
                continue
            if seen.tobytes() == there.tobytes() and _same(other.image, band.image):
                raise InputError(
                    f"the images of {other.name!r} and {band.name!r} are the same, pixel for pixel, which "
                    "no two detector lines see; give the image of each"
                )
            law = _law_of(there, seen)
            if law is not None and _follows(other.image, band.image, law):
                raise InputError(
                    f"the image of {band.name!r} is that of {other.name!r} times {law[0]:.6g} plus "
                    f"{law[1]:.6g}, pixel for pixel, which no two detector lines see; give the image of each"
                )
        known.append((band, seen))


def _law_of(one: Array, other: Array) -> tuple[float, float] | None:
    """Gain and offset by which all pixels of `other` follow from `one`, as far as both are rounded; or None.

    Images that vary by few of their steps may agree by chance, and have none.
    """
    both = np.isfinite(one) & np.isfinite(other)
    a, b = one[both].astype(np.float64), other[both].astype(np.float64)
    if a.size < FEWEST_COMPARED or a.std() == 0.0:
        return None
    gain = float(np.mean((a - a.mean()) * (b - b.mean())) / a.var())
    law = gain, float(b.mean() - gain * a.mean())
    most = _rounding(a, b, gain)
    return law if b.std() > DISTINCT * most and _within(a, b, law, most) else None


def _rounding(a: Array, b: Array, gain: float) -> float:
    """How far apart rounding alone puts `b` and `a` times a gain: half a step of each, and a fit's error."""
    steps = [
        1.0 if (x == np.rint(x)).all() else 4.0 * float(np.finfo(np.float32).eps * np.abs(x).max())
        for x in (a, b)
    ]
    return 0.6 * (abs(gain) * steps[0] + steps[1])


def _within(a: Array, b: Array, law: tuple[float, float], most: float) -> bool:
    return bool((np.abs(law[0] * a + law[1] - b) <= most).all())


def _follows(one: ImageSource, other: ImageSource, law: tuple[float, float]) -> bool:
    """Whether all pixels of an image follow from those of another."""
    lines, columns = one.shape
    for some in slices(lines, LINES_AT_ONCE):
        part = (some.start, some.stop), (0, columns)
        a, b = (image.read(*part).astype(np.float64) for image in (one, other))
        both = np.isfinite(a) & np.isfinite(b)
        a, b = a[both], b[both]
        if a.size and not _within(a, b, law, _rounding(a, b, law[0])):
            return False
    return True


def _same(one: ImageSource, other: ImageSource) -> bool:
    """Whether two images of one size are the same, pixel for pixel."""
    lines, columns = one.shape
    for some in slices(lines, LINES_AT_ONCE):
        part = (some.start, some.stop), (0, columns)
        if not np.array_equal(one.read(*part), other.read(*part), equal_nan=True):
            return False
    return True


def known_content(strip: Strip) -> KnownContent:
    """Known tones of the strip, each once; refused where its lines cannot hold them, or a known spectrum."""
    known = strip.known
    spans = [camera.times(np.array([0.0, camera.lines - 1.0])) for camera in strip.nominal]
    period = min(float(t[1] - t[0]) / (c.lines - 1) for t, c in zip(spans, strip.nominal, strict=True))
    lowest, highest = 1.0 / max(float(t[1] - t[0]) for t in spans), 0.5 / period
    tones: list[float] = []
    for tone in sorted(known.tones):
        if not lowest <= tone < highest:
            raise InputError(
                f"`tones` of [known_motion] holds {tone:g} Hz; allowed are {lowest:.4g} Hz (one period in "
                f"the strip) to below {highest:.4g} Hz (half the line rate); give Hz, or leave it out"
            )
        if not tones or tone - tones[-1] > SAME_TONE * lowest:
            tones.append(tone)
    for axis, spectrum in zip(("roll", "pitch", "yaw"), known.spectra or (), strict=False):
        parts = [part for part in spectrum.components if isinstance(part, TabulatedPsd)]
        starts = [part.frequency[max(int(np.flatnonzero(part.density)[0]) - 1, 0)] for part in parts]
        if starts and len(parts) == len(spectrum.components) and min(starts) >= highest:
            raise InputError(
                f"`psd` of [known_motion] has power of {axis} only from {min(starts):g} Hz; allowed is a "
                f"spectrum that begins below {highest:.4g} Hz (half the line rate); give Hz"
            )
    return replace(known, tones=tuple(tones))


def _check_stages(strip: Strip) -> None:
    """Lines average over no more than half of their image."""
    for band in strip.bands:
        most = 1 if band.camera.stages is None else int(np.asarray(band.camera.stages).max())
        if 2 * most > band.camera.lines:
            raise InputError(
                f"each line of {band.name!r} averages over {most} stages, more than half of the "
                f"{band.camera.lines} lines of its image: all its lines average over nearly the same motion, "
                "of which they show nothing; check `stages`, or give a longer image"
            )


def _check_windows(strip: Strip, options: RecoverOptions) -> None:
    """Windows, steps and searches fit in every image; they are given in pixels of the finest."""
    ratios = np.array([ratio_to_finest(strip.nominal, band) for band in range(len(strip.bands))])
    shapes = [band.image.shape for band in strip.bands]
    lines, columns = np.floor((ratios * shapes).min(axis=0) + 1e-6).astype(int).tolist()
    size = f"the smallest image has {lines} lines and {columns} columns"
    size += " in pixels of the finest" if (ratios != 1.0).any() else ""
    usual = RecoverOptions().window[1], window_columns(strip.bands)
    for key in ("first_window", "window", "search_px"):
        given = getattr(options, key)
        # windows that nobody asked for are narrowed to a narrow detector's line
        narrowed = key not in ("search_px", *options.asked) and given[1] in usual
        if given[0] > lines or (given[1] > columns and not narrowed):
            raise InputError(
                f"`{key}` of [matching] is {list(given)}; {size}: at most [{lines}, {columns}] is allowed"
            )
    if options.step > lines:
        raise InputError(f"`step` of [matching] is {options.step}; {size}: at most {lines} is allowed")


@dataclass(frozen=True)
class CommonWindows:
    """Windows of the first pass on ground that another image sees too.

    Attributes
    ----------
    seen, whole, clear : float
        How many have their middle, and all of themselves, in another image; and how many of the first lie in
        neither of the two across a change of TDI stages.
    side_by_side : int
        Most that one row has of the former.
    rows : float
        Rows that hold two of them, of the two images that share most such rows.
    whole_of : tuple of float
        Of each band: windows that lie whole in it and in another.
    clear_of : tuple of float
        Of each band: those of `clear` that are seen in it.
    """

    seen: float
    whole: float
    clear: float
    side_by_side: int
    rows: float
    whole_of: tuple[float, ...]
    clear_of: tuple[float, ...]


def windows_in_common(
    strip: Strip, options: RecoverOptions, window: tuple[int, int] | None = None, step: int = 0
) -> CommonWindows:
    """Windows on ground that another image sees too, by the nominal cameras; of the first pass by default."""
    window, step = window or options.first_window, step or 2 * options.first_window[0]
    plan = strip.plan(options, window, step)
    shapes = [(band.image.shape[0], band.image.shape[1]) for band in strip.bands]
    hubs = hub_windows(strip.nominal, strip.surface, shapes, strip.order, plan, strip.views)
    common, inside_all, clear_all, side_by_side, rows = 0.0, 0.0, 0.0, 0, 0.0
    whole_of, clear_of = np.zeros((2, len(strip.bands)))
    for hub, partners, grid in hubs:
        asked = grid.lines[np.linspace(0, len(grid.lines) - 1, min(len(grid.lines), ROWS_ASKED)).astype(int)]
        some, share = WindowGrid(grid.window, asked, grid.columns), len(grid.lines) / len(asked)
        seen, whole, clear = np.zeros((3, len(some.centres)), dtype=bool)
        alike = ~mixed_stages(strip.nominal[hub], some.centres, grid.window)
        for image, found in zip(
            partners, predict_windows(strip.nominal, hub, partners, strip.surface, some), strict=True
        ):
            here = within(found.b, shapes[image])
            seen |= here
            size = size_in_partner(strip.nominal, hub, image, grid.window)
            matched = here & alike & ~mixed_stages(strip.nominal[image], found.b, size)
            clear |= matched
            clear_of[image] += share * float(matched.sum())
            rows = max(rows, share * float((here.reshape(some.shape).sum(axis=1) >= 2).sum()))
            inside = within(found.b, shapes[image], np.array(size) / 2.0 - 1.0)
            whole |= inside
            whole_of[image] += share * float(inside.sum())
        common += share * float(seen.sum())
        inside_all += share * float(whole.sum())
        clear_all += share * float(clear.sum())
        whole_of[hub] += share * float(whole.sum())
        clear_of[hub] += share * float(clear.sum())
        side_by_side = max(side_by_side, int(seen.reshape(some.shape).sum(axis=1).max(initial=0)))
    of_bands = tuple(whole_of.tolist()), tuple(clear_of.tolist())
    return CommonWindows(common, inside_all, clear_all, side_by_side, rows, *of_bands)


def _check_common_ground(strip: Strip, options: RecoverOptions) -> None:
    """Windows of the first pass lie on ground that another image sees too: enough, and two side by side."""
    found = windows_in_common(strip, options)
    common = found.seen
    if common < FEWEST_WINDOWS:
        height, width = options.first_window
        size = f"{height} x {min(width, strip.bands[0].image.shape[1])} px"
        raise EstimationError(
            f"the images have too little ground in common: {common:.0f} windows of {size}, {FEWEST_WINDOWS} "
            "are needed; give longer images (more lines than the longest lag), or smaller windows: "
            "[matching] first_window"
        )
    if found.clear < FEWEST_WINDOWS:
        raise EstimationError(
            f"{found.clear:.0f} of {common:.0f} windows lie between two changes of TDI stages, and "
            f"none across one is matched; {FEWEST_WINDOWS} are needed; let `stages` change less often from "
            "column to column ([choice] hysteresis of TDI.toml), or give narrower windows: [matching] "
            "first_window, window"
        )
    if found.side_by_side < 2:
        narrowest = min(range(len(strip.bands)), key=lambda band: strip.bands[band].image.shape[1])
        name, columns = strip.bands[narrowest].name, strip.bands[narrowest].image.shape[1]
        height, half = options.first_window[0], max(columns // 2, 3)
        plan = strip.plan(options, options.first_window, height)
        width = min(plan.coarser(ratio_to_finest(strip.nominal, narrowest)).window[1], columns)
        raise EstimationError(
            f"{name} has {columns} columns, and no row holds two windows of {width} columns side by side, "
            f"from which yaw is estimated: {2 * width} columns in common are needed, or narrower windows: "
            f"[matching] first_window = [{height}, {half}], window = [{options.window[0]}, {half}]"
        )


def _check_compensated(strip: Strip, options: RecoverOptions) -> None:
    """Enough rows of windows of the other passes see two windows in one other image."""
    (height, width), step = options.window, options.step
    found = windows_in_common(strip, options, options.window, step)
    if found.rows < FEWEST_ROWS and strip.known.spectra is None:
        raise EstimationError(
            f"windows of {height} x {width} px every {step} lines ([matching] window, step) make "
            f"{found.rows:.0f} rows with two side by side that two images share; {FEWEST_ROWS} are needed; "
            "give lower or narrower windows, a smaller step, or longer images"
        )


def _check_features(strip: Strip, options: RecoverOptions) -> None:
    """Some listed feature lies on its image."""
    listed = options.selection.features
    if options.selection.way != "listed" or not listed:
        return
    for image, pixels in listed.items():
        inside = (pixels >= -0.5) & (pixels <= np.array(strip.bands[image].image.shape) - 0.5)
        if inside.all(axis=1).any():
            return
    shapes = ", ".join(f"{b.name} {b.image.shape[0]} x {b.image.shape[1]}" for b in strip.bands)
    raise InputError(
        "`features` of [matching]: every listed feature lies outside its image; allowed are lines and "
        f"columns, counted from 0, within: {shapes}"
    )


def _check_control(strip: Strip) -> None:
    """Control points lie about where the cameras look."""
    for k, angle in _control_angles(strip).items():
        if not angle <= FARTHEST:
            raise InputError(
                f"{_control_words(strip, k, angle)}; allowed are {FARTHEST} rad; check its coordinates and "
                "their units, its line and column, and the platform"
            )


def farthest_control(strip: Strip) -> str:
    """The control point that moved the cameras most, as the end of a refusal; "" without control points."""
    angles = _control_angles(strip)
    if not angles:
        return ""
    k = max(angles, key=lambda point: angles[point])
    return f"; matching began where control points say: {_control_words(strip, k, angles[k])}"


def farthest_sensor(strip: Strip, search_px: tuple[int, int]) -> str:
    """The attitude sensor that moved the cameras by more than is searched, as the end of a refusal; "" if
    none did."""
    if not strip.sensors:
        return ""

    def moved(sensor: AttitudeSensor) -> float:
        angles = sensor.angles if sensor.kind != "gyro" else np.cumsum(sensor.angles, axis=0)
        # px at the edge of the field where the angle is yaw; about the axes of the estimate
        return float(np.abs(angles @ strip.turn / strip.scale).max(initial=0.0))

    worst = max(strip.sensors, key=moved)
    if moved(worst) <= max(search_px):
        return ""
    return (
        f"; matching began where attitude sensor {worst.name} says, up to {moved(worst):.3g} px from where "
        "the cameras look without it: are its angles in rad, about body axes, relative to the reference "
        "attitude?"
    )


def _control_angles(strip: Strip) -> dict[int, float]:
    """rad; how far each control point within the images lies from where its camera is said to look."""
    points, out = strip.control, {}
    for k, image in enumerate([] if points is None else points.image):
        assert points is not None
        camera, pixel = strip.nominal[image], points.pixels[k : k + 1]
        if not -1.0 <= pixel[0, 0] <= camera.lines:
            continue  # outside the estimated time: such points are left out and counted
        rays = camera.rays(pixel)
        there = points.position[k] - rays.origins[0]
        there = there / max(float(np.abs(there).max()), 1e-9)
        across = np.cross(rays.directions[0], there)
        out[k] = float(np.arctan2(np.sqrt(across @ across), rays.directions[0] @ there))
    return out


def _control_words(strip: Strip, k: int, angle: float) -> str:
    """Which control point lies how far from where its band looked."""
    points = strip.control
    assert points is not None
    (x, y, z), (line, column) = points.position[k], points.pixels[k]
    return (
        f"control point {k + 1} ({x:g}, {y:g}, {z:g} m) lies {angle:.3g} rad from where "
        f"{strip.bands[points.image[k]].name!r} looked at line {line:g}, column {column:g}"
    )
