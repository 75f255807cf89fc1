"""The folder of a result: nothing half-written carries a final name, nothing of the user's is lost.

A run holds the folder's lock. It makes its files in a fresh folder ``DIR/.partial-XXXXXXXX`` and moves them
to their names together, when all of them are there. What it moves stands in a journal first, so that whatever
stops it in between, the next run puts everything back as it was. Of what lies in ``DIR`` only files that a
run made itself are touched, or that have the name of one of its results; no link is followed.

This file writes no result itself: ``io`` and ``report`` do, into the folder given here. Not here: the lock
(``lock.py``), the journal (``publish.py``).
"""

from __future__ import annotations

import errno
import logging
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sightline.errors import InputError, SightlineError
from sightline.execution import size_words
from sightline.inputs import Inputs, changed_error, noted
from sightline.output.lock import LOCK, Lock, take
from sightline.output.publish import JOURNAL, NEW, OLD, file_kind, publish, roll_back
from sightline.writing import creation_date, scratch_in

#: In the folder: finished stages of a long run, kept until it has ended well.
PARTIAL, STAGES = ".partial", "stages"
#: Names of folders in which runs make their files, and what such a folder holds besides them: a mark that it
#: is one, and scratch files.
_STAGING = re.compile(r"\.partial-[a-z0-9_]{8}")
_MARK, _SCRATCH = "made-by-sightline", "scratch"
#: Files of stages (`sightline.stages`), also one that was being written.
_STAGE_FILE = re.compile(r"[A-Za-z0-9-]+\.stage\.npz(\.tmp)?")
#: What becomes the file of a name once it is whole.
_DRAFT = re.compile(r"\.(.+)\.draft\.[a-z]+")
#: What the system says where there is no room.
_NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}

#: Folders whose results this process has published, the last one last.
published: list[Path] = []

#: Called with what is worth knowing of a folder.
Note = Callable[[str], None]


class Interrupted(Exception):
    """The user or the system stopped a command; the message says what was kept of it."""


def _log(text: str) -> None:
    logging.getLogger("sightline").warning(text)


def _nothing(folder: Path) -> Iterable[str]:
    return ()


