"""The report of a stereo prediction: one HTML page that asks no network for anything.

Not here: its figures (``stereo_prediction_figures.py``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sightline.applications.stereo_prediction import StereoPrediction
from sightline.evaluation.direction_words import AXES
from sightline.geometry.units import ARCSEC
from sightline.report import stereo_figures, stereo_prediction_figures
from sightline.report.page import Section, render, write_page
from sightline.report.stereo_page import improvement_rows
from sightline.report.words import digits


def write_prediction_report(path: Path, predicted: StereoPrediction, summary: Mapping[str, Any]) -> None:
    """Write ``report.html``, complete or not at all.

    Parameters
    ----------
    path : Path
        Of the page.
    predicted : StereoPrediction
    summary : mapping
        As ``io.stereo_predicted.write_prediction`` gives it.
    """
    write_page(path, prediction_html(predicted, summary))


def prediction_html(predicted: StereoPrediction, summary: Mapping[str, Any]) -> str:
    """The page as text; parameters as of `write_prediction_report`."""
    return render(
        "stereo_prediction.html.j2",
        summary=summary,
        sentences=sentences(summary),
        sigmas=[
            [camera, *(_arcsec(own[axis]) for axis in AXES)] for camera, own in summary["sigmas"].items()
        ],
        sections=sections(predicted, summary),
        tables=[
            (table.quantity, table.how, *stereo_prediction_figures.prediction_rows(table))
            for table in predicted.tables
        ],
        improvement_heads=["change", *(f"{axis} {c}" for c in predicted.cameras for axis in AXES)],
        improvements=improvement_rows(summary),
    )


def _arcsec(sigma: float) -> str:
    return digits(sigma / ARCSEC, 3) if math.isfinite(sigma) else "not observable"


def sentences(summary: Mapping[str, Any]) -> list[str]:
    """The prediction in plain words."""
    said = [
        f"The least errors that any unbiased estimate can have, for {summary['points']:,} points in "
        f"{summary['shots']:,} shots over {digits(summary['window_seconds'], 3)} s, cameras "
        f"{digits(summary['baseline'] / 1e3, 3)} km apart. Points: {summary['points_from']}.",
    ]
    if summary["unobservable"]:
        said.append(f"Not observable: {'; '.join(entry['words'] for entry in summary['unobservable'])}.")
    seen = [entry for entry in summary["principal_sigmas"] if math.isfinite(entry["sigma"])]
    if seen:
        said.append(
            f"Known least would be {seen[0]['words']}, to {digits(seen[0]['sigma'] / ARCSEC, 2)} arcsec; "
            f"known best {seen[-1]['words']}, to {digits(seen[-1]['sigma'] / ARCSEC, 2)} arcsec."
        )
    return said


#: Ratio of sigmas below which cameras are alike.
_ALIKE = 1.02


def _whose(predicted: StereoPrediction) -> str:
    """Which camera that is, axis by axis, as planned."""
    sigmas = predicted.sigmas
    names = []
    for k, axis in enumerate(AXES):
        if not sigmas[:, k].max() <= _ALIKE * sigmas[:, k].min():
            names.append(f"{axis} of camera {predicted.cameras[int(sigmas[:, k].argmax())]}")
    if not names:
        return " (as planned all are known alike)"
    return f" (as planned {', '.join(names)}{'' if len(names) == len(AXES) else '; else all alike'})"


def sections(predicted: StereoPrediction, summary: Mapping[str, Any]) -> list[Section]:
    """All figures in the order of the page."""
    found = [
        Section(
            "directions",
            "What would be known well, and what not",
            "Combinations of the angles that can be known independently of each other, the weakest first.",
            stereo_figures.direction_figure(summary["principal_sigmas"]),
        )
    ]
    if predicted.tables:
        found.append(
            Section(
                "tables",
                "Sigma against what can be chosen",
                "Bounds of the angles when one quantity changes and all else stays as planned. Roll, pitch "
                f"and yaw are each of the camera known least{_whose(predicted)}.",
                stereo_prediction_figures.prediction_figure(predicted.tables),
            )
        )
    if predicted.improvements:
        found.append(
            Section(
                "improvements",
                "What would improve it",
                "What each change leaves of the sigmas: bars show roll, pitch and yaw each of the camera "
                "known least, the table all cameras.",
                stereo_prediction_figures.improvements_figure(predicted.improvements),
            )
        )
    return found
