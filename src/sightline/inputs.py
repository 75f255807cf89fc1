"""Files that a command reads: still what they were when it began to read them, and never written over.

A command that runs for minutes describes its result by hashes of its inputs. They are those of what was read
only if no file was exchanged meanwhile: size, time and place of each are kept when it is first met and
compared before the result is published.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from sightline.errors import InputError


@dataclass(frozen=True)
class _Stamp:
    """What distinguishes a file from one that took its place; all -1 where there is none."""

    size: int = -1
    mtime_ns: int = -1
    inode: int = -1
    ctime_ns: int = -1

    @classmethod
    def of(cls, path: Path) -> _Stamp:
        try:
            known = path.stat()
        except OSError:
            return cls()
        return cls(known.st_size, known.st_mtime_ns, known.st_ino, known.st_ctime_ns)

    def same(self, other: _Stamp) -> bool:
        """Whether nothing speaks for another file or other content."""
        if (self.size, self.mtime_ns) != (other.size, other.mtime_ns):
            return False
        # some network file systems number a file anew now and then, and a backup may touch its ctime: only
        # both together are another file
        return self.inode == other.inode or self.ctime_ns == other.ctime_ns


@dataclass
class Inputs:
    """Files met since `noted` began, but for those below `own`, which the command makes itself.

    None may be of `replaced`, real paths of files that the command will write.
    """

    own: Path
    replaced: set[str] = field(default_factory=set)
    _stamps: dict[Path, _Stamp] = field(default_factory=dict)

    def add(self, path: Path) -> None:
        """Keep what a file is now, unless it was met before."""
        if path not in self._stamps and not path.is_relative_to(self.own):
            if self.replaced and os.path.realpath(path) in self.replaced:
                raise replaced_error(path)
            self._stamps[path] = _Stamp.of(path)

    def replace(self, names: Iterable[str]) -> None:
        """Files of these names are written beside `own`: none that was or will be met may be one of them.

        Nor may a folder that holds something have one of the names.
        """
        finals = [self.own.parent / name for name in names]
        for final in finals:
            refuse_folder(final)
        self.replaced |= {os.path.realpath(final) for final in finals}
        for path in self._stamps:
            if os.path.realpath(path) in self.replaced:
                raise replaced_error(path)

    def changed(self) -> Path | None:
        """The first file that is not what it was."""
        return next((p for p, stamp in self._stamps.items() if not stamp.same(_Stamp.of(p))), None)

    def stamps(self) -> dict[str, list[int]]:
        """Size and time (ns) of each file by its whole path, as they were when it was met; -1 of none."""
        return {os.path.abspath(path): [stamp.size, stamp.mtime_ns] for path, stamp in self._stamps.items()}

    def places(self) -> frozenset[str]:
        """Real paths of all files."""
        return frozenset(os.path.realpath(path) for path in self._stamps)


_watching: list[Inputs] = []


@contextmanager
def noted(own: Path) -> Iterator[Inputs]:
    """Every file that is read during the block, as far as readers `note` it; none below `own`."""
    seen = Inputs(own)
    _watching.append(seen)
    try:
        yield seen
    finally:
        _watching.remove(seen)


@contextmanager
def apart(own: Path) -> Iterator[Inputs]:
    """As `noted`, of a run within another one, which does not take these files for its own."""
    around, _watching[:] = list(_watching), []
    try:
        with noted(own) as seen:
            yield seen
    finally:
        _watching[:] = around


def unchanged(stamps: dict[str, list[int]]) -> bool:
    """Whether files still have the size and time that `Inputs.stamps` kept of them."""
    return all(
        [now.size, now.mtime_ns] == stamp
        for now, stamp in ((_Stamp.of(Path(p)), s) for p, s in stamps.items())
    )


def note(path: Path) -> None:
    """Call before a file is read: it is an input of the command under way, if there is one."""
    for seen in _watching:
        seen.add(path)


def will_write(names: Iterable[str]) -> None:
    """Call when it is known what the command under way will write into its folder, before the work.

    Raises
    ------
    InputError
        If a file of these names was read, or a folder that holds something has one; later, where one is read.
    """
    # a batch around it has another folder
    for seen in _watching[-1:]:
        seen.replace(names)


def refuse_folder(final: Path) -> None:
    """InputError where what has the name of a file that is to be written is a folder that holds something."""
    if not final.is_symlink() and final.is_dir() and any(final.iterdir()):
        raise InputError(
            f"{final}: is a folder that holds something, where a file of this name is to be written; move it "
            "away, or give another --out"
        )


def replaced_error(path: Path) -> InputError:
    """That a file that was read has the name of one that is to be written."""
    return InputError(
        f"{path}: was read for the result and would be replaced by a file of it; give another --out"
    )


def changed_error(path: Path) -> InputError:
    """That a file is not any more what was read of it."""
    return InputError(
        f"{path}: changed while it was read; a result of it would be a mixture of both, and its hash that of "
        "neither: run the same command again once the file stays as it is"
    )
