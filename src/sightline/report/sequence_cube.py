"""A cube on the page of its sequence: three bands in colour before and after, how well bands fit, coverage.

Not here: how a cube is made.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from sightline.applications.frame_cube import CubeSummary
from sightline.errors import InputError
from sightline.geometry.checks import ReadOnlyArrays
from sightline.report.composite import colours
from sightline.report.figure import Figure
from sightline.report.marks import Line, Map, Points
from sightline.report.raster import data_png
from sightline.report.style import AFTER, BEFORE, DOUBT
from sightline.report.words import digits

Array = NDArray[np.float64]
#: Pixels of the overview at most, sides (rows, columns) of the detail at most, cells of a map at most.
OVERVIEW, DETAIL, MAP_CELLS = 60_000, (150, 250), 60_000
#: Pairs of bands that are drawn at most.
PAIRS = 3000
#: Pairs from which on large dots would hide each other.
_MANY_PAIRS = 60
#: Rows over columns from which on pictures are laid on their side.
TALL = 1.6
#: Share of a detail that may have no value.
_GAP = 0.02


@dataclass(frozen=True, eq=False)
class CubeView(ReadOnlyArrays):
    """What a page shows of a cube of B bands.

    Attributes
    ----------
    wavelength_nm : (B,)
    coverage : (B,)
        Share of the ground that lines of every band passed over for which each has a value.
    after : (rows, columns, 3)
        Bands shown in red, green, blue by the poses found; NaN where any of the three has no value.
    rgb_nm : (3,)
        Their wavelengths.
    pixel_size : float
        m, side of a pixel of `after`.
    before : (rows, columns, 3) or None
        The same by the given poses.
    error_px : (r, c) or None
        Band-to-band error over the same ground, px, rms over the pairs compared; NaN where not known.
    pair_nm : (P,)
        Distance in wavelength of pairs of bands compared.
    pair_rms_px : (P,)
        px rms of each pair, by the poses found.
    pair_before_px : (P,) or None
        By the given poses.
    pair_noise_px : (P,) or None
        What the comparison itself errs by, as far as it is known.
    notes : tuple of str
        What else to say.
    map_shape : (int, int) or None
        Rows and columns of the maps, of which `after` is a picture; None: those of `after`.
    gsd : float
        m, side of a pixel of the maps; 0: that of `after`.
    """

    wavelength_nm: Array
    coverage: Array
    after: Array
    rgb_nm: Array
    pixel_size: float
    before: Array | None = None
    error_px: Array | None = None
    pair_nm: Array = field(default_factory=lambda: np.zeros(0))
    pair_rms_px: Array = field(default_factory=lambda: np.zeros(0))
    pair_before_px: Array | None = None
    pair_noise_px: Array | None = None
    notes: tuple[str, ...] = ()
    map_shape: tuple[int, int] | None = None
    gsd: float = 0.0

    def __post_init__(self) -> None:
        """Check shapes."""
        if len(self.wavelength_nm) != len(self.coverage) or len(self.pair_nm) != len(self.pair_rms_px):
            raise InputError("wavelength_nm and coverage, pair_nm and pair_rms_px need as many rows each")
        if self.after.ndim != 3 or self.after.shape[2] != 3 or len(self.rgb_nm) != 3:
            raise InputError(f"`after` must be (rows, columns, 3) of 3 wavelengths, got {self.after.shape}")
        if self.before is not None and self.before.shape != self.after.shape:
            raise InputError(f"`before` must be of the shape of `after`, got {self.before.shape}")


def cube_view(cube: CubeSummary) -> CubeView | None:
    """What a page shows of a cube; None where its bands have no wavelengths to name them by."""
    if not np.isfinite(cube.wavelength_nm).all() or not cube.after.size:
        return None
    known = np.isfinite(cube.pair_rms_px)
    first, second = cube.wavelength_nm[cube.pairs[known].T.reshape(2, -1)]
    return CubeView(
        cube.wavelength_nm,
        cube.passed,
        _picture(cube.after),
        cube.wavelength_nm[cube.rgb],
        cube.picture_gsd,
        before=_picture(cube.before) if cube.before.size else None,
        error_px=cube.error_map,
        pair_nm=np.abs(first - second),
        pair_rms_px=cube.pair_rms_px[known],
        pair_noise_px=cube.pair_noise_px[known],
        notes=tuple(_sentence(text) for text in (f"the maps lie on {cube.surface}", *cube.warnings)),
        map_shape=cube.grid.shape,
        gsd=cube.grid.gsd,
    )


def _sentence(text: str) -> str:
    """A note as a sentence."""
    return text[:1].upper() + text[1:].rstrip(".") + "."


def _picture(coded: NDArray[np.uint8]) -> Array:
    """Tones (h, w, 3); NaN where any band has no value: the others alone would look like misfit."""
    return np.where((coded == 0).any(axis=2, keepdims=True), np.nan, coded.astype(np.float64))


@dataclass(frozen=True)
class Slider:
    """Two pictures of the same ground, one drawn over the other as far as a handle says.

    Attributes
    ----------
    name, caption : str
    before : str or None
        ``data:`` address of a PNG; None where there is only one picture.
    after : str
    width, height : int
        px of each.
    """

    name: str
    caption: str
    before: str | None
    after: str
    width: int
    height: int

    @property
    def html(self) -> Markup:
        """As a piece of a page; ``page.js`` moves the handle."""
        wide = round(680 * self.width / self.height)
        image = '<img{}src="{}" width="{}" height="{}" alt="Three bands by the {} poses">'
        after = Markup(image).format(" ", self.after, self.width, self.height, "estimated")
        handle = Markup("")
        if self.before is not None:
            top = Markup(image).format(Markup(' class="top" '), self.before, self.width, self.height, "given")
            handle = top + Markup(
                '<div class="rule"></div><span class="left">before: given poses</span>'
                '<span class="right">after: estimated poses</span>'
                '<input type="range" min="0" max="100" step="0.1" value="50" '
                'aria-label="Share of the picture drawn by the given poses">'
            )
        begin = Markup('<div class="slider {}" style="max-width: {}px">').format(self.name, wide)
        return begin + after + handle + Markup("</div>")

    @property
    def said(self) -> str:
        """The caption, and what the handle does."""
        drag = " Drag the handle: left of it by the given poses, right of it by the estimated poses."
        grey = " Flat light grey: at least one of the three bands has no value there."
        return self.caption + (drag if self.before is not None else "") + grey


def sliders(cube: CubeView) -> list[Slider]:
    """The whole picture reduced, and a detail pixel by pixel; none where the three bands never meet."""
    if not np.isfinite(cube.after).all(axis=2).any():
        return []
    rows, columns = cube.after.shape[:2]
    every = max(int(np.ceil(np.sqrt(rows * columns / OVERVIEW))), 1)
    size = f"{digits(rows * cube.pixel_size, 3)} m down × {digits(columns * cube.pixel_size, 3)} m across"
    whole = _map_size(cube)
    of_map = f" of the {digits(whole[0], 3)} m × {digits(whole[1], 3)} m of the maps"
    reduced = f", means of {every} × {every} of its pixels" if every > 1 else ""
    names = ", ".join(
        f"{nm:.0f} nm in {hue}" for nm, hue in zip(cube.rgb_nm, ("red", "green", "blue"), strict=True)
    )
    turned = ", turned so that its first row is at the left" if _turned(cube) else ""
    pictures = [_reduced(picture, every) for picture in (cube.before, cube.after) if picture is not None]
    if turned:
        pictures = [np.rot90(picture) for picture in pictures]
    shown = f"The part of the maps where all three bands have values ({size},{of_map}{reduced}){turned}"
    out = [_slider("overview", f"{shown}: {names}.", pictures)]
    if every > 1 or rows > DETAIL[0] or columns > DETAIL[1]:
        first = _busiest(cube)
        part = tuple(slice(f, f + n) for f, n in zip(first, DETAIL, strict=True))
        last = [min(p.stop, n) - 1 for p, n in zip(part, (rows, columns), strict=True)]
        caption = (
            "A detail of the same pixel by pixel, its "
            f"rows {first[0]} to {last[0]}, columns {first[1]} to {last[1]}: coloured rims are misfit of "
            "bands, colours of whole areas are those of the ground."
        )
        crops = [picture[part] for picture in (cube.before, cube.after) if picture is not None]
        out.append(_slider("detail", caption, crops))
    return out


def _map_size(cube: CubeView) -> Array:
    """m; sides of the maps down and across, of which the picture may be a part."""
    if cube.map_shape is None or not cube.gsd:
        return np.array(cube.after.shape[:2]) * cube.pixel_size
    return np.array(cube.map_shape) * cube.gsd


def _turned(cube: CubeView) -> bool:
    """Whether the ground is so tall that it is laid on its side."""
    return cube.after.shape[0] > TALL * cube.after.shape[1]


def _reduced(picture: Array, every: int) -> Array:
    """Means of blocks, NaN where any pixel has no value."""
    if every == 1:
        return picture
    rows, columns = (max(n // every, 1) for n in picture.shape[:2])
    part = picture[: rows * every, : columns * every]
    return np.asarray(part.reshape(rows, -1, columns, part.shape[1] // columns, 3).mean(axis=(1, 3)))


def _slider(name: str, caption: str, pictures: list[Array]) -> Slider:
    """Pictures with one stretch of their tones: (before and) after."""
    rows, columns = pictures[0].shape[:2]
    both = np.concatenate(pictures)
    drawn = colours([both[..., band] for band in range(3)])
    coded = [data_png(drawn[k * rows : (k + 1) * rows]) for k in range(len(pictures))]
    return Slider(name, caption, coded[0] if len(coded) == 2 else None, coded[-1], columns, rows)


def _busiest(cube: CubeView) -> tuple[int, int]:
    """First row and column of the full detail with the strongest edges."""
    grey = cube.after.mean(axis=2)
    if cube.before is not None:
        grey = grey + 0.0 * cube.before.mean(axis=2)
    size = (min(DETAIL[0], grey.shape[0]), min(DETAIL[1], grey.shape[1]))
    best, chosen = -1.0, (0, 0)
    for row in np.unique(np.linspace(0, grey.shape[0] - size[0], 9).astype(int)):
        for column in np.unique(np.linspace(0, grey.shape[1] - size[1], 9).astype(int)):
            tile = grey[row : row + size[0] : 2, column : column + size[1] : 2]
            full = float(np.isfinite(tile).mean())
            edges = np.abs(np.diff(tile, axis=0))
            strength = float(np.nanmean(edges)) if np.isfinite(edges).any() else 0.0
            worth = strength * (1.0 if full >= 1.0 - _GAP else 0.1 * full)
            if worth > best:
                best, chosen = worth, (int(row), int(column))
    return chosen


def error_map_figure(cube: CubeView) -> Figure | None:
    """Band-to-band error over the ground; None where none is known."""
    if cube.error_px is None or not np.isfinite(cube.error_px).any():
        return None
    shown = _block_rms(cube.error_px, max(int(np.ceil(np.sqrt(cube.error_px.size / MAP_CELLS))), 1))
    size = _map_size(cube)
    down, along = ((np.arange(n) + 0.5) / n * whole for n, whole in zip(shown.shape, size, strict=True))
    names = ("from the first column (m)", "from the first row (m)")
    x, y, tall = along, down, float(size[0] / size[1])
    if _turned(cube):
        x, y, shown, names, tall = down, along, shown.T, names[::-1], 1.0 / tall
    figure = Figure(height=float(np.clip(900 * tall, 120, 620)))
    panel, most = figure[0], float(np.nanpercentile(shown, 99.0))
    panel.add(Map(x=x, y=y, z=shown, palette="cividis", high=most or 1.0, bar="px rms"))
    # as in the picture: rows run down, or the first column is at the bottom where it is turned
    panel.x.title, panel.y.title, panel.y.tight = *names, True
    panel.y.downward, panel.equal = not _turned(cube), True
    return figure


def _block_rms(values: Array, every: int) -> Array:
    """rms of finite values in blocks."""
    rows, columns = (max(n // every, 1) for n in values.shape)
    part = values[: rows * every, : columns * every].reshape(rows, -1, columns, min(every, values.shape[1]))
    known = np.isfinite(part)
    total, count = np.where(known, part, 0.0) ** 2, known.sum(axis=(1, 3))
    return np.asarray(np.sqrt(np.where(count, total.sum(axis=(1, 3)), np.nan) / np.maximum(count, 1)))


def pair_figure(cube: CubeView) -> Figure | None:
    """Band-to-band rms against how far apart wavelengths are; None without pairs."""
    if not len(cube.pair_nm):
        return None
    figure = Figure(height=270)
    panel = figure[0]
    rows = np.unique(np.linspace(0, len(cube.pair_nm) - 1, min(len(cube.pair_nm), PAIRS)).astype(np.intp))
    size = 5.0 if len(rows) > _MANY_PAIRS else 8.0
    for values, name, colour in (
        (cube.pair_before_px, "by the given poses", BEFORE),
        (cube.pair_rms_px, "by the estimated poses", AFTER),
        (cube.pair_noise_px, "noise of the comparison itself", DOUBT),
    ):
        if values is not None:
            panel.add(
                Points(x=cube.pair_nm[rows], y=values[rows], name=name, colour=colour, size=size, opacity=0.8)
            )
    panel.x.title, panel.x.from_zero, panel.x.tight = "distance of the two bands (nm)", True, False
    panel.y.log = cube.pair_before_px is not None
    panel.y.title, panel.y.from_zero = (
        f"error between the bands (px rms{', logarithmic' * panel.y.log})",
        not panel.y.log,
    )
    return figure


def coverage_figure(cube: CubeView) -> Figure | None:
    """Share of the ground with a value, band by band; None where no ground could have one in every band."""
    if not np.isfinite(cube.coverage).any():
        return None
    figure = Figure(height=220)
    panel = figure[0]
    x, y = cube.wavelength_nm, 100.0 * cube.coverage
    panel.add(Line(x=x, y=y, name="coverage", key=False, colour=AFTER, width=1.0, dotted=6.0))
    low = float(np.floor(np.nanmin(y, initial=100.0) - 0.5))
    panel.y.low = low if low > 80.0 else 0.0
    panel.y.high = 100.0 + 0.03 * (100.0 - panel.y.low)
    panel.x.title, panel.y.title, panel.x.tight = "wavelength (nm)", "ground with a value (%)", False
    return figure


def cube_sentences(cube: CubeView) -> list[str]:
    """The cube in plain words."""
    rows, columns = cube.map_shape or cube.after.shape[:2]
    size = (
        f"The cube has {len(cube.wavelength_nm)} bands from {cube.wavelength_nm.min():.0f} to "
        f"{cube.wavelength_nm.max():.0f} nm of {rows:,} rows × {columns:,} columns, "
        f"{digits(cube.gsd or cube.pixel_size, 3)} m a pixel"
    )
    if np.isfinite(cube.coverage).all():
        share = f"{100.0 * cube.coverage.min():.1f}"
        if f"{100.0 * cube.coverage.max():.1f}" != share:
            share += f" to {100.0 * cube.coverage.max():.1f}"
        out = [f"{size}; a band has a value on {share} % of the ground that lines of every band passed over."]
    else:
        out = [f"{size}."]
    if len(cube.pair_rms_px):
        rms = float(np.sqrt(np.mean(cube.pair_rms_px**2)))
        far = cube.pair_nm >= np.quantile(cube.pair_nm, 0.75)
        least, most = cube.pair_rms_px.min(), cube.pair_rms_px.max()
        said = (
            f"Bands lie on each other to {least:.2g} to {most:.2g} px rms per axis in those "
            f"{len(cube.pair_rms_px):,} pairs that look alike enough to be compared, up to "
            f"{cube.pair_nm.max():.0f} nm apart, each over the windows compared. "
            f"All these pairs together have {digits(rms, 2)} px rms, the quarter of them farthest apart "
            f"(from {cube.pair_nm[far].min():.0f} nm on) "
            f"{digits(float(np.sqrt(np.mean(cube.pair_rms_px[far] ** 2))), 2)} px rms"
        )
        if cube.pair_before_px is not None:
            before = float(np.sqrt(np.mean(cube.pair_before_px**2)))
            said += f"; by the given poses all would have {digits(before, 2)} px rms"
        out.append(said + ".")
    return [*out, *cube.notes]
