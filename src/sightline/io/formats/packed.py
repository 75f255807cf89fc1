"""Text files that may be compressed (gzip, bzip2, xz), in bounded size.

Not here: what is in them.
"""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from sightline.access import TABLE, check_file, read_bytes, refuse_utf16
from sightline.errors import FormatError, foreign_errors

#: First bytes of each kind, and what opens it.
_KINDS: tuple[tuple[bytes, Callable[[IO[bytes]], Any]], ...] = (
    (b"\x1f\x8b", lambda stream: gzip.GzipFile(fileobj=stream)),
    (b"BZh", lambda stream: bz2.BZ2File(stream)),
    (b"\xfd7zXZ\x00", lambda stream: lzma.LZMAFile(stream)),
)
#: Bytes in which the kind of a file is looked for.
HEAD = 65536


def read_packed_text(path: Path, what: str, *, most: int = TABLE) -> str:
    """The content of a text file (UTF-8), unpacked where it is compressed.

    Parameters
    ----------
    path : Path
    what : str
        What is expected, for messages.
    most : int
        Bytes of the file, and of what it unpacks to.

    Raises
    ------
    FormatError
        If it cannot be read or is too large.
    """
    content = read_bytes(path, what, most=most)
    with foreign_errors(path, f"cannot be read as {what}", "the file is damaged, or another one is meant"):
        opener = _opener(content)
        if opener is not None:
            content = opener(io.BytesIO(content)).read(most + 1)
        if len(content) > most:
            raise FormatError(f"{path}: unpacks to more than {most:,} bytes; {what} is expected")
        refuse_utf16(path, content)
        return content.decode("utf-8-sig")


def head_lines(path: Path) -> list[str]:
    """Lines of the first 64 kB of a file, unpacked; bytes that are no text are replaced."""
    check_file(path, "check the name in the TOML file")
    with foreign_errors(path, "cannot be read", "a table or a CCSDS message is expected"):
        with path.open("rb") as stream:
            opener = _opener(stream.read(8))
            stream.seek(0)
            content = (stream if opener is None else opener(stream)).read(HEAD)
    refuse_utf16(path, content)
    return content.decode("utf-8", "replace").lstrip("\ufeff").splitlines()


def _opener(content: bytes) -> Callable[[IO[bytes]], Any] | None:
    return next((opener for magic, opener in _KINDS if content.startswith(magic)), None)
