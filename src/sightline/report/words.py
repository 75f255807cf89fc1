"""A recovery in plain words: what was found, how well, and what could not be seen.

Not here: the figures; nothing is computed but shares and units.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.applications.spin_attitude import SpinAttitude
from sightline.evaluation.band_words import passband_words
from sightline.evaluation.observed import SEEN_TONE_PX
from sightline.evaluation.score import words_of_hidden
from sightline.geometry.camera import FrameCamera
from sightline.motion.results import LineOfSight
from sightline.motion.tones import DetectedTone, lowest_sought
from sightline.report.motion_figures import FEW_EPOCHS, visible_motion_px
from sightline.report.spectrum_figures import tones_of
from sightline.report.style import AXES, AXIS_UNITS

Array = NDArray[np.float64]

#: A number and its unit stay on one line.
_NUMBER_AND_UNIT = re.compile(r"(\d) (px|Hz|s|µrad|mrad|%)")


def sentences(result: LineOfSight, summary: Mapping[str, Any], tones: Sequence[DetectedTone]) -> list[str]:
    """The summary, a sentence or two per subject."""
    said = [_what(result, summary), _how_well(result), *_method(result), _residuals(summary)]
    said += withheld_words(summary)
    if len(result.motion.t) >= FEW_EPOCHS:
        said += [_tones(result, tones) + _hardly_seen(result, summary), _passbands(summary)]
    said.append(_hidden(result))
    return [_NUMBER_AND_UNIT.sub("\\1\u00a0\\2", sentence) for sentence in said]


def axis_cards(result: LineOfSight, summary: Mapping[str, Any]) -> list[dict[str, str]]:
    """The main numbers of each axis."""
    motion = np.sqrt((visible_motion_px(result) ** 2).mean(axis=0))
    sigma = np.median(result.sigma, axis=0) / result.scale
    worst = result.sigma.max(axis=0) / result.scale
    return [
        {
            "name": axis,
            "unit": AXIS_UNITS[k],
            "motion": digits(motion[k], 3),
            "motion_angle": _angle(motion[k] * result.scale[k], 3),
            "sigma": digits(sigma[k], 2),
            "sigma_angle": _angle(sigma[k] * result.scale[k], 2),
            "worst": digits(worst[k], 2),
            "worst_angle": _angle(worst[k] * result.scale[k], 2),
            "absolute": _absolute(result, k),
            "seen": passband_words(summary["passbands"][axis]) if len(result.motion.t) >= FEW_EPOCHS else "",
        }
        for k, axis in enumerate(AXES)
    ]


def _method(result: LineOfSight) -> list[str]:
    """Which estimator the motion is of, where it is not the joint one."""
    if result.method is None:
        return []
    departure = np.sqrt((result.method.departure**2).mean(axis=0)) / result.scale
    own = np.sqrt((result.method.stated_sigma**2).mean(axis=0)) / result.scale
    sizes = ", ".join(f"{axis} {digits(departure[k], 2)} px" for k, axis in enumerate(AXES))
    stated = ", ".join(f"{digits(value, 2)} px" for value in own)
    return [
        f"The motion is that of S1's method “{result.method.name}”, from the angular differences of pairs. "
        f"It departs from the joint estimate by {sizes} rms; sigma is that of the joint estimate and this "
        f"departure together. By itself the method states a sigma of {stated}."
    ]


def _absolute(result: LineOfSight, axis: int) -> str:
    """Median sigma of the whole angle; "" where nothing ties it."""
    sigma = float(np.median(result.absolute_sigma[:, axis]))
    if not np.isfinite(sigma):
        return ""
    return f"{digits(sigma / result.scale[axis], 2)} px ({_angle(sigma, 2)})"


def tone_rows(
    result: LineOfSight, tones: Sequence[DetectedTone], hardly_seen: Sequence[DetectedTone] = ()
) -> list[list[str]]:
    """Table of tones: axis, frequency, amplitude in px and urad, name or why it is none, false alarm."""
    rows = []
    for tone in [*tones, *hardly_seen]:
        scale = float(result.scale[AXES.index(tone.axis)])
        rows.append(
            [
                tone.axis,
                f"{tone.frequency:.2f} ± {tone.sigma_frequency:.2f}",
                f"{tone.amplitude / scale:.4f} ± {tone.sigma_amplitude / scale:.4f}",
                f"{1e6 * tone.amplitude:.4g} ± {1e6 * tone.sigma_amplitude:.2g}",
                _bound(tone, scale) if tone in hardly_seen else tone.name if "×" in tone.name else "",
                f"{tone.false_alarm:.0e}",
            ]
        )
    return rows


def _bound(tone: DetectedTone, scale: float) -> str:
    """What is known of the size of a tone of less than 3 sigma: it may be none, or larger than it looks."""
    return f"hardly seen: 0 to {digits((tone.amplitude + 2.0 * tone.sigma_amplitude) / scale, 2)} px"


def close_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """Table of tones closer than 1/T: axis, both frequencies, both amplitudes."""
    found = summary["microvibration"]
    rows = []
    for pair in found["close_pairs"] if found is not None else []:
        both = zip(pair["frequencies"], pair["sigma_frequencies"], strict=True)
        sizes = zip(pair["amplitudes_px"], pair["sigma_amplitudes_px"], strict=True)
        rows.append(
            [
                pair["axis"],
                " and ".join(f"{f:.3f} ± {sigma:.3f}" for f, sigma in both),
                " and ".join(f"{a:.4f} ± {sigma:.4f}" for a, sigma in sizes),
            ]
        )
    return rows


def above_band(summary: Mapping[str, Any]) -> str:
    """What lies above the frequencies that were seen, in a sentence; "" for frames."""
    found = summary["microvibration"]
    if found is None:
        return ""
    parts = []
    for axis in AXES:
        above = found["above_passband"][axis]
        if above["rms_px"] is not None and math.isfinite(above["rms_px"]):
            parts.append(f"{axis} {digits(above['rms_px'], 2)} px rms above {above['from']:.4g} Hz")
    if not parts:
        return ""
    return "Above the frequencies that were seen, the fitted spectrum believes in: " + "; ".join(parts) + "."


def static_rows(result: LineOfSight) -> list[list[str]]:
    """Table of static parameters: name, value, sigma before and after, how much the images added."""
    rows = []
    for static in result.statics:
        factor, unit = (1e6, "µrad") if static.unit == "rad" else (1.0, static.unit)
        share = 1.0 - (static.sigma / static.prior_sigma) ** 2
        rows.append(
            [
                static.name,
                f"{factor * static.value:+.4g}",
                digits(factor * static.sigma, 2),
                digits(factor * static.prior_sigma, 2),
                unit,
                f"{100.0 * max(share, 0.0):.0f} %",
            ]
        )
    return rows


def sensor_table(result: LineOfSight) -> list[list[str]]:
    """Table of attitude sensors and control points: name, kind, readings, outliers, sigma, constants."""
    rows = []
    for use in result.sensors:
        factors = (
            "as given"
            if max(use.sigma_factor) == 1.0
            else "x " + " / ".join(f"{factor:.2g}" for factor in use.sigma_factor)
        )
        constants = [
            f"{name} {1e6 * value:+.3g} ± {1e6 * sigma:.2g}" for name, (value, sigma) in use.constants.items()
        ]
        rows.append(
            [
                use.name,
                use.kind,
                f"{use.used} of {use.given}",
                str(use.outliers),
                factors,
                "; ".join(constants) or "none",
            ]
        )
    return rows


def pair_table(result: LineOfSight) -> list[list[str]]:
    """Table of pairs: names, lag, windows tried and kept, reasons, residuals before, after, expected."""
    rows = []
    for pair in result.pairs:
        if not pair.tried:
            continue
        reasons = ", ".join(f"{name} {number:,}" for name, number in pair.rejected.items())
        rows.append(
            [
                " – ".join(result.image_names[image] for image in pair.images),
                _number(pair.lag, ".4f"),
                f"{pair.tried:,}",
                f"{pair.kept:,} ({100.0 * pair.kept / pair.tried:.0f} %)",
                reasons or "none",
                _number(pair.rms_before_px, ".3f"),
                _number(pair.rms_after_px, ".4f"),
                _number(pair.sigma_px, ".4f"),
            ]
        )
    return rows


def digits(value: float, count: int) -> str:
    """A number with `count` significant digits, never with an exponent."""
    if not np.isfinite(value):
        return "–"
    return np.format_float_positional(value, precision=count, unique=False, fractional=False, trim="-")


def _angle(value: float, count: int) -> str:
    """An angle in urad, or in mrad where that is shorter."""
    factor, unit = (1e6, "µrad") if value < 1e-3 else (1e3, "mrad")
    return f"{digits(factor * value, count)} {unit}"


def _number(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "–"


def _what(result: LineOfSight, summary: Mapping[str, Any]) -> str:
    matches, t = summary["matches"], result.motion.t
    if result.control is not None:
        kept = int(result.control.kept.sum())
        return (
            f"{result.image_names[0]} is the only image: what moved it was recovered from {kept:,} control "
            f"points, at {len(t):,} instants over {t[-1] - t[0]:.3g} s. Between control points the spectrum "
            "that they show says how far the motion may have gone; sigma grows there."
        )
    share = 100.0 * matches["kept"] / max(matches["tried"], 1)
    names = ", ".join(result.image_names[:6]) + (", …" if len(result.image_names) > 6 else "")
    return (
        f"{len(result.image_names)} images ({names}) were compared in {matches['tried']:,} windows, of which "
        f"{matches['kept']:,} ({share:.0f} %) were used. From how far each window lay from where the cameras "
        f"said, the attitude of the platform was recovered at {len(t):,} instants over {t[-1] - t[0]:.3g} s."
    )


def _how_well(result: LineOfSight) -> str:
    motion = np.sqrt((visible_motion_px(result) ** 2).mean(axis=0))
    sigma = np.median(result.sigma, axis=0) / result.scale
    parts = [
        f"{axis} moved by {digits(motion[k], 3)} {AXIS_UNITS[k]} rms and is known to {digits(sigma[k], 2)} px"
        + ("" if motion[k] > sigma[k] else ", not told from no motion")
        for k, axis in enumerate(AXES)
    ]
    return _capital("; ".join(parts) + " (1-sigma, median over these instants).")


def _residuals(summary: Mapping[str, Any]) -> str:
    control = summary.get("control")
    if control is not None:
        sizes = (digits(control[f"residual_{key}_px"], 3) for key in ("rms_before", "rms", "sigma"))
        return (
            "Before, control points lay {} px rms from where the camera as given saw them; with the "
            "recovered motion {} px are left, where their own sigma asks for {} px at most.".format(*sizes)
        )
    before, after, expected = (
        digits(np.nan if summary[key] is None else summary[key], count)
        for key, count in (
            ("residual_rms_before_px", 3), ("residual_rms_px", 2), ("residual_sigma_px", 2),
        )
    )  # fmt: skip
    return (
        f"Before, windows lay {before} px rms from their places; with the recovered motion "
        f"{after} px are left, where the matches' own sigma asks for {expected} px."
    )


def withheld_words(summary: Mapping[str, Any]) -> list[str]:
    """How pairs that the estimate did not use agree with it, pooled, in a sentence; none without any."""
    found = summary["withheld"]
    if not found:
        return []
    pairs = list(dict.fromkeys("–".join(entry["pair"]) for entry in found))
    parts = []
    for axis in dict.fromkeys(entry["axis"] for entry in found):
        own = [entry for entry in found if entry["axis"] == axis]
        count = np.array([entry["count"] for entry in own], dtype=float)
        squares, covered, rms = (
            float(np.average([entry[key] ** power for entry in own], weights=count))
            for key, power in (("nees", 1), ("coverage", 1), ("rms_px", 2))
        )
        parts.append(
            f"{axis} {digits(math.sqrt(rms), 2)} px rms, NEES {digits(squares, 2)}, {100.0 * covered:.0f} % "
            "within 1.96 sigma"
        )
    why = "left out on demand" if found[0]["asked"] else "that the estimate did not use"
    pair, them = ("Pair", "it") if len(pairs) == 1 else ("Pairs", "them")
    what = f"{pair} {', '.join(pairs)} ({why}) less the estimate's prediction of {them}"
    return [f"{what}: {'; '.join(parts)}."]


def withheld_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """Table of left-out pairs: pair, axis, windows, worth, rms, its sigma, that of the prediction, NEES,
    coverage."""
    return [
        [
            " – ".join(entry["pair"]),
            entry["axis"],
            f"{entry['count']:,}",
            f"{entry['samples']:,.0f}",
            *(_number(entry[key], ".4f") for key in ("rms_px", "sigma_px", "prediction_sigma_px")),
            _number(entry["nees"], ".2f"),
            f"{100.0 * entry['coverage']:.0f} %",
        ]
        for entry in summary["withheld"]
    ]


def _tones(result: LineOfSight, tones: Sequence[DetectedTone]) -> str:
    lowest = lowest_sought(result.motion)
    if not np.isfinite(lowest):
        return "The motion has too few instants for tones to be sought."
    if not tones:
        return f"No tone stands out of the spectrum above {lowest:.3g} Hz, eight cycles in all."
    return (
        f"Tones, with their amplitude: {_largest(result, tones)}. "
        f"None is sought below {lowest:.3g} Hz, eight cycles in all."
    )


def _hardly_seen(result: LineOfSight, summary: Mapping[str, Any]) -> str:
    """Peaks that are less than three sigmas of the motion's own error; "" where there are none."""
    tones = tones_of(summary["tones_hardly_seen"])
    if not tones:
        return ""
    return (
        " Peaks of less than 3 sigma, hardly seen, so that there may be no tone, or a larger one: "
        f"{_largest(result, tones)}."
    )


