"""The page of a stereo orientation.

Not here: its figures (``stereo_figures.py``, ``stereo_height_figure.py``), its words (``stereo_words.py``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from sightline.applications.stereo_orientation import StereoOrientation
from sightline.evaluation.direction_words import AXES
from sightline.geometry.units import ARCSEC
from sightline.io.stereo.load import Stereo
from sightline.report import stereo_figures
from sightline.report.page import Page, Section, Table, inputs
from sightline.report.stereo_height_figure import PointHeights, height_figure, point_heights
from sightline.report.stereo_words import (
    DRIFT_HEADS,
    FOCAL_HEADS,
    advice,
    drift_rows,
    focal_rows,
    sentences,
    several,
    with_sigma,
)
from sightline.report.words import digits


def stereo_page(stereo: Stereo, result: StereoOrientation, summary: Mapping[str, Any]) -> Page:
    """The page of a stereo orientation.

    Parameters
    ----------
    stereo : Stereo
    result : StereoOrientation
    summary : mapping
        As ``write_stereo_result`` gives it.
    """
    heights = point_heights(stereo, result)
    problem = stereo.problem
    notes = summary.get("export_notes", [])
    more = "" if notes and "no corrected" in notes[0] else ", cameras_corrected.csv, colmap"
    units = [f"{axis} ({unit})" for unit in ("arcsec", "µrad") for axis in AXES]
    angles: list[str | Table] = [
        "Small turn of each body from its planned to its true attitude, about body axes: true = planned × "
        "exp(roll, pitch, yaw). The same for all shots. ± is 1 sigma.",
        Table(["camera", *units], angle_rows(summary)),
    ]
    for rows, heads, said in (
        (
            drift_rows(result),
            DRIFT_HEADS,
            "Drift: how fast these errors change; the angles above are those of the middle of the times. ± "
            "is 1 sigma.",
        ),
        (focal_rows(problem, result), FOCAL_HEADS, "Focal lengths as found. ± is 1 sigma."),
    ):
        angles += [said, Table(heads, rows)] if rows else []
    return Page(
        heading=summary["name"],
        what=f"attitude errors of {several(len(summary['cameras']), 'camera')}",
        about=f"Constant attitude errors of {several(len(summary['cameras']), 'camera')} by Sightline "
        f"{summary['version']}, method {summary['method']}; equations solved in "
        f"{summary['solve_seconds']:.2g} s",
        sentences=sentences(problem, result, summary, heights),
        warnings=summary["warnings"],
        sections=[
            Section("angles", "The angles", angles),
            *sections(stereo, result, summary, heights),
            Section(
                "improve",
                "What would improve it",
                [*improvement_rows(summary, result.cameras), advice(problem, summary)],
            ),
            inputs(summary, Table(["what", "how many"], counts(summary))),
        ],
        footer="Files beside this page: orientation.csv, covariance.csv, matches_used.csv, points.csv, "
        f"summary.json{more}. {' '.join(f'{note[:1].upper()}{note[1:]}.' for note in notes)}",
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


def improvement_rows(summary: Mapping[str, Any], cameras: Sequence[str]) -> list[str | Table]:
    """Per change, sigma (arcsec) of every angle and how far it falls; nothing where none was judged."""
    rows = [
        [entry["change"], *(_better(s, r) for s, r in zip(entry["sigmas"], entry["ratio"], strict=True))]
        for entry in summary.get("improvements", [])
    ]
    said = (
        "1 sigma of every angle (arcsec) that one change at a time would give, and by how much it falls: "
        "bounds for the same cameras and points, the most useful change for the worst angle first."
    )
    heads = ["change", *(f"{axis} {camera}" for camera in cameras for axis in AXES)]
    return [said, Table(heads, rows)] if rows else []


def _better(sigma: float, ratio: float) -> str:
    """A sigma and what the change makes of it."""
    if not math.isfinite(sigma):
        return "not observable"
    change = round(100.0 * (ratio - 1.0))
    percent = "now seen" if ratio <= 0.0 else f"{change:+d} %" if change else "as it is"
    return f"{digits(sigma / ARCSEC, 2)} ({percent})"


_RESIDUAL_CAPTIONS = {
    "ml-track": "Length of the residuals of both coordinates. Good points lie near the dotted line: below "
    "it by what the bundle adjustment takes up, above it where the noise was stated too small or poses of a "
    "shot are wrong.",
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
            [
                "Combinations of the angles that can be known independently of each other, the weakest "
                "first: words name the angles that turn together. A correction along a weak direction "
                "changes the images least, so that it is also what harms products least.",
                stereo_figures.direction_figure(summary["principal_sigmas"]),
            ],
        )
    ]
    ellipses = stereo_figures.ellipse_figure(result)
    if ellipses is not None:
        caption = (
            "Where the true angles lie about the estimated ones. Solid: 1 sigma of each angle at its edges; "
            "dashed: holds both angles of a panel 95 times in 100. A slanted, slim ellipse: the two are "
            "known together better than each by itself."
        )
        found.append(Section("ellipses", "Error ellipses", [caption, ellipses]))
    caption = _RESIDUAL_CAPTIONS.get(result.method, _RESIDUAL_CAPTIONS["ml-track"])
    found.append(
        Section(
            "residuals", "Residuals of every shot", [caption, stereo_figures.residual_figure(stereo, result)]
        )
    )
    plane = stereo_figures.image_plane_figure(stereo, result)
    if plane is not None:
        longest = digits(plane[1], 2)
        caption = (
            "Mean residual of the kept points in cells of the frame, all shots together, as a stroke from a "
            f"dot; the longest is {longest} px. Strokes at random are noise; a pattern (all outward, all "
            "turning) is a lens or a focal length that is not as stated."
        )
        found.append(Section("frame", "Residuals over the frame", [caption, plane[0]]))
    if heights is not None:
        found.append(
            Section("heights", "Heights before and after", [_height_caption(heights), height_figure(heights)])
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
