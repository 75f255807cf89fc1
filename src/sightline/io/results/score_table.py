"""Scores as tables for people: of a motion, of an orientation, of poses.

Not here: the scores (``evaluation/``), reading what is scored (``pose_score.py``, ``stereo_score.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sightline.evaluation.direction_words import AXES
from sightline.evaluation.score_poses import PARAMETERS
from sightline.geometry.units import ARCSEC

#: Columns of a table: head, key of an entry, form.
_COLUMNS = (
    ("rms", "rms", ".3g"),
    ("max", "max", ".3g"),
    ("sigma", "sigma", ".3g"),
    ("NEES", "nees", ".2f"),
    ("in 95 %", "coverage_95", ".0%"),
)
_ALONE = {"not_in_truth": "frames that are not in the truth", "not_in_result": "that are not in the result"}


def score_lines(score: dict[str, Any]) -> list[str]:
    """A score of any kind as lines of a table.

    Parameters
    ----------
    score : dict
        As `sightline score` prints it as JSON.
    """
    lines: Callable[[dict[str, Any]], list[str]] = motion_score_lines
    if "by_source" in score:
        lines = pose_score_lines
    elif "cameras" in score:
        lines = orientation_score_lines
    return lines(score)


def motion_score_lines(score: dict[str, Any]) -> list[str]:
    """A score of a motion: per axis rms, largest error and rms of the stated sigma, NEES, coverage.

    Parameters
    ----------
    score : dict
        As of ``Score.as_dict``.
    """
    lines = [_line("lines", "", [head for head, _, _ in _COLUMNS])]
    name = f"hidden left out ({score['lines']})"
    for axis in AXES:
        lines.append(_line(name, axis, _cells(score[axis])) + f"  {score[axis]['unit']}")
        name = ""
    name = f"whole angle ({score['lines']})"
    for axis, entry in score["absolute"].items():
        lines.append(_line(name, axis, _cells(entry)) + f"  {entry['unit']}")
        name = ""
    if score["left_out"]:
        lines.append(f"hidden, and left out: {', '.join(score['left_out'])}")
    expected = "; ".join(
        f"{axis} {score[axis]['nees_low']:.2f} to {score[axis]['nees_high']:.2f}" for axis in AXES
    )
    lines.append(
        f"NEES: mean squared error over the stated variance; 95 times in 100 a true sigma has {expected}"
    )
    return lines


def orientation_score_lines(score: dict[str, Any]) -> list[str]:
    """A score of an orientation: per camera and axis error, stated sigma, and their ratio.

    Parameters
    ----------
    score : dict
        As of `sightline.evaluation.score_orientation.score_orientation`.
    """
    lines = [_line("cameras", "", ["error", "sigma", "ratio"])]
    for camera, axes in score["cameras"].items():
        name = camera
        for axis, entry in axes.items():
            if entry["error_over_sigma"] is None:
                cells = ["-", "-", "-"]
            else:
                sigma = entry["sigma"] / ARCSEC
                cells = [f"{entry['error_arcsec']:.3g}", f"{sigma:.3g}", f"{entry['error_over_sigma']:.2f}"]
            lines.append(_line(name, axis, cells) + "  arcsec")
            name = ""
    lines.append(f"rms {score['rms_arcsec']:.3g} arcsec, max {score['max_arcsec']:.3g} arcsec")
    together = "with the covariance" if score["nees"] is not None else "each angle by itself"
    nees = score["nees"] if score["nees"] is not None else score["nees_independent"]
    lines.append(
        f"NEES {nees:.2f} ({together}); {score['expected']} is expected, "
        f"{score['nees_low']:.2f} to {score['nees_high']:.2f} 95 times in 100; "
        f"{score['coverage_95']:.0%} within 1.96 sigma"
    )
    if score["not_observable"]:
        lines.append(f"not observable: {', '.join(score['not_observable'])}")
    return lines


def pose_score_lines(score: dict[str, Any]) -> list[str]:
    """A score of poses: per kind of frame and parameter rms, largest error, rms of the stated sigma (m,
    degrees), NEES, coverage.

    Parameters
    ----------
    score : dict
        As of `sightline.io.results.pose_score.score_pose_folder`.
    """
    count = score["frames"]
    lines = [_line("frames", "", [head for head, _, _ in _COLUMNS])]
    lines += _part_lines(f"all ({count})", score["absolute"])
    for source, part in score["by_source"].items():
        lines += _part_lines(f"{source} ({part['frames']})", part)
    if "rigid" in score:
        lines += _part_lines(f"all, turned and moved ({count})", score["rigid"])
    if "focal_length" in score:
        focal = score["focal_length"]
        lines.append(
            f"focal length: error {focal['error_px']:.3g} px, stated sigma {focal['sigma_px']:.3g} px"
        )
    lines.append(
        "NEES: mean squared error over the stated variance; 1 is expected, of all six together 6. Frames "
        "share the error of their datum: one flight is one draw of it."
    )
    alone = [f"{score[key]} {words}" for key, words in _ALONE.items() if score[key]]
    return lines + ([f"not compared: {', '.join(alone)}"] if alone else [])


def _part_lines(name: str, entries: dict[str, Any]) -> list[str]:
    """Of each parameter, and of all together."""
    lines = []
    for parameter in PARAMETERS:
        entry = entries[parameter]
        unit, factor = ("m", 1.0) if entry["unit"] == "m" else ("deg", float(np.degrees(1.0)))
        lines.append(_line(name, f"{parameter} {unit}", _cells(entry, factor)))
        name = ""
    together = entries.get("nees")
    return lines if together is None else [*lines, _line("", "all six", ["", "", "", f"{together:.2f}"])]


def _cells(entry: dict[str, Any], factor: float = 1.0) -> list[str]:
    """The numbers of one line; lengths and angles times a factor, a dash for what is not there."""
    return [
        format(entry[key] * (factor if form == ".3g" else 1.0), form) if key in entry else "-"
        for _, key, form in _COLUMNS
    ]


def _line(name: str, parameter: str, cells: Sequence[str]) -> str:
    return f"{name:30}{parameter:10}" + "".join(f"{cell:>10}" for cell in cells)
