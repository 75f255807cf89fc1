"""Figures of microvibration: tones through the strip, and how far each line is smeared.

Not here: how they are found (``evaluation/microvibration.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sightline.evaluation.microvibration import STEADY, most_stages, smear_px
from sightline.motion.results import LineOfSight
from sightline.report.figure import Figure
from sightline.report.marks import DASHES, Between, Line
from sightline.report.style import AXES, AXIS_COLOURS, AXIS_UNITS


def tone_figure(found: Mapping[str, Any]) -> Figure | None:
    """Amplitude of every tone against time with its 1-sigma band; None where there is none.

    Parameters
    ----------
    found : mapping
        ``microvibration`` of ``summary.json``.
    """
    axes = [axis for axis in AXES if any(tone["axis"] == axis for tone in found["tones"])]
    if not axes:
        return None
    figure = Figure(len(axes), height=190)
    for row, axis in enumerate(axes):
        panel, colour = figure[row], AXIS_COLOURS[AXES.index(axis)]
        for k, tone in enumerate(tone for tone in found["tones"] if tone["axis"] == axis):
            t, size, sigma = np.array(tone["t"]), np.array(tone["amplitude_px"]), tone["sigma_px"]
            name = f"{axis} {tone['frequency']:.1f} Hz"
            name += ", varies" if tone["steady_chance"] < STEADY else ", steady"
            dash = list(DASHES)[k % len(DASHES)]
            panel.add(
                Between(
                    x=t, low=np.maximum(size - sigma, 0.0), high=size + sigma, colour=colour, opacity=0.15
                ),
                Line(x=t, y=size, name=name, colour=colour, dash=dash, dotted=4.0),
            )
        panel.y.title, panel.y.from_zero = f"{axis} amplitude ({AXIS_UNITS[AXES.index(axis)]})", True
    figure[0].x.title = "time from the epoch (s)"
    return figure


def smear_figure(result: LineOfSight, found: Mapping[str, Any]) -> Figure:
    """Motion of the image during each line, or within its stages: by roll, pitch, and yaw at the edge.

    Parameters
    ----------
    result : LineOfSight
    found : mapping
        ``microvibration`` of ``summary.json``.
    """
    smear, figure = smear_px(result), Figure(3, height=150)
    names = ("across, by roll", "along, by pitch", "along at the field's edge, by yaw")
    for axis, name in enumerate(names):
        words = f"{name} (± {found['smear_px'][AXES[axis]]['sigma']:.2g} px)"
        colour = AXIS_COLOURS[axis]
        figure[axis].add(Line(x=result.motion.t, y=smear[:, axis], name=words, colour=colour, width=1.1))
        figure[axis].y.title = "motion (px per line)" if most_stages(result) == 1 else "even motion (px)"
    figure[0].x.title = "time from the epoch (s)"
    return figure
