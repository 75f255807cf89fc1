"""Names that users and files give: as text that steers nothing, as names of files, as strings of TOML.

A name may hold anything: line breaks, codes that colour or clear a terminal, marks that turn the direction of
writing, slashes, half a character of another encoding. It is kept as it is in tables and JSON, and made safe
here where it becomes a path, in ``errors.py`` where it is shown.
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Callable, Iterable
from datetime import date
from typing import Any

from sightline.errors import STEERING, printable

#: Bytes of UTF-8 that the name of a file made of a name has at most: endings and drafts add to it.
_LONGEST_FILE = 120
#: What Windows takes for a device, whatever its ending.
_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)


def json_printable(text: str) -> str:
    """JSON, indented or not, that says the same and in which nothing steers a terminal."""
    return STEERING.sub(lambda found: found[0] if found[0] == "\n" else f"\\u{ord(found[0]):04x}", text)


def toml_string(text: str) -> str:
    """A basic string of TOML that says `text`; halves of characters are written as `printable` does."""
    kept = re.sub("[\ud800-\udfff]", lambda found: printable(found[0]), text)
    return json_printable(json.dumps(kept, ensure_ascii=False))


def toml_value(value: Any) -> str:
    """A value as TOML has it: numbers that read back to the same bits."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return toml_string(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml_value(part) for part in value)}]"
    return value.isoformat() if isinstance(value, date) else repr(value)


def file_stem(name: str) -> str:
    """A name as that of a file in the folder at hand, without ending: what file systems dislike is ``_``."""
    stem = "".join(c if c.isalnum() or c in "-_." else "_" for c in name).lstrip(".")
    stem = stem.encode()[:_LONGEST_FILE].decode(errors="ignore") or "_"
    return f"_{stem}" if _DEVICES.match(stem) else stem


def file_stems(names: Iterable[str]) -> tuple[str, ...]:
    """The same of several names, no two alike even where capitals do not count: a number is added."""
    return numbered(map(file_stem, names), lambda stem: unicodedata.normalize("NFKC", stem).casefold())


def single_words(names: Iterable[str]) -> tuple[str, ...]:
    """Names as words of a file in which spaces part words, no two alike."""
    return numbered(("_".join(printable(name).split()) or "_" for name in names), str)


def numbered(words: Iterable[str], key: Callable[[str], str]) -> tuple[str, ...]:
    """Each word, with a number where one before it has the same `key`."""
    made: list[str] = []
    met: set[str] = set()
    for word in words:
        new, number = word, 2
        while key(new) in met:
            new, number = f"{word}_{number}", number + 1
        met.add(key(new))
        made.append(new)
    return tuple(made)
