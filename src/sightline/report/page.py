"""The report of a recovery: one HTML page that asks no network for anything.

The drawing library is inside the page, once; figures are drawn by the reader's browser.

Not here: what the figures and sentences are (the other files of this folder).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from sightline.applications.results import LineOfSight
from sightline.applications.spin_attitude import SpinAttitude
from sightline.errors import printable, shortened
from sightline.evaluation.observed import SEEN_TONE_PX, observed
from sightline.io.acquired import Acquisition
from sightline.report import (
    match_figures,
    microvibration_figures,
    motion_figures,
    spectrum_figures,
    style,
    words,
)
from sightline.report.composite import composite
from sightline.report.spin_words import spin_section
from sightline.writing import whole

#: Frequencies at which visibility is drawn.
_FREQUENCIES = 2401
#: Characters of a word on a page.
LONGEST_WORD = 160


@dataclass(frozen=True)
class Section:
    """A figure with its heading and how to read it.

    Attributes
    ----------
    name : str
        Anchor of the section.
    title, caption : str
    figure : Figure
        Of plotly.
    """

    name: str
    title: str
    caption: str
    figure: go.Figure

    @property
    def html(self) -> Markup:
        """The figure as a piece of the page."""
        return Markup(style.as_html(self.figure, f"figure-{self.name}"))


def write_report(
    path: Path, result: LineOfSight, acquisition: Acquisition, summary: Mapping[str, Any]
) -> None:
    """Write ``report.html``, complete or not at all.

    Parameters
    ----------
    path : Path
        Of the page.
    result : LineOfSight
    acquisition : Acquisition
        What it was recovered from.
    summary : mapping
        As ``io.results.write_result`` gives it.
    """
    write_page(path, report_html(result, acquisition, summary))


def write_page(path: Path, text: str) -> None:
    """Write a page, complete or not at all."""
    with whole(path) as draft:
        draft.write_text(text, encoding="utf-8")


def render(template: str, **values: Any) -> str:
    """A page of this folder as text; the drawing library is put in once.

    All text is escaped, on one line, and its words have an end: whatever it holds is shown and does nothing.
    """
    environment = Environment(
        loader=PackageLoader("sightline.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_shown,
    )
    return environment.get_template(template).render(library=Markup(get_plotlyjs()), **values)


def _shown(value: Any) -> Any:
    """Text as it can be shown, unless it is HTML already."""
    if not isinstance(value, str) or isinstance(value, Markup):
        return value
    return re.sub(r"\S+", lambda word: shortened(word[0], LONGEST_WORD), printable(value))


def report_html(result: LineOfSight, acquisition: Acquisition, summary: Mapping[str, Any]) -> str:
    """The page as text; parameters as of `write_report`."""
    tones = spectrum_figures.tones_of(summary["tones"])
    spin = spin_section(result, acquisition.chip.names) if isinstance(result, SpinAttitude) else None
    return render(
        "page.html.j2",
        summary=summary,
        sentences=words.sentences(result, summary, tones),
        cards=words.axis_cards(result, summary),
        sections=sections(result, summary),
        overlay=composite(result, acquisition),
        tones=words.tone_rows(result, tones, spectrum_figures.tones_of(summary["tones_hardly_seen"])),
        statics=words.static_rows(result),
        sensors=words.sensor_rows(result),
        close=words.close_rows(summary),
        above=words.above_band(summary),
        pairs=[] if spin else words.pair_rows(result),
        spin=spin,
    )


def sections(result: LineOfSight, summary: Mapping[str, Any]) -> list[Section]:
    """All figures in the order of the page."""
    few = len(result.motion.t) < motion_figures.FEW_EPOCHS
    band, narrower = (
        ("bars are", "they are shorter than the dot") if few else ("band is", "it is narrower than the line")
    )
    found = [
        Section(
            "attitude",
            "Attitude against time",
            f"Departure from the reference attitude, less what the images cannot see. The {band} ± 1 sigma; "
            f"where {narrower}, the motion is known better than the drawing shows.",
            motion_figures.attitude_figure(result),
        )
    ]
    close = motion_figures.close_figure(result)
    if close is not None:
        caption = "The same over a few lines where roll and pitch are fastest; one mark per image line."
        found.append(Section("close", "A closer look at the jitter", caption, close))
    caption = (
        "How well each axis is known at every instant. It grows at the ends and where matches are missing."
    )
    found.append(Section("sigma", "Sigma against time", caption, motion_figures.sigma_figure(result)))
    return (
        found
        + _frequency_sections(result, summary)
        + _microvibration_sections(result, summary)
        + _match_sections(result)
    )


def _frequency_sections(result: LineOfSight, summary: Mapping[str, Any]) -> list[Section]:
    """Figures against frequency; none for a few frames."""
    if len(result.motion.t) < motion_figures.FEW_EPOCHS:
        return []
    highest = float(summary["highest_frequency"])
    seen = observed(result, np.linspace(0.0, highest, _FREQUENCIES))
    tones = spectrum_figures.tones_of(summary["tones"])
    return [
        Section(
            "spectrum",
            "Spectrum of the motion",
            "Power spectral density of the recovered motion, with tones named. The dotted curve is the error "
            "that remains: where the motion lies below it, it is believed, not measured. Where it is shaded, "
            f"a steady tone of {SEEN_TONE_PX:g} px would not stand out.",
            spectrum_figures.spectrum_figure(result, summary["passbands"], tones, highest),
        ),
        Section(
            "seen",
            "What could be seen, frequency by frequency",
            "Amplitude of a steady tone that would stand out by 5 sigma. One pair of images alone is blind "
            "at the multiples of 1/lag marked below; pairs of several lags fill each other's gaps. Shown up "
            f"to {highest:.4g} Hz: beyond, a window of several lines averages the motion away.",
            spectrum_figures.visibility_figure(result, seen, result.image_names),
        ),
    ]


def _microvibration_sections(result: LineOfSight, summary: Mapping[str, Any]) -> list[Section]:
    """Tones through time and the smear of the lines; none for frames."""
    found = summary["microvibration"]
    if found is None:
        return []
    out = []
    tones = microvibration_figures.tone_figure(found)
    if tones is not None:
        caption = (
            "Amplitude of each tone in short pieces of the strip, ± 1 sigma. “Varies”: a steady tone would "
            "scatter so much less than once in a thousand strips."
        )
        out.append(Section("tones", "Tones through the strip", caption, tones))
    smear = found["smear_px"]
    caption = (
        "How far the image moves during one line period beside the nominal scan. It multiplies the MTF at "
        f"half a cycle per pixel by {smear['roll']['mtf_at_nyquist']:.4f} across and "
        f"{smear['pitch']['mtf_at_nyquist']:.4f} along, on average over the lines."
    )
    smeared = microvibration_figures.smear_figure(result, found)
    out.append(Section("smear", "Smear of each line", caption, smeared))
    return out


def _match_sections(result: LineOfSight) -> list[Section]:
    """Figures of the matches; none where there is no pair."""
    views = match_figures.pair_views(result)
    if not views:
        return []
    return [
        Section(
            "residuals",
            f"Residuals over the image, before and after ({views[0].name})",
            "Measured minus predicted place of every window: red where it was found at a later line (a "
            "larger column) than predicted. Before: by the nominal cameras. After: what the recovered motion "
            "does not explain; stripes would be motion left over, patches relief, clouds or false matches. "
            "The scales of before and after differ.",
            match_figures.residual_map_figure(result, views[0]),
        ),
        Section(
            "histogram",
            "Residuals of all pairs, before and after",
            "If the sigmas of the matches are true, the bars on the right follow the curve.",
            match_figures.residual_histogram(result),
        ),
        Section(
            "matches",
            "Where matches were kept, and why others were not",
            "One cell per window, or the most frequent answer of several. A later image is first of a pair "
            "only for ground that no earlier one has seen.",
            match_figures.status_figure(result, views[:6]),
        ),
    ]
