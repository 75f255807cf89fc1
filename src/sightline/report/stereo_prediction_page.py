"""The page of a stereo prediction.

Not here: its figures (``stereo_prediction_figures.py``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from sightline.applications.stereo_prediction import StereoPrediction
from sightline.evaluation.direction_words import AXES
from sightline.geometry.units import ARCSEC
from sightline.report import stereo_figures, stereo_prediction_figures
from sightline.report.page import Page, Section, Table, inputs
from sightline.report.stereo_page import improvement_rows
from sightline.report.stereo_words import several
from sightline.report.words import digits


def prediction_page(predicted: StereoPrediction, summary: Mapping[str, Any]) -> Page:
    """The page of a stereo prediction.

    Parameters
    ----------
    predicted : StereoPrediction
    summary : mapping
        As ``write_prediction`` gives it.
    """
    sigmas = [[camera, *(_arcsec(own[axis]) for axis in AXES)] for camera, own in summary["sigmas"].items()]
    heads = ["camera", "roll (arcsec, 1 sigma)", "pitch (arcsec)", "yaw (arcsec)"]
    numbers: list[str | Table] = []
    for table in predicted.tables:
        quantity = table.quantity[:1].upper() + table.quantity[1:]
        numbers += [f"{quantity}: {table.how}.", Table(*stereo_prediction_figures.prediction_rows(table))]
    said = "1 sigma, arcsec; roll, pitch and yaw are each of the camera known least."
    return Page(
        heading=summary["name"],
        what="what a stereo orientation would give",
        about=f"Predicted attitude errors of {several(len(summary['cameras']), 'camera')} by Sightline "
        f"{summary['version']}: the bound of {summary['method']}; nothing was estimated",
        sentences=sentences(summary),
        warnings=summary["warnings"],
        sections=[
            Section("sigmas", "Sigma of the angles", [Table(heads, sigmas)]),
            *sections(predicted, summary),
            *([Section("numbers", "The numbers", [said, *numbers])] if numbers else []),
            inputs(summary),
        ],
        footer="Files beside this page: orientation.csv (sigmas), "
        f"covariance.csv{', tables.csv' if numbers else ''}, summary.json.",
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
            [
                "Combinations of the angles that can be known independently of each other, the weakest "
                "first.",
                stereo_figures.direction_figure(summary["principal_sigmas"]),
            ],
        )
    ]
    if predicted.tables:
        found.append(
            Section(
                "tables",
                "Sigma against what can be chosen",
                [
                    "Bounds of the angles when one quantity changes and all else stays as planned. Roll, "
                    f"pitch and yaw are each of the camera known least{_whose(predicted)}.",
                    stereo_prediction_figures.prediction_figure(predicted.tables),
                ],
            )
        )
    if predicted.improvements:
        found.append(
            Section(
                "improvements",
                "What would improve it",
                [
                    "What each change leaves of the sigmas: bars show roll, pitch and yaw each of the camera "
                    "known least, the table all cameras.",
                    stereo_prediction_figures.improvements_figure(predicted.improvements),
                    *improvement_rows(summary, predicted.cameras)[1:],
                ],
            )
        )
    return found
