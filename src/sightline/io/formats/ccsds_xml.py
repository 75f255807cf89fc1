"""CCSDS navigation messages in XML (505.0-B) → the same in keyword = value notation (KVN).

Orbits and attitudes (OEM, AEM) are taken over element by element, whatever namespace they are in; ccsds-ndm
does the same of messages of one instant.

Not here: what keywords mean (``ccsds_message.py`` and those that use it).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from sightline.errors import FormatError, foreign_errors
from sightline.geometry.earth_orientation import orbit_package

Element = ElementTree.Element

#: What another implementation may ask of a parser of XML, and never needs here.
_ENTITIES = re.compile(r"<!\s*(?:DOCTYPE|ENTITY)", re.IGNORECASE)
#: Numbers of a state in the order of a line of KVN, and their unit; the last three may be left out.
_STATE = (
    *((key, "km") for key in ("X", "Y", "Z")),
    *((key, "km/s") for key in ("X_DOT", "Y_DOT", "Z_DOT")),
    *((key, "km/s**2") for key in ("X_DDOT", "Y_DDOT", "Z_DDOT")),
)
_NEEDED = 6
_COVARIANCE = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
_QUATERNION = ("Q1", "Q2", "Q3", "QC")
#: Units that angles and their rates may have.
_ANGLES = ("deg", "deg/s", "1/s")


def kvn_of_xml(path: Path, text: str, kind: str) -> str:
    """A message of a kind ("OEM", ...) in KVN; FormatError where the XML does not hold just one."""
    found = _ENTITIES.search(text)
    if found is not None:
        raise FormatError(
            f"{path}: holds {found[0]!r}: XML with a document type or entities is not read; write the "
            "message without them"
        )
    advice = "its schema is that of the CCSDS (505.0-B)"
    try:
        root = ElementTree.fromstring(text.lstrip("\ufeff \t\r\n"))
    except ElementTree.ParseError as error:
        raise FormatError(f"{path}: is no {kind} in XML ({error}; was it cut?); {advice}") from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    messages = [root] if root.tag.upper() == kind else root.findall(kind.lower())
    if len(messages) != 1:
        raise FormatError(
            f"{path}: <{root.tag[:40]}> holds {len(messages)} messages <{kind.lower()}>; one is needed: "
            "write each into a file of its own, and name the one that is meant"
        )
    if kind in ("OEM", "AEM"):
        return "\n".join(_lines(path, messages[0], kind)) + "\n"
    ndm = orbit_package("ccsds_ndm.ndm_io", "a message in XML")
    forms = orbit_package("ccsds_ndm.mapping", "a message in XML").NDMFileFormats
    with foreign_errors(path, f"is no {kind} in XML", advice):
        plain = ElementTree.tostring(messages[0], encoding="unicode")
        return str(ndm.NdmIo().to_string(ndm.NdmIo().from_string(plain), forms.KVN))


def _lines(path: Path, message: Element, kind: str) -> Iterator[str]:
    """Lines of an OEM or AEM."""
    yield f"CCSDS_{kind}_VERS = {message.get('version', '')}"
    yield from _keywords(message.find("header"))
    body = message.find("body")
    for segment in () if body is None else body.findall("segment"):
        metadata, data = segment.find("metadata"), segment.find("data")
        yield "META_START"
        yield from _keywords(metadata)
        yield "META_STOP"
        if data is None:
            continue
        if kind == "OEM":
            yield from (_state(path, one) for one in data.findall("stateVector"))
            for one in data.findall("covarianceMatrix"):
                yield from _covariance(path, one)
            continue
        first = _text(metadata, "QUATERNION_TYPE").upper() == "FIRST"
        yield "DATA_START"
        yield from (_attitude(path, one, first=first) for one in data.findall("attitudeState"))
        yield "DATA_STOP"


def _keywords(parent: Element | None) -> Iterator[str]:
    """KEY = value of the elements in a header or in metadata."""
    for child in () if parent is None else parent:
        if isinstance(child.tag, str) and child.tag != "COMMENT" and not len(child):
            yield f"{child.tag} = {_plain(child)}"


def _plain(element: Element | None) -> str:
    """The text of an element in one line; "" of none."""
    return "" if element is None else " ".join((element.text or "").split())


def _text(parent: Element | None, tag: str) -> str:
    return "" if parent is None else _plain(parent.find(tag))


def _number(path: Path, element: Element, unit: str | tuple[str, ...]) -> str:
    """The text of an element whose unit, if it names one, is as it must be."""
    allowed = (unit,) if isinstance(unit, str) else unit
    given = element.get("units", allowed[0])
    if given.replace(" ", "").lower() not in allowed:
        raise FormatError(
            f"{path}: {element.tag} is in {given[:20]!r}; CCSDS messages give it in {' or '.join(allowed)}"
        )
    text = _plain(element)
    if not text or " " in text:
        raise FormatError(f"{path}: {element.tag} holds {text[:40]!r}, no number")
    return text


def _at(path: Path, parent: Element, tag: str) -> Element:
    """The one element of a tag below another."""
    found = parent.findall(tag)
    if len(found) != 1:
        raise FormatError(
            f"{path}: <{parent.tag}> of EPOCH {_text(parent, 'EPOCH')[:30] or '(none)'} holds {tag} "
            f"{len(found)} times; once is needed"
        )
    return found[0]


def _state(path: Path, state: Element) -> str:
    """A data line of an OEM."""
    present = {child.tag for child in state}
    keys = _STATE if present & {key for key, _ in _STATE[_NEEDED:]} else _STATE[:_NEEDED]
    cells = [_number(path, _at(path, state, key), unit) for key, unit in keys]
    return " ".join([_plain(_at(path, state, "EPOCH")), *cells])


def _covariance(path: Path, block: Element) -> Iterator[str]:
    """A covariance, within its marks."""
    yield "COVARIANCE_START"
    yield f"EPOCH = {_plain(_at(path, block, 'EPOCH'))}"
    if block.find("COV_REF_FRAME") is not None:
        yield f"COV_REF_FRAME = {_text(block, 'COV_REF_FRAME')}"
    for row, one in enumerate(_COVARIANCE):
        tags = [f"C{one}_{other}" for other in _COVARIANCE[: row + 1]]
        units = [
            "km**2" + ("/s**2", "/s", "")[("DOT" not in one) + ("DOT" not in other)]
            for other in _COVARIANCE[: row + 1]
        ]
        yield " ".join(
            _number(path, _at(path, block, tag), unit) for tag, unit in zip(tags, units, strict=True)
        )
    yield "COVARIANCE_STOP"


def _attitude(path: Path, state: Element, *, first: bool) -> str:
    """A data line of an AEM: its quaternion, scalar `first` or last, and all else that it holds."""
    epoch = next((one for one in state.iter("EPOCH")), None)
    if epoch is None:
        raise FormatError(f"{path}: an <attitudeState> without EPOCH")
    leaves = [
        one for one in state.iter() if not len(one) and one.tag not in ("EPOCH", "COMMENT", *_QUATERNION)
    ]
    cells = [_number(path, one, _ANGLES) for one in leaves if one is not state]
    quaternion = next((one for one in state.iter() if one.find("QC") is not None), None)
    if quaternion is not None:
        order = ("QC", "Q1", "Q2", "Q3") if first else _QUATERNION
        cells = [_number(path, _at(path, quaternion, key), "") for key in order] + cells
    return " ".join([_plain(epoch), *cells])
