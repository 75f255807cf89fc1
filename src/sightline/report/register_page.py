"""The report of ``register``: bands before and after in colour, how well every pair fits, maps of misfit.

Not here: the images (``products/``), the page of a recovery (``line_of_sight_page.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.imaging.source import ImageSource
from sightline.io.results.registered import Written
from sightline.products.band_fit import WINDOW, BandFit
from sightline.report.composite import CROP, colours
from sightline.report.figure import Figure
from sightline.report.match_figures import offset_maps
from sightline.report.page import Page, Section, Table, inputs, pictures, resources
from sightline.report.raster import data_png

Array = NDArray[np.float64]
#: How a band came to its place, in words.
_PLACED = {
    "matches": "its own matches",
    "motion": "the recovered motion alone",
    "cameras": "its camera as given",
}
#: Places tried for the pictures until one has no gap.
CROPS_TRIED = 12


def register_page(
    written: Written, before: Sequence[BandFit], after: Sequence[BandFit], summary: Mapping[str, Any]
) -> Page:
    """The page of registered bands.

    Parameters
    ----------
    written : Written
        The images.
    before, after : sequence of BandFit
        Of the same pairs.
    summary : mapping
        As ``io.results.registration`` gives it, with `wall_seconds`.
    """
    lines, columns = summary["shape"]
    fits = (
        "Every pair matched on windows of its own, not those of the recovery; only windows on which both "
        "bands have values are tried, and false matches are left out. rms is along / across, px; “match "
        "noise” is what the matches' own sigma makes of it: where rms and noise agree, no misfit is left to "
        "be seen."
    )
    heads = "pair|before: rms (px)|after: rms (px)|match noise (px)|mean after (px)|windows|kept".split("|")
    made = Table("band|pixels with a value|placed by|type|file".split("|"), _band_rows(summary), [0, 2, 3, 4])
    taps = summary["kernel"]["taps"]
    return Page(
        heading=f"{summary['name']}: registered bands",
        what="registered bands",
        about=f"{len(summary['bands'])} bands on the grid of {summary['onto']} ({lines} lines × {columns} "
        f"columns) by Sightline {summary['version']}{resources(summary)}",
        sentences=sentences(summary),
        warnings=summary["warnings"],
        mind="Mind before using the images",
        sections=[
            *_pictures(written, before, summary),
            Section(
                "pairs",
                "How well the bands fit",
                [fits, Table(heads, list(map(_pair_row, summary["pairs"])))],
            ),
            *sections(before, after, summary),
            Section("bands", "What was written", [made]),
            inputs(summary),
        ],
        footer=f"Images are in the sensor geometry of {summary['onto']}; kernel of {taps} × {taps} pixels. "
        f"Files beside this page: {', '.join(summary['files'])}, summary.json.",
    )


def sentences(summary: Mapping[str, Any]) -> list[str]:
    """What the numbers say, in words."""
    pairs = summary["pairs"]
    sizes = {when: [float(np.hypot(*pair[when]["rms_px"])) for pair in pairs] for when in ("before", "after")}
    noise = [float(np.hypot(*pair["after"]["noise_px"])) for pair in pairs]
    known = np.isfinite(sizes["after"])
    given = all(band["placed_by"] == "cameras" for band in summary["bands"])
    by = "by their cameras as given" if given else "with the motion and the band offsets that were recovered"
    if len(summary["bands"]) == 1:
        return [
            f"{summary['onto']} is the only band: it is written as it is, on its own grid. Its lines "
            "have moved as motion.csv of the recovery says; `sightline export` gives that to other programs."
        ]
    out = [f"{len(summary['bands'])} bands were resampled onto {summary['onto']}, each once, {by}."]
    if known.any():
        worst = int(np.nanargmax(np.where(known, sizes["after"], np.nan)))
        label = " and ".join(pairs[worst]["images"])
        whose = "pairs of bands" if known.all() else "the pairs of bands that can be matched"
        lay = ""
        if np.isfinite(sizes["before"]).any():
            most = np.nanmax(sizes["before"])
            lay = f"By the nominal cameras, {whose} lay up to {most:.2f} px apart (rms over the image). "
            early = [pair for pair, size in zip(pairs, sizes["before"], strict=True) if not np.isfinite(size)]
            if early:
                lay += f"Too few windows matched then to say it of {_named(early)}. "
        who = "they" if lay else whose
        out.append(
            f"{lay}Now {who} lie within {sizes['after'][worst]:.3f} px; the worst pair is {label}, of which "
            f"single matches are good to {noise[worst]:.3f} px."
        )
    unknown = [pair for pair, ok in zip(pairs, known, strict=True) if not ok]
    if unknown:
        out.append(f"Too few windows match to say how well these fit: {_named(unknown)}.")
    alone = [band["name"] for band in summary["bands"] if band["placed_by"] == "motion"]
    if alone:
        out.append(
            f"Placed by the recovered motion alone, their own place never measured: {', '.join(alone)}."
        )
    return out


def _named(pairs: Sequence[Mapping[str, Any]]) -> str:
    return ", ".join(" – ".join(pair["images"]) for pair in pairs)


def _pictures(written: Written, before: Sequence[BandFit], summary: Mapping[str, Any]) -> list[Section]:
    """Colour crops where the pair that was furthest apart was so most; none without a match."""
    fit = _furthest(before)
    if fit is None:
        return []
    others = [k for k in range(len(written.after)) if k not in fit.images]
    shown = sorted([*fit.images, *others[:1]])
    lines, columns = _busiest_crop(
        fit, [images[k] for images in (written.before, written.after) for k in shown]
    )
    hues = ("red", "green", "blue") if len(shown) == 3 else ("red", "cyan")
    shown = _in_own_hues(shown, [summary["bands"][k]["name"] for k in shown], hues)
    names = [summary["bands"][k]["name"] for k in shown]
    drawn = [
        data_png(colours([_crop(images[k], lines, columns) for k in shown]))
        for images in (written.before, written.after)
    ]
    caption = (
        f"{', '.join(f'{name} in {hue}' for name, hue in zip(names, hues, strict=True))}; lines {lines[0]}–"
        f"{lines[1] - 1}, columns {columns[0]}–{columns[1] - 1}, where the nominal cameras fit badly. Each "
        "band is stretched by itself. Coloured rims are misfit; colours of whole areas are those of the "
        "ground. Flat light grey: a band has no value there."
    )
    both = [
        (drawn[0], "Colour composite by the nominal cameras", "Before: by the nominal cameras"),
        (drawn[1], "Colour composite of the registered bands", "After: by the recovered line of sight"),
    ]
    return [Section("pictures", "The same ground in colour, before and after", [caption, pictures(both)])]


def _in_own_hues(bands: Sequence[int], names: Sequence[str], hues: Sequence[str]) -> list[int]:
    """Bands in the order of the hues that they are drawn in: one named after a hue has its own."""
    own = {hue: band for band, name in zip(bands, names, strict=True) for hue in hues if name.lower() == hue}
    others = iter(band for band in bands if band not in own.values())
    return [own[hue] if hue in own else next(others) for hue in hues]


def _furthest(before: Sequence[BandFit]) -> BandFit | None:
    """The pair of bands that was furthest apart; None where nothing matched."""
    # pairs with a few false matches only would be the furthest apart of all
    fits = [fit for fit in before if fit.known] or list(before)
    fits = [fit for fit in fits if len(fit.points)]
    return max(fits, key=lambda one: float((one.offset_px**2).mean()), default=None)


def _busiest_crop(fit: BandFit, images: Sequence[ImageSource]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Lines and columns of a crop about a window that lay far off, where all images have values.

    The fullest of a few tried is taken where none is full.
    """
    shape = images[0].shape
    size = [min(CROP[k], shape[k]) for k in (0, 1)]
    moved = np.linalg.norm(fit.offset_px - np.median(fit.offset_px, axis=0), axis=1)
    best, chosen = -1.0, ((0, size[0]), (0, size[1]))
    for rank in np.linspace(0.97, 0.5, CROPS_TRIED):
        centre = fit.points[np.argsort(moved)[int(rank * (len(moved) - 1))]]
        first = [int(np.clip(round(centre[k] - size[k] / 2), 0, shape[k] - size[k])) for k in (0, 1)]
        crop = (first[0], first[0] + size[0]), (first[1], first[1] + size[1])
        full = min(float(np.isfinite(_crop(image, *crop)).mean()) for image in images)
        if full > best:
            best, chosen = full, crop
        if best == 1.0:
            break
    return chosen


