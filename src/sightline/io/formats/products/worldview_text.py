"""IMD, ATT, EPH, GEO, RPB, TIL of QuickBird and WorldView as text → the tree of their XML.

Not here: what the values mean (``worldview.py``).
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

from sightline.access import read_text
from sightline.errors import FormatError
from sightline.io.formats.products.tree import LARGEST, Part

#: Parts that a scene needs, and what is lost without each; parts that it may have.
_NEEDED = {
    "ATT": "the attitudes",
    "EPH": "the orbit",
    "GEO": "the camera (principal distance, detector line, how it sits in the body)",
}
_OPTIONAL = ("RPB", "TIL")
#: A statement: group begun or ended, or a key with its value.
_STATEMENT = re.compile(r"(BEGIN_GROUP|END_GROUP)\s*=\s*(\w+)|(\w+)\s*=\s*([^;]*);|(END);?")
#: Groups that are numbered.
_NUMBERED = re.compile(r"(IMAGE|TILE|DETECTOR_ARRAY|STEREO_PAIR)_\d+")
#: A row of a list: numbers in brackets.
_ROW = re.compile(r"\(([^()]*)\)")


def read_text_set(path: Path, what: str) -> Part:
    """The IMD and the files that lie beside it under the same name.

    Raises
    ------
    FormatError
        Names the part that is missing, and what is in it.
    """
    root = ElementTree.Element("isd")
    root.append(_parsed(path, "IMD", what))
    beside = {file.name.upper(): file for file in path.parent.iterdir()}
    for part, holds in _NEEDED.items():
        file = beside.get(f"{path.stem}.{part}".upper())
        if file is None:
            raise FormatError(
                f"{path}: {path.stem}.{part} is missing, which holds {holds} and is delivered with it: put "
                "it beside it"
            )
        root.append(_parsed(file, part, what))
    for part in _OPTIONAL:
        file = beside.get(f"{path.stem}.{part}".upper())
        if file is not None:
            root.append(_parsed(file, part, what))
    return Part(path, "", root, what)


def _parsed(path: Path, tag: str, what: str) -> ElementTree.Element:
    """One file as an element; keys in capitals, lists as in the XML."""
    text = read_text(path, what, most=LARGEST)
    inner = [ElementTree.Element(tag)]
    end = 0
    for found in _STATEMENT.finditer(text):
        if text[end : found.start()].strip():
            raise FormatError(
                f"{path}: {text[end : found.start()].strip()[:60]!r} is no `key = value;`; {what} is expected"
            )
        end = found.end()
        bracket, group, key, value, _ = found.groups()
        if bracket == "BEGIN_GROUP":
            numbered = _NUMBERED.fullmatch(group)
            inner.append(ElementTree.SubElement(inner[-1], numbered[1] if numbered else group.upper()))
        elif bracket == "END_GROUP":
            if len(inner) < 2:
                raise FormatError(f"{path}: END_GROUP = {group} ends what was not begun; {what} is expected")
            inner.pop()
        elif key:
            _add(inner[-1], key.upper(), value.strip())
    if len(inner) > 1 or text[end:].strip():
        raise FormatError(f"{path}: ends within {inner[-1].tag}: is it cut short? fetch it again")
    return inner[0]


def _add(parent: ElementTree.Element, key: str, value: str) -> None:
    """A key: lists become one element for each row."""
    if not value.startswith("("):
        ElementTree.SubElement(parent, key).text = value.strip('"')
        return
    rows = _ROW.findall(value[1:]) if "(" in value[1:] else [value.strip("()")]
    holder = ElementTree.SubElement(parent, f"{key}List")
    for row in rows:
        ElementTree.SubElement(holder, key).text = " ".join(row.replace(",", " ").split())
