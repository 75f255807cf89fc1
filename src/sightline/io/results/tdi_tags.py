"""Tags of TDI lines ↔ one binary file, run-length coded; its bytes are described in ``docs/formats.md``.

Not here: what tags mean (``tdi/tagging.py``).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sightline.access import LARGE, read_bytes
from sightline.errors import FormatError, InputError, said_by
from sightline.imaging.tdi_transfer import ALIGNMENTS, Exposure
from sightline.tdi.tagging import FIELDS, TdiTags, decode_field, encode_field
from sightline.writing import scratch_folder, whole

MAGIC = b"SLTDITAG"
VERSION = 1
#: Magic, version, align, lines, groups, columns, head stages, ratios, head ratio, signal ratio.
_HEADER = struct.Struct("<8sHHIIIHHdd")
_LENGTH = struct.Struct("<I")
_ALIGN = tuple(ALIGNMENTS)
#: Bytes of a field's code that its length can say; bytes copied at a time.
MOST_CODE, _PIECE = 2**32 - 1, 1 << 20


def tags_as_bytes(tags: TdiTags) -> bytes:
    """The content of a file of tags."""
    parts = [_head(tags, len(tags))]
    for name in FIELDS:
        code = encode_field(getattr(tags, name))
        parts += [_LENGTH.pack(len(code)), code]
    content = b"".join(parts)
    return content + _LENGTH.pack(zlib.crc32(content))


def _head(tags: TdiTags, lines: int) -> bytes:
    """All before the fields."""
    exposure = tags.exposure
    header = _HEADER.pack(
        MAGIC, VERSION, _ALIGN.index(exposure.align), lines, len(tags.first_column), tags.columns,
        exposure.head_stages, len(tags.ratios), exposure.head_ratio, tags.signal_ratio,
    )  # fmt: skip
    return header + tags.first_column.astype("<u4").tobytes() + tags.ratios.astype("<f8").tobytes()


def write_tags(path: Path, blocks: Iterable[TdiTags], lines: int) -> int:
    """Write a file of tags, complete or not at all; gives its bytes.

    Parameters
    ----------
    path : Path
    blocks : iterable of TdiTags
        One after the other the tags of some lines, of the same groups and detector; only one is held at a
        time. One block at least.
    lines : int
        Of all blocks.

    Raises
    ------
    InputError
        If a field is too long for the file.
    """
    with scratch_folder() as folder, ExitStack() as stack:
        codes = {name: stack.enter_context((folder / name).open("w+b")) for name in FIELDS}
        head, before, count = b"", dict[str, NDArray[Any]](), 0
        for tags in blocks:
            head, count = head or _head(tags, lines), count + len(tags)
            for name, stream in codes.items():
                values = getattr(tags, name)
                stream.write(encode_field(values, before.get(name)))
                if len(values):
                    before[name] = values[-1]
        if count != lines or not head:
            raise InputError(f"{count} lines of tags were given; {lines} were announced")
        with whole(path) as draft, draft.open("wb") as target:
            check = _Checked(target)
            check.write(head)
            for name, stream in codes.items():
                length = stream.tell()
                if length > MOST_CODE:
                    raise InputError(
                        f"{path}: the tags `{name}` of {lines:,} lines take {length:,} bytes, more than the "
                        f"{MOST_CODE:,} that the file can say; cut the image into shorter ones"
                    )
                check.write(_LENGTH.pack(length))
                stream.seek(0)
                while piece := stream.read(_PIECE):
                    check.write(piece)
            target.write(_LENGTH.pack(check.sum))
            return target.tell()


class _Checked:
    """A file and the check sum of what was written to it."""

    def __init__(self, target: BinaryIO) -> None:
        self.target, self.sum = target, 0

    def write(self, piece: bytes) -> None:
        self.sum = zlib.crc32(piece, self.sum)
        self.target.write(piece)


def read_tdi_tags(path: str | Path) -> TdiTags:
    """The tags that `sightline tdi --signals` wrote.

    Parameters
    ----------
    path : path
        Its ``tags.bin``.

    Returns
    -------
    TdiTags
        One record per line and column of the image of signals.

    Raises
    ------
    FormatError
        If the file is missing, is none of tags, is of a later version, or is damaged.
    """
    path = Path(path)
    advice = "tags are written by `sightline tdi --signals`"
    content = read_bytes(path, "tags of TDI lines", most=LARGE, advice=advice)
    if content[: len(MAGIC)] != MAGIC:
        raise FormatError(f"{path}: not a file of TDI tags: it does not begin with {MAGIC.decode()!r}")
    if len(content) < _HEADER.size + _LENGTH.size:
        raise FormatError(f"{path}: {len(content)} bytes; the file is cut off within its header")
    header = _HEADER.unpack_from(content)
    if header[1] != VERSION:
        raise FormatError(f"{path}: version {header[1]}; version {VERSION} is read here")
    if zlib.crc32(content[: -_LENGTH.size]) != _LENGTH.unpack_from(content, len(content) - _LENGTH.size)[0]:
        raise FormatError(f"{path}: the check sum differs; the file is cut off or damaged: fetch it again")
    try:
        return _parsed(header, content)
    except Exception as error:  # a right check sum over a content that nobody wrote
        raise FormatError(f"{path}: the content does not fit its header ({said_by(error)})") from error


def _parsed(header: tuple[Any, ...], content: bytes) -> TdiTags:
    """Tags of a content whose check sum is right."""
    _, _, align, lines, groups, columns, head_stages, n_ratios, head_ratio, signal_ratio = header
    at = _HEADER.size
    first = np.frombuffer(content, "<u4", groups, at)
    at += first.nbytes
    ratios = np.frombuffer(content, "<f8", n_ratios, at)
    at += ratios.nbytes
    fields: dict[str, NDArray[Any]] = {}
    for name, form in FIELDS.items():
        (length,) = _LENGTH.unpack_from(content, at)
        at += _LENGTH.size
        if at + length > len(content) - _LENGTH.size:
            raise FormatError(f"field {name!r} goes past the end")
        fields[name] = decode_field(content[at : at + length], (lines, groups), form)
        at += length
    if at != len(content) - _LENGTH.size:
        raise FormatError(f"{len(content) - _LENGTH.size - at} bytes are left over")
    exposure = Exposure(head_stages, head_ratio, _ALIGN[align])
    return TdiTags(
        first_column=first, columns=columns, ratios=ratios, exposure=exposure, signal_ratio=signal_ratio,
        **fields,
    )  # fmt: skip