@contextmanager
def output_folder(
    folder: Path,
    *,
    overwrite: bool = False,
    earlier: Callable[[Path], Iterable[str]] = _nothing,
    resume: bool | None = None,
    writes: Iterable[str] = (),
    note: Note = _log,
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
    writes
        Names, below `folder`, of files that the command is sure to write: that one of them is read, or is a
        folder that holds something, is refused at once, and not when all is done. Those that only its input
        tells: `sightline.inputs.will_write`.
    note
        Called with what the user should know: a lock taken over, stages gone on from.

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
        with _locked(folder, made, note):
            _clear_after_killed(folder)
            _refuse_content(folder, overwrite)
            left = list(earlier(folder)) if overwrite else []
            with (
                _stages(folder, resume, note, overwrite=overwrite),
                _staging(folder) as staging,
                noted(staging) as inputs,
                scratch_in(staging / _SCRATCH),
            ):
                inputs.replace(writes)
                try:
                    yield staging / NEW
                except Exception as error:
                    _refuse_changed(inputs, folder if resume is not None else None, error)
                    raise
                _refuse_changed(inputs, folder if resume is not None else None)
                publish(folder, staging, left, inputs, lambda: published.append(folder))
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
def _stages(folder: Path, resume: bool | None, note: Note, *, overwrite: bool) -> Iterator[None]:
    """What becomes of finished stages, and what is said of them; nothing where `resume` is None."""
    place = stages_folder(folder)
    if resume is None:
        yield
        return
    _refuse_foreign_stages(folder)
    if overwrite and not resume:
        _remove_stages(folder)
    if place.is_dir() and not resume:
        note(f"goes on from the finished stages in {place}; --overwrite would begin anew")
    try:
        yield
    except BaseException as error:
        kept = f"finished stages wait in {place}; the same command goes on from them, also without --resume"
        corrected = f"finished stages wait in {place}; a corrected run goes on from those it has in common"
        if folder in published:
            _remove_stages(folder)
        else:
            finished = place.is_dir() and any(_STAGE_FILE.fullmatch(path.name) for path in place.iterdir())
            if not finished:
                _remove_stages(folder)
            if isinstance(error, KeyboardInterrupt):
                left = kept if finished else "no stage was finished"
                raise Interrupted(f"no result was written; {left}") from error
            if finished:
                note(corrected if isinstance(error, SightlineError) else kept)
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
    if any("\ud800" <= letter <= "\udfff" for letter in str(folder)):
        raise InputError(
            f"cannot write into the output folder: {folder} is no UTF-8 text; give another --out"
        )
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
def _locked(folder: Path, made: list[Path], note: Note) -> Iterator[None]:
    lock = _take(folder, made)
    try:
        if lock.stale:
            note(f"{folder}: the lock that {lock.stale} left behind is taken over: it has ended")
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
        kind = file_kind(path)
        if kind == "":
            return None
        if kind != "folder":
            return f"{path.name} is a {kind}, not made by Sightline"
        for entry in sorted(path.iterdir()):
            if not allowed.fullmatch(entry.name):
                return f"it holds {entry.relative_to(partial)}, which Sightline did not make"
            if path != partial and file_kind(entry) != "file":
                return f"it holds {entry.relative_to(partial)}, a {file_kind(entry)}, not made by Sightline"
    return None


@contextmanager
def _staging(folder: Path) -> Iterator[Path]:
    """A fresh folder inside `folder`, gone at the end with all that is left in it."""
    # below `folder` as it was given, so that messages name files as the user does
    staging = folder / Path(tempfile.mkdtemp(prefix=".partial-", dir=folder)).name
    try:
        (staging / _MARK).touch()
        for name in (NEW, OLD, _SCRATCH):
            (staging / name).mkdir()
        yield staging
    finally:
        if not (staging / JOURNAL).exists():
            _remove(staging)


def _remove(staging: Path) -> None:
    """Remove a staging folder, its mark last: what is left of it is known to be ours at any moment."""
    with suppress(OSError):
        for entry in staging.iterdir():
            if file_kind(entry) == "folder":
                shutil.rmtree(entry, ignore_errors=True)
            elif entry.name != _MARK:
                entry.unlink()
        if [entry.name for entry in staging.iterdir()] == [_MARK]:
            (staging / _MARK).unlink()
        staging.rmdir()


def _clear_after_killed(folder: Path) -> None:
    """Put back what runs that were killed had begun to replace, and remove what they had made."""
    for staging in sorted(folder.iterdir()):
        if not _STAGING.fullmatch(staging.name) or file_kind(staging) != "folder":
            continue
        if file_kind(staging / _MARK) == "file":
            roll_back(folder, staging)
            _remove(staging)
        else:
            # killed before it left its mark, or somebody else's
            with suppress(OSError):
                staging.rmdir()


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
        words += (
            f"; without the files of this run {size_words(shutil.disk_usage(place).free, 3)} are free there"
        )
    limit = _largest_file()
    if limit is not None:
        return f"{words}; no file may be larger than {size_words(limit, 3)} (`ulimit -f`): raise that limit"
    return f"{words}; make room, or give a folder on another disk with --out"


def _largest_file() -> int | None:
    """Bytes that the shell allows a file of this process; None if there is no such limit."""
    try:
        from resource import RLIM_INFINITY, RLIMIT_FSIZE, getrlimit
    except ImportError:  # not on every system
        return None
    limit = getrlimit(RLIMIT_FSIZE)[0]
    return None if limit == RLIM_INFINITY else limit


def _final_name(path: Path, folder: Path) -> Path:
    """The name that a file of the staging folder was to have."""
    parts = path.relative_to(folder).parts if path.is_relative_to(folder) else ()
    if not parts or not _STAGING.fullmatch(parts[0]):
        return path
    if parts[1:2] != (NEW,):
        return folder
    final = folder.joinpath(*parts[2:])
    draft = _DRAFT.fullmatch(final.name)
    return final.with_name(draft[1]) if draft else final
