"""Figures of microvibration: tones through the strip, and how far each line is smeared.

Not here: how they are found (``evaluation/microvibration.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from sightline.applications.results import LineOfSight
from sightline.evaluation.microvibration import STEADY, smear_px
from sightline.report.reduce import envelope_rows
from sightline.report.style import AXES, AXIS_COLOURS, AXIS_UNITS, faint, panels

Array = NDArray[np.float64]

#: Marks of the tones of one axis, in turn.
_DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")


def tone_figure(found: Mapping[str, Any]) -> go.Figure | None:
    """Amplitude of every tone against time with its 1-sigma band; None where there is none.

    Parameters
    ----------
    found : mapping
        ``microvibration`` of ``summary.json``.
    """
    axes = [axis for axis in AXES if any(tone["axis"] == axis for tone in found["tones"])]
    if not axes:
        return None
    figure = panels(len(axes), 130 + 210 * len(axes), shared_xaxes=True)
    for row, axis in enumerate(axes, 1):
        colour = AXIS_COLOURS[AXES.index(axis)]
        tones = [tone for tone in found["tones"] if tone["axis"] == axis]
        for k, tone in enumerate(tones):
            t, size, sigma = np.array(tone["t"]), np.array(tone["amplitude_px"]), tone["sigma_px"]
            band = np.concatenate([size + sigma, np.maximum(size - sigma, 0.0)[::-1]])
            name = f"{axis} {tone['frequency']:.1f} Hz"
            name += ", varies" if tone["steady_chance"] < STEADY else ", steady"
            figure.add_scatter(
                x=np.concatenate([t, t[::-1]]), y=band, mode="lines", line={"width": 0}, fill="toself",
                fillcolor=faint(colour, 0.15), hoverinfo="skip", showlegend=False, legendgroup=name, row=row,
                col=1,
            )  # fmt: skip
            figure.add_scatter(
                x=t, y=size, name=name, legendgroup=name, mode="lines+markers", marker={"size": 4},
                line={"color": colour, "width": 1.5, "dash": _DASHES[k % len(_DASHES)]}, row=row, col=1,
            )  # fmt: skip
        unit = AXIS_UNITS[AXES.index(axis)]
        figure.update_yaxes(title_text=f"{axis} amplitude ({unit})", rangemode="tozero", row=row, col=1)
    figure.update_xaxes(title_text="time from the epoch (s)", row=len(axes), col=1)
    return figure


def smear_figure(result: LineOfSight, found: Mapping[str, Any]) -> go.Figure:
    """Motion of the image during each line: across (roll), along (pitch), and what yaw adds at the edge.

    Parameters
    ----------
    result : LineOfSight
    found : mapping
        ``microvibration`` of ``summary.json``.
    """
    smear = smear_px(result)
    figure = panels(3, 560, shared_xaxes=True)
    names = ("across, by roll", "along, by pitch", "along at the field's edge, by yaw")
    for axis, name in enumerate(names):
        values = smear[:, axis]
        rows = envelope_rows(values)
        sigma = found["smear_px"][AXES[axis]]["sigma"]
        figure.add_scatter(
            x=result.motion.t[rows], y=values[rows], mode="lines",
            name=f"{name} (± {sigma:.2g} px)", line={"color": AXIS_COLOURS[axis], "width": 1.1},
            row=axis + 1, col=1,
        )  # fmt: skip
        figure.update_yaxes(title_text="motion (px per line)", row=axis + 1, col=1)
    figure.update_xaxes(title_text="time from the epoch (s)", row=3, col=1)
    return figure