def _largest(result: LineOfSight, tones: Sequence[DetectedTone]) -> str:
    """The largest tones of each axis with their amplitudes."""
    said = []
    for axis in AXES:
        own = sorted((tone for tone in tones if tone.axis == axis), key=lambda tone: -tone.amplitude)
        scale = float(result.scale[AXES.index(axis)])
        if own:
            listed = ", ".join(f"{t.frequency:.1f} Hz ({t.amplitude / scale:.2g} px)" for t in own[:4])
            said.append(f"{axis} at {listed}" + (f" and {len(own) - 4} more" if len(own) > 4 else ""))
    return "; ".join(said)


def _passbands(summary: Mapping[str, Any]) -> str:
    seen = "; ".join(f"{axis} {passband_words(summary['passbands'][axis])}" for axis in AXES)
    return f"A steady tone of {SEEN_TONE_PX:g} px would be seen at these frequencies: {seen}."


def _hidden(result: LineOfSight) -> str:
    if not result.hidden_names:
        return "Nothing of the motion is hidden from the images."
    tied = np.asarray(np.isfinite(result.absolute_sigma).all(axis=0))
    if tied.all():
        known = "other knowledge ties it: sigma_absolute in motion.csv includes it"
    elif not tied.any():
        known = "nothing given here ties it, so sigma_absolute in motion.csv is infinite"
    else:
        held = _listed([axis for axis, own in zip(AXES, tied, strict=True) if own])
        free = _listed([axis for axis, own in zip(AXES, tied, strict=True) if not own])
        known = (
            f"other knowledge ties it in {held}, where sigma_absolute in motion.csv includes it, but not in "
            f"{free}, where it is infinite"
        )
    imitated = ""
    if not all(name.startswith("constant of ") for name in result.hidden_names):
        frames = isinstance(result.cameras[0], FrameCamera)
        unknown = "instants and an unknown lens" if frames else "places of the detector lines"
        if isinstance(result, SpinAttitude):
            unknown = "rate and axis of the spin and an unknown lens"
        imitated = f", and unknown {unknown} imitate the rest"
    if result.control is not None:
        return (
            f"Figures and sigmas here are of the motion less {grouped(_left_out(result))}, as those of "
            f"strips of several bands; {known}."
        )
    return (
        f"Images compared with each other cannot show {grouped(_left_out(result))}: a constant changes "
        f"nothing between them{imitated}; {known}. Figures and sigmas here are of the motion less "
        "this hidden part."
    )


def _left_out(result: LineOfSight) -> tuple[str, ...]:
    """Hidden directions of a result, each with what it brings on other axes."""
    return words_of_hidden(
        result.hidden_names,
        result.motion.t,
        result.hidden,
        ifov=result.ifov,
        half_field_px=result.half_field / result.ifov,
    )


def grouped(names: Sequence[str]) -> str:
    """Names such as ``constant of roll`` and ``constant of pitch`` as ``a constant of roll and pitch``."""
    groups: dict[str, list[str]] = {}
    for name in names:
        kind, _, axis = name.partition(" of ")
        groups.setdefault(kind, []).append(axis)
    return ", ".join(f"a {kind} of {_listed(axes)}" if all(axes) else kind for kind, axes in groups.items())


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
