"""Figures of a page as SVG: panels with axes, marks in them, and a key above.

Not here: the marks (``marks.py``), what a figure shows (the other files of this folder).
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from sightline.errors import printable
from sightline.report import raster
from sightline.report.axes import (
    SIZE,
    WIDTH,
    Array,
    Axis,
    Box,
    Scale,
    array,
    linear_ticks,
    number,
    text_width,
)
from sightline.report.marks import FINE, Bars, Map, Mark, Note, Points, Spans, attributes, label, rectangle
from sightline.report.style import GRID, MUTED

#: px: height of a line of text, gap between columns of panels.
LINE, GAP = 16.0, 26.0


@dataclass(eq=False)
class Panel:
    """Marks between two axes.

    Attributes
    ----------
    x, y : Axis
    title : str
    right : (float, str), optional
        Factor and unit of a second ordinate at the right.
    equal : bool
        Both axes have one scale: the panel is made smaller.
    marks : list of Mark
    """

    x: Axis = field(default_factory=Axis)
    y: Axis = field(default_factory=Axis)
    title: str = ""
    right: tuple[float, str] | None = None
    equal: bool = False
    marks: list[Mark] = field(default_factory=list)

    def add(self, *marks: Mark) -> None:
        """Draw more, on top."""
        self.marks += marks

    def named(self, name: str) -> Any:
        """The first mark of a name."""
        return next(mark for mark in self.marks if mark.name == name)

    @property
    def bar(self) -> Map | Points | None:
        """What has a scale of colours beside the panel."""
        barred = (m for m in self.marks if isinstance(m, (Map, Points)) and m.bar)
        return next(barred, None)

    @property
    def logs(self) -> tuple[bool, bool]:
        """Which of the two axes are logarithmic."""
        return self.x.log, self.y.log

    def x_range(self) -> tuple[float, float]:
        """Ends of the abscissa."""
        return self.x.range([v for mark in self.marks for v in mark.extent(self.logs)[0]])

    def y_range(self) -> tuple[float, float]:
        """Ends of the ordinate."""
        return self.y.range([v for mark in self.marks for v in mark.extent(self.logs)[1]])


class Figure:
    """Panels in rows and columns.

    Parameters
    ----------
    rows, columns : int
    height : float or sequence of float
        px of the panels of each row.
    shared : bool
        The panels of a column have one abscissa, written under the lowest.
    """

    def __init__(
        self,
        rows: int = 1,
        columns: int = 1,
        *,
        height: float | Sequence[float] = 180.0,
        shared: bool = True,
    ) -> None:
        self.height = np.broadcast_to(array(height), rows).tolist()
        self.shared = shared
        axes = [Axis(tight=True) for _ in range(columns)]
        self.rows = [[Panel(x=axis if shared else Axis()) for axis in axes] for _ in range(rows)]

    def __getitem__(self, place: int | tuple[int, int]) -> Panel:
        """The panel of a row, or of a row and a column."""
        row, column = place if isinstance(place, tuple) else (place, 0)
        return self.rows[row][column]

    @property
    def panels(self) -> list[Panel]:
        """All, row by row."""
        return [panel for row in self.rows for panel in row]

    @property
    def marks(self) -> list[Mark]:
        """Of all panels."""
        return [mark for panel in self.panels for mark in panel.marks]

    def keys(self) -> dict[str, str]:
        """Samples of what is named, each name once."""
        out: dict[str, str] = {}
        for mark in self.marks:
            for name, sample in mark.keys():
                out.setdefault(name, sample)
        return out

    def described(self) -> str:
        """What is drawn, for who cannot see it."""
        said = []
        for panel in self.panels:
            names = "; ".join(dict.fromkeys(name for mark in panel.marks for name, _ in mark.keys()))
            title = f"{panel.title}: " if panel.title else ""
            axes = f"{panel.y.title or 'values'} against {panel.x.title or 'values'}"
            said.append(f"{title}{axes}" + (f" ({names})" if names else ""))
        return printable(". ".join(" ".join(text.split()) for text in said[:12]) + ".")

    def html(self, name: str) -> Markup:
        """Key and drawing as a piece of a page; `name` is unlike that of any other figure of the page."""
        svg, height = self._drawn(name)
        key = Markup("").join(
            Markup('<li><svg class="key" viewBox="0 0 24 12" aria-hidden="true">{}</svg>{}</li>').format(
                Markup(sample), printable(words)
            )
            for words, sample in self.keys().items()
        )
        key = Markup('<ul class="key">{}</ul>').format(key) if key else key
        said = escape(self.described())
        titled = f'aria-labelledby="{name}-title"'
        return Markup(
            f'<div class="figure">{key}<div class="scroll" tabindex="0" role="group" {titled}>'
            f'<svg class="drawn" viewBox="0 0 {WIDTH:.0f} {height:.0f}" role="img" {titled} '
            f'aria-describedby="{name}-said"><desc id="{name}-said">{said}</desc>{svg}</svg></div></div>'
        )

    def _drawn(self, name: str) -> tuple[str, float]:
        """The panels, and the height of all."""
        columns = range(len(self.rows[0]))
        ends = [[(self._x_range(r, c), row[c].y_range()) for c in columns] for r, row in enumerate(self.rows)]
        every = list(zip(self.rows, ends, self.height, strict=True))
        left = [max(_left(row[c], end[c][1], height) for row, end, height in every) for c in columns]
        right = [max(_right(row[c], height) for row, _, height in every) for c in columns]
        room = (WIDTH - GAP * (len(columns) - 1) - sum(left) - sum(right)) / len(columns)
        top, out = 0.0, []
        for r, (row, end, height) in enumerate(every):
            titles = [_fitted(row[c].title, room + right[c] - 4.0) if row[c].title else [] for c in columns]
            top += max(LINE * max(map(len, titles)) + 8.0, 10.0)
            start, used = 0.0, 0.0
            lowest = r == len(self.rows) - 1 or not self.shared
            for c, panel in enumerate(row):
                start += left[c]
                if panel.marks:
                    box = _box(panel, *end[c], start, top, room, height)
                    out.append(_panel(panel, box, titles[c], f"{name}-{r}-{c}", lowest))
                    used = max(used, box.corners[3] + (_below(panel) if lowest else 6.0))
                start += room + right[c] + GAP
            top += used
        return "".join(out), top + 4.0

    def _x_range(self, row: int, column: int) -> tuple[float, float]:
        if not self.shared:
            return self.rows[row][column].x_range()
        panels = [panels[column] for panels in self.rows]
        every = [v for panel in panels for mark in panel.marks for v in mark.extent(panel.logs)[0]]
        return self.rows[row][column].x.range(every)


def _box(
    panel: Panel,
    x: tuple[float, float],
    y: tuple[float, float],
    left: float,
    top: float,
    width: float,
    height: float,
) -> Box:
    """The scales of a panel in the room that it has."""
    if panel.equal:
        per = min(width / (x[1] - x[0]), height / (y[1] - y[0]))
        width, height = per * (x[1] - x[0]), per * (y[1] - y[0])
    back, down = panel.x.downward, panel.y.downward
    return Box(
        Scale(*x, panel.x.log, left + width if back else left, -width if back else width),
        Scale(*y, panel.y.log, top if down else top + height, height if down else -height),
    )


def _fitted(text: str, room: float) -> list[str]:
    """A text in lines that have room."""
    most = max(int(room / (0.57 * SIZE)), 8)
    return [line for part in text.split("\n") for line in textwrap.wrap(part, most) or [""]]


def _tick_room(length: float, apart: float) -> float:
    return max(length / apart, 2.0)


def _y_ticks(panel: Panel, low: float, high: float, height: float) -> list[tuple[float, str]]:
    return panel.y.marked(low, high, _tick_room(height, 27.0))


def _left(panel: Panel, ends: tuple[float, float], height: float) -> float:
    """px for the numbers and the title of an ordinate."""
    texts = [line for _, text in _y_ticks(panel, *ends, height) for line in text.split("\n")]
    title = LINE * len(_fitted(panel.y.title, height + 20.0)) + 4.0 if panel.y.title else 4.0
    return max((text_width(text, 12.0) for text in texts), default=0.0) + 12.0 + title


def _right(panel: Panel, height: float) -> float:
    """px at the right of a panel."""
    if panel.bar is not None:
        return 26.0 + max(text_width(text, 12.0) for _, text in _bar_ticks(panel.bar, height)) + LINE + 10.0
    return 14.0 if panel.right is None else 58.0


def _below(panel: Panel) -> float:
    """px under a panel for the numbers and the title of its abscissa."""
    return 22.0 + (LINE + 4.0 if panel.x.title else 0.0) + 8.0


def _panel(panel: Panel, box: Box, titles: list[str], name: str, lowest: bool) -> str:
    """One panel: frame, grid, numbers, marks."""
    left, top, w, h = box.corners
    clip = f'<clipPath id="{name}"><path d="{rectangle(left, top, w, h)}"/></clipPath>'
    said = ["" if axis.ticks is not None else printable(axis.title) for axis in (panel.x, panel.y)]
    read = attributes(
        data_box=f"{left:.1f} {top:.1f} {w:.1f} {h:.1f}",
        data_x=f"{box.x.low:.9g} {box.x.high:.9g} {int(box.x.log)} {int(panel.x.downward)}",
        data_y=f"{box.y.low:.9g} {box.y.high:.9g} {int(box.y.log)} {int(panel.y.downward)}",
        data_xt=said[0],
        data_yt=said[1],
    )
    out = [f'<g class="panel"{read}>{clip}']
    for k, line in enumerate(titles):
        out.append(label(line, left, top - 7.0 - LINE * (len(titles) - 1 - k)))
    out.append(_axes(panel, box, lowest))
    under = [mark for mark in panel.marks if isinstance(mark, (Spans, Map))]
    over = [mark for mark in panel.marks if mark not in under]
    drawn: dict[bool, str] = {True: "", False: ""}
    for mark in [*under, *over]:
        drawn[not isinstance(mark, (Points, Note, Bars))] += mark.drawn(box)
    clipped = f'<g clip-path="url(#{name})">{drawn[True]}</g>'
    out.append(f'<g class="marks" transform="scale({1 / FINE:g})">{clipped}{drawn[False]}</g>')
    out.append(f'<path class="frame" d="M{left:.1f} {top:.1f}v{h:.1f}h{w:.1f}"/>')
    if panel.bar is not None:
        out.append(_bar(panel.bar, left + w + 12.0, top, h))
    return "".join([*out, "</g>"])


def _axes(panel: Panel, box: Box, lowest: bool) -> str:
    """Grid, numbers and titles."""
    left, top, w, h = box.corners
    out, grid = [], ""
    widest = max((text_width(t, 12.0) for _, t in panel.x.marked(box.x.low, box.x.high, 8.0)), default=20.0)
    x_ticks = panel.x.marked(box.x.low, box.x.high, _tick_room(w, max(widest + 24.0, 60.0)))
    said = -np.inf
    for place, (_, text) in sorted(zip(box.x([v for v, _ in x_ticks]).tolist(), x_ticks, strict=True)):
        grid += f"M{place:.1f} {top:.1f}v{h:.1f}" if panel.x.grid else ""
        half = 0.5 * text_width(text, 12.0)
        if lowest and text and place - half > said + 6.0:
            out.append(label(text, place, top + h + 17.0, anchor="middle", size=12.0))
            said = place + half
    y_ticks = _y_ticks(panel, box.y.low, box.y.high, h)
    for place in box.y([v for v, _ in y_ticks]).tolist():
        grid += f"M{left:.1f} {place:.1f}h{w:.1f}" if panel.y.grid else ""
    for place, text in _apart(box.y([v for v, _ in y_ticks]), y_ticks):
        lines = text.count("\n")
        out.append(label(text, left - 7.0, place + 4.0 - 7.0 * lines, anchor="end", size=12.0))
    if panel.right is not None:
        factor, unit = panel.right
        for v in linear_ticks(box.y.low * factor, box.y.high * factor, _tick_room(h, 34.0)):
            place = float(box.y([v / factor])[0])
            out.append(
                label(number(float(f"{v:.10g}")), left + w + 6.0, place + 4.0, size=12.0, colour=MUTED)
            )
        out.append(label(unit, left + w + 52.0, top + 0.5 * h, anchor="middle", colour=MUTED, turn=True))
    if lowest and panel.x.title:
        out.append(label(panel.x.title, left + 0.5 * w, top + h + 22.0 + LINE, anchor="middle"))
    if panel.y.title:
        title = _fitted(panel.y.title, h + 20.0)
        widest = max((text_width(line, 12.0) for _, t in y_ticks for line in t.split("\n")), default=0.0)
        for k, line in enumerate(title):
            place = left - 14.0 - widest - LINE * (len(title) - 1 - k)
            out.append(label(line, place, top + 0.5 * h, anchor="middle", turn=True))
    return f'<path d="{grid}" stroke="{GRID}"/>' + "".join(out)


def _apart(places: Array, ticks: list[tuple[float, str]]) -> list[tuple[float, str]]:
    """Places (px) and texts of those ticks that leave each other room; decades go before what is between."""
    kept: list[tuple[float, str]] = []
    for place, (_, text) in sorted(
        zip(places.tolist(), ticks, strict=True), key=lambda t: t[1][1].strip("0.,")[:2] != "1"
    ):
        if all(abs(place - other) > 13.0 for other, _ in kept):
            kept.append((place, text))
    return kept


def _bar_ticks(mark: Map | Points, height: float) -> list[tuple[float, str]]:
    return Axis(log=isinstance(mark, Map) and mark.log).marked(mark.low, mark.high, _tick_room(height, 22.0))


def _bar(mark: Map | Points, left: float, top: float, height: float) -> str:
    """The scale of colours beside a panel."""
    colours = raster.lookup(raster.PALETTES[mark.palette])[::-1]
    png = raster.data_png(colours[:, None, :])
    scale = Scale(mark.low, mark.high, isinstance(mark, Map) and mark.log, top + height, -height)
    frame = attributes(x=f"{left:.1f}", y=f"{top:.1f}", width=12, height=f"{height:.1f}")
    out = [f'<image preserveAspectRatio="none" href="{png}"{frame}/>']
    ticks = _bar_ticks(mark, height)
    widest = max(text_width(text, 12.0) for _, text in ticks)
    for place, text in _apart(scale([v for v, _ in ticks]), ticks):
        out.append(label(text, left + 17.0, place + 4.0, size=12.0))
    out.append(label(mark.bar, left + 17.0 + widest + LINE, top + 0.5 * height, anchor="middle", turn=True))
    return "".join(out)
