"""The report of a stereo orientation: one HTML page that asks no network for anything.

Not here: its figures (``stereo_figures.py``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sightline.applications.stereo_orientation import StereoOrientation
from sightline.evaluation.direction_words import AXES
from sightline.evaluation.score_orientation import ARCSEC
from sightline.io.stereo import Stereo
from sightline.report import stereo_figures
from sightline.report.page import Section, render, write_page
from sightline.report.words import digits

#: Seconds of a window, and degrees of convergence, below which more of it is advised first.
SHORT_WINDOW = 60.0


def write_stereo_report(
    path: Path, stereo: Stereo, result: StereoOrientation, summary: Mapping[str, Any]
) -> None:
    """Write ``report.html``, complete or not at all.

    Parameters
    ----------
    path : Path
        Of the page.
    stereo : Stereo
    result : StereoOrientation
    summary : mapping
        As ``io.stereo_results.write_stereo_result`` gives it.
    """
    write_page(path, stereo_html(stereo, result, summary))


def stereo_html(stereo: Stereo, result: StereoOrientation, summary: Mapping[str, Any]) -> str:
    """The page as text; parameters as of `write_stereo_report`."""
    return render(
        "stereo.html.j2",
        summary=summary,
        sentences=sentences(summary),
        warnings=summary["warnings"],
        angles=angle_rows(summary),
        sections=sections(stereo, result, summary),
        improvement_heads=["change", *(f"{axis} {camera}" for camera in result.cameras for axis in AXES)],
        improvements=improvement_rows(summary),
        advice=advice(stereo, summary),
        counts=counts(summary),
        export_notes=summary.get("export_notes", []),
    )


def angle_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """Table of the angles: arcsec, then µrad."""
    rows = []
    for camera, angles in summary["angles"].items():
        row = [camera]
        for unit in (ARCSEC, 1e-6):
            for axis in AXES:
                row.append(_with_sigma(angles[axis] / unit, angles[f"sigma_{axis}"] / unit))
        rows.append(row)
    return rows


def _with_sigma(value: float, sigma: float) -> str:
    """Value and sigma with two figures of the sigma."""
    if not math.isfinite(sigma):
        return "not observable"
    if sigma <= 0.0:
        return f"{value:.4g}"
    places = max(0, 1 - math.floor(math.log10(sigma)))
    return f"{value:+.{places}f} ± {sigma:.{places}f}"


def improvement_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """Per change, sigma (arcsec) of every angle and how far it falls."""
    return [
        [entry["change"], *(_better(s, r) for s, r in zip(entry["sigmas"], entry["ratio"], strict=True))]
        for entry in summary.get("improvements", [])
    ]


def _better(sigma: float, ratio: float) -> str:
    """A sigma and what the change makes of it."""
    if not math.isfinite(sigma):
        return "not observable"
    change = round(100.0 * (ratio - 1.0))
    percent = "now seen" if ratio <= 0.0 else f"{change:+d} %" if change else "as it is"
    return f"{digits(sigma / ARCSEC, 2)} ({percent})"


def sections(stereo: Stereo, result: StereoOrientation, summary: Mapping[str, Any]) -> list[Section]:
    """All figures in the order of the page."""
    found = [
        Section(
            "directions",
            "What is known well, and what is not",
            "Combinations of the angles that can be known independently of each other, the weakest first: "
            "words "
            "name the angles that turn together. A correction along a weak direction changes the images "
            "least, "
            "so that it is also what harms products least.",
            stereo_figures.direction_figure(summary["principal_sigmas"]),
        )
    ]
    ellipses = stereo_figures.ellipse_figure(result)
    if ellipses is not None:
        caption = (
            "Where the true angles lie about the estimated ones. Solid: 1 sigma of each angle at its "
            "edges; dotted: "
            "holds both angles of a panel 95 times in 100. A slanted, slim ellipse: the two are known "
            "together "
            "better than each by itself."
        )
        found.append(Section("ellipses", "Error ellipses", caption, ellipses))
    caption = (
        "Length of the residuals of both coordinates. Good points lie near the dotted line: below it by "
        "what the "
        "adjustment takes up, above it where the noise was stated too small or poses of a shot are wrong."
    )
    found.append(
        Section(
            "residuals", "Residuals of every shot", caption, stereo_figures.residual_figure(stereo, result)
        )
    )
    plane = stereo_figures.image_plane_figure(stereo, result)
    if plane is not None:
        longest = digits(plane.layout.meta["largest"], 2)
        caption = (
            "Mean residual of the kept points in cells of the frame, all shots together, as a stroke from a "
            f"dot; the longest is {longest} px. Strokes at random are noise; a pattern (all outward, all "
            "turning) is a lens or a focal length that is not as stated."
        )
        found.append(Section("frame", "Residuals over the frame", caption, plane))
    heights = stereo_figures.height_figure(stereo, result)
    if heights is not None:
        caption = (
            "Every point where its rays meet, all shots together, before and after the compensation. "
            "Errors of "
            "pitch raise or lower the whole scene."
        )
        found.append(Section("heights", "Heights before and after", caption, heights))
    return found


def sentences(summary: Mapping[str, Any]) -> list[str]:
    """The orientation in plain words."""
    matches = summary["matches"]
    what = "pairs of conjugate points" if matches["kind"] == "pairs" else "sightings of points"
    said = [
        f"From {matches['kept']:,} {what} in {summary['shots']:,} shots over "
        f"{digits(summary['window_seconds'], 3)} "
        f"s, the constant attitude errors of {_cameras(summary['cameras'])} were found. {_rejected(matches)}",
        *_hidden(summary),
        _weakest(summary),
        f"{summary['chi_square']['verdict'][0].upper()}{summary['chi_square']['verdict'][1:]}.",
    ]
    heights = summary["heights"]
    if math.isfinite(heights["rms_change"]):
        sigma = heights["median_sigma"]
        known = f", known to {digits(sigma, 2)} m each (median)" if math.isfinite(sigma) else ""
        said.append(
            f"The compensation moves the points' heights by {digits(heights['mean_change'], 2)} m on "
            "average, "
            f"{digits(heights['rms_change'], 2)} m rms{known}."
        )
    return [sentence for sentence in said if sentence]


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
        "number "
        "would be invented."
    ]


def _weakest(summary: Mapping[str, Any]) -> str:
    seen = [entry for entry in summary["principal_sigmas"] if math.isfinite(entry["sigma"])]
    if not seen:
        return ""
    weak, strong = seen[0], seen[-1]
    return (
        f"Known least is {weak['words']}, to {digits(weak['sigma'] / ARCSEC, 2)} arcsec; known best is "
        f"{strong['words']}, to {digits(strong['sigma'] / ARCSEC, 2)} arcsec."
    )


def advice(stereo: Stereo, summary: Mapping[str, Any]) -> list[str]:
    """What helps against weak directions, by what is weak here."""
    problem = stereo.problem
    said = []
    weak = summary["principal_sigmas"][0]["words"]
    if summary["unobservable"] and summary["shots"] == 1:
        said.append(
            "Shots that span time: with one shot a turn of both cameras about their baseline stays unseen."
        )
    elif summary["window_seconds"] < SHORT_WINDOW:
        said.append("More time: what is weak falls about as the length of the window while that is short.")
    if "yaw" in weak:
        said.append(
            f"Yaw ({weak}) is told by image noise over the field of view: points at the edges of the frame, "
            "better matching, more pixels, more points; DEM and control points help it little."
        )
    reckoned = bool(summary.get("improvements"))
    if problem.heights is None and not reckoned:
        said.append("A DEM (dem, dem_sigma) tells pitch, which otherwise hides in the heights.")
    if problem.control is None and not reckoned:
        said.append("A few control points (control_points) tell roll and pitch of both cameras absolutely.")
    if summary["method"] != "ml-track":
        said.append("Points followed through all shots (--method ml-track): the same matches then tell more.")
    return said


def counts(summary: Mapping[str, Any]) -> list[list[str]]:
    """Table of how much went in."""
    matches = summary["matches"]
    return [
        ["cameras", f"{len(summary['cameras']):,}"],
        ["shots", f"{summary['shots']:,}"],
        ["images", f"{summary['images']:,}"],
        ["points", f"{summary['points']:,}"],
        [
            f"{matches['kind']} tried, kept, rejected",
            f"{matches['tried']:,}, {matches['kept']:,}, {matches['rejected']:,}",
        ],
        *(
            []
            if summary["degrees_of_freedom"] is None
            else [["degrees of freedom", f"{summary['degrees_of_freedom']:,}"]]
        ),
    ]
