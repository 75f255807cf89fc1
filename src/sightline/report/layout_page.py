"""The page of a choice of layouts.

Not here: its figures (``layout_figures.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sightline.applications.focal_plane import (
    BALANCED,
    BALANCED_SHARE,
    LEAST_SIGMA,
    JudgedLayout,
    LayoutChoice,
)
from sightline.report import layout_figures
from sightline.report.page import Page, Section, Table, inputs, resources
from sightline.report.words import digits

#: Groups of lags that are blind together shown per layout, the largest first.
_GROUPS = 8


def layout_page(choice: LayoutChoice, summary: Mapping[str, Any]) -> Page:
    """The page of a choice of layouts.

    Parameters
    ----------
    choice : LayoutChoice
    summary : mapping
        As ``write_layouts`` gives it.
    """
    low, high = summary["passband"]
    unlike = ["images"] if len(set(choice.focal_plane.image_sigma_px)) > 1 else []
    judged = ["worst case", "at (Hz)", "sigma (px)", "in band (px)", "blind (Hz)"]
    ranked = Table(
        ["rank", "name", "places (ms)", "places (px)", *unlike, *judged],
        layout_rows(choice.ranked, summary["ranked"], numbered=True),
        [1, 2, 3, *([4] if unlike else [])],
    )
    compared = Table(
        ["name", "places (ms)", *judged], layout_rows(choice.compared, summary["compared"]), [0, 1]
    )
    common = Table(
        ["layout", "frequency (Hz)", "pairs", "lags (ms)", "whole periods", "mismatch"],
        common_rows([*layout_figures.standing_out(choice), *_published(choice)]),
        [0, 3, 4],
    )
    return Page(
        heading=summary["name"],
        what="layouts of the focal plane",
        about=f"Layouts of the focal plane for {low:g} to {high:g} Hz by Sightline {summary['version']}"
        f"{resources(summary)}",
        sentences=sentences(choice),
        warnings=summary["warnings"],
        sections=[
            Section(
                "ranked",
                "Layouts found",
                [
                    "By their worst case in the band, in images' worth. Sigma is what remains unknown of "
                    "the whole motion less its mean, ends of the strip included; “in band” the part of it "
                    "within the pass-band. Blind: where all pairs are, up to "
                    f"{summary['highest_frequency']:.4g} Hz.",
                    ranked,
                ],
            ),
            Section(
                "compared",
                "Yours and published ones, judged alike",
                ["With the same error per image.", compared],
            ),
            *sections(choice),
            Section(
                "common-lags",
                "Lags that go blind together",
                [
                    "Lags that are nearly whole periods of one frequency, so nearly in the ratio of small "
                    "whole numbers: at that frequency and its multiples none of them sees anything. "
                    "“Mismatch” is how far the worst is from whole. Where it says all, the layout is blind "
                    "there.",
                    common,
                ],
            ),
            inputs(summary),
        ],
        footer="One image's worth: what a row of windows of one image would observe if the ground were "
        "known. Files beside this page: layouts.csv, summary.json.",
    )


def _published(choice: LayoutChoice) -> list[JudgedLayout]:
    return [layout for layout in choice.compared if layout.source == "published"]


def sections(choice: LayoutChoice) -> list[Section]:
    """All figures in the order of the page."""
    return [
        Section(
            "information",
            "Information against frequency",
            [
                "How well each layout sees a steady motion, in units of what one image knows of its own "
                "place: at most the number of images. The pass-band is shaded, the worst frequency in it "
                "marked; where a curve touches zero, all pairs of the layout are blind together.",
                layout_figures.information_figure(choice),
            ],
        ),
        Section(
            "places",
            "Where the detectors stand",
            [
                "One mark per detector. Close ones see fast motion, distant ones slow motion.",
                layout_figures.places_figure(choice),
            ],
        ),
        Section(
            "span",
            "What a longer focal plane brings",
            [
                "For every span the layout whose worst frequency in the band is seen best (above), and what "
                "remains unknown with it of the whole motion, slow drift included (below). The best layout "
                "for the band alone is often short; a longer one gains slow motion for a little of the band.",
                layout_figures.span_figure(choice),
            ],
        ),
        Section(
            "remaining",
            "What remains unknown",
            [
                "Spectrum of the motion that is expected, and of the error that each layout leaves of it. "
                "Peaks are frequencies that the layout hardly sees.",
                layout_figures.remaining_figure(choice),
            ],
        ),
    ]


def sentences(choice: LayoutChoice) -> list[str]:
    """The choice in plain words."""
    return [_sought(choice), _best(choice), _others(choice), _alternatives(choice), _model(choice)]


def _sought(choice: LayoutChoice) -> str:
    plane, (low, high) = choice.focal_plane, choice.passband
    where = (
        f"lines of one detector ({len(plane.lines)} to choose from)"
        if plane.lines is not None
        else f"detectors within {1e3 * plane.span_px / plane.ground_rate_px:.4g} ms"
    )
    how = (
        f"All {choice.tried:,.0f} layouts on the grid were gone through"
        if choice.exhaustive
        else f"{choice.tried:,.0f} layouts were judged; no move of one or two detectors betters the best"
    )
    return f"{plane.detectors} {where} were placed for motion of {low:g} to {high:g} Hz. {how}."


def _best(choice: LayoutChoice) -> str:
    best = choice.best
    places = ", ".join(f"{1e3 * t:.4g}" for t in best.positions)
    blind = [f"{b.frequency:.4g}" for b in best.blind if b.frequency > choice.passband[1]]
    beyond = f" Beyond the band it is blind at {', '.join(blind[:4])} Hz." if blind else ""
    return (
        f"The best one stands at {places} ms. At its worst frequency of the band, "
        f"{best.worst_frequency:.4g} Hz, it gives as much as {best.worst_images:.3g} images over ground that "
        f"is known would; {len(best.positions)} is the limit.{beyond}"
    )


def _others(choice: LayoutChoice) -> str:
    blind = [f"{x.name} at {x.worst_frequency:.4g} Hz" for x in choice.compared if x.blind_in_band]
    seeing = [
        f"{choice.best.worst_images / x.worst_images:.3g} times that of {x.name} "
        f"(worst at {x.worst_frequency:.4g} Hz)"
        for x in choice.compared
        if not x.blind_in_band
    ]
    said = [f"Its worst case is {', '.join(seeing)}." if seeing else ""]
    said.append(f"Quite blind within the band: {', '.join(blind)}." if blind else "")
    return " ".join(filter(None, said))


def _alternatives(choice: LayoutChoice) -> str:
    named = {layout.name: layout for layout in choice.ranked if layout.name}
    said = [
        f"Of the whole motion, slow drift included, {digits(choice.best.sigma_px, 2)} px remain unknown "
        f"with it, {digits(choice.best.band_sigma_px, 2)} px of them in the band"
    ]
    if BALANCED in named:
        said.append(
            f"“{BALANCED}” gives up at most {100 * (1 - BALANCED_SHARE):.0f} % of the worst case and leaves "
            f"{digits(named[BALANCED].sigma_px, 2)} px"
        )
    if LEAST_SIGMA in named:
        said.append(
            f"the least that any layout leaves is about {digits(named[LEAST_SIGMA].sigma_px, 2)} px, with "
            f"{digits(named[LEAST_SIGMA].worst_images, 2)} images' worth at its worst frequency"
        )
    return "; ".join(said) + "."


def _model(choice: LayoutChoice) -> str:
    return (
        "Each image has one error per row of windows, which all its pairs share: more pairs of the same "
        f"images add nothing. Sigmas are for a strip of {choice.duration:.4g} s, the motion less its mean. "
        "Not in the account: relief, whose parallax grows with the lag, and so favours short ones."
    )


def layout_rows(
    layouts: Sequence[JudgedLayout], rows: Sequence[Mapping[str, Any]], *, numbered: bool = False
) -> list[list[str]]:
    """Table of layouts: name, places in ms, worst case, its frequency, sigmas, blind frequencies.

    With `numbered`, the rank before and the places in px too, and which image stands where if they differ.
    """
    out = []
    for rank, (layout, row) in enumerate(zip(layouts, rows, strict=True), 1):
        blind = [f"{b.frequency:.4g}" for b in layout.blind]
        cells = [
            layout.name,
            " ".join(f"{1e3 * t:.2f}" for t in layout.positions),
            "blind" if layout.blind_in_band else digits(layout.worst_images, 3),
            f"{layout.worst_frequency:.4g}",
            digits(layout.sigma_px, 3),
            digits(layout.band_sigma_px, 3),
            ", ".join(blind[:3]) + (", …" if len(blind) > 3 else "") or "–",
        ]
        if numbered:
            px = " ".join(f"{place:.1f}" for place in row["positions_px"])
            images = " ".join(str(image) for image in layout.order)
            unlike = len(set(layout.noise.sigma_px)) > 1
            cells = [str(rank), *cells[:2], px, *([images] if unlike else []), *cells[2:]]
        out.append(cells)
    return out


def common_rows(layouts: Sequence[JudgedLayout]) -> list[list[str]]:
    """Table of lags that go blind together: layout, frequency, lags (ms), whole periods in each, mismatch."""
    out = []
    for layout in layouts:
        largest = sorted(layout.common, key=lambda common: (-len(common.pairs), common.frequency))[:_GROUPS]
        every = len(layout.positions) * (len(layout.positions) - 1) // 2
        for common in sorted(largest, key=lambda group: group.frequency):
            lags = [layout.positions[b] - layout.positions[a] for a, b in common.pairs]
            shown = sorted(zip(lags, common.periods, strict=True))
            more = ", …" if len(shown) > 6 else ""
            out.append(
                [
                    layout.name,
                    f"{common.frequency:.4g}",
                    "all" if len(common.pairs) == every else f"{len(common.pairs)} of {every}",
                    ", ".join(f"{1e3 * lag:.4g}" for lag, _ in shown[:6]) + more,
                    " : ".join(str(periods) for _, periods in shown[:6]) + more,
                    f"{100.0 * common.mismatch:.1f} %",
                ]
            )
    return out
