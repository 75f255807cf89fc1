"""What may be wrong with a file, as hypothesis strategies: bytes, structure, what stands under its name.

A case is a dictionary of the files of a folder. An edit changes one of them and tells its kind, which is
counted. ``SERVER`` stands for the address of a server that must never be asked.
"""

from __future__ import annotations

import datetime
import io
import json
import math
import re
import struct
import tomllib
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from hypothesis import strategies as st
from tests.fuzz.seeds import again

SERVER = "SIGHTLINE-FUZZ-SERVER"


@dataclass(frozen=True)
class Special:
    """No plain file: `kind` is "folder", "fifo", "link" (to `target`) or "hole" (`target` bytes of zeros)."""

    kind: str
    target: str = ""


File = bytes | Special


@dataclass
class Case:
    """Files of a case, the kinds of its edits, and options that are added to a command."""

    files: dict[str, File]
    edits: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """Short: hypothesis prints what fails."""
        printer.text(f"<{len(self.files)} files after {', '.join(self.edits)}; {' '.join(self.words)[:200]}>")


class Raw(str):
    """Text that goes into a TOML or JSON file as it stands."""


# Values that TOML and JSON share ----------------------------------------------------------------------------

NUMBERS = [
    *"0 -1 1 2 3 0.0 -0.0 0.5 nan -nan inf -inf 1e300 -1e300 1e-300 1e-17 1e-9 1e9 1e15 1e30 89.9".split(),
    *"91.0 -122.0 181.0 361.0 65536 340000 1000000000 2147483648 9223372036854775807".split(),
    "9223372036854775808", "1" + "0" * 30, "9" * 5000, "-" + "9" * 5000,
]  # fmt: skip
OTHERS = [
    "true", "false", '""', '" "', '"x"', "[]", "[[]]", "{}", "[0]", "[nan]", "[1, 2]", "[3, 2, 1]", '"exif"',
    "[0.0, 0.0, 0.0]", "[1, 2, 3, 4, 5, 6, 7, 8]", '["a", "b"]', "[[1, 2], [3]]", '"1"', '"nan"', '"none"',
    "[true]", "[1e300, 1e300]", '"estimate"', '"2026-01-01T00:00:00Z"',
    '"0001-01-01T00:00:00Z"', '"\\u0000"', '"a\\nb"',
    '"9999-12-31T23:59:60Z"', '"2026-02-30T00:00:00Z"', '"2026-01-01T00:00:00+25:00"', '"{{7*7}}<script>"',
    '"\\u202e\\u00e9"',
]  # fmt: skip
TOML_ONLY = ["1979-05-27T07:32:00Z", "07:32:00", "0xffffffffffffffffff", "1_000", "'''x'''"]
JSON_ONLY = ["null", "NaN", "Infinity", "-Infinity", "1e400", '"\\ud800"', '{"a": null}']
DEPTHS = (50, 100_000)
PATHS = [
    *"missing.csv . .. / /dev/zero /dev/null fifo loop dangling folder hole ~/x.tif - con".split(),
    *"$HOME/x.tif ../outside.csv /etc/passwd /proc/self/mem /vsimem/x.tif /vsistdin/".split(),
    f"http://{SERVER}/x.tif", f"/vsicurl/http://{SERVER}/x.tif", f"https://{SERVER}/x.csv",
    f"file://{SERVER}/x", f"WMS:http://{SERVER}/", f"/vsizip//vsicurl/http://{SERVER}/x.zip/x.tif",
    "", " ", "GTIFF_DIR:1:x.tif", "x.tif\n", "a\x00b", "x" * 300, "x/" * 3000, "\u00fc\u4e2d.tif",
]  # fmt: skip
#: What the names among `PATHS` that are no plain files stand for.
COMPANIONS: dict[str, File] = {
    "fifo": Special("fifo"),
    "loop": Special("link", "loop"),
    "dangling": Special("link", "nothing"),
    "folder": Special("folder"),
    "hole": Special("hole", str(3 << 30)),
}
WORDS = [
    *"nan inf -inf x 1e400 -1 0 1e300 -1e300 1e-300 1e18 0x10 1_000 1,5 \u0661\u0662 1D5 true None".split(),
    "", " ", "-0", "\x00", '"', "'", "#", "=1+1", "1 2", "9" * 5000, "2026-01-01T00:00:00Z", "2026-01-01",
    "9999-99-99T99:99:99Z", "\u00e9", "../x", "{{7*7}}", "<b>", "x" * 200_000,
]  # fmt: skip


def _nested(opening: str, closing: str, depth: int) -> str:
    return opening * depth + closing * depth


