"""Readers with a fault each, for the test of the fuzzer itself; a worker given this module knows them."""

from __future__ import annotations

import os
import time
import urllib.request
import warnings
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from tests.fuzz.readers import READERS, Reader

from sightline.errors import FormatError


def raises(folder: Path) -> None:
    raise ValueError("operands could not be broadcast")


def names_nothing(folder: Path) -> None:
    raise FormatError("something is wrong")


def two_lines(folder: Path) -> None:
    error = FormatError()
    error.args = (f"{folder}/acquisition.toml: wrong\nhere",)
    raise error


def leaks(folder: Path) -> None:
    warnings.warn("invalid value encountered in sqrt", RuntimeWarning, stacklevel=1)


def strays(folder: Path) -> None:
    (folder.parent.parent / "stray.txt").write_text("x")


def litters(folder: Path) -> None:
    (folder / "PAN.tif.aux.xml").write_text("x")


def changes(folder: Path) -> None:
    (folder / "PAN.tif").write_bytes(b"")


def asks(folder: Path) -> None:
    with suppress(OSError):
        urllib.request.urlopen("http://127.0.0.1:9/", timeout=1)


def gorges(folder: Path) -> None:
    np.ones((3 << 30) // 8)


def dies(folder: Path) -> None:
    os.abort()


def waits(folder: Path) -> None:
    time.sleep(100.0)


def ends_the_process(folder: Path) -> None:
    os._exit(0)


#: Each with what its fault begins with.
FAULTS = {
    "raises": "status 70: ValueError at", "names_nothing": "no file named", "two_lines": "not one line",
    "leaks": "foreign warning", "strays": "strayed", "litters": "strayed", "changes": "strayed",
    "asks": "strayed",
    "gorges": "memory", "dies": "died SIGABRT", "ends_the_process": "died status 0",
    "waits": "hung",
}  # fmt: skip
PLANTED = {name: Reader(name, "level", ("acquisition.toml",), globals()[name]) for name in FAULTS}
PLANTED["waits"] = replace(PLANTED["waits"], patience=1.0)


def register() -> None:
    """In the worker: beside the real ones."""
    READERS.update(PLANTED)
