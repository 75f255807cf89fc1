"""New files to their names in a folder, all of them or none: what is moved stands in a journal first.

The journal lies beside the new files and those that they replace. As long as it is there nothing has
happened: whoever finds it, the run itself after an error or the next one after a kill, puts everything back.
Its removal is the moment from which the new files are the result.

Not here: who may write, and when (``folder.py``).
"""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath

from sightline.access import read_json
from sightline.errors import InputError, SightlineError
from sightline.inputs import Inputs, refuse_folder, replaced_error
from sightline.writing import whole

#: In a folder beside the final names: new files, those that they replace, while files are moved the journal.
NEW, OLD, JOURNAL = "new", "old", "journal.json"


def file_kind(path: Path) -> str:
    """ "file", "folder", "link" or "special file"; "" where there is nothing. Links are not followed."""
    try:
        known = os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return ""
    for is_kind, name in ((stat.S_ISLNK, "link"), (stat.S_ISDIR, "folder"), (stat.S_ISREG, "file")):
        if is_kind(known.st_mode):
            return name
    return "special file"


@dataclass(frozen=True)
class _Move:
    """One step of publishing a result.

    Attributes
    ----------
    kind : str
        "folder": made; "file": takes its name, and what had it goes to the old ones; "gone": goes there.
    name : str
        Below the output folder, with slashes.
    size, mtime_ns : int
        Of a file that takes its name, by which it is known again.
    """

    kind: str
    name: str
    size: int = -1
    mtime_ns: int = -1

    def at(self, folder: Path) -> Path:
        """The place below a folder."""
        return folder.joinpath(*PurePosixPath(self.name).parts)

    def is_safe(self) -> bool:
        """Whether it stays below the folder it is applied to."""
        parts = PurePosixPath(self.name).parts
        return bool(parts) and not self.name.startswith("/") and ".." not in parts and "\0" not in self.name


def publish(
    folder: Path, staging: Path, earlier: Iterable[str], inputs: Inputs, done: Callable[[], object]
) -> None:
    """Move all new files to their names; if that fails, everything is as it was before.

    `done` is called once the new files are the result, be it that an interruption met the last step.
    """
    moves = _planned(folder, staging / NEW, earlier, inputs)
    if any(os.path.lexists(move.at(folder)) for move in moves if move.kind != "folder"):
        # earlier results go: after a power cut either they or the new ones must be on the disk
        for move in moves:
            if move.kind == "file":
                _to_disk(move.at(staging / NEW))
    with whole(staging / JOURNAL) as draft:
        draft.write_text(json.dumps([asdict(move) for move in moves]), encoding="utf-8")
        _to_disk(draft)
    try:
        for move in moves:
            _apply(move, folder, staging)
        # from here on the new result is what holds
        (staging / JOURNAL).unlink()
    except BaseException:
        if file_kind(staging / JOURNAL):
            roll_back(folder, staging)
        else:
            done()
        raise
    done()


def _planned(folder: Path, new: Path, earlier: Iterable[str], inputs: Inputs) -> list[_Move]:
    """Every step, folders before what is in them."""
    moves: list[_Move] = []
    names, read = set(), inputs.places()
    fresh = set()  # folders that are made, so that nothing is in the way in them
    for place, folders, files in os.walk(new):
        folders.sort()
        inside = Path(place).relative_to(new)
        for name in sorted(folders):
            path = inside / name
            kind = "" if inside in fresh else file_kind(folder / path)
            if kind != "folder":
                fresh.add(path)
                if kind:
                    _refuse_replacing(folder / path, read)
                    moves.append(_Move("gone", path.as_posix()))
                moves.append(_Move("folder", path.as_posix()))
            names.add(path.as_posix())
        for name in sorted(files):
            path = inside / name
            if inside not in fresh:
                _refuse_replacing(folder / path, read)
            known = os.lstat(new / path)
            moves.append(_Move("file", path.as_posix(), known.st_size, known.st_mtime_ns))
            names.add(path.as_posix())
    gone = sorted(
        name
        for name in set(earlier) - names
        if _Move("gone", name).is_safe()
        and file_kind(folder / name) == "file"
        and _unlinked(folder, name)
        and os.path.realpath(folder / name) not in read
    )
    return moves + [_Move("gone", name) for name in gone]


def _unlinked(folder: Path, name: str) -> bool:
    """Whether no folder on the way to a name is a link."""
    parents = list(PurePosixPath(name).parents)[:-1]
    return not any((folder / parent).is_symlink() for parent in parents)


def _refuse_replacing(final: Path, read: frozenset[str]) -> None:
    """InputError if what has the name of a result was read for it, or is a folder that holds something."""
    refuse_folder(final)
    if file_kind(final) and os.path.realpath(final) in read:
        raise replaced_error(final)


def _to_disk(path: Path) -> None:
    """Wait until a file has reached the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _apply(move: _Move, folder: Path, staging: Path) -> None:
    final, old = move.at(folder), move.at(staging / OLD)
    if move.kind == "folder":
        final.mkdir()
        return
    if os.path.lexists(final):
        old.parent.mkdir(parents=True, exist_ok=True)
        os.rename(final, old)
    if move.kind == "file":
        os.rename(move.at(staging / NEW), final)


def roll_back(folder: Path, staging: Path) -> None:
    """Undo what a journal says was begun, if there is one."""
    journal = staging / JOURNAL
    if file_kind(journal) != "file":
        return
    moves = _read(journal)
    for place in (staging / OLD, staging / NEW):
        if file_kind(place) != "folder":
            raise InputError(
                f"{place}: is no folder, as where a run was killed that was moving files; nothing was moved: "
                f"look at {staging}, then remove it"
            )
    for move in moves:  # before the first of them is undone
        for place in (folder, staging / OLD, staging / NEW):
            if not _unlinked(place, move.name):
                raise _cannot_undo(move.at(place), staging)
    for move in reversed(moves):
        final, old, new = (move.at(place) for place in (folder, staging / OLD, staging / NEW))
        if move.kind == "folder":
            with suppress(OSError):
                final.rmdir()
            continue
        if move.kind == "file" and not os.path.lexists(new) and os.path.lexists(final):
            known = os.lstat(final)
            if (known.st_size, known.st_mtime_ns) != (move.size, move.mtime_ns):
                raise _cannot_undo(final, staging)
            os.rename(final, new)
        if os.path.lexists(old):
            if os.path.lexists(final):
                raise _cannot_undo(final, staging)
            os.rename(old, final)
    journal.unlink()


def _read(journal: Path) -> list[_Move]:
    """The steps of a journal; InputError where it is none of ours."""
    try:
        moves = [_Move(**entry) for entry in read_json(journal, "a journal")]
        valid = all(isinstance(move.name, str) and move.is_safe() for move in moves)
    except (SightlineError, TypeError):
        valid = False
    if not valid:
        raise InputError(
            f"{journal}: cannot be read, but is what a run that was killed left to say which files it was "
            f"moving; look for earlier files in {journal.parent / OLD}, then remove {journal.parent}"
        )
    return moves


def _cannot_undo(final: Path, staging: Path) -> InputError:
    return InputError(
        f"{final}: was changed after a run was killed that was replacing it; the earlier files are in "
        f"{staging / OLD}, those of that run in {staging / NEW}: move those you want to keep, then remove "
        f"{staging}"
    )