def _crop(image: ImageSource, lines: tuple[int, int], columns: tuple[int, int]) -> Array:
    """Pixels of a crop, NaN where there is no value."""
    pixels, bad = image.read(lines, columns).astype(np.float64), image.mask(lines, columns)
    return pixels if bad is None else np.where(bad, np.nan, pixels)


def sections(
    before: Sequence[BandFit], after: Sequence[BandFit], summary: Mapping[str, Any]
) -> list[Section]:
    """Maps of misfit of the pair that was furthest apart; none without matches."""
    fit = _furthest(before)
    if fit is None:
        return []
    worst = next(k for k, one in enumerate(before) if one is fit)
    names = summary["pairs"][worst]["images"]
    said = (
        f"Where {names[1]} shows a window, less where the other does: red is a later line (a larger "
        "column). Stripes are motion, slopes a rotation, patches relief or false matches. The scales of "
        "before and after differ."
    )
    title = f"Misfit over the image, before and after ({' – '.join(names)})"
    return [Section("misfit", title, [said, misfit_figure(fit, after[worst], summary["shape"])])]


def misfit_figure(before: BandFit, after: BandFit, shape: Sequence[int]) -> Figure:
    """Offsets of one pair over the image, before and after, along and across."""
    maps = []
    for fit in (before, after):
        reach = float(np.percentile(np.abs(fit.offset_px), 99.0)) if len(fit.points) else 1.0
        maps += [(*_table(fit, component), reach) for component in (0, 1)]
    figure = offset_maps(maps, "line (px)")
    # narrow overlaps fill the map
    for axes, axis in (([figure[0].x], 0), ([panel.y for panel in figure.panels], 1)):
        for one in axes:
            one.low, one.high = _seen_range([before, after], axis, shape[axis])
    return figure


