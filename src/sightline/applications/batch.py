"""Many inputs, one run each: what their results are called, and what became of each.

Not here: which worker does which (``execution.py``); which command a file is for, and what is kept of an
earlier batch (``cli/jobs.py``).
"""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from sightline.errors import STEERING, InputError
from sightline.result import Result

#: Bytes of a name: file systems take 255, and some is added to it while a result is written.
_LONGEST = 200
#: What no file system or library takes for something else than a letter, and what does not stand at an end.
_ODD = re.compile(rf'[<>:"/\\|?*]|{STEERING.pattern}')
#: Names of devices on some systems, and of the files of the batch itself.
_TAKEN = re.compile(
    r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?|summary\.json|report\.html|results\..*", re.IGNORECASE
)


@dataclass(frozen=True)
class JobOutcome:
    """What became of one input.

    Attributes
    ----------
    name : str
        Of its folder.
    file : str
        The input as it was given.
    command : str
        "" where the file is of no kind that has one.
    status : int
        Exit status of the command.
    message : str
        Why it failed, on one line; "" where it did not.
    kept : bool
        Whether an earlier batch had done it.
    wall_seconds, cpu_seconds : float
        s.
    peak_memory_bytes : int or None
        Of the process that did it.
    worker : str
        That process.
    warnings : int
        In its summary.
    figures : dict of str to float
        Its main numbers.
    outline : list
        Rings of [longitude, latitude], degrees, round the ground that it saw; empty where there is none, or
        it is not on the Earth.
    """

    name: str
    file: str
    command: str = ""
    status: int = 0
    message: str = ""
    kept: bool = False
    wall_seconds: float = 0.0
    cpu_seconds: float = 0.0
    peak_memory_bytes: int | None = None
    worker: str = ""
    warnings: int = 0
    figures: dict[str, float | None] = field(default_factory=dict)
    outline: list[list[list[float]]] = field(default_factory=list, repr=False)

    @property
    def state(self) -> str:
        """ "done" or "failed"."""
        return "failed" if self.status else "done"


@dataclass(frozen=True, eq=False, repr=False)
class Batch(Result):
    """What became of many inputs.

    Attributes
    ----------
    name : str
        Of the folder of all results.
    outcomes : tuple of JobOutcome
        In the order in which they were given.
    """

    name: str
    outcomes: tuple[JobOutcome, ...]

    @property
    def failed(self) -> tuple[JobOutcome, ...]:
        """Those without a result that can be used."""
        return tuple(one for one in self.outcomes if one.status)


def job_names(files: Sequence[Path]) -> list[str]:
    """A name for the result of each file: its stem or, where stems are alike, that of its folder.

    Names can stand below any folder: what steers, leads elsewhere, or is taken for something else becomes
    ``_``. Names that differ in their case alone are alike.

    Raises
    ------
    InputError
        If a file is given twice, or names still are alike: both files are named.
    """
    seen: set[str] = set()
    for file in files:
        place = os.path.abspath(file)
        if place in seen:
            raise InputError(f"{file} is given twice; give each file once")
        seen.add(place)
    stems = [_safe(file.stem) for file in files]
    often = _counted(stems)
    folders = [_safe(Path(os.path.abspath(file)).parent.name) for file in files]
    names = [
        folder if often[_likeness(stem)] > 1 else stem for stem, folder in zip(stems, folders, strict=True)
    ]
    first: dict[str, Path] = {}
    for name, file in zip(names, files, strict=True):
        other = first.setdefault(_likeness(name), file)
        if other is not file:
            raise InputError(
                f"{other} and {file} would both write into the folder {name!r} (a result is called as its "
                "file or, where files are called alike, as the folder of its file); rename one, or give "
                "each a batch of its own"
            )
    return names


def _counted(names: Sequence[str]) -> dict[str, int]:
    counts: dict[str, int] = {}
    for name in names:
        counts[_likeness(name)] = counts.get(_likeness(name), 0) + 1
    return counts


def _likeness(name: str) -> str:
    """The same of names that some file system takes for one."""
    return unicodedata.normalize("NFC", name).casefold()


def _safe(name: str) -> str:
    """A name that is one part of a path on every system, and none of a batch's own."""
    plain = _ODD.sub("_", name)
    plain = re.sub(r"^[.~\s-]+", lambda found: "_" * len(found[0]), plain)
    plain = re.sub(r"[.\s]+$", lambda found: "_" * len(found[0]), plain)
    plain = plain.encode()[:_LONGEST].decode(errors="ignore")
    return f"{plain}_" if not plain or _TAKEN.fullmatch(plain) else plain
