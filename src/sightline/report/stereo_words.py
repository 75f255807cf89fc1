"""A stereo orientation in plain words, and its drifts and focal lengths as tables of words.

Not here: the page (``stereo_page.py``); nothing is computed but shares and units.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from sightline.applications.stereo_orientation import StereoOrientation, focal_length_seen
from sightline.evaluation.direction_words import AXES
from sightline.geometry.units import ARCSEC
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.report.stereo_height_figure import PointHeights
from sightline.report.words import digits

#: Seconds of a window below which more of it is advised first.
SHORT_WINDOW = 60.0
#: arcsec from which on a sigma is said in degrees.
IN_DEGREES = 1000.0
#: Share of the variance of heights that must be alike in all points to be called common to them.
SHARED = 0.75

DRIFT_HEADS = ["camera", *(f"{axis} (arcsec/s)" for axis in AXES)]
FOCAL_HEADS = [
    "camera",
    "focal length (px)",
    "less that of the file (px)",
    "relative error of the file's (%)",
]


def with_sigma(value: float, sigma: float) -> str:
    """Value and sigma with two figures of the sigma."""
    if not math.isfinite(sigma):
        return "not observable"
    if sigma <= 0.0:
        return f"{value:.4g}"
    places = max(0, 1 - math.floor(math.log10(sigma)))
    return f"{value:+.{places}f} ± {sigma:.{places}f}"


def angle_words(sigma: float) -> str:
    """A size (rad) in arcsec, or in degrees where that is shorter."""
    arcsec = sigma / ARCSEC
    return f"{digits(arcsec, 2)} arcsec" if arcsec < IN_DEGREES else f"{digits(arcsec / 3600.0, 2)} deg"


def several(count: int, what: str) -> str:
    """A number of things."""
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def drift_rows(result: StereoOrientation) -> list[list[str]]:
    """Per camera, the rates of its angles, arcsec/s; none where none were sought."""
    if result.drift is None or result.drift_sigma is None:
        return []
    return [
        [camera, *(with_sigma(r / ARCSEC, s / ARCSEC) for r, s in zip(rate, sigma, strict=True))]
        for camera, rate, sigma in zip(result.cameras, result.drift, result.drift_sigma, strict=True)
    ]


def focal_rows(problem: StereoProblem, result: StereoOrientation) -> list[list[str]]:
    """Per camera whose focal length was sought: px, px and % beside that of the file; else none."""
    if result.stretch is None or result.stretch_sigma is None or problem.focal_sigma is None:
        return []
    rows = []
    for c, (camera, before) in enumerate(zip(result.cameras, problem.focal_sigma, strict=True)):
        given, value, sigma = problem.detectors[c].focal_length_px, result.stretch[c], result.stretch_sigma[c]
        if before == 0.0:
            continue
        if not focal_length_seen(sigma, before):
            rows.append([camera, *["not observable"] * 3])
            continue
        length = with_sigma(given * (1.0 + value), given * sigma).lstrip("+")
        parts = (with_sigma(unit * value, unit * sigma) for unit in (given, 100.0))
        rows.append([camera, length, *parts])
    return rows


def sentences(
    problem: StereoProblem,
    result: StereoOrientation,
    summary: Mapping[str, Any],
    heights: PointHeights | None,
) -> list[str]:
    """The orientation in plain words."""
    verdict = summary["chi_square"]["verdict"]
    said = [
        _found(summary),
        *_hidden(summary),
        _weakest(summary),
        _drifts(result),
        _focal_lengths(problem, result),
        f"{verdict[0].upper()}{verdict[1:]}.",
        "" if heights is None else _heights(problem, heights),
    ]
    return [sentence for sentence in said if sentence]


def _found(summary: Mapping[str, Any]) -> str:
    """What went in, and which angles came out."""
    matches, shots = summary["matches"], summary["shots"]
    what = "pair" if matches["kind"] == "pairs" else "sighting"
    of = " of conjugate points" if matches["kind"] == "pairs" else " of points"
    time = f" over {digits(summary['window_seconds'], 3)} s" if summary["window_seconds"] > 0.0 else ""
    begin = f"From {several(matches['kept'], what)}{of} in {several(shots, 'shot')}{time}"
    seen = [
        f"{axis} of camera {camera}"
        for camera, angles in summary["angles"].items()
        for axis in AXES
        if math.isfinite(angles[f"sigma_{axis}"])
    ]
    whose, count = _cameras(summary["cameras"]), 3 * len(summary["cameras"])
    if len(seen) == count:
        end = f"the constant attitude errors of {whose} were found."
    elif seen:
        end = f"{len(seen)} of the {count} constant attitude errors of {whose} were found: {', '.join(seen)}."
    else:
        observed = sum(math.isfinite(entry["sigma"]) for entry in summary["principal_sigmas"])
        end = (
            f"no constant attitude error of {whose} is observable by itself; {observed} of their {count} "
            "combinations are (below)."
        )
    return f"{begin}, {end} {_rejected(matches)}"


def _cameras(names: Sequence[str]) -> str:
    if len(names) > 4:
        return f"{len(names)} cameras"
    word = "camera" if len(names) == 1 else "cameras"
    return f"{word} {' and '.join(names)}" if len(names) < 3 else f"cameras {', '.join(names)}"


def _rejected(matches: Mapping[str, Any]) -> str:
    count = matches["rejected"]
    if not count:
        return "None was rejected."
    was = "1 was" if count == 1 else f"{count:,} were"
    return f"{was} rejected ({100.0 * count / matches['tried']:.2g} %)."


def _hidden(summary: Mapping[str, Any]) -> list[str]:
    words = [entry["words"] for entry in summary["unobservable"]]
    if not words:
        return []
    one = len(words) == 1
    return [
        f"{'One direction is' if one else f'{len(words)} directions are'} not observable from these data: "
        f"{'; '.join(words)}. The angles that take part in {'it' if one else 'them'} are not given: any "
        "number would be invented."
    ]


def _seen(summary: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Directions that are seen, the weakest first."""
    return [entry for entry in summary["principal_sigmas"] if math.isfinite(entry["sigma"])]


