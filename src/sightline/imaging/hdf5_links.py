"""What an HDF5 file (as netCDF 4 is one) links to, read without the library that would follow the links.

HDF5 opens other files where a link, a data set or a driver names them, and walks in circles where a group
leads back to one above it. So groups are walked here first, by the format's specification (HDF5 File Format
Specification, version 3.0; its section numbers stand in the docstrings), and such files are refused.

Not here: pixels (GDAL reads them), other formats (``rasters.py``).
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from sightline.errors import FormatError, foreign_errors

__all__ = ["check_hdf5", "hdf5_start"]

#: What HDF5 begins with, at the start or after a block of 512 bytes, 1024, 2048 ...
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
#: Objects and links of a file that are looked at, levels of its groups and indices, links in a row.
_MOST, _DEEPEST, _LONGEST = 100_000, 64, 16
#: Messages of an object (IV.A.2) that are looked at.
_LINK_INFO, _LINK, _FILES, _LAYOUT, _CONTINUED, _TABLE, _DRIVER = 0x2, 0x6, 0x7, 0x8, 0x10, 0x11, 0x14
#: Kinds of links, and of layouts of data.
_HARD, _SOFT, _ELSEWHERE, _VIRTUAL = 0, 1, 64, 3


def hdf5_start(path: Path) -> int | None:
    """Byte at which HDF5 begins in a file, 0 or 512, 1024 ...; None if it is no HDF5."""
    with foreign_errors(path, "cannot be read", "copy it again"), path.open("rb") as stream:
        at = 0
        while len(head := stream.read(len(_SIGNATURE))) == len(_SIGNATURE):
            if head == _SIGNATURE:
                return at
            at = max(512, 2 * at)
            stream.seek(at)
    return None


def check_hdf5(path: Path) -> None:
    """FormatError unless an HDF5 file holds all of its data and each of its groups in one place.

    Parameters
    ----------
    path : Path

    Raises
    ------
    FormatError
        If a link or data set names another file, a group is linked to twice (as in a circle), or the file is
        damaged or of a kind that is not read here.
    """
    start = hdf5_start(path)
    if start is None:
        raise FormatError(f"{path}: is no HDF5; check the name")
    advice = "it is truncated or damaged; copy it again"
    try:
        with (
            path.open("rb") as stream,
            mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content,
        ):
            _Walk(_Bytes(path, content, start)).check()
    except (OSError, ValueError, IndexError, struct.error, RecursionError) as error:
        raise FormatError(f"{path}: links of its groups cannot be read; {advice}") from error


class _Bytes:
    """Numbers of a file at addresses that count from where HDF5 begins.

    Parameters
    ----------
    path : Path
    content : mmap
    start : int
        Of HDF5 in it.
    """

    def __init__(self, path: Path, content: mmap.mmap, start: int) -> None:
        self.path, self._content, self._base = path, content, 0
        version = self._content[start + 8]
        if version > 3:
            raise self.refused(f"is HDF5 of version {version} of the superblock; 0 to 3 are read")
        # II.A: widths of addresses and lengths, then base and the root's header, in the order of the version
        old = version < 2
        self.wide, self.long = (
            self._content[start + (13 if old else 9)],
            self._content[start + (14 if old else 10)],
        )
        if {self.wide, self.long} - {2, 4, 8}:
            raise ValueError("widths of addresses that there are not")
        at = start + (24 + 4 * (version == 1) if old else 12)
        base, second, _, fourth = (self.number(at + k * self.wide, self.wide) for k in range(4))
        self.root = self.number(at + 5 * self.wide, self.wide) if old else fourth
        # of the file's driver: a block of its own, or a message of the superblock's extension
        self.driver = self.known(fourth) if old else False
        self.extension = None if old or not self.known(second) else second
        self._base = base if base != 0 else start

    def refused(self, what: str) -> FormatError:
        """The error of a file that is not read, and what to do."""
        return FormatError(f"{self.path}: {what}; make a GeoTIFF of its image (gdal_translate)")

    def take(self, at: int, count: int) -> bytes:
        """Bytes from an address on; ValueError beyond the file."""
        found = self._content[self._base + at : self._base + at + count]
        if at < 0 or len(found) != count:
            raise ValueError(f"{count} bytes at {at}")
        return found

    def number(self, at: int, count: int) -> int:
        """An unsigned number of `count` bytes."""
        return int.from_bytes(self.take(at, count), "little")

    def known(self, address: int) -> bool:
        """Whether an address is one: all ones stand for none."""
        return address != (1 << 8 * self.wide) - 1

    def text(self, at: int) -> str:
        """Characters up to a zero."""
        end = self._content.find(b"\0", self._base + at)
        if end < 0:
            raise ValueError("a name without end")
        return self.take(at, end - self._base - at).decode("utf-8", "replace")

    def expect(self, at: int, word: bytes) -> int:
        """The address after a signature; ValueError if something else stands there."""
        if self.take(at, len(word)) != word:
            raise ValueError(f"no {word!r} at {at}")
        return at + len(word)


@dataclass(frozen=True)
class _Link:
    """From a group to an object of the file (its address) or to a path in it."""

    name: str
    target: int | str


class _Walk:
    """The groups of a file and what they lead to.

    Parameters
    ----------
    data : _Bytes
    """

    def __init__(self, data: _Bytes) -> None:
        self.data, self.count = data, 0
        #: Links of every group, by the address of its header; the first name of every object.
        self.groups: dict[int, dict[str, _Link]] = {}
        self.names: dict[int, str] = {}

    def check(self) -> None:
        """Walk from the root; then see where soft links lead."""
        data = self.data
        messages = [] if data.extension is None else list(self._messages(data.extension))
        if data.driver or any(kind == _DRIVER for kind, _, _ in messages):
            raise data.refused("is HDF5 of several files (by its driver)")
        waiting = [(data.root, "/", 0)]
        while waiting:
            address, name, depth = waiting.pop()
            known = self.names.setdefault(address, name)
            if known != name:
                if address in self.groups:
                    raise self._twice(name, known)
                continue
            if depth > _DEEPEST:
                raise data.refused(f"holds groups at more than {_DEEPEST} levels")
            links = self._object(address, name)
            if links is not None:
                self.groups[address] = {link.name: link for link in links}
                below = [(link.target, f"{name}{link.name}/", depth + 1) for link in links
                         if isinstance(link.target, int)]  # fmt: skip
                waiting += below
        for address, held in self.groups.items():
            for link in held.values():
                found = self._followed(address, link)
                if found in self.groups:
                    raise self._twice(f"{self.names[address]}{link.name}/", self.names[found])

    def _twice(self, name: str, known: str) -> FormatError:
        return self.data.refused(
            f"its group {known[:-1] or '/'} is linked to a second time, as {name[:-1]}: a walk through the "
            "groups of such a file may not end"
        )

    def _followed(self, address: int, link: _Link, steps: int = 0) -> int | None:
        """The object that a soft link leads to; None for a hard one, and where it leads nowhere."""
        if isinstance(link.target, int) or steps > _LONGEST:
            return None
        here: int | None = self.data.root if link.target.startswith("/") else address
        for part in PurePosixPath(link.target).parts:
            if here is None or part in ("/", "."):
                continue
            step = self.groups.get(here, {}).get(part)
            if step is None:
                return None
            here = step.target if isinstance(step.target, int) else self._followed(here, step, steps + 1)
        return here

    def _tick(self) -> None:
        """One thing more that was looked at; FormatError beyond what a file holds."""
        self.count += 1
        if self.count > 10 * _MOST:
            raise self.data.refused(f"holds more than {_MOST:,} objects, or lists in circles")

    def _object(self, address: int, name: str) -> list[_Link] | None:
        """Links of a group; None for data sets and types. FormatError where data lie in another file."""
        links: list[_Link] = []
        group = False
        for kind, at, shared in self._messages(address):
            if kind in (_LINK_INFO, _LINK, _FILES, _LAYOUT, _TABLE) and shared:
                raise self.data.refused(
                    f"shares messages of {name[:-1] or '/'} that describe links or layout"
                )
            if kind == _FILES or (kind == _LAYOUT and self._layout(at) == _VIRTUAL):
                raise self.data.refused(f"data of {name[:-1]} lie in other files, which cannot be checked")
            found = {_LINK_INFO: self._dense, _LINK: self._one, _TABLE: self._listed}.get(kind)
            if found is not None:
                group = True
                links += found(at)
        for link in links:
            if link.target == "":
                raise self.data.refused(f"{name}{link.name} is a link to another file")
        return links if group else None

    def _layout(self, at: int) -> int:
        """Class of a data layout (IV.A.2.i)."""
        version = self.data.number(at, 1)
        return self.data.number(at + (2 if version < 3 else 1), 1)

    def _messages(self, address: int) -> Iterator[tuple[int, int, bool]]:
        """Type of every message of an object header, where its data begin, whether they are shared (IV.A)."""
        data = self.data
        new = data.take(address, 4) == b"OHDR"
        flags = data.number(address + 5, 1) if new else 0
        if new:
            at = address + 6 + 16 * (flags >> 5 & 1) + 4 * (flags >> 4 & 1)
            width = 1 << (flags & 3)
            blocks = [(at + width, data.number(at, width))]
        else:
            blocks = [(address + 16, data.number(address + 8, 4))]
        head = 4 + 2 * (flags >> 2 & 1) if new else 8
        for _ in range(_MOST // 100):
            if not blocks:
                return
            at, length = blocks.pop()
            end = at + length
            while at + head <= end:
                self._tick()
                kind, size = data.number(at, 1 if new else 2), data.number(at + (1 if new else 2), 2)
                shared = bool(data.number(at + (3 if new else 4), 1) & 2)
                body = at + head
                if kind == _CONTINUED:
                    there, much = data.number(body, data.wide), data.number(body + data.wide, data.long)
                    # a new block has a signature before its messages and a sum behind them
                    blocks.append((data.expect(there, b"OCHK"), much - 8) if new else (there, much))
                else:
                    yield kind, body, shared
                at = body + size
        raise ValueError("a list that leads in circles")

    def _one(self, at: int) -> list[_Link]:
        """A link message (IV.A.2.g)."""
        data, flags, place = self.data, self.data.number(at + 1, 1), at + 2
        kind = data.number(place, 1) if flags & 8 else _HARD
        place += (flags >> 3 & 1) + 8 * (flags >> 2 & 1) + (flags >> 4 & 1)
        width = 1 << (flags & 3)
        length = data.number(place, width)
        name = data.take(place + width, length).decode("utf-8", "replace")
        place += width + length
        if kind == _HARD:
            return [_Link(name, data.number(place, data.wide))]
        if kind == _SOFT:
            return [
                _Link(name, data.take(place + 2, data.number(place, 2)).decode("utf-8", "replace") or ".")
            ]
        return [_Link(name, "")]  # to another file, or of a kind that a library outside defines

    def _listed(self, at: int) -> list[_Link]:
        """Links of an old group: by a tree of names and a heap of them (IV.A.2.r, III.A.1, III.B, III.D)."""
        data = self.data
        tree, heap = data.number(at, data.wide), data.number(at + data.wide, data.wide)
        names = data.number(data.expect(heap, b"HEAP") + 4 + 2 * data.long, data.wide)
        links, nodes = [], [tree]
        while nodes:
            self._tick()
            node = nodes.pop()
            if data.take(node, 4) == b"TREE":
                used, first = data.number(node + 6, 2), node + 8 + 2 * data.wide + data.long
                step = data.wide + data.long
                nodes += [data.number(first + k * step, data.wide) for k in range(used)]
                continue
            entry = data.expect(node, b"SNOD") + 4
            for k in range(data.number(node + 6, 2)):
                self._tick()
                place = entry + k * (2 * data.wide + 24)
                name = data.text(names + data.number(place, data.wide))
                if data.number(place + 2 * data.wide, 4) == 2:  # the path stands in the heap
                    path = data.text(names + data.number(place + 2 * data.wide + 8, 4))
                    links.append(_Link(name, path or "."))
                else:
                    links.append(_Link(name, data.number(place + data.wide, data.wide)))
        return links

    def _dense(self, at: int) -> list[_Link]:
        """Links of a group that has many: messages in a heap, found by a tree (IV.A.2.c)."""
        data = self.data
        place = at + 2 + 8 * (data.number(at + 1, 1) & 1)
        heap, tree = data.number(place, data.wide), data.number(place + data.wide, data.wide)
        if not data.known(heap) or not data.known(tree):
            return []
        held = _Heap(data, heap)
        return [link for record in self._records(tree) for link in self._one(held.place(record[4:]))]

    def _records(self, tree: int) -> Iterator[bytes]:
        """Records of a tree of version 2 (III.A.2)."""
        data = self.data
        at = data.expect(tree, b"BTHD") + 2
        size, record, levels = data.number(at, 4), data.number(at + 4, 2), data.number(at + 6, 2)
        root, count = data.number(at + 10, data.wide), data.number(at + 10 + data.wide, 2)
        if levels > _DEEPEST or not 4 < record <= size:
            raise ValueError("a damaged tree")
        # bytes by which a node tells how many records are in, and below, a node of the level beneath
        most = (size - 10) // record
        width, below, totals = _bytes_of(most), most, [0]
        for _ in range(levels):
            pointer = data.wide + width + totals[-1]
            most = (size - 10 - pointer) // (record + pointer)
            below = (most + 1) * below + most
            totals.append(_bytes_of(below))
        nodes = [(root, count, levels)] if data.known(root) else []
        while nodes:
            node, count, level = nodes.pop()
            first = data.expect(node, b"BTIN" if level else b"BTLF") + 2
            for k in range(count):
                self._tick()
                yield data.take(first + k * record, record)
            if level:
                step = data.wide + width + totals[level - 1]
                for k in range(count + 1):
                    place = first + count * record + k * step
                    nodes.append(
                        (data.number(place, data.wide), data.number(place + data.wide, width), level - 1)
                    )


class _Heap:
    """A heap of objects in blocks that double in size (III.G).

    Parameters
    ----------
    data : _Bytes
    address : int
        Of its header.
    """

    def __init__(self, data: _Bytes, address: int) -> None:
        at = data.expect(address, b"FRHP")
        self.data, long, wide = data, data.long, data.wide
        if data.number(at + 3, 2):
            raise data.refused("packs the names of its groups with a filter, which is not read")
        largest = data.number(at + 6, 4)
        at += 10 + 10 * long + 2 * wide  # counts and sizes of what is in it
        self.width, self.least = data.number(at, 2), data.number(at + 2, long)
        most = data.number(at + 2 + long, long)
        bits = data.number(at + 2 + 2 * long, 2)
        self.root, self.rows = data.number(at + 6 + 2 * long, wide), data.number(at + 6 + 2 * long + wide, 2)
        if min(self.width, self.least, most) < 1:
            raise ValueError("a damaged heap")
        self.offset, self.length = -(-bits // 8), _bytes_of(min(most, largest))
        #: Rows whose blocks hold objects; of those after them, blocks hold blocks.
        self.direct = (most // self.least).bit_length() + 1

    def place(self, ident: bytes) -> int:
        """Address of the object of an ID."""
        if ident[0] >> 4 & 3:
            raise self.data.refused("has names of groups too long to be read")
        offset = int.from_bytes(ident[1 : 1 + self.offset], "little")
        block, rows, begin = self.root, self.rows, 0
        for _ in range(_DEEPEST):
            if rows == 0:
                return block + offset - begin
            block, rows, begin = self._below(block, rows, begin, offset)
        raise ValueError("a heap without end")

    def _below(self, block: int, rows: int, begin: int, offset: int) -> tuple[int, int, int]:
        """The inner block that an offset lies in, its rows (0: it holds objects), its own offset."""
        first = self.data.expect(block, b"FHIB") + 1 + self.data.wide + self.offset
        start = begin
        for row in range(rows):
            size = self.least << max(row - 1, 0)
            if offset < start + self.width * size:
                column = (offset - start) // size
                found = self.data.number(first + (row * self.width + column) * self.data.wide, self.data.wide)
                deeper = row >= self.direct
                inner = (size // (self.least * self.width)).bit_length() if deeper else 0
                return found, inner, start + column * size
            start += self.width * size
        raise ValueError("an object outside its heap")


def _bytes_of(limit: int) -> int:
    """Bytes that hold numbers up to a limit."""
    return max(limit.bit_length() - 1, 0) // 8 + 1