@cache
def words_of_schemas() -> tuple[str, ...]:
    """Every word that some key of a TOML file allows."""
    from sightline.io.config import SCHEMAS, json_schema

    found: set[str] = set()

    def walk(value: Any) -> None:
        if isinstance(value, dict):
            found.update(word for word in value.get("enum", ()) if isinstance(word, str))
            if isinstance(value.get("const"), str):
                found.add(value["const"])
            for inner in value.values():
                walk(inner)
        elif isinstance(value, list):
            for inner in value:
                walk(inner)

    for name in SCHEMAS:
        walk(json_schema(name))
    return tuple(sorted(found))


@cache
def keys_of_schemas() -> tuple[str, ...]:
    """Every key that some table of a TOML file allows."""
    from sightline.io.config import SCHEMAS, json_schema

    found: set[str] = set()

    def walk(value: Any) -> None:
        if isinstance(value, dict):
            found.update(value.get("properties", ()))
            for inner in value.values():
                walk(inner)
        elif isinstance(value, list):
            for inner in value:
                walk(inner)

    for name in SCHEMAS:
        walk(json_schema(name))
    return tuple(sorted(found))


def _places(tree: Any, where: tuple = ()) -> list[tuple]:
    """Every place of a tree of tables and lists (of a long list the first, middle and last)."""
    found = [where] if where else []
    if isinstance(tree, dict):
        inner = list(tree)
    elif isinstance(tree, list):
        inner = sorted({0, len(tree) // 2, len(tree) - 1} & set(range(len(tree))))
    else:
        inner = []
    for key in inner:
        found += _places(tree[key], (*where, key))
    return found


def _holder(tree: Any, where: tuple) -> Any:
    for key in where[:-1]:
        tree = tree[key]
    return tree


def _copy(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {key: _copy(value) for key, value in tree.items()}
    return [_copy(value) for value in tree] if isinstance(tree, list) else tree


def _value(draw, old: Any, own: tuple[str, ...], files: dict[str, File]) -> tuple[str, Any]:
    """Another value in the place of `old`, with the kind of the change."""
    if isinstance(old, str) and draw(st.integers(0, 2)):
        choice = draw(st.sampled_from(["path", "word", "name"]))
        if choice == "path":
            path = draw(st.sampled_from(PATHS))
            files.update({path: COMPANIONS[path]} if path in COMPANIONS else {})
            return "path", path
        if choice == "word":
            return "word", draw(st.sampled_from(words_of_schemas()))
        return "other file", draw(st.sampled_from(sorted(files)))
    if isinstance(old, int | float) and not isinstance(old, bool) and draw(st.integers(0, 3)):
        if draw(st.booleans()):
            return "number", Raw(draw(st.sampled_from(NUMBERS)))
        factor = draw(st.sampled_from([-1.0, 1e-12, 1e-6, 1e-3, 0.1, 0.9, 1.1, 10.0, 1e3, 1e6, 1e12]))
        new = old * factor
        return "factor", int(new) if isinstance(old, int) and math.isfinite(new) and draw(
            st.booleans()
        ) else new
    if isinstance(old, list) and old and draw(st.integers(0, 2)):
        new = _copy(old)
        match draw(st.sampled_from(["shorter", "longer", "reversed", "twice", "alike", "long"])):
            case "shorter":
                del new[draw(st.integers(0, len(new) - 1))]
            case "longer":
                new.append(_copy(new[-1]))
            case "reversed":
                new.reverse()
            case "twice":
                new += _copy(new)
            case "alike":
                new = [_copy(new[0]) for _ in new]
            case "long":
                new = [
                    _copy(value)
                    for value in new
                    for _ in range(20_000 // len(new) if not _tables(new) else 20)
                ]
        return "list", new
    kind = draw(st.sampled_from(["type", "deep"] if draw(st.integers(0, 9)) == 0 else ["type"]))
    if kind == "deep":
        opening, closing = draw(
            st.sampled_from([("[", "]")] + ([("{a=", "}")] if "null" not in own else [('{"a":', "}")]))
        )
        if opening != "[":
            return kind, Raw(opening * 2000 + "1" + closing * 2000)
        return kind, Raw(_nested("[", "]", draw(st.sampled_from(DEPTHS))))
    return kind, Raw(draw(st.sampled_from([*NUMBERS, *OTHERS, *own])))


def _tables(value: list) -> bool:
    return any(isinstance(item, dict) for item in value)


def _tree_edit(draw, tree: Any, own: tuple[str, ...], files: dict[str, File]) -> str:
    """Change one place of a tree; gives the kind."""
    places = _places(tree)
    if not places:
        return "nothing"
    where = draw(st.sampled_from(places))
    holder, key = _holder(tree, where), where[-1]
    match draw(
        st.sampled_from(["value", "value", "value", "value", "removed", "added", "moved", "repeated"])
    ):
        case "removed":
            del holder[key]
            return "removed"
        case "added" if isinstance(holder, dict):
            name = draw(st.sampled_from(["unknown", "", "a.b", "\u00e9", "kind", *keys_of_schemas()]))
            holder[name] = _value(draw, draw(st.sampled_from([1.0, "x"])), own, files)[1]
            return "added key"
        case "moved":
            other = draw(st.sampled_from(places))
            value = _copy(_holder(tree, other)[other[-1]])
            holder[key] = value
            return "moved value"
        case "repeated" if isinstance(holder, list):
            holder.insert(key, _copy(holder[key]))
            return "repeated"
        case _:
            kind, holder[key] = _value(draw, holder[key], own, files)
            return kind


# TOML and JSON ----------------------------------------------------------------------------------------------


def toml_text(tree: dict[str, Any]) -> str:
    """A TOML file of a tree."""

    def key_text(key: str) -> str:
        return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)

    def inline(value: Any) -> str:
        match value:
            case Raw():
                return str(value)
            case bool():
                return "true" if value else "false"
            case str():
                return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
            case int() | float():
                return repr(value)
            case datetime.datetime() | datetime.date() | datetime.time():
                return value.isoformat()
            case list():
                return f"[{', '.join(map(inline, value))}]"
            case dict():
                return "{" + ", ".join(f"{key_text(k)} = {inline(v)}" for k, v in value.items()) + "}"
        raise TypeError(type(value))

    def is_table(value: Any) -> bool:
        return isinstance(value, dict) or (
            isinstance(value, list) and value != [] and all(isinstance(v, dict) for v in value)
        )

    lines = [f"{key_text(key)} = {inline(value)}" for key, value in tree.items() if not is_table(value)]
    for key, value in tree.items():
        if is_table(value):
            for item in value if isinstance(value, list) else [value]:
                lines.append(f"[[{key_text(key)}]]" if isinstance(value, list) else f"[{key_text(key)}]")
                lines += [f"{key_text(k)} = {inline(v)}" for k, v in item.items()]
    return "\n".join(lines) + "\n"


def json_text(tree: Any) -> str:
    """A JSON file of a tree."""
    held: list[str] = []

    def mark(value: Any) -> Any:
        if isinstance(value, Raw):
            held.append(str(value))
            return f"\x01{len(held) - 1}\x01"
        if isinstance(value, dict):
            return {key: mark(inner) for key, inner in value.items()}
        return [mark(inner) for inner in value] if isinstance(value, list) else value

    text = json.dumps(mark(tree))
    return re.sub(r'"\\u0001(\d+)\\u0001"', lambda found: held[int(found[1])], text)


def _toml_edit(draw, content: bytes, files: dict[str, File]) -> tuple[str, bytes]:
    if draw(st.integers(0, 11)) == 0:
        return _text_edit(draw, content)
    try:
        tree = tomllib.loads(content.decode())
    except (ValueError, RecursionError):
        return _text_edit(draw, content)
    kind = _tree_edit(draw, tree, tuple(TOML_ONLY), files)
    return f"toml {kind}", toml_text(tree).encode("utf-8", "surrogatepass")


def _json_edit(draw, content: bytes, files: dict[str, File]) -> tuple[str, bytes]:
    if draw(st.integers(0, 11)) == 0:
        return _text_edit(draw, content)
    try:
        tree = json.loads(content[max(content.find(b"{"), 0) :] if content[:1] != b"[" else content)
    except (ValueError, RecursionError):
        return _text_edit(draw, content)
    kind = _tree_edit(draw, tree, tuple(JSON_ONLY), files)
    return f"json {kind}", json_text(tree).encode("utf-8", "surrogatepass")


# Tables and text --------------------------------------------------------------------------------------------


def _table_edit(draw, content: bytes) -> tuple[str, bytes]:
    """Cells, columns and rows of a CSV file (or of words between blanks)."""
    text = content.decode("utf-8", "replace")
    between = "," if "," in text.splitlines()[0:1].__str__() else " "
    rows = [line.split(between) for line in text.splitlines()]
    if not rows:
        return _text_edit(draw, content)
    row = draw(st.integers(0, len(rows) - 1))
    column = draw(st.integers(0, max(map(len, rows)) - 1))
    kinds = [
        "cell", "cell", "cell", "cell", "column words", "column constant", "column factor", "no column",
        "column twice",
        "swapped columns", "no row", "row twice", "swapped rows", "reversed", "header only", "many rows",
        "longer row",
        "shorter row", "no header", "other header", "separator",
    ]  # fmt: skip
    kind = draw(st.sampled_from(kinds))
    at = min(column, len(rows[row]) - 1)
    match kind:
        case "cell":
            rows[row][at] = draw(st.sampled_from(WORDS))
        case "column words" | "column constant":
            word = (
                rows[min(row, len(rows) - 1)][at]
                if kind == "column constant"
                else draw(st.sampled_from(WORDS[:22]))
            )
            for cells in rows[1:]:
                if column < len(cells):
                    cells[column] = word
        case "column factor":
            factor = draw(st.sampled_from([-1.0, 0.0, 1e-300, 1e-12, 1e-3, 1e3, 1e12, 1e300]))
            for cells in rows[1:]:
                if column < len(cells):
                    try:
                        cells[column] = repr(float(cells[column]) * factor)
                    except ValueError:
                        pass
        case "no column":
            rows = [cells[:column] + cells[column + 1 :] for cells in rows]
        case "column twice":
            rows = [cells[: column + 1] + cells[column:] for cells in rows]
        case "swapped columns":
            other = draw(st.integers(0, max(map(len, rows)) - 1))
            for cells in rows:
                if max(column, other) < len(cells):
                    cells[column], cells[other] = cells[other], cells[column]
        case "no row":
            del rows[row]
        case "row twice":
            rows.insert(row, list(rows[row]))
        case "swapped rows":
            other = draw(st.integers(0, len(rows) - 1))
            rows[row], rows[other] = rows[other], rows[row]
        case "reversed":
            rows[1:] = rows[:0:-1]
        case "header only":
            rows = rows[:1]
        case "many rows":
            rows += [list(rows[-1]) for _ in range(3000)]
        case "longer row":
            rows[row] += ["1"] * draw(st.sampled_from([1, 20_000]))
        case "shorter row":
            rows[row] = rows[row][:-1]
        case "no header":
            rows = rows[1:]
        case "other header":
            rows[0][min(column, len(rows[0]) - 1)] = draw(
                st.sampled_from(["", "x", "t", "frame", " t ", "\u00e9", rows[0][0]])
            )
        case "separator":
            between = draw(st.sampled_from([";", "\t", ", ", "  ", "|"]))
    return f"table {kind}", ("\n".join(between.join(cells) for cells in rows) + "\n").encode(
        "utf-8", "surrogatepass"
    )


def _text_edit(draw, content: bytes) -> tuple[str, bytes]:
    """How a text is written down."""
    kinds = "bom crlf cr utf-16 latin nul quote comment long-line one-line blank twice no-end".split()
    kind = draw(st.sampled_from(kinds))
    at = draw(st.integers(0, len(content)))
    match kind:
        case "bom":
            new = b"\xef\xbb\xbf" + content
        case "crlf":
            new = content.replace(b"\n", b"\r\n")
        case "cr":
            new = content.replace(b"\n", b"\r")
        case "utf-16":
            new = content.decode("utf-8", "replace").encode("utf-16")
        case "latin":
            new = content[:at] + b"\xe9\xff" + content[at:]
        case "nul":
            new = content[:at] + b"\0" + content[at:]
        case "quote":
            new = content[:at] + b'"' + content[at:]
        case "no-end":
            new = content.rstrip(b"\n")
        case "comment":
            new = content.replace(b"\n", b"\n# ", 1)
        case "long-line":
            new = content[:at] + b"1" * 300_000 + content[at:]
        case "one-line":
            new = content.replace(b"\n", b" ")
        case "blank":
            new = b"\n \n\t\n"
        case _:
            new = content + content
    return f"text {kind}", new


# Bytes ------------------------------------------------------------------------------------------------------

_EXTREMES = [
    b"\0" * 4, b"\xff" * 4, b"\xff\xff\xff\x7f", b"\x7f\xff\xff\xff", b"\0\0\0\x80", b"\x01\0\0\0", b"\0" * 8,
    b"\xff" * 8,
    b"\xff" * 7 + b"\x7f", struct.pack("<d", math.nan), struct.pack("<d", math.inf), struct.pack("<d", 1e300),
    struct.pack("<d", -1.0), struct.pack("<Q", 1 << 40), struct.pack(">Q", 1 << 40), b"\0\0", b"\xff\xff",
]  # fmt: skip
_RUN = re.compile(rb"[ -~]{3,}")


def _byte_edit(draw, content: bytes) -> tuple[str, bytes]:
    kinds = "flip cut cut zeros inserted removed repeated number number words words random".split()
    kind = draw(st.sampled_from(kinds))
    size = len(content)
    # beginnings hold what is read first
    at = draw(st.one_of(st.integers(0, min(size, 64)), st.integers(0, size)))
    count = draw(st.sampled_from([1, 2, 4, 16, 256, 4096]))
    match kind:
        case "flip":
            new = bytearray(content)
            for place in draw(st.lists(st.integers(0, max(size - 1, 0)), min_size=1, max_size=8)):
                if size:
                    new[place] ^= 1 << draw(st.integers(0, 7))
            new = bytes(new)
        case "cut":
            new = content[:at]
        case "zeros":
            new = content[:at] + b"\0" * min(count, size - at) + content[at + count :]
        case "inserted":
            new = content[:at] + draw(st.binary(min_size=1, max_size=16)) + content[at:]
        case "removed":
            new = content[:at] + content[at + count :]
        case "repeated":
            new = content[:at] + content[at : at + count] * 2 + content[at + count :]
        case "number":
            value = draw(st.sampled_from(_EXTREMES))
            new = content[:at] + value + content[at + len(value) :]
        case "words":  # of the same length: offsets behind stay right
            runs = [found.span() for found in _RUN.finditer(content)]
            if not runs:
                return "bytes words", content
            start, end = draw(st.sampled_from(runs))
            word = draw(
                st.sampled_from([*WORDS[:-1], "\xff\xfe", "</", "<!DOCTYPE", "&x;", "9" * 40])
            ).encode("latin-1", "replace")
            offset = draw(st.integers(start, end - 1))
            word = word[: end - offset]
            new = content[:offset] + word + content[offset + len(word) :]
        case _:
            new = draw(st.binary(max_size=200))
    return f"bytes {kind}", new


# Rasters ----------------------------------------------------------------------------------------------------

VRT = (
    '<VRTDataset rasterXSize="{columns}" rasterYSize="{lines}"><VRTRasterBand dataType="UInt16" band="1">'
    '<SimpleSource><SourceFilename relativeToVRT="{relative}">{source}</SourceFilename>'
    "<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
)
WMS = (
    '<GDAL_WMS><Service name="TMS"><ServerUrl>http://'
    + SERVER
    + "/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service><DataWindow>"
    "<UpperLeftX>0</UpperLeftX><UpperLeftY>0</UpperLeftY><LowerRightX>64</LowerRightX>"
    "<LowerRightY>700</LowerRightY><TileLevel>0</TileLevel><SizeX>{columns}</SizeX><SizeY>{lines}</SizeY>"
    "</DataWindow><BlockSizeX>64</BlockSizeX><BlockSizeY>64</BlockSizeY><BandsCount>1</BandsCount></GDAL_WMS>"
)
#: Of a map: none, cells far too small or large, turned, not a number, degenerate, upside down, elsewhere.
TRANSFORMS = [
    (1, 0, 0, 0, 1, 0), (1e-12, 0, 0, 0, -1e-12, 0), (1e300, 0, 0, 0, 1e300, 0), (20, 5, 0, 5, -20, 0),
    (1, 0, math.nan, 0, -1, 0), (1, 0, math.inf, 0, -1, 0), (1, 1, 0, 1, 1, 0), (-20, 0, 0, 0, 20, 0),
    (20, 0, 1e7, 0, -20, 1e7),
]  # fmt: skip
RASTER_KINDS = [
    "type", "shape", "nodata", "nan", "constant", "half nan", "infinite", "bands", "transform", "crs",
    "unit", "scaled",
    "tiled", "other format", "vrt", "wms", "huge", "mask",
]  # fmt: skip


def _raster_edit(draw, name: str, content: bytes) -> tuple[str, File]:
    """The same raster written otherwise; what is no raster any more is edited byte by byte."""
    import rasterio
    from rasterio.crs import CRS
    from rasterio.io import MemoryFile
    from rasterio.transform import Affine

    kind = draw(st.sampled_from(RASTER_KINDS))
    if not content.startswith((b"II*", b"MM", b"\x89PNG", b"\xff\xd8")):  # an earlier edit has made it a VRT
        return _byte_edit(draw, content)
    try:
        with warnings.catch_warnings(action="ignore"), MemoryFile(content) as memory, memory.open() as source:
            if source.width * source.height > 1_000_000:
                return _byte_edit(draw, content)
            pixels, profile, tags = source.read(), source.profile, source.tags()
    except Exception:
        return _byte_edit(draw, content)
    given = {
        "driver": "GTiff",
        "crs": profile.get("crs"),
        "transform": profile["transform"],
        "nodata": profile.get("nodata"),
    }
    units, scale, lines, columns = None, None, *pixels.shape[1:]
    match kind:
        case "type":
            new = draw(
                st.sampled_from(
                    ["uint8", "int8", "int16", "uint32", "int32", "float32", "float64", "complex64", "int64"]
                )
            )
            with np.errstate(all="ignore"):
                pixels, given["nodata"] = pixels.astype(new), None
        case "shape":
            shape = draw(
                st.sampled_from(
                    [
                        (1, 1),
                        (1, columns),
                        (lines, 1),
                        (lines - 1, columns),
                        (lines, columns + 1),
                        (2, 2),
                        (3, 3),
                    ]
                )
            )
            grown = np.pad(pixels, ((0, 0), (0, 1), (0, 1)), mode="edge")
            pixels = grown[:, : shape[0], : shape[1]]
        case "nodata":
            value = draw(st.sampled_from([float(pixels.flat[0]), 0.0, 65535.0, -9999.0, math.nan, 1e300]))
            pixels, given["nodata"] = pixels.astype("float64"), value
        case "nan" | "half nan" | "infinite":
            pixels = pixels.astype("float32")
            pixels[:, : lines if kind == "nan" else lines // 2] = math.inf if kind == "infinite" else math.nan
        case "constant":
            pixels = np.full_like(pixels, draw(st.sampled_from([0, 7, 255])))
        case "bands":
            pixels = np.concatenate([pixels] * draw(st.sampled_from([2, 3, 40])))
        case "transform":
            given["transform"] = Affine(*draw(st.sampled_from(TRANSFORMS)))
        case "crs":
            code = draw(
                st.sampled_from(
                    [
                        "EPSG:4326",
                        "EPSG:3857",
                        "EPSG:32633",
                        "EPSG:4326+5773",
                        "EPSG:5773",
                        "EPSG:2056",
                        "none",
                    ]
                )
            )
            given["crs"] = None if code == "none" else CRS.from_string(code)
        case "unit":
            units = draw(st.sampled_from(["feet", "km", "m", "\u00e9"]))
        case "scaled":
            scale = draw(st.sampled_from([0.0, -1.0, 1e300, math.nan]))
        case "tiled":
            given |= {"tiled": True, "blockxsize": 16, "blockysize": 16, "compress": "deflate"}
        case "other format":
            given["driver"] = draw(st.sampled_from(["PNG", "JPEG", "BMP", "ENVI", "AAIGrid"]))
            with np.errstate(all="ignore"):
                pixels = pixels[:1].astype("uint8")
        case "vrt":
            source_path = draw(st.sampled_from([*PATHS, name, "self"]))
            text = VRT.format(
                lines=lines, columns=columns, relative=draw(st.sampled_from([0, 1])), source=source_path
            )
            return "raster vrt", text.encode("utf-8", "surrogatepass")
        case "wms":
            return "raster wms", WMS.format(lines=lines, columns=columns).encode()
        case "huge":
            text = VRT.format(
                lines=draw(st.sampled_from([10**6, 2**31 - 1])), columns=10**6, relative=1, source="x.tif"
            )
            if draw(st.booleans()):
                return "raster huge", text.encode()
            given |= {"tiled": True, "compress": "deflate", "sparse_ok": True, "bigtiff": "yes"}
            pixels = None
        case "mask":
            pass
    with warnings.catch_warnings(action="ignore"), MemoryFile() as memory:
        try:
            if pixels is None:
                shape = {"height": 60_000, "width": 60_000, "count": 1, "dtype": "uint16"}
                memory.open(**{k: v for k, v in given.items() if v is not None}, **shape).close()
            else:
                shape = {
                    "height": pixels.shape[1],
                    "width": pixels.shape[2],
                    "count": len(pixels),
                    "dtype": pixels.dtype,
                }
                with memory.open(**{k: v for k, v in given.items() if v is not None}, **shape) as target:
                    target.write(pixels)
                    target.update_tags(**tags)
                    if kind == "mask":
                        target.write_mask(False)
                    if units is not None:
                        target.units = [units] * len(pixels)
                    if scale is not None:
                        target.scales = [scale] * len(pixels)
            return f"raster {kind}", memory.read()
        except (rasterio.errors.RasterioError, ValueError, TypeError):
            return _byte_edit(draw, content)


# numpy's files ----------------------------------------------------------------------------------------------

ARRAY_KINDS = [
    "type", "shape", "nan", "infinite", "constant", "objects", "big-endian", "column order", "claimed shape",
    "claimed type",
    "version", "factor",
]  # fmt: skip


def _array_edit(draw, content: bytes) -> tuple[str, bytes]:
    """An .npy file of another array."""
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except Exception:
        return _byte_edit(draw, content)
    kind = draw(st.sampled_from(ARRAY_KINDS))
    match kind:
        case "type":
            new = draw(
                st.sampled_from(["i1", "u4", "f2", "f8", "c16", "?", "U4", "S3", "M8[s]", "V4", "f16", "i8"])
            )
            try:
                with np.errstate(all="ignore"):
                    array = array.astype(new)
            except (TypeError, ValueError):
                array = np.zeros(array.shape, new)
        case "shape":
            flat, array = array.reshape(-1), np.atleast_1d(array)
            array = draw(
                st.sampled_from(
                    [flat, flat[:0], np.array(flat[0]) if flat.size else flat, array[:0], array[..., :0],
                     array[None], array[:1],
                     np.repeat(array, 2, axis=0), array.T]
                )
            )  # fmt: skip
        case "nan" | "infinite":
            array = np.full(array.shape, math.nan if kind == "nan" else -math.inf)
        case "constant":
            array = np.zeros_like(array)
        case "factor":
            if array.dtype.kind in "iuf":
                array = array.astype("f8") * draw(st.sampled_from([-1.0, 1e-300, 1e300, 1e6]))
        case "objects":
            stream = io.BytesIO()
            np.save(stream, np.array([{"a": 1}, None], dtype=object), allow_pickle=True)
            return "array objects", stream.getvalue()
        case "big-endian":
            array = array.astype(array.dtype.newbyteorder(">"))
        case "column order":
            array = np.asfortranarray(array)
        case "claimed shape":
            claimed = draw(
                st.sampled_from(
                    ["(1000000000, 1000000000)", "(-1, 5)", "(4294967296,)", "(2.5,)", "('a',)", "5"]
                )
            )
            return "array claimed shape", _with_header(content, rb"'shape': \([^)]*\)", f"'shape': {claimed}")
        case "claimed type":
            claimed = draw(
                st.sampled_from(["'|O'", "'<f1000'", "[('a', '<f8')]", "'<U99999999'", "None", "(" * 300])
            )
            return "array claimed type", _with_header(content, rb"'descr': '[^']*'", f"'descr': {claimed}")
        case "version":
            return "array version", content[:6] + bytes(
                [draw(st.integers(0, 9)), draw(st.integers(0, 9))]
            ) + content[8:]
    stream = io.BytesIO()
    np.save(stream, array)
    return f"array {kind}", stream.getvalue()


def _with_header(content: bytes, old: bytes, new: str) -> bytes:
    """An .npy file whose header says something else."""
    length = struct.unpack("<H", content[8:10])[0]
    header = re.sub(old, lambda _: new.encode(), content[10 : 10 + length].rstrip())
    header = header.ljust(-(-(len(header) + 11) // 64) * 64 - 11) + b"\n"
    return content[:8] + struct.pack("<H", len(header)) + header + content[10 + length :]


def _archive_edit(draw, content: bytes) -> tuple[str, bytes]:
    """An .npz file with a member changed, left out, or named otherwise."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:
        return _byte_edit(draw, content)
    kind = draw(
        st.sampled_from(
            [
                "member",
                "member",
                "member",
                "member",
                "removed",
                "renamed",
                "swapped",
                "empty",
                "bomb",
                "bytes",
                "no zip",
            ]
        )
    )
    if kind == "bytes" or not members:
        return _byte_edit(draw, content)
    name = draw(st.sampled_from(sorted(members)))
    match kind:
        case "member":
            inner, members[name] = _array_edit(draw, members[name])
            kind = f"member {inner.split(' ', 1)[1]}"
        case "removed":
            del members[name]
        case "renamed":
            members[draw(st.sampled_from(["x.npy", "../x.npy", name.removesuffix(".npy"), name.upper()]))] = (
                members.pop(name)
            )
        case "swapped":
            other = draw(st.sampled_from(sorted(members)))
            members[name], members[other] = members[other], members[name]
        case "empty":
            members = {}
        case "bomb":
            members[name] = members[name] + b"\0" * (200 << 20)
        case "no zip":
            return "archive no zip", draw(
                st.sampled_from([b"", b"PK\x05\x06" + b"\0" * 18, b"\x93NUMPY", members[name]])
            )
    stream = io.BytesIO()
    packed = zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
    with warnings.catch_warnings(action="ignore"), packed as archive:
        for member, data in members.items():
            archive.writestr(member, data)
    return f"archive {kind}", stream.getvalue()


# What stands under the name ---------------------------------------------------------------------------------


def _name_edit(draw, name: str, files: dict[str, File]) -> str:
    """Something else than a readable file of its kind."""
    kinds = [
        "missing",
        "empty",
        "folder",
        "fifo",
        "link to /dev/zero",
        "link to itself",
        "link elsewhere",
        "hole",
        "other file",
    ]
    kind = draw(st.sampled_from(kinds))
    others = sorted(other for other, content in files.items() if other != name and isinstance(content, bytes))
    match kind:
        case "missing":
            del files[name]
        case "empty":
            files[name] = b""
        case "folder" | "fifo":
            files[name] = Special(kind)
        case "link to /dev/zero":
            files[name] = Special("link", "/dev/zero")
        case "link to itself":
            files[name] = Special("link", name.rsplit("/", 1)[-1])
        case "link elsewhere":
            files[name] = Special("link", "missing")
        case "hole":
            files[name] = Special("hole", str(3 << 30))
        case "other file" if others:
            files[name] = files[draw(st.sampled_from(others))]
    return f"file {kind}"


# All together -----------------------------------------------------------------------------------------------

Editor = Callable[..., tuple[str, File]]
_TABLES = (".csv", ".txt", ".oem", ".aem", ".hdr")
_RASTERS = (".tif", ".png", ".jpg", ".tiff")
_SUMMED = (".bin", ".hex", ".c")


def _edit(draw, name: str, files: dict[str, File]) -> str:
    """Change one file of a case; gives the kind of the change."""
    content = files[name]
    if isinstance(content, Special) or draw(st.integers(0, 11)) == 0:
        return _name_edit(draw, name, files)
    if draw(st.integers(0, 5)) == 0:
        kind, files[name] = _byte_edit(draw, content)
        return kind
    end = "." + name.rsplit(".", 1)[-1].lower()
    if end == ".toml":
        kind, files[name] = _toml_edit(draw, content, files)
    elif end == ".json":
        kind, files[name] = _json_edit(draw, content, files)
    elif end == ".npy":
        kind, files[name] = _array_edit(draw, content)
    elif end == ".npz":
        kind, files[name] = _archive_edit(draw, content)
    elif end in _RASTERS:
        kind, files[name] = (
            _byte_edit(draw, content) if draw(st.booleans()) else _raster_edit(draw, name, content)
        )
    elif end in _TABLES:
        kind, files[name] = (
            _table_edit(draw, content) if draw(st.integers(0, 4)) else _text_edit(draw, content)
        )
    elif (
        end in _SUMMED and "/table" in f"/{name}" and name.rsplit("/", 1)[0] + "/table.bin" in files
    ) or name == "tags.bin":
        image = files[name if name == "tags.bin" else name.rsplit("/", 1)[0] + "/table.bin"]
        kind, changed = _byte_edit(draw, image)  # type: ignore[arg-type]
        kind, files[name] = f"{kind}, summed anew", again(name, changed)
    else:
        kind, files[name] = _byte_edit(draw, content)
    return kind


#: Values of options: none that is a lot of work and may well be asked for.
VALUES = [
    *"-1 0 1 2 3 0.5 nan inf -inf 1e300 -1e300 1e-300 x 1,2 nan,nan 1e300,1e300 -5,-5 40-20 3,4 0-1".split(),
    "../x", "1" + "0" * 18, "-1" + "0" * 18, f"{10**18},{10**18}", "9" * 5000, "", " ", "\u00e9", "a\nb",
    "{{7*7}}", "@missing", "@folder", "@fifo", "/dev/zero", "x" * 300,
]  # fmt: skip


def _option(draw, options: tuple[tuple[str, int, bool], ...], case: Case) -> str:
    """Add an option with a value; gives the kind."""
    name, count, flag = draw(st.sampled_from(options))
    values = [] if flag else [draw(st.sampled_from([*VALUES, *words_of_schemas()])) for _ in range(count)]
    for value in values:
        if value.removeprefix("@") in COMPANIONS:
            case.files[value[1:]] = COMPANIONS[value[1:]]
    # a value that begins with a dash is one of the option, not another
    case.words += [f"{name}={values[0]}"] if count == 1 and not flag else [name, *values]
    return f"option {name}"


@st.composite
def cases(
    draw, files: dict[str, bytes], targets: tuple[str, ...], options: tuple[tuple[str, int, bool], ...] = ()
) -> Case:
    """A case of up to three edits, mostly of one: of files among `targets`, or further options."""
    case = Case(dict(files))
    if options:
        for _ in range(draw(st.sampled_from([1, 1, 2, 3]))):
            case.edits.append(_option(draw, options, case))
        return case
    for _ in range(draw(st.sampled_from([1, 1, 1, 2, 3]))):
        there = [name for name in targets if name in case.files]
        if there:
            case.edits.append(_edit(draw, draw(st.sampled_from(there)), case.files))
    return case
