"""Figures against frequency: spectrum of the motion with its tones, and what could be seen at all.

Not here: how they are found (``motion/tones.py``, ``evaluation/observed.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from sightline.applications.results import LineOfSight
from sightline.evaluation.error_spectrum import error_psd
from sightline.evaluation.observed import SEEN_SIGMAS, SEEN_TONE_PX, Observed
from sightline.motion.observability import Passbands
from sightline.motion.tones import DetectedTone, spectrum
from sightline.report.reduce import envelope_rows
from sightline.report.style import AXES, AXIS_COLOURS, AXIS_UNITS, BLIND, INK, MUTED, faint, labels, panels

Array = NDArray[np.float64]

#: A PSD is drawn over at most so many decades below its peak.
DECADES = 9.0


def spectrum_figure(
    result: LineOfSight, bands: Mapping[str, Passbands], tones: Sequence[DetectedTone], highest: float
) -> go.Figure:
    """PSD of each axis with tones named, beside the prior, the remaining error, and blind bands shaded."""
    found = spectrum(result.motion)
    inside = (found.frequency > 0.0) & (found.frequency <= highest)
    frequency = found.frequency[inside]
    fine = np.geomspace(frequency[0], highest, 1500)
    left = error_psd(result, fine)
    figure = panels(3, 780, shared_xaxes=True)
    for axis in range(3):
        square = 1.0 / result.scale[axis] ** 2
        psd = found.psd[inside, axis] * square
        row: dict[str, Any] = {"row": axis + 1, "col": 1}
        first = axis == 0
        rows = envelope_rows(np.log(np.maximum(psd, 1e-300)))
        curves = [
            (frequency[rows], psd[rows], "recovered motion", {"color": AXIS_COLOURS[axis], "width": 1.1}),
            (
                fine,
                left[:, axis] * square,
                "error that remains",
                {"color": MUTED, "width": 1.4, "dash": "dot"},
            ),
        ]
        if result.spectra is not None:
            prior = result.spectra[axis].psd(fine) * square
            curves.insert(1, (fine, prior, "spectrum fitted to it (prior)", {"color": INK, "width": 1.4}))
        for x, y, name, line in curves:
            figure.add_scatter(
                x=x, y=y, name=name, line=line, mode="lines", legendgroup=name, showlegend=first, **row
            )
        _name_tones(figure, [tone for tone in tones if tone.axis == AXES[axis]], frequency, psd, row, first)
        _shade_blind(figure, bands[AXES[axis]], float(frequency[0]), highest, row)
        _set_range(figure, axis, psd, left[:, axis] * square)
    _key_of_shading(figure)
    figure.update_xaxes(type="log", range=np.log10([frequency[0], highest]).tolist())
    figure.update_xaxes(title_text="frequency (Hz)", row=3)
    return figure


def visibility_figure(result: LineOfSight, seen: Observed, names: Sequence[str]) -> go.Figure:
    """Smallest tone that would stand out, per axis, and below it the blind frequencies of every pair."""
    # a pair matched both ways is blind at the same frequencies: once is enough
    once: dict[frozenset[int], tuple[int, int]] = {}
    for pair in seen.blind:
        once.setdefault(frozenset(pair), pair)
    names = labels(names)
    pairs = {f"{names[a]} – {names[b]}": seen.blind[a, b] for a, b in once.values()}
    share = 0.10 + 0.04 * len(pairs)
    figure = panels(2, 400 + 24 * len(pairs), shared_xaxes=True, row_heights=[1.0 - share, share])
    f = seen.frequency[1:]
    for axis, name in enumerate(AXES):
        smallest = SEEN_SIGMAS * seen.tone_sigma[1:, axis] / result.scale[axis]
        figure.add_scatter(
            x=f,
            y=np.minimum(smallest, 1e3),
            name=f"{name} ({AXIS_UNITS[axis]})",
            mode="lines",
            line={"color": AXIS_COLOURS[axis], "width": 1.2},
            row=1,
            col=1,
        )
    figure.add_hline(y=SEEN_TONE_PX, line={"color": INK, "width": 1, "dash": "dash"}, row=1, col=1)
    figure.add_annotation(
        x=0.995, y=np.log10(SEEN_TONE_PX), xref="x domain", yref="y", xanchor="right", yanchor="bottom",
        text=f"a tone of {SEEN_TONE_PX:g} px; above this line it counts as blind", showarrow=False,
    )  # fmt: skip
    for name, at in pairs.items():
        mark = {"symbol": "line-ns-open", "size": 11, "color": MUTED, "line": {"width": 1}}
        x = at[:: max(1, len(at) // 400)]
        figure.add_scatter(
            x=x, y=[name] * len(x), mode="markers", marker=mark, showlegend=False, name=name, row=2, col=1
        )
    smallest = SEEN_SIGMAS * seen.tone_sigma[1:] / result.scale
    floor = float(np.log10(smallest.min())) - 0.2
    top = min(max(float(np.log10(np.percentile(smallest, 99.5))), 0.0), 2.0)
    figure.update_yaxes(
        type="log",
        title_text="smallest tone seen (px)",
        exponentformat="power",
        range=[floor, top],
        dtick=1,
        row=1,
    )
    # names of pairs are as long as their bands' are: the margin follows them
    figure.update_yaxes(title_text="blind alone", showgrid=False, automargin=True, row=2)
    figure.update_xaxes(title_text="frequency (Hz)", row=2)
    figure.update_xaxes(range=[0.0, float(f[-1])])
    return figure


def tones_of(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[DetectedTone]:
    """Tones of a ``summary.json`` as the objects they were."""
    keys = DetectedTone.__dataclass_fields__
    return [
        DetectedTone(**{key: tone[key] for key in keys if key in tone} | {"axis": axis})
        for axis in AXES
        for tone in found[axis]
    ]


def _name_tones(
    figure: go.Figure,
    tones: Sequence[DetectedTone],
    frequency: Array,
    psd: Array,
    row: dict[str, Any],
    first: bool,
) -> None:
    """A mark and a name on every tone's peak."""
    if not tones:
        return
    near = [np.argmax(psd * (np.abs(frequency - tone.frequency) <= 3 * frequency[0])) for tone in tones]
    figure.add_scatter(
        x=frequency[near],
        y=psd[near],
        mode="markers+text",
        marker={"symbol": "circle-open", "size": 9, "color": INK, "line": {"width": 1.4}},
        text=[tone.name for tone in tones],
        textposition="top center",
        textfont={"size": 11},
        name="tone",
        legendgroup="tone",
        showlegend=first,
        cliponaxis=False,
        **row,
    )