def _weakest(summary: Mapping[str, Any]) -> str:
    seen = _seen(summary)
    if not seen:
        return ""
    weak, strong = seen[0], seen[-1]
    among = " of what is seen" if summary["unobservable"] else ""
    return (
        f"Known least{among} is {weak['words']}, to {angle_words(weak['sigma'])}; known best is "
        f"{strong['words']}, to {angle_words(strong['sigma'])}."
    )


def _drifts(result: StereoOrientation) -> str:
    parts = [
        f"camera {camera} {', '.join(f'{axis} {value}' for axis, value in zip(AXES, values, strict=True))}"
        for camera, *values in drift_rows(result)
    ]
    if not parts:
        return ""
    return (
        f"The errors drift (arcsec/s): {'; '.join(parts)}; the angles are those of the middle of the times."
    )


def _focal_lengths(problem: StereoProblem, result: StereoOrientation) -> str:
    parts = [
        f"of camera {camera} {percent}{'' if percent == 'not observable' else ' % from that of the file'}"
        for camera, _, _, percent in focal_rows(problem, result)
    ]
    return f"Focal length: {'; '.join(parts)}." if parts else ""


def _heights(problem: StereoProblem, heights: PointHeights) -> str:
    """How far the compensation moves heights, and how well they are known."""
    way = "raises" if heights.change > 0.0 else "lowers"
    said = (
        f"The compensation {way} the points by {digits(abs(heights.change), 2)} m on average, and moves them "
        f"against each other by {digits(heights.spread, 2)} m rms"
    )
    sigma = heights.median_sigma
    if math.isfinite(sigma):
        # what all points share cannot exceed the least sigma; known ground ties every point by itself
        shared = heights.sigma[heights.good].min() ** 2 > SHARED * sigma**2
        common = ", most of it common to all" if shared and problem.heights is None else ""
        said += f"; heights are known to {digits(sigma, 2)} m each{common} (median of 1 sigma)"
    poor = int((~heights.good).sum())
    if poor:
        said += f"; {several(poor, 'point')} known much worse left out"
    return f"{said}."


def advice(problem: StereoProblem, summary: Mapping[str, Any]) -> list[str]:
    """What helps against weak directions, by what is weak here."""
    said = []
    seen = _seen(summary)
    weak = seen[0]["words"] if seen else ""
    if summary["unobservable"] and summary["shots"] == 1:
        said.append(
            "Shots that span time: with one shot a turn of both cameras about their baseline stays unseen."
        )
    elif summary["window_seconds"] < SHORT_WINDOW:
        said.append("More time: what is weak falls about as the length of the window while that is short.")
    if weak.startswith("yaw"):
        said.append(
            f"Yaw ({weak}) is set by image noise over the field of view: points at the edges of the frame, "
            "better matching, more pixels, more points; DEM and control points help it little."
        )
    reckoned = bool(summary.get("improvements"))
    if problem.heights is None and not reckoned:
        said.append("A DEM (dem, dem_sigma) makes pitch observable, which otherwise hides in the heights.")
    if problem.control is None and not reckoned:
        said.append("A few control points (control_points) make roll and pitch of both cameras observable.")
    if summary["method"] != "ml-track":
        said.append("Points followed through all shots (--method ml-track): the same matches then give more.")
    return said