def _seen_range(fits: Sequence[BandFit], axis: int, size: int) -> tuple[float, float]:
    """First and last line (axis 0) or column (axis 1) of the windows kept: narrow overlaps fill the map."""
    places = np.concatenate([fit.points[:, axis] for fit in fits])
    if not len(places):
        return 0.0, float(size)
    half = 0.5 * WINDOW[axis]
    return max(float(places.min()) - half, 0.0), min(float(places.max()) + half, float(size))


def _table(fit: BandFit, component: int) -> tuple[Array, Array, Array]:
    """Offsets on the grid of their windows, NaN where none was kept."""
    lines, row = np.unique(fit.points[:, 0], return_inverse=True)
    columns, column = np.unique(fit.points[:, 1], return_inverse=True)
    if not len(lines):
        return np.zeros(1), np.zeros(1), np.full((1, 1), np.nan)
    # windows that no cell of this grid holds leave it empty
    table = np.full((len(lines), len(columns)), np.nan)
    table[row, column] = fit.offset_px[:, component]
    return lines, columns, table


def _pair_row(pair: Mapping[str, Any]) -> list[str]:
    """One line of the table of pairs."""
    before, after = pair["before"], pair["after"]
    return [
        " – ".join(pair["images"]),
        _both(before["rms_px"], 2),
        _both(after["rms_px"], 4),
        _both(after["noise_px"], 4),
        _both(after["mean_px"], 4),
        str(after["windows"]),
        str(after["kept"]),
    ]


def _both(values: Sequence[float], digits: int) -> str:
    """Along / across; a dash where not known."""
    return " / ".join(
        "–" if not np.isfinite(v) else f"{round(v, digits) + 0.0:.{digits}f}".replace("-", "−")
        for v in values
    )


def _band_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """One line per band of what was written."""
    files = summary["files"] if len(summary["files"]) > 1 else summary["files"] * len(summary["bands"])
    return [
        [
            band["name"],
            f"{100.0 * band['valid_share']:.1f} %",
            _PLACED[band["placed_by"]],
            band["type"],
            file,
        ]
        for band, file in zip(summary["bands"], files, strict=True)
    ]
