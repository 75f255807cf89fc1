"""A report: one HTML page that asks no network for anything. All reports have this form.

Not here: what the figures and sentences are (the other files of this folder).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from sightline.errors import printable, shortened
from sightline.report.figure import Figure
from sightline.writing import whole_text

#: Characters of a word on a page.
LONGEST_WORD = 160
_NOTHING = Markup("")


@dataclass(frozen=True)
class Table:
    """Rows of texts under their heads.

    Attributes
    ----------
    heads, rows : sequence
    left : sequence of int
        Columns of words, which begin at the left.
    folded : str
        Words that unfold a long table; "" for one that is open.
    """

    heads: Sequence[str]
    rows: Sequence[Sequence[Any]]
    left: Sequence[int] = (0,)
    folded: str = ""


@dataclass(frozen=True)
class Section:
    """A part of a page with its heading.

    Attributes
    ----------
    name : str
        Anchor of the section, and its word at the head of the page.
    title : str
    parts : sequence of str, list of str, Table, Figure or Markup
        Text, points, and what is shown, in their order.
    """

    name: str
    title: str
    parts: Sequence[str | list[str] | Table | Figure | Markup]

    @property
    def figure(self) -> Figure:
        """The one figure of the section."""
        return next(part for part in self.parts if isinstance(part, Figure))


@dataclass(frozen=True)
class Page:
    """A page.

    Attributes
    ----------
    heading : str
        Name of what was worked on.
    what : str
        What the page says of it, for the title of the window.
    about : str
        One line under the heading.
    sentences, warnings : sequence of str
    sections : sequence of Section
    footer : str
    mind : str
        Words above the warnings.
    cards : Markup
        Main numbers, under the sentences.
    """

    heading: str
    what: str
    about: str
    sentences: Sequence[str]
    warnings: Sequence[str]
    sections: Sequence[Section]
    footer: str
    mind: str = "Mind before using the numbers"
    cards: Markup = _NOTHING

    @property
    def title(self) -> str:
        """Of the window."""
        return f"{self.heading}: {self.what}"

    def section(self, name: str) -> Section:
        """The section of a name."""
        return next(section for section in self.sections if section.name == name)

    @property
    def html(self) -> str:
        """The page as text.

        All text is escaped, on one line, and its words have an end: whatever it holds is shown and does
        nothing.
        """
        environment = Environment(
            loader=PackageLoader("sightline.report", "."),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
            finalize=_shown,
        )
        environment.filters["is_html"] = lambda value: isinstance(value, Markup)
        return environment.get_template("page.html.j2").render(page=self)

    def write(self, path: Path) -> None:
        """Write the page, complete or not at all."""
        text = self.html
        whole_text(path, text)


def _shown(value: Any) -> Any:
    """Text as it can be shown, unless it is HTML already."""
    if not isinstance(value, str) or isinstance(value, Markup):
        return value
    return re.sub(r"\S+", lambda word: shortened(word[0], LONGEST_WORD), printable(value))


def pictures(shown: Iterable[tuple[str, str, str | Markup]], kind: str = "") -> Markup:
    """Pictures beside each other, each an address, what it is for who cannot see it, and a caption."""
    one = Markup('<figure><img src="{}" alt="{}"><figcaption>{}</figcaption></figure>')
    inner = Markup("").join(
        one.format(address, _shown(alternative), _shown(said)) for address, alternative, said in shown
    )
    return Markup('<div class="pictures {}">{}</div>').format(kind, inner)


def resources(summary: Mapping[str, Any]) -> str:
    """Time and memory that a result took, as the end of a sentence."""
    peak = summary.get("peak_memory_bytes")
    return f"; {summary['wall_seconds']:.0f} s" + (f", {peak / 2**30:.2f} GiB" if peak else "")


def inputs(summary: Mapping[str, Any], *before: Table) -> Section:
    """Which files were read."""
    files = Table(["file", "SHA-256"], list(summary["inputs"].items()), [0, 1])
    return Section("inputs", "Inputs", [*before, files])
