"""The folder a command writes: nothing half-written carries a final name, nothing of the user's is lost.

A run holds the folder's lock. It makes its files in a fresh folder ``DIR/.partial-XXXXXXXX`` and moves them
to their names together, when all of them are there. What it moves stands in a journal first, so that whatever
stops it in between, the next run puts everything back as it was. Of what lies in ``DIR`` only files that a
run made itself are touched, or that have the name of one of its results; no link is followed.

This file writes no result itself: ``io`` and ``report`` do, into the folder given here. Not here: the lock
(``lock.py``).
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath

from sightline.cli.lock import LOCK, Lock, take
from sightline.cli.terminal import Interrupted, complain
from sightline.errors import InputError
from sightline.inputs import Inputs, changed_error, noted
from sightline.writing import creation_date, in_bytes, scratch_in, whole

#: In the folder: finished stages of a long run, kept until it has ended well.
PARTIAL, STAGES = ".partial", "stages"
#: Names of folders in which runs make their files, and what such a folder holds: a mark that it is one, the
#: new files, earlier ones that they replace, scratch files, and while files are moved the journal.
_STAGING = re.compile(r"\.partial-[a-z0-9_]{8}")
_MARK, _NEW, _OLD, _SCRATCH, _JOURNAL = "made-by-sightline", "new", "old", "scratch", "journal.json"
#: Files of stages (`applications.stages`), also one that was being written.
_STAGE_FILE = re.compile(r"[A-Za-z0-9-]+\.stage\.npz(\.tmp)?")
#: What the system says where there is no room.
_NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}

#: Folders whose results this process has published, the last one last.
published: list[Path] = []


def _nothing(folder: Path) -> Iterable[str]:
    return ()


@contextmanager
def output_folder(
    folder: Path,
    *,
    overwrite: bool = False,
    earlier: Callable[[Path], Iterable[str]] = _nothing,
    resume: bool | None = None,
) -> Iterator[Path]:
    """Folder to write into, whose files appear in `folder` when the block ends without an exception.

    All of a command's work belongs into the block: the folder is checked and locked before it.

    Parameters
    ----------
    folder
        Where the results belong; created, with its parents, if it does not exist.
    overwrite
        Allow `folder` to hold something already. Files of the same names are replaced, at the very end;
        all others stay as they are.
    earlier
        Names, below `folder`, of what an earlier result there is made of: of these, what is not written again
        goes too.
    resume
        Of a command that keeps finished stages in ``stages_folder(folder)``: whether ``--resume`` was given.
        The block goes on from those of a run that was stopped, unless to overwrite was all that was asked
        for; they are removed where it ends well, and where an input changed.

    Yields
    ------
    Path
        An empty folder inside `folder`.

    Raises
    ------
    InputError
        If `folder` is a file, cannot be made or written, or holds something and `overwrite` is not given; if
        another run writes into it; if a file that was read is not what it was any more, or would be replaced.
    """
    creation_date()  # one that is not valid would be met when all is done
    published[:] = [other for other in published if other != folder]
    made = _make(folder)
    try:
        with _locked(folder, made):
            _clear_after_killed(folder)
            _refuse_content(folder, overwrite)
            with (
                _stages(folder, resume, overwrite=overwrite),
                _staging(folder) as staging,
                noted(staging) as inputs,
                scratch_in(staging / _SCRATCH),
            ):
                try:
                    yield staging / _NEW
                except Exception as error:
                    _refuse_changed(inputs, folder if resume is not None else None, error)
                    raise
                _refuse_changed(inputs, folder if resume is not None else None)
                _publish(folder, staging, earlier(folder) if overwrite else (), inputs)
                published.append(folder)
    except OSError as error:
        refusal = _refusal(error, folder)
        if refusal is None:
            raise
        raise refusal from error
    finally:
        for path in reversed(made):
            with suppress(OSError):
                path.rmdir()


def stages_folder(folder: Path) -> Path:
    """Where finished stages of a run into `folder` wait."""
    return folder / PARTIAL / STAGES


@contextmanager
def _stages(folder: Path, resume: bool | None, *, overwrite: bool) -> Iterator[None]:
    """What becomes of finished stages, and what is said of them; nothing where `resume` is None."""
    place = stages_folder(folder)
    if resume is None:
        yield
        return
    _refuse_foreign_stages(folder)
    if overwrite and not resume:
        _remove_stages(folder)
    if place.is_dir() and not resume:
        complain("note", f"goes on from the finished stages in {place}; --overwrite would begin anew")
    try:
        yield
    except BaseException as error:
        kept = f"finished stages wait in {place}; the same command goes on from them, also without --resume"
        if folder not in published:
            if isinstance(error, KeyboardInterrupt):
                raise Interrupted(kept if place.is_dir() else "no stage was finished") from error
            if place.is_dir():
                complain("note", kept)
        raise
    _remove_stages(folder)


def _refuse_changed(inputs: Inputs, stages: Path | None, error: Exception | None = None) -> None:
    """InputError if a file that was read is another by now; `error` is what came of it.

    Finished stages of the run into a folder `stages` go: they may hold what was read of either.
    """
    exchanged = inputs.changed()
    if exchanged is not None:
        if stages is not None:
            _remove_stages(stages)
        raise changed_error(exchanged) from error


def _remove_stages(folder: Path) -> None:
    """Remove the finished stages of a run into `folder`; anything else there stays."""
    if _foreign(folder / PARTIAL) is None and stages_folder(folder).is_dir():
        for path in stages_folder(folder).iterdir():
            with suppress(OSError):
                path.unlink()
    for path in (stages_folder(folder), folder / PARTIAL):
        if not path.is_symlink():
            with suppress(OSError):
                path.rmdir()


# ---- before the work


def _make(folder: Path) -> list[Path]:
    """Make a folder; gives those that were not there, outermost first."""
    missing = [folder, *folder.parents]
    missing = missing[: next((n for n, path in enumerate(missing) if os.path.exists(path)), len(missing))]
    if not missing and not os.path.isdir(folder):
        raise InputError(f"the output folder is a file: {folder}; give a folder with --out")
    try:
        for path in reversed(missing):
            path.mkdir(exist_ok=True)
    except OSError as error:
        for path in missing:
            with suppress(OSError):
                path.rmdir()
        raise _unusable(error, folder) from error
    return missing[::-1]


@contextmanager
def _locked(folder: Path, made: list[Path]) -> Iterator[None]:
    lock = _take(folder, made)
    try:
        if lock.stale:
            complain("note", f"{folder}: the lock that {lock.stale} left behind is taken over: it has ended")
        yield
    finally:
        lock.release()


def _take(folder: Path, made: list[Path]) -> Lock:
    while True:
        try:
            return take(folder)
        except FileNotFoundError:
            # a run that failed removed the folder it had made, which this one found there
            made += [path for path in _make(folder) if path not in made]
        except OSError as error:
            raise _unusable(error, folder) from error


def _unusable(error: OSError, folder: Path) -> InputError:
    """That a folder cannot be written at all."""
    if os.path.islink(folder) and not os.path.exists(folder):
        return InputError(
            f"the output folder is a link to a folder that does not exist: {folder}; make that folder, or "
            "give another --out"
        )
    if error.errno in _NO_ROOM:
        return InputError(f"no room on the disk of the output folder: {folder} {_advice(error, folder)}")
    refused = "" if error.filename in (None, str(folder)) else f": {error.filename}"
    return InputError(
        f"cannot write into the output folder: {folder} ({error.strerror}{refused}); give a folder you may "
        "write with --out"
    )


def _refuse_content(folder: Path, overwrite: bool) -> None:
    """InputError if a folder holds something and nothing is to be overwritten."""
    if overwrite:
        return
    held = [
        entry.name
        for entry in sorted(folder.iterdir())
        if entry.name != LOCK and not (entry.name == PARTIAL and _foreign(entry) is None)
    ]
    if not held:
        return
    shown = ", ".join(held[:3]) + (", ..." if len(held) > 3 else "")
    not_ours = f" ({_foreign(folder / PARTIAL)})" if held[0] == PARTIAL else ""
    raise InputError(
        f"the output folder is not empty: {folder} holds {shown}{not_ours}; an empty or new folder is "
        "allowed; add --overwrite to replace files of the same names, or give another --out"
    )


def _refuse_foreign_stages(folder: Path) -> None:
    """InputError if what stands where finished stages are kept was not made by us."""
    why = _foreign(folder / PARTIAL)
    if why is not None:
        raise InputError(
            f"{folder / PARTIAL}: {why}; finished stages of a run are kept there, and nothing else is "
            "touched: move it away, or give another --out"
        )


def _foreign(partial: Path) -> str | None:
    """Why a folder of finished stages is none of ours; None if it is ours, or not there."""
    if not os.path.lexists(partial):
        return None
    for path, allowed in ((partial, re.compile(STAGES)), (partial / STAGES, _STAGE_FILE)):
        kind = _kind(path)
        if kind == "":
            return None
        if kind != "folder":
            return f"{path.name} is a {kind}, not made by Sightline"
        for entry in sorted(path.iterdir()):
            if not allowed.fullmatch(entry.name):
                return f"it holds {entry.relative_to(partial)}, which Sightline did not make"
            if path != partial and _kind(entry) != "file":
                return f"it holds {entry.relative_to(partial)}, a {_kind(entry)} that Sightline did not make"
    return None


def _kind(path: Path) -> str:
    """ "file", "folder", "link" or "special file"; "" where there is nothing. Links are not followed."""
    try:
        known = os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return ""
    for is_kind, name in ((stat.S_ISLNK, "link"), (stat.S_ISDIR, "folder"), (stat.S_ISREG, "file")):
        if is_kind(known.st_mode):
            return name
    return "special file"


@contextmanager
def _staging(folder: Path) -> Iterator[Path]:
    """A fresh folder inside `folder`, gone at the end with all that is left in it."""
    # below `folder` as it was given, so that messages name files as the user does
    staging = folder / Path(tempfile.mkdtemp(prefix=".partial-", dir=folder)).name
    try:
        (staging / _MARK).touch()
        for name in (_NEW, _OLD, _SCRATCH):
            (staging / name).mkdir()
        yield staging
    finally:
        if not (staging / _JOURNAL).exists():
            _remove(staging)


def _remove(staging: Path) -> None:
    """Remove a staging folder, its mark last: what is left of it is known to be ours at any moment."""
    with suppress(OSError):
        for entry in staging.iterdir():
            if _kind(entry) == "folder":
                shutil.rmtree(entry, ignore_errors=True)
            elif entry.name != _MARK:
                entry.unlink()
        if [entry.name for entry in staging.iterdir()] == [_MARK]:
            (staging / _MARK).unlink()
        staging.rmdir()


def _clear_after_killed(folder: Path) -> None:
    """Put back what runs that were killed had begun to replace, and remove what they had made."""
    for staging in sorted(folder.iterdir()):
        if not _STAGING.fullmatch(staging.name) or _kind(staging) != "folder":
            continue
        if _kind(staging / _MARK) == "file":
            _roll_back(folder, staging)
            _remove(staging)
        else:
            # killed before it left its mark, or somebody else's
            with suppress(OSError):
                staging.rmdir()


# ---- the files to their names


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


def _publish(folder: Path, staging: Path, earlier: Iterable[str], inputs: Inputs) -> None:
    """Move all new files to their names; if that fails, everything is as it was before."""
    moves = _planned(folder, staging / _NEW, earlier, inputs)
    if any(os.path.lexists(move.at(folder)) for move in moves if move.kind != "folder"):
        # earlier results go: after a power cut either they or the new ones must be on the disk
        for move in moves:
            if move.kind == "file":
                _to_disk(move.at(staging / _NEW))
    with whole(staging / _JOURNAL) as draft:
        draft.write_text(json.dumps([asdict(move) for move in moves]), encoding="utf-8")
        _to_disk(draft)
    try:
        for move in moves:
            _apply(move, folder, staging)
    except BaseException:
        _roll_back(folder, staging)
        raise
    # from here on the new result is what holds
    (staging / _JOURNAL).unlink()


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
            kind = "" if inside in fresh else _kind(folder / path)
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
        and _kind(folder / name) == "file"
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
    kind = _kind(final)
    if kind == "folder" and any(final.iterdir()):
        raise InputError(
            f"{final}: is a folder that holds something, where a file of this name is to be written; move it "
            "away, or give another --out"
        )
    if kind and os.path.realpath(final) in read:
        raise InputError(
            f"{final}: was read for the result and would be replaced by a file of it; give another --out"
        )


def _to_disk(path: Path) -> None:
    """Wait until a file has reached the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _apply(move: _Move, folder: Path, staging: Path) -> None:
    final, old = move.at(folder), move.at(staging / _OLD)
    if move.kind == "folder":
        final.mkdir()
        return
    if os.path.lexists(final):
        old.parent.mkdir(parents=True, exist_ok=True)
        os.rename(final, old)
    if move.kind == "file":
        os.rename(move.at(staging / _NEW), final)


