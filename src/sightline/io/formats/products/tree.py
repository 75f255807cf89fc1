"""Metadata of products as a tree: XML without entities, values by their path, errors that name it.

Not here: what the values mean (``worldview.py``, ...).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from sightline.access import read_bytes
from sightline.errors import FormatError

Array = NDArray[np.float64]

#: Bytes of metadata at most: ephemeris and attitudes of a long strip are some MB.
LARGEST = 200_000_000
#: Elements inside one another at most.
_DEEPEST = 64
#: Characters of a value that a message repeats.
_SHOWN = 60


@dataclass(frozen=True, eq=False)
class Part:
    """An element of the metadata, and where it is.

    Attributes
    ----------
    path : Path
        The file.
    place : str
        Tags from the root, for messages.
    element : ElementTree.Element
    what : str
        What is expected of the file, for messages.
    """

    path: Path
    place: str
    element: ElementTree.Element
    what: str

    def refused(self, name: str, why: str) -> FormatError:
        """The error of a value that is not as it should be."""
        return FormatError(f"{self.path}: {self.place}/{name} {why}; {self.what} is expected")

    def has(self, name: str) -> bool:
        """Whether there is an element at the path `name` below this one."""
        return self.element.find(name) is not None

    def part(self, name: str) -> Part:
        """The element at the path `name`; FormatError where it is missing."""
        found = self.element.find(name)
        if found is None:
            raise self.refused(name, "is missing")
        return Part(self.path, f"{self.place}/{name}", found, self.what)

    def parts(self, name: str) -> list[Part]:
        """All elements at the path `name`, none where it is missing."""
        return [
            Part(self.path, f"{self.place}/{name}[{number}]", found, self.what)
            for number, found in enumerate(self.element.findall(name), 1)
        ]

    def text(self, name: str) -> str:
        """The words at the path `name`."""
        value = (self.part(name).element.text or "").strip()
        if not value:
            raise self.refused(name, "is empty")
        return value

    def number(self, name: str) -> float:
        """A finite number."""
        return float(self.numbers(name, 1)[0])

    def positive(self, name: str) -> float:
        """A number above 0."""
        value = self.number(name)
        if not value > 0.0:
            raise self.refused(name, f"is {value:g}, not above 0")
        return value

    def count(self, name: str, least: int, most: int) -> int:
        """A whole number."""
        value = self.number(name)
        if value != int(value) or not least <= value <= most:
            raise self.refused(name, f"is {value:g}; a whole number from {least} to {most} is allowed")
        return int(value)

    def numbers(self, name: str, width: int | None = None) -> Array:
        """Finite numbers with white space or commas between; `width` of them where that is given."""
        text = self.text(name)
        try:
            values = np.array([float(word) for word in re.split(r"[\s,]+", text.strip("() \t\r\n"))])
        except ValueError:
            raise self.refused(name, f"is {text[:_SHOWN]!r}, no number") from None
        if not np.isfinite(values).all():
            raise self.refused(name, "holds what is no finite number")
        if width is not None and len(values) != width:
            raise self.refused(name, f"holds {len(values)} numbers, not {width}")
        return values

    def table(self, name: str, width: int) -> Array:
        """Rows (N, width) of numbers, one for each element at the path `name`; at least one."""
        rows = [row for row in self.element.findall(name)]
        if not rows:
            raise self.refused(name, "is missing")
        try:
            values = [[float(word) for word in (row.text or "").replace(",", " ").split()] for row in rows]
        except ValueError:
            raise self.refused(name, "holds what is no number") from None
        wrong = next((k for k, row in enumerate(values) if len(row) != width), None)
        if wrong is not None:
            raise self.refused(name, f"holds {len(values[wrong])} numbers in row {wrong + 1}, not {width}")
        table = np.array(values)
        if not np.isfinite(table).all():
            raise self.refused(name, "holds what is no finite number")
        return table


def read_xml(path: Path, what: str) -> Part:
    """The root of an XML file.

    Parameters
    ----------
    path : Path
    what : str
        What is expected of it, for messages: ``"metadata of a WorldView product"``.

    Raises
    ------
    FormatError
        If it is cut short, no XML, or declares entities.
    """
    builder, depth = ElementTree.TreeBuilder(), 0

    def refuse(*_: object) -> NoReturn:
        raise FormatError(f"{path}: declares entities (DOCTYPE); write it without")

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST:
            raise FormatError(f"{path}: holds elements {depth} deep; {what} is expected")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.CharacterDataHandler = builder.data
    parser.buffer_text = True
    content = read_bytes(path, what, most=LARGEST)
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise FormatError(f"{path}: is no complete XML ({error}); is it cut short? fetch it again") from None
    root = builder.close()
    return Part(path, root.tag, root, what)
