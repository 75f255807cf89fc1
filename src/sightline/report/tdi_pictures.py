"""Pictures of what the chosen TDI settings do, beside one setting for all, as a piece of HTML.

Not here: the images and what is measured on them (``evaluation/tdi_pictures.py``).
"""

from __future__ import annotations

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from sightline.evaluation.tdi_pictures import Crop, StripPictures
from sightline.report.composite import data_png

#: Radiance that is white in every picture, so that they can be compared; 0 is black.
WHITE = 1.8
CHOSEN, SINGLE = "each column by its own setting", "all columns by the setting of the centre column"


def tdi_pictures_html(pictures: StripPictures) -> Markup:
    """Two miniatures of the whole detector line, and crops of a target: chosen settings above, one below."""
    rows = (
        (CHOSEN, pictures.miniature_chosen, pictures.chosen),
        (SINGLE, pictures.miniature_single, pictures.single),
    )
    parts = [Markup('<div class="pictures one">')]
    for title, miniature, _ in rows:
        parts.append(_figure(miniature, f"ground, {title}", Markup.escape(_sentence(title, pictures))))
    parts.append(Markup("</div>"))
    for title, _, crops in rows:
        heading = title[0].upper() + title[1:]
        parts.append(Markup('<h3>{}</h3><div class="pictures three">').format(heading))
        parts += [_figure(crop.radiance, f"target, {title}", _caption(crop)) for crop in crops]
        parts.append(Markup("</div>"))
    return Markup("").join(parts)


def grey(radiance: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Radiance (lines, columns) as a picture (lines, columns, 3), the same greys for all."""
    level = np.clip(255.0 * radiance / WHITE, 0.0, 255.0).round().astype(np.uint8)
    return np.repeat(level[..., None], 3, axis=2)


def _figure(radiance: NDArray[np.float64], alternative: str, caption: Markup) -> Markup:
    return Markup('<figure><img src="{}" alt="{}"><figcaption>{}</figcaption></figure>').format(
        data_png(grey(radiance)), alternative, caption
    )


def _sentence(title: str, pictures: StripPictures) -> str:
    """What the miniature shows."""
    first, last, width = pictures.columns[0], pictures.columns[-1], len(pictures.columns)
    different = len(np.unique(pictures.columns))
    if different == 1:
        which = f"column {first:g}, {width} times"
    elif different == width:
        which = f"{width} columns taken evenly from {first:g} to {last:g}"
    else:
        which = f"{different} columns from {first:g} to {last:g}, some more than once to make {width}"
    return f"The whole line in little, {title}: {which}, each drifting as it does"


def _caption(crop: Crop) -> Markup:
    """Setting, and measured beside predicted quality."""
    group, found, said = crop.group, crop.measured, crop.predicted
    mtf = [
        f"{axis} {found.mtf[k]:.3f} ± {found.mtf_sigma[k]:.3f} (predicted {said.mtf[k]:.3f})"
        for k, axis in enumerate(("across", "along"))
    ]
    full = f"; {100.0 * crop.saturated:.0f} % of pixels with a full well" if crop.saturated else ""
    return Markup("<strong>Column {}: {} stages, Kt {}</strong><br>MTF {},<br>{}<br>SNR {}{}").format(
        f"{group.column:g}", group.stages, f"{group.ratio:.2f}", *mtf,
        f"{found.snr:.0f} ± {found.snr_sigma:.0f} (predicted {said.snr:.0f})", full,
    )  # fmt: skip