def _roll_back(folder: Path, staging: Path) -> None:
    """Undo what a journal says was begun, if there is one."""
    journal = staging / _JOURNAL
    if _kind(journal) != "file":
        return
    for move in reversed(_read(journal)):
        final, old, new = (move.at(place) for place in (folder, staging / _OLD, staging / _NEW))
        if not _unlinked(folder, move.name):
            raise _cannot_undo(final, staging)
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
        moves = [_Move(**entry) for entry in json.loads(journal.read_text(encoding="utf-8"))]
        valid = all(isinstance(move.name, str) and move.is_safe() for move in moves)
    except (OSError, ValueError, TypeError, RecursionError):
        valid = False
    if not valid:
        raise InputError(
            f"{journal}: cannot be read, but is what a run that was killed left to say which files it was "
            f"moving; look for earlier files in {journal.parent / _OLD}, then remove {journal.parent}"
        )
    return moves


def _cannot_undo(final: Path, staging: Path) -> InputError:
    return InputError(
        f"{final}: was changed after a run was killed that was replacing it; the earlier files are in "
        f"{staging / _OLD}, those of that run in {staging / _NEW}: move those you want to keep, then remove "
        f"{staging}"
    )


# ---- what the system refused


def _refusal(error: OSError, folder: Path) -> InputError | None:
    """What to say of a file that could not be written; None if the error is of something else."""
    named = Path(os.fsdecode(error.filename)) if isinstance(error.filename, str | bytes) else None
    inside = named is not None and named.is_relative_to(folder)
    short = error.errno is None and "requested and" in str(error)  # numpy's words
    if not (inside or short or error.errno in _NO_ROOM):
        return None
    what = folder if named is None else _final_name(named, folder)
    return InputError(f"{what}: cannot be written {_advice(error, named or folder)}; no result was written")


def _advice(error: OSError, path: Path) -> str:
    """The system's reason, the room that there is without the run's own files, and what to do."""
    words = f"({error.strerror or error})"
    place = next((p for p in (path, *path.parents) if os.path.exists(p)), Path())
    with suppress(OSError):
        words += f"; without the files of this run {in_bytes(shutil.disk_usage(place).free)} are free there"
    return f"{words}; make room, or give a folder on another disk with --out"


def _final_name(path: Path, folder: Path) -> Path:
    """The name that a file of the staging folder was to have."""
    parts = path.relative_to(folder).parts if path.is_relative_to(folder) else ()
    if not parts or not _STAGING.fullmatch(parts[0]):
        return path
    return folder.joinpath(*parts[2:]) if parts[1:2] == (_NEW,) else folder
