"""The report of ``tie``: images with the reference over them, before and after, and how far cameras are off.

Not here: the control points (``applications/reference_tie.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sightline.applications.reference_tie import ReferenceTie
from sightline.report.match_page import arrows, overlay_sections, profile_figure, score_figure, shift_maps
from sightline.report.page import Page, Section, Table, inputs, resources
from sightline.report.style import short_label

#: Images that have pictures and figures of their own.
SHOWN = 4


def tie_page(tie: ReferenceTie, summary: Mapping[str, Any]) -> Page:
    """The page of control points.

    Parameters
    ----------
    tie : ReferenceTie
    summary : mapping
        As ``io.results.reference_tie`` gives it.
    """
    sections = [Section("images", "Images and their control points", [_table(summary)])]
    for count, number in enumerate(sorted(tie.matches)[:SHOWN], 1):
        matches, label = tie.matches[number], short_label(tie.names[number])
        for one in overlay_sections(matches):
            sections.append(Section(f"pictures{count}", f"{label} and the reference", one.parts))
        sections += [
            Section(
                f"offsets{count}",
                f"{label}: the reference less the image, over the image",
                [
                    "Where the camera as given shows a place of the reference, less where the image shows "
                    "it; less the median. A slope is a rotation or another scale, stripes along columns are "
                    "motion.",
                    shift_maps(matches),
                ],
            ),
            Section(f"arrows{count}", f"{label}: the same as strokes", [arrows(matches)]),
            Section(f"means{count}", f"{label}: means of rows and columns", [profile_figure(matches)]),
            Section(f"score{count}", f"{label}: how alike windows are", [score_figure(matches)]),
        ]
    left = summary["left_out"]
    if left:
        rows = [[name, text] for name, text in left.items()]
        sections.append(Section("left", "Images that were left out", [Table(["image", "why"], rows, [0, 1])]))
    return Page(
        heading=summary["name"],
        what="tied to a reference",
        about=f"{summary['points']} control points in {len(summary['images'])} images by Sightline "
        f"{summary['version']}{resources(summary)}",
        sentences=_sentences(summary),
        warnings=summary["warnings"],
        sections=[*sections, inputs(summary)],
        footer="Files beside this page: control_points.csv, ties.csv, summary.json, and the TOML file that "
        "names the control points.",
    )


def _sentences(summary: Mapping[str, Any]) -> list[str]:
    """What was found, in words."""
    first = summary["images"][0]
    return [
        f"{summary['reference']} was laid on the images as their cameras, as given, see the DEM, and found "
        f"in {len(summary['images'])} of them.",
        f"{first['name']} shows it {_signed(first['offset_px'][0])} lines and "
        f"{_signed(first['offset_px'][1])} columns (median) from where its camera does; a "
        f"match alone is known to {first['sigma_px'][0]:.3f} / {first['sigma_px'][1]:.3f} px.",
        "An error that the whole reference has in common is not in these sigmas: it is one of the attitude "
        "that follows.",
    ]


def _signed(value: float) -> str:
    return f"{value:+.2f}".replace("-", "−")


def _table(summary: Mapping[str, Any]) -> Table:
    heads = "image|control points|camera off by (px)|stands out (sigma)|sigma of a match (px)|windows|kept"
    rows = [
        [
            one["name"],
            str(one["points"]),
            " / ".join(_signed(value) for value in one["offset_px"]),
            f"{one['strength']:.1f}",
            " / ".join(f"{value:.3f}" for value in one["sigma_px"]),
            str(one["windows"]["tried"]),
            str(one["windows"]["kept"]),
        ]
        for one in summary["images"]
    ]
    return Table(heads.split("|"), rows)