def _shade_blind(
    figure: go.Figure, bands: Passbands, lowest: float, highest: float, row: dict[str, Any]
) -> None:
    """Shade every frequency outside the passbands."""
    start = lowest
    for low, high in [*bands, (highest, highest)]:
        if low > start:
            figure.add_vrect(
                x0=start, x1=min(low, highest), fillcolor=BLIND, line_width=0, layer="below", **row
            )
        start = max(start, high)


def _key_of_shading(figure: go.Figure) -> None:
    key = {
        "size": 11,
        "symbol": "square",
        "color": BLIND,
        "line": {"width": 1, "color": faint("#d69e2e", 0.6)},
    }
    name = f"blind to {SEEN_TONE_PX:g} px"  # short: the buttons stand at the end of the same line
    figure.add_scatter(x=[None], y=[None], mode="markers", marker=key, name=name)


def _set_range(figure: go.Figure, axis: int, psd: Array, left: Array) -> None:
    top = float(np.log10(psd.max())) + 1.5
    bottom = max(
        min(float(np.log10(max(np.percentile(psd, 2), 1e-300))), float(np.log10(left.min()))) - 0.3,
        top - DECADES,
    )
    unit = "px²/Hz" if axis < 2 else "px²/Hz at field edge"
    figure.update_yaxes(
        type="log",
        title_text=f"{AXES[axis]} ({unit})",
        range=[bottom, top],
        exponentformat="power",
        row=axis + 1,
    )
