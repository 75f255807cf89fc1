"""The folder a command writes: nothing half-written ever carries a final name.

Files are made in ``DIR/.partial`` and move to their final names together, when all of them are there.
This file writes no result itself: ``io`` and ``report`` do, into the folder given here.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from sightline.errors import InputError

PARTIAL = ".partial"
#: In it: finished stages of a long run, kept until it has ended well.
STAGES = "stages"


@contextmanager
def output_folder(folder: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Folder to write into, whose files appear in `folder` when the block ends without an exception.

    Parameters
    ----------
    folder
        Where the results belong; created, with its parents, if it does not exist.
    overwrite
        Allow `folder` to hold something already. Files of the same names are replaced, at the very end;
        all others stay as they are.

    Yields
    ------
    Path
        The empty folder ``.partial`` inside `folder`.

    Raises
    ------
    InputError
        If `folder` is a file, cannot be made, or holds something and `overwrite` is not given.
    """
    existed = folder.is_dir()
    staging = _prepare(folder, overwrite)
    try:
        yield staging
        for made in sorted(staging.iterdir()):
            if made.name != STAGES:
                _replace(made, folder / made.name)
    finally:
        _clear(staging)
        if not existed and not any(folder.iterdir()):
            folder.rmdir()


def check_output_folder(folder: Path, *, overwrite: bool = False, resume: bool = True) -> None:
    """Refuse a folder that `output_folder` would refuse, without touching it.

    For commands that work long before they write: a wrong ``--out`` is said at once. Finished stages of a run
    that was stopped are refused too, unless they are to be gone on from (`resume`) or replaced.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"the output folder is a file: {folder}; give a folder with --out")
    if folder.is_dir() and not overwrite:
        held = sorted(entry.name for entry in folder.iterdir() if entry.name != PARTIAL)
        if held:
            shown = ", ".join(held[:3]) + (", ..." if len(held) > 3 else "")
            raise InputError(
                f"the output folder is not empty: {folder} holds {shown}; an empty or new folder is allowed; "
                "add --overwrite to replace files of the same names, or give another --out"
            )
    if not (overwrite or resume) and stages_folder(folder).is_dir():
        raise InputError(
            f"the output folder {folder} holds finished stages of a run that was stopped; add --resume to go "
            "on from them, --overwrite to begin anew, or give another --out"
        )


def stages_folder(folder: Path) -> Path:
    """Where finished stages of a run into `folder` wait."""
    return folder / PARTIAL / STAGES


def remove_stages(folder: Path) -> None:
    """Remove the finished stages of a run into `folder`, and `folder` if it holds nothing else."""
    shutil.rmtree(folder / PARTIAL, ignore_errors=True)
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def remove_earlier(folder: Path, names: Iterable[str], keep: Iterable[Path]) -> None:
    """Remove what an earlier run left in `folder` and this one did not write again.

    Parameters
    ----------
    folder
        Where the results lie.
    names
        Files that the command may write and did not write now; other files are not touched.
    keep
        Files that stay whatever they are called, such as inputs that lie in `folder` too.
    """
    kept = {path.resolve() for path in keep}
    for name in names:
        path = folder / name
        if path.is_file() and path.resolve() not in kept:
            path.unlink()


def _clear(staging: Path) -> None:
    """Remove what a run has left there, but for finished stages."""
    if not staging.is_dir():
        return
    for entry in staging.iterdir():
        if entry.name == STAGES:
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            entry.unlink(missing_ok=True)
    if not any(staging.iterdir()):
        staging.rmdir()


def _prepare(folder: Path, overwrite: bool) -> Path:
    check_output_folder(folder, overwrite=overwrite)
    staging = folder / PARTIAL
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _clear(staging)
        staging.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(
            f"cannot write into the output folder: {folder} ({error.strerror}); give a folder you may write "
            "with --out"
        ) from error
    return staging


def _replace(made: Path, final: Path) -> None:
    if final.is_dir() and not final.is_symlink():
        shutil.rmtree(final)
    made.replace(final)
