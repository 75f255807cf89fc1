"""What a figure shows: lines, bands, points, bars, maps, each with its numbers, as SVG.

What is not finite is left out, curves of more points than a page can show keep the least and the largest
value of each px, and names are text whatever they hold.

Not here: panels and axes (``figure.py``), the read-out under the pointer (``page.js``).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import ArrayLike, NDArray

from sightline.errors import printable
from sightline.report import raster
from sightline.report.axes import SIZE, Array, Box, Scale, array
from sightline.report.reduce import outline_rows, runs
from sightline.report.style import INK, MUTED

#: Which of the two axes are logarithmic.
Logs = tuple[bool, bool]
#: Steps of the coordinates of a path per px.
FINE = 10
DASHES = {"solid": "", "dash": "6 4", "dot": "1.5 3", "dashdot": "7 3 1.5 3", "longdash": "11 4",
          "longdashdot": "11 3 1.5 3"}  # fmt: skip
#: Outlines of marks, of radius 1 about the origin.
SYMBOLS = {"ring": "m-1 0a1 1 0 1 0 2 0a1 1 0 1 0-2 0", "cross": "m-1-1l2 2m0-2l-2 2", "tick": "m0-1v2",
           "triangle": "m0-1l1 1.8h-2z", "square": "m-1-1h2v2h-2z"}  # fmt: skip


def _fine(x: Array, y: Array) -> NDArray[np.intp]:
    return np.rint(np.stack([x, y], axis=1) * FINE).astype(np.intp)


def _words(numbers: Iterable[int]) -> str:
    return " ".join(map(str, numbers)).replace(" -", "-")


def path(x: Array, y: Array, close: str = "") -> str:
    """Unbroken pieces through places (px) as the ``d`` of a path in `FINE` steps; gaps where they are NaN."""
    out = []
    for first, last in runs(np.isfinite(x) & np.isfinite(y)):
        part = _fine(x[first : last + 1], y[first : last + 1])
        steps = np.diff(part, axis=0)
        steps = steps[steps.any(axis=1)]
        out.append(f"M{_words(part[0])}" + (f"l{_words(steps.ravel())}" if len(steps) else "h0") + close)
    return "".join(out)


def rectangle(x: float, y: float, w: float, h: float) -> str:
    """The ``d`` of a rectangle (px), in `FINE` steps."""
    x, y, w, h = (FINE * v for v in (x, y, w, h))
    return f"M{x:.0f} {y:.0f}h{w:.0f}v{h:.0f}h{-w:.0f}z"


def attributes(**values: Any) -> str:
    """Attributes of an element: names with ``-`` for ``_``; what is empty is left out."""
    said = ((name.rstrip("_").replace("_", "-"), value) for name, value in values.items())
    return "".join(f' {name}="{escape(value)}"' for name, value in said if value not in ("", None))


def dashed(dash: str, by: float = 1.0) -> str:
    """Strokes and gaps of a dash, px."""
    return " ".join(f"{float(part) * by:g}" for part in DASHES[dash].split())


@dataclass(frozen=True, eq=False, kw_only=True)
class Mark:
    """What all marks have.

    Attributes
    ----------
    name : str
        In the key, and under the pointer.
    key : bool
        Whether the name stands in the key.
    colour : str
    opacity : float
    """

    name: str = ""
    key: bool = True
    colour: str = INK
    opacity: float = 1.0

    def extent(self, log: Logs = (False, False)) -> tuple[list[Array], list[Array]]:
        """Values that the ranges of x and of y have to hold, of axes of which some are logarithmic."""
        return [], []

    def drawn(self, box: Box) -> str:
        """As SVG."""
        raise NotImplementedError

    def sample(self) -> str:
        """As it looks in the key, 24 by 12 px."""
        return f'<path d="M2 2h20v8H2z"{attributes(fill=self.colour, opacity=self.opacity)}/>'

    def keys(self) -> list[tuple[str, str]]:
        """Names and samples in the key."""
        return [(self.name, self.sample())] if self.key and self.name else []


@dataclass(frozen=True, eq=False, kw_only=True)
class Line(Mark):
    """A curve; with dots on its points where they are `dotted`."""

    x: ArrayLike
    y: ArrayLike
    width: float = 1.4
    dash: str = "solid"
    dotted: float = 0.0
    hover: bool = True

    def extent(self, log: Logs = (False, False)) -> tuple[list[Array], list[Array]]:
        """See `Mark`."""
        return [array(self.x)], [array(self.y)]

    def drawn(self, box: Box) -> str:
        """See `Mark`."""
        x, y = box.x(self.x), box.y(self.y)
        rows, out = outline_rows(x, y), ""
        look = {"stroke": self.colour, "opacity": "" if self.opacity == 1.0 else self.opacity}
        if self.width:
            look |= {"stroke_width": self.width * FINE, "stroke_dasharray": dashed(self.dash, FINE)}
            said = attributes(data_n=printable(self.name) if self.hover else "", **look)
            out = f'<path class="l" d="{path(x[rows], y[rows])}"{said}/>'
        if self.dotted:
            dots = Points(x=self.x, y=self.y, size=self.dotted, colour=self.colour, opacity=self.opacity)
            out += dots.drawn(box)
        return out

    def sample(self) -> str:
        """See `Mark`."""
        look = {"stroke_width": max(self.width, 1.2), "stroke_dasharray": dashed(self.dash)}
        line = attributes(stroke=self.colour, opacity=self.opacity, **look)
        dot = f'<circle cx="12" cy="6" r="{0.5 * self.dotted}"{attributes(fill=self.colour)}/>'
        return f'<path d="M1 6h22"{line}/>{dot if self.dotted else ""}'


@dataclass(frozen=True, eq=False, kw_only=True)
class Between(Mark):
    """The room between two curves."""

    x: ArrayLike
    low: ArrayLike
    high: ArrayLike
    opacity: float = 0.25

    def extent(self, log: Logs = (False, False)) -> tuple[list[Array], list[Array]]:
        """See `Mark`."""
        return [array(self.x)], [array(self.low), array(self.high)]

    def drawn(self, box: Box) -> str:
        """See `Mark`."""
        x, low, high = box.x(self.x), box.y(self.low), box.y(self.high)
        d = ""
        for first, last in runs(np.isfinite(x) & np.isfinite(low) & np.isfinite(high)):
            part = slice(first, last + 1)
            there, back = (outline_rows(x[part], curve[part]) for curve in (low, high))
            d += path(
                np.concatenate([x[part][there], x[part][back][::-1]]),
                np.concatenate([low[part][there], high[part][back][::-1]]), "z",
            )  # fmt: skip
        return f'<path d="{d}"{attributes(fill=self.colour, fill_opacity=self.opacity)}/>'


@dataclass(frozen=True, eq=False, kw_only=True)
class Points(Mark):
    """Places, each with a symbol.

    Attributes
    ----------
    x, y : (n,)
    size : float
        px across.
    symbol : str
        ``"dot"`` or one of `SYMBOLS`.
    sigma : (n,), optional
        Half the length of error bars along y.
    says : sequence of str, optional
        What stands under the pointer, beside the name, for each.
    texts : sequence of str, optional
        What is written above each, or at its right.
    right : bool
        Texts at the right.
    width : float
        px of the outline of a symbol.
    values, palette, low, high
        Numbers that colours stand for, with the scale beside the panel called `bar`.
    """

    x: ArrayLike
    y: ArrayLike
    size: float = 6.0
    symbol: str = "dot"
    sigma: ArrayLike | None = None
    says: Sequence[str] | None = None
    texts: Sequence[str] = ()
    right: bool = False
    width: float = 1.6
    values: Array | None = None
    palette: str = "viridis"
    low: float = 0.0
    high: float = 1.0
    bar: str = ""

    def extent(self, log: Logs = (False, False)) -> tuple[list[Array], list[Array]]:
        """See `Mark`."""
        y = np.where(np.isfinite(self.y), array(self.y), np.nan)
        bars = [] if self.sigma is None else [y - array(self.sigma), y + array(self.sigma)]
        return [array(self.x)], [y, *bars]

    def drawn(self, box: Box) -> str:
        """See `Mark`."""
        x, y = box.x(self.x), box.y(self.y)
        rows = np.flatnonzero(box.holds(x, y))
        out = "" if self.sigma is None else self._bars(box, rows)
        if self.values is None:
            out += self._symbols(x, y, rows, self.colour)
        else:
            step = raster.codes(self.values, self.low, self.high) // 8 * 8
            colours = raster.lookup(raster.PALETTES[self.palette])
            for code in np.unique(step[rows]):
                red, green, blue = colours[min(int(code) + 4, raster.STEPS - 1)]
                out += self._symbols(x, y, rows[step[rows] == code], f"#{red:02x}{green:02x}{blue:02x}")
        for k, text in enumerate(self.texts):
            if k in rows and text:
                place = (x[k] + self.size, y[k] + 4.0) if self.right else (x[k], y[k] - self.size)
                anchor = "start" if self.right else "middle"
                out += label(text, FINE * place[0], FINE * place[1], anchor=anchor, size=FINE * 12)
        return out

    def _symbols(self, x: Array, y: Array, rows: NDArray[np.intp], colour: str) -> str:
        if not len(rows):
            return ""
        said = [] if self.says is None else [printable(self.says[k]) for k in rows.tolist()]
        shared = {
            "opacity": None if self.opacity == 1 else self.opacity,
            "data_n": printable(self.name),
            "data_s": "\n".join(said),
        }
        if self.symbol == "dot":
            shape, look = "h0", {"class_": "p dot", "stroke": colour, "stroke_width": self.size * FINE}
        else:
            shape = _sized(SYMBOLS[self.symbol], 0.5 * self.size * FINE)
            filled = colour if self.symbol == "square" else ""
            look = {"class_": "p", "stroke": colour, "stroke_width": self.width * FINE, "fill": filled}
        d = "".join(f"M{_words(place)}{shape}" for place in _fine(x[rows], y[rows]))
        return f'<path d="{d}"{attributes(**look, **shared)}/>'

    def _bars(self, box: Box, rows: NDArray[np.intp]) -> str:
        x, y, sigma = box.x(self.x)[rows], array(self.y)[rows], array(self.sigma)[rows]  # type: ignore[arg-type]
        low, high, gap = box.y(y - sigma), box.y(y + sigma), np.full(len(rows), np.nan)
        d = path(np.repeat(x, 3), np.stack([low, high, gap], axis=1).ravel())
        return f'<path class="l" d="{d}"{attributes(stroke=self.colour, stroke_width=1.2 * FINE)}/>'

    def sample(self) -> str:
        """See `Mark`."""
        if self.symbol == "dot":
            return f'<circle cx="12" cy="6" r="{max(0.5 * self.size, 2)}"{attributes(fill=self.colour)}/>'
        d = f"M12 6{_sized(SYMBOLS[self.symbol], 4.5)}"
        fill = self.colour if self.symbol == "square" else "none"
        return f'<path d="{d}"{attributes(stroke=self.colour, stroke_width=1.5, fill=fill)}/>'


def _sized(shape: str, by: float) -> str:
    """A shape of radius 1 made larger."""
    out = ""
    for letter, body in re.findall(r"([a-z])([^a-z]*)", shape):
        numbers = [float(v) for v in re.findall(r"-?[\d.]+", body)]
        # the turn and the two flags of an arc are no lengths
        sized = [v if letter == "a" and k % 7 in (2, 3, 4) else by * v for k, v in enumerate(numbers)]
        out += letter + " ".join(f"{v:g}" for v in sized)
    return out


@dataclass(frozen=True, eq=False, kw_only=True)
class Bars(Mark):
    """Bars from 0, or from the end of a logarithmic axis, to `length`, `thick` wide about `place`."""

    place: ArrayLike
    length: ArrayLike
    thick: float
    level: bool = False
    texts: Sequence[str] = ()

    def extent(self, log: Logs = (False, False)) -> tuple[list[Array], list[Array]]:
        """See `Mark`."""
        place, length = array(self.place), array(self.length)
        along, across = [length], [place - 0.5 * self.thick, place + 0.5 * self.thick]
        return (along, across) if self.level else (across, along)

    def drawn(self, box: Box) -> str:
        """See `Mark`."""
        along, across = (box.x, box.y) if self.level else (box.y, box.x)
        start = float(along([along.low])[0] if along.log else along([0.0])[0])
        end, place, out = along(self.length), array(self.place), ""
        sides = [across(place - 0.5 * self.thick), across(place + 0.5 * self.thick)]
        for k in np.flatnonzero(np.isfinite(end)).tolist():
            a, b = sorted((sides[0][k], sides[1][k]))
            c, d = sorted((start, end[k]))
            x, y, w, h = (c, a, d - c, b - a) if self.level else (a, c, b - a, d - c)
            out += f'<path d="{rectangle(x, y, w, h)}"{attributes(fill=self.colour)}/>'
            if k < len(self.texts) and self.texts[k]:
                out += label(self.texts[k], FINE * (d + 4.0), FINE * (0.5 * (a + b) + 4.0), size=FINE * 11)
        return out


@dataclass(frozen=True, eq=False, kw_only=True)
class Map(Mark):
    """Values over two axes as colours.

    Attributes
    ----------
    x : (n,)
    y : (m,)
        Middles of the cells; on a logarithmic axis they need not be even.
    z : (m, n)
    palette : str
    low, high : float
    log : bool
        Colours stand for the logarithm.
    bar : str
        Title of the scale beside the panel.
    names : sequence of (text, colour)
        Instead of a palette: what 0, 1, 2 ... stand for, in the key.
    hatch : bool
        Strokes of `colour` where `z` is not 0, over what lies below.
    """

    x: ArrayLike
    y: ArrayLike
    z: NDArray[Any]
    palette: str = "viridis"
    low: float = 0.0
    high: float = 1.0
    log: bool = False
    bar: str = ""
    names: Sequence[tuple[str, str]] = ()
    hatch: bool = False

    def extent(self, log: Logs = (False, False)) -> tuple[list[Array], list[Array]]:
        """See `Mark`."""
        to = [Scale(1.0, 10.0, one, 0.0, 1.0).to for one in log]
        x, y = (self.edges(f(v)) for f, v in zip(to, (self.x, self.y), strict=True))
        return [10.0**x if log[0] else x], [10.0**y if log[1] else y]

    @staticmethod
    def edges(middles: Array) -> Array:
        """Ends (n + 1,) of cells about their middles."""
        if len(middles) < 2:
            return middles[0] + np.array([-0.5, 0.5])
        inner = 0.5 * (middles[1:] + middles[:-1])
        return np.array([2 * middles[0] - inner[0], *inner, 2 * middles[-1] - inner[-1]])

    def drawn(self, box: Box) -> str:
        """See `Mark`."""
        picked, ends = [], []
        for scale, middles in ((box.x, self.x), (box.y, self.y)):
            side = self.edges(scale.to(middles))
            low, high = scale.to([scale.low, scale.high])
            ends.append(np.sort(scale.start + scale.length * (side[[0, -1]] - low) / (high - low)))
            picked.append(self._cells(scale, side, *ends[-1]))
        z = np.asarray(self.z, dtype=np.float64)[np.ix_(picked[1], picked[0])]
        (x0, x1), (y0, y1) = FINE * np.array(ends)
        place = attributes(x=f"{x0:.0f}", y=f"{y0:.0f}", width=f"{x1 - x0:.0f}", height=f"{y1 - y0:.0f}")
        return f'<image preserveAspectRatio="none" href="{self._png(z)}"{place}{self._read()}/>'

    def _cells(self, scale: Scale, side: Array, start: float, stop: float) -> NDArray[np.intp]:
        """Numbers of the cells along one side of the picture, from its left or its top."""
        forward = (scale.length > 0.0) == (side[-1] > side[0])
        widths = np.abs(np.diff(side))
        if not self.hatch and np.ptp(widths) <= 1e-3 * widths.max():
            return np.arange(len(widths)) if forward else np.arange(len(widths))[::-1]
        middles = np.arange(start, stop, (stop - start) / max(round(stop - start), 1)) + 0.5
        at = scale.back(middles)
        order = side if side[-1] > side[0] else side[::-1]
        cell = np.clip(np.searchsorted(order, at) - 1, 0, len(widths) - 1)
        return np.asarray(cell if side[-1] > side[0] else len(widths) - 1 - cell)

    def _png(self, z: Array) -> Markup:
        if self.hatch:
            line, column = np.indices(z.shape)
            stroke = (z != 0.0) & ((line + column) % 7 < 2)
            colours = np.array([raster.rgb(self.colour), (0, 0, 0)])
            return raster.data_png((~stroke).astype(np.uint8), colours, clear=1)
        if self.names:
            colours = np.array([raster.rgb(colour) for _, colour in self.names])
            return raster.data_png(z.astype(np.uint8), colours)
        low, high = (np.log10([self.low, self.high])) if self.log else (self.low, self.high)
        with np.errstate(invalid="ignore", divide="ignore"):
            shown = np.log10(z) if self.log else z
        colours = np.vstack([raster.lookup(raster.PALETTES[self.palette]), [[0, 0, 0]]])
        return raster.data_png(raster.codes(shown, low, high), colours, raster.STEPS)

    def _read(self) -> str:
        """What the pointer needs to read values off the colours."""
        if self.hatch:
            return ' pointer-events="none"'
        if self.names:
            texts, colours = zip(*self.names, strict=True)
            return attributes(data_names="\n".join(map(printable, texts)), data_stops=" ".join(colours))
        ends = f"{self.low:.6g} {self.high:.6g} {int(self.log)}"
        stops = " ".join(raster.PALETTES[self.palette])
        return attributes(data_bar=printable(self.bar), data_stops=stops, data_range=ends)

    def keys(self) -> list[tuple[str, str]]:
        """See `Mark`."""
        if self.hatch:
            look = attributes(stroke=self.colour, stroke_width=1.8)
            return [(self.name, f'<path d="M2 11l8-10M9 11l8-10M16 11l7-9"{look}/>')]
        rim = attributes(stroke=MUTED, stroke_width=0.7)
        box = '<path d="M2 1h20v10H2z"'
        return [(text, f"{box}{attributes(fill=colour)}{rim}/>") for text, colour in self.names]


@dataclass(frozen=True, eq=False, kw_only=True)
class Spans(Mark):
    """Ranges of x, shaded from top to bottom."""

    spans: Sequence[tuple[float, float]]
    opacity: float = 0.22

    def drawn(self, box: Box) -> str:
        """See `Mark`."""
        left, top, w, h = box.corners
        d = ""
        for pair in self.spans:
            a, b = np.clip(np.sort(box.x(pair)), left, left + w)
            # what is narrower than a px is seen too
            d += rectangle(a, top, max(b - a, 0.7), h)
        return f'<path d="{d}"{attributes(fill=self.colour, fill_opacity=self.opacity)}/>' if d else ""


@dataclass(frozen=True, eq=False, kw_only=True)
class Rules(Mark):
    """Straight lines through a panel at places of x, or of y."""

    x: Sequence[float] = ()
    y: Sequence[float] = ()
    width: float = 1.0
    dash: str = "dot"

    def extent(self, log: Logs = (False, False)) -> tuple[list[Array], list[Array]]:
        """See `Mark`."""
        return [], [array(self.y)]

    def drawn(self, box: Box) -> str:
        """See `Mark`."""
        left, top, w, h = box.corners
        x, y = box.x(self.x), box.y(self.y)
        upright, level = x[(x >= left) & (x <= left + w)], y[(y >= top) & (y <= top + h)]
        d = "".join(f"M{FINE * v:.0f} {FINE * top:.0f}v{FINE * h:.0f}" for v in upright)
        d += "".join(f"M{FINE * left:.0f} {FINE * v:.0f}h{FINE * w:.0f}" for v in level)
        dashes = dashed(self.dash, FINE)
        look = attributes(stroke=self.colour, stroke_width=self.width * FINE, stroke_dasharray=dashes)
        return f'<path class="l" d="{d}"{look}/>' if d else ""

    def sample(self) -> str:
        """See `Mark`."""
        look = attributes(stroke=self.colour, stroke_width=1.4, stroke_dasharray=dashed(self.dash))
        return f'<path d="M1 6h22"{look}/>'


@dataclass(frozen=True, eq=False, kw_only=True)
class Note(Mark):
    """Words in a panel: from a place of y at its right end, or in its middle."""

    words: str
    y: float | None = None

    def drawn(self, box: Box) -> str:
        """See `Mark`."""
        left, top, w, h = box.corners
        x, y, anchor, size = left + 0.5 * w, top + 0.5 * h, "middle", SIZE
        if self.y is not None:
            x, y, anchor, size = left + w - 6.0, float(box.y([self.y])[0]) - 5.0, "end", 12.0
        return label(self.words, FINE * x, FINE * y, anchor=anchor, size=FINE * size)


def label(
    text: str,
    x: float,
    y: float,
    *,
    anchor: str = "start",
    size: float = SIZE,
    colour: str = "",
    turn: bool = False,
) -> str:
    """A text; lines of it are parted by line breaks."""
    lines = text.split("\n")
    inner = str(escape(printable(lines[0])))
    if len(lines) > 1:
        steps = ("0", *["1.2em"] * (len(lines) - 1))
        span = Markup('<tspan x="{:.0f}" dy="{}">{}</tspan>').format
        inner = "".join(span(x, step, printable(line)) for step, line in zip(steps, lines, strict=True))
    look = attributes(
        text_anchor="" if anchor == "start" else anchor,
        font_size="" if size == SIZE else f"{size:g}",
        fill=colour,
        transform=f"rotate(-90 {x:.0f} {y:.0f})" if turn else "",
    )
    return f'<text x="{x:.0f}" y="{y:.0f}"{look}>{inner}</text>'


def broken(*parts: Array) -> Array:
    """Curves one after the other as one, with a gap between each and the next."""
    gap = np.full(1, np.nan)
    return np.concatenate([piece for part in parts for piece in (part, gap)][:-1] or [gap])
