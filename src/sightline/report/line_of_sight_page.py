"""The page of a recovery of the line of sight.

Not here: what the figures and sentences are (``*_figures.py``, ``words.py``, ``spin_words.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from markupsafe import Markup

from sightline.applications.spin_attitude import SpinAttitude
from sightline.evaluation.microvibration import most_stages
from sightline.evaluation.observed import SEEN_TONE_PX, observed
from sightline.io.acquisition.acquired import Acquisition
from sightline.io.formats.tables import MotionTable
from sightline.motion.results import LineOfSight
from sightline.report import match_figures, microvibration_figures, motion_figures, spectrum_figures, words
from sightline.report.composite import composite
from sightline.report.page import Page, Section, Table, inputs, pictures, resources
from sightline.report.spin_words import spin_sections

#: Frequencies at which visibility is drawn.
_FREQUENCIES = 2401
_FOOTER = (
    "Angles are about body axes (roll forward, pitch right, yaw down); sigma is one standard deviation; px "
    "of yaw are px at the edge of the field. Files beside this page: motion.csv, summary.json, "
    "attitude.csv, spectrum.csv, hidden.csv, covariance.npz and, where they could be made, differences.csv, "
    "smear.csv and attitude.aem."
)
_TRUTH = " Dark dashes: the truth, which the estimate never saw, less the same unobservable part."


def line_of_sight_page(
    result: LineOfSight,
    acquisition: Acquisition,
    summary: Mapping[str, Any],
    truth: MotionTable | None = None,
) -> Page:
    """The page of a recovery.

    Parameters
    ----------
    result : LineOfSight
    acquisition : Acquisition
        What it was recovered from.
    summary : mapping
        As ``write_result`` gives it.
    truth : MotionTable, optional
        The true motion, drawn over the estimate.
    """
    tones = spectrum_figures.tones_of(summary["tones"])
    spin = spin_sections(result, acquisition.chip.names) if isinstance(result, SpinAttitude) else []
    epoch = f"; t = 0 is {summary['epoch']}" if summary["epoch"] else ""
    return Page(
        heading=summary["name"],
        what="line of sight",
        about=f"Line of sight recovered from {len(summary['images'])} images by Sightline "
        f"{summary['version']}{epoch}{resources(summary)}",
        sentences=words.sentences(result, summary, tones),
        warnings=summary["warnings"],
        cards=_cards(words.axis_cards(result, summary)),
        sections=[
            *spin,
            *_overlay(result, acquisition),
            *figure_sections(result, summary, truth),
            *_tables(result, summary, pairs=not spin),
            inputs(summary),
        ],
        footer=_FOOTER,
    )


def _cards(cards: list[dict[str, str]]) -> Markup:
    """The main numbers of each axis."""
    out = []
    for card in cards:
        unit = Markup(" <small>{}</small>").format(card["unit"]) if card["unit"] != "px" else ""
        size = "{} px <small>({})</small>"
        rows = [
            ("motion, rms", Markup(size).format(card["motion"], card["motion_angle"])),
            ("sigma, median", Markup(size).format(card["sigma"], card["sigma_angle"])),
            ("sigma, largest", Markup(size).format(card["worst"], card["worst_angle"])),
            ("absolute sigma", card["absolute"]),
            ("seen", card["seen"]),
        ]
        inner = Markup("").join(Markup("<dt>{}</dt><dd>{}</dd>").format(*row) for row in rows if row[1])
        head = Markup('<div class="card {0}"><h2>{0}{1}</h2><dl>').format(card["name"], unit)
        out.append(head + inner + Markup("</dl></div>"))
    return Markup('<div class="cards">{}</div>').format(Markup("").join(out))


def _overlay(result: LineOfSight, acquisition: Acquisition) -> list[Section]:
    """Two images laid on each other; none without any match."""
    found = composite(result, acquisition)
    if found is None:
        return []
    caption = (
        f"{found.hub} in red, {found.partner} laid on it in cyan; lines {found.first_line}–"
        f"{found.first_line + found.lines - 1}, columns {found.first_column}–"
        f"{found.first_column + found.columns - 1}. Where the two fit the picture is grey (but for "
        "differences of colour between the bands); red and cyan rims are misfit. Flat light grey: one of "
        "the two has no value there."
    )
    shown = pictures(
        [
            (found.before, "Overlay by the nominal cameras", "Before: by the nominal cameras"),
            (found.after, "Overlay by the recovered cameras", "After: by the recovered line of sight"),
        ]
    )
    return [Section("overlay", "The same ground in two images, before and after", [caption, shown])]


def figure_sections(
    result: LineOfSight, summary: Mapping[str, Any], truth: MotionTable | None = None
) -> list[Section]:
    """All figures in the order of the page."""
    few = len(result.motion.t) < motion_figures.FEW_EPOCHS
    band, narrower = (
        ("bars are", "they are shorter than the dot") if few else ("band is", "it is narrower than the line")
    )
    true = _TRUTH if truth is not None else ""
    caption = (
        f"Departure from the reference attitude, less what the images cannot observe. The {band} ± 1 sigma; "
        f"where {narrower}, the motion is known better than the drawing shows.{true}"
    )
    found = [
        Section("attitude", "Attitude against time", [caption, motion_figures.attitude_figure(result, truth)])
    ]
    close = motion_figures.close_figure(result, truth)
    if close is not None:
        caption = (
            f"The same over a few lines where roll and pitch are fastest; one mark per image line.{true}"
        )
        found.append(Section("close", "A closer look at the jitter", [caption, close]))
    caption = (
        "How well each axis is known at every instant. It grows at the ends and where matches are missing."
    )
    found.append(Section("sigma", "Sigma against time", [caption, motion_figures.sigma_figure(result)]))
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
            [
                "Power spectral density of the recovered motion, with tones named. The dotted curve is the "
                "error that remains: where the motion lies below it, it is believed, not measured. Where it "
                f"is shaded, a steady tone of {SEEN_TONE_PX:g} px would not stand out.",
                spectrum_figures.spectrum_figure(result, summary["passbands"], tones, highest),
            ],
        ),
        Section(
            "seen",
            "What could be seen, frequency by frequency",
            [
                "Amplitude of a steady tone that would stand out by 5 sigma. One pair of images alone is "
                "blind at the multiples of 1/lag marked below; pairs of several lags fill each other's "
                f"gaps. Shown up to {highest:.4g} Hz: beyond, a window of several lines averages the motion "
                "away.",
                spectrum_figures.visibility_figure(result, seen, result.image_names),
            ],
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
        out.append(Section("tones", "Tones through the strip", [caption, tones]))
    smear = found["smear_px"]
    stages = most_stages(result)
    moved = "How far the image moves during one line period"
    if stages > 1:
        moved = f"The even motion that blurs as much as what the image moves within its {stages} stages does,"
    caption = (
        f"{moved} beside the nominal scan. It multiplies the MTF at "
        f"half a cycle per pixel by {smear['roll']['mtf_at_nyquist']:.4f} across and "
        f"{smear['pitch']['mtf_at_nyquist']:.4f} along, on average over the lines."
    )
    smeared = microvibration_figures.smear_figure(result, found)
    out.append(Section("smear", "Smear of each line", [caption, smeared]))
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
            [
                "Measured minus predicted place of every window: red where it was found at a later line (a "
                "larger column) than predicted. Before: by the nominal cameras. After: what the recovered "
                "motion does not explain; stripes would be motion left over, patches relief, clouds or "
                "false matches. The scales of before and after differ.",
                match_figures.residual_map_figure(result, views[0]),
            ],
        ),
        Section(
            "histogram",
            "Residuals of all pairs, before and after",
            [
                "If the sigmas of the matches are true, the bars on the right follow the curve.",
                match_figures.residual_histogram(result),
            ],
        ),
        Section(
            "matches",
            "Where matches were kept, and why others were not",
            [
                "One cell per window, or the most frequent answer of several. A later image is first of a "
                "pair only for ground that no earlier one has seen.",
                match_figures.status_figure(result, views[:6]),
            ],
        ),
    ]


def _tables(result: LineOfSight, summary: Mapping[str, Any], *, pairs: bool) -> list[Section]:
    """Pairs, tones, sensors and static parameters, each where there are any."""
    tones, hardly = (spectrum_figures.tones_of(summary[key]) for key in ("tones", "tones_hardly_seen"))
    every = [
        (
            "pairs",
            "Pairs of images",
            "Residuals are rms over both components of the windows kept; “expected” is what the matches' own "
            "sigma asks for.",
            Table(
                "pair|lag (s)|windows|kept|others|before (px)|after (px)|expected (px)".split("|"),
                words.pair_table(result) if pairs else [],
                [0, 4],
            ),
        ),
        (
            "withheld",
            "Pairs that the estimate did not use",
            "Windows of these pairs against what motion, offsets and ground found from the others predict of "
            "them. "
            "“NEES” is the mean square of measured less predicted over its sigma, which is that of the "
            "prediction and of the match, less what they share: 1 where the sigmas are true; above, they are "
            "too small. "
            "“Worth” is how many independent windows they amount to: the NEES of true sigmas scatters by "
            "√(2 / worth).",
            Table(
                "pair|axis|windows|worth|rms (px)|its sigma (px)|predicted to (px)|NEES|within 95 %".split(
                    "|"
                ),
                words.withheld_rows(summary),
                [0, 1],
            ),
        ),
        (
            "peaks",
            "Tones",
            f"{words.above_band(summary)} Amplitude is that of the sine (√2 times its rms), yaw in px at "
            "the field edge. The sigmas hold the scatter around the peak and the error of the motion there; "
            "a peak of less than three of them is hardly seen: there may be no tone, or a larger one (up to "
            "2 sigma is given), for the estimate shrinks what it does not see. The last column is the "
            "probability of so strong a peak anywhere in the axis without any tone.",
            Table(
                "axis|frequency (Hz)|amplitude (px)|amplitude (µrad)|multiple, or doubt|false alarm".split(
                    "|"
                ),
                words.tone_rows(result, tones, hardly),
            ),
        ),
        (
            "close-tones",
            "Tones closer than the strip's own resolution",
            "Peaks that two steady tones explain to the noise, and one does not: fitting both separates "
            "frequencies closer than 1/duration.",
            Table("axis|frequencies (Hz)|amplitudes (px)".split("|"), words.close_rows(summary)),
        ),
        (
            "sensors",
            "Attitude sensors and control points",
            "Readings during the strip, observations in the same estimate as the images. A sensor whose "
            "residuals scatter more than its sigma says is believed less: by the factor shown (roll / pitch "
            "/ yaw). Constants of a sensor are in µrad (drift µrad/s), with their sigma after the estimate.",
            Table(
                "name|kind|readings used|outliers|sigma|its constants".split("|"),
                words.sensor_table(result),
                [0, 1, 5],
            ),
        ),
        (
            "statics",
            "Static parameters",
            "Departure of each detector line (or of the lens) from what was given. “Observed in the "
            "images”: the part of the a priori variance that is gone; the remainder cannot be separated "
            "from motion.",
            Table(
                "parameter|value|sigma|a priori sigma|unit|observed in the images".split("|"),
                words.static_rows(result),
            ),
        ),
    ]
    return [Section(name, title, [said, table]) for name, title, said, table in every if table.rows]
