"""The report of a stereo orientation: one HTML page that asks no network for anything.

Not here: its figures (``stereo_figures.py``, ``stereo_height_figure.py``), its words (``stereo_words.py``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sightline.applications.stereo_orientation import StereoOrientation
from sightline.evaluation.direction_words import AXES
from sightline.geometry.units import ARCSEC
from sightline.io.stereo import Stereo
from sightline.report import stereo_figures
from sightline.report.page import Section, render, write_page
from sightline.report.stereo_height_figure import PointHeights, height_figure, point_heights
from sightline.report.stereo_words import (
    DRIFT_HEADS,
    FOCAL_HEADS,
    advice,
    drift_rows,
    focal_rows,
    sentences,
    with_sigma,
)
from sightline.report.words import digits


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
    heights = point_heights(stereo, result)
    problem = stereo.problem
    return render(
        "stereo.html.j2",
        summary=summary,
        sentences=sentences(problem, result, summary, heights),
        warnings=summary["warnings"],
        angles=angle_rows(summary),
        drift_heads=DRIFT_HEADS,
        drift=drift_rows(result),
        focal_heads=FOCAL_HEADS,
        focal=focal_rows(problem, result),
        sections=sections(stereo, result, summary, heights),
        improvement_heads=["change", *(f"{axis} {camera}" for camera in result.cameras for axis in AXES)],
        improvements=improvement_rows(summary),
        advice=advice(problem, summary),
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
                row.append(with_sigma(angles[axis] / unit, angles[f"sigma_{axis}"] / unit))
        rows.append(row)
    return rows


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


_RESIDUAL_CAPTIONS = {
    "ml-track": "Length of the residuals of both coordinates. Good points lie near the dotted line: below it "
    "by what the adjustment takes up, above it where the noise was stated too small or poses of a shot are "
    "wrong.",
    "epipolar": "How far each pair must move for its rays to meet, shared evenly (in squares) by its two "
    "images. The dotted line is the noise of points alone; the noise of positions and attitudes, which this "
    "method does not adjust, lifts residuals above it.",
    "plane": "How far apart on the plane the two rays of a pair arrive, as the second camera sees it, shared "
    "evenly (in squares) by its two images. Relief is in it and is mostly the largest part: this is no "
    "measure of how well points were found.",
}


def _height_caption(heights: PointHeights) -> str:
    """How to read the maps of heights."""
    said = (
        "Every point where its rays meet, all shots together, before and after the compensation. Errors of "
        "pitch raise or lower the whole scene: the mean of the change is in its title, the map shows what is "
        "left of it. Sigma holds all errors, those that are common to all points too: differences between "
        "points are known better."
    )
    poor = int((~heights.good).sum())
    if poor:
        said += (
            f" Crosses: {poor:,} point{' is' if poor == 1 else 's are'} known three times worse than the "
            "median or more, and in no mean or scale here."
        )
    return said


def sections(
    stereo: Stereo, result: StereoOrientation, summary: Mapping[str, Any], heights: PointHeights | None
) -> list[Section]:
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
    caption = _RESIDUAL_CAPTIONS.get(result.method, _RESIDUAL_CAPTIONS["ml-track"])
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
    if heights is not None:
        found.append(
            Section("heights", "Heights before and after", _height_caption(heights), height_figure(heights))
        )
    return found


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
