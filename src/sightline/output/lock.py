"""One run at a time writes into a folder: a lock that names its owner.

The lock is the system's (``flock``): it ends with the process that holds it, however that ends, so a file
that is left says only who it was. Where a file system knows no such locks, the file itself is the lock and
its owner is looked for among the processes of this machine.

Not here: what is done in the folder (``folder.py``).
"""

from __future__ import annotations

import errno
import json
import os
import secrets
import shlex
import socket
import stat
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from sightline.errors import InputError

#: In the folder that a run writes, while it runs.
LOCK = ".sightline.lock"
#: What the refusal of a folder with a run in it says.
HELD = "is being written by another run"
#: What systems say that know no locks, or not on this file system.
_NO_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EINVAL}
#: Bytes of a lock that are read; characters of a command that are shown.
_MOST, _SHOWN = 4096, 160
#: s; a lock without an owner that is older was left by a process stopped while it wrote its name.
_WRITTEN_WITHIN = 10.0
#: s within which two that take a lock over at the same moment have both written their names.
_SETTLES = 0.1
#: Distinguishes this process from all others, also from one with its number on a machine of the same name.
_TOKEN = secrets.token_hex(8)


@dataclass(frozen=True)
class Lock:
    """A lock that is held.

    Attributes
    ----------
    path : Path
    descriptor : int
    stale : str
        Who had left it behind; "" if nobody had.
    """

    path: Path
    descriptor: int
    stale: str

    def release(self) -> None:
        """Remove the file, if it still is ours, and let go."""
        with suppress(OSError):
            if _is_at(self.path, self.descriptor):
                self.path.unlink()
        os.close(self.descriptor)


def take(folder: Path) -> Lock:
    """The lock of a folder that exists.

    Raises
    ------
    InputError
        If another run holds it, or what has its name is none of ours.
    OSError
        If the folder cannot be written, or is gone.
    """
    path = folder / LOCK
    while True:
        lock = _try(path)
        if lock is not None:
            return lock


def _try(path: Path) -> Lock | None:
    """The lock; None where it changed hands meanwhile and is to be tried again."""
    descriptor, fresh = _opened(path)
    ours = False
    try:
        known = os.fstat(descriptor)
        if not stat.S_ISREG(known.st_mode) or known.st_nlink > 1:
            raise _not_ours(path)
        locked = _flock(descriptor)
        if locked is False:
            raise _held(path, _owner(descriptor))
        ours = _is_at(path, descriptor)
        if not ours:
            os.close(descriptor)
            return None
        owner = {} if fresh else _owner(descriptor)
        if locked is None and not fresh:
            ours = False
            _give_way_to_the_living(path, owner, known.st_mtime)
            ours = True
        _write(descriptor, _myself())
        if locked is None and not fresh:
            # of two that take it over at the same moment the last to write has it
            time.sleep(_SETTLES)
            ours = _owner(descriptor).get("token") == _TOKEN
            if not ours:
                raise _held(path, _owner(descriptor))
        return Lock(path, descriptor, "" if fresh else _words(owner))
    except BaseException:
        if ours:
            with suppress(OSError):
                path.unlink()
        os.close(descriptor)
        raise


def _opened(path: Path) -> tuple[int, bool]:
    """Descriptor of the file, and whether it was made now."""
    flags = os.O_RDWR | getattr(os, "O_CLOEXEC", 0)
    with suppress(FileExistsError):
        return os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o666), True
    try:
        # neither through a link nor waiting for a reader of a pipe
        more = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
        return os.open(path, flags | more), False
    except FileNotFoundError:
        return _opened(path)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO):
            raise _not_ours(path) from None
        raise


def _flock(descriptor: int) -> bool | None:
    """Whether this process has the lock now; None where the file system knows none."""
    try:
        import fcntl
    except ImportError:  # not a POSIX system
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _NO_LOCKS:
            return None
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            return False
        raise
    return True


def _is_at(path: Path, descriptor: int) -> bool:
    """Whether a name still is that of the open file."""
    try:
        named = os.lstat(path)
    except FileNotFoundError:
        return False
    mine = os.fstat(descriptor)
    return (named.st_dev, named.st_ino) == (mine.st_dev, mine.st_ino)


def _give_way_to_the_living(path: Path, owner: dict[str, object], written: float) -> None:
    """Without locks of the system: refuse where the owner runs on this machine, or began a moment ago.

    Of an owner on another machine nothing can be known; it is taken for gone.
    """
    begins = not owner and time.time() - written < _WRITTEN_WITHIN
    if begins or (owner.get("host") == socket.gethostname() and _lives(owner.get("pid"))):
        raise _held(path, owner)


def _lives(pid: object) -> bool:
    """Whether a process runs on this machine; so taken where the system has no way to ask."""
    if not isinstance(pid, int) or isinstance(pid, bool) or not 0 < pid < 2**31:
        return False
    if os.name != "posix":
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        return True
    return True


def _myself() -> bytes:
    """What the file says of its owner."""
    said = {
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "begun": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        "command": shlex.join(["sightline", *sys.argv[1:]])[:_SHOWN],
        "token": _TOKEN,
    }
    return json.dumps(said).encode()


def _write(descriptor: int, content: bytes) -> None:
    os.ftruncate(descriptor, 0)
    os.lseek(descriptor, 0, os.SEEK_SET)
    os.write(descriptor, content)


def _owner(descriptor: int) -> dict[str, object]:
    """What a lock says of its owner; empty where it says nothing that can be read."""
    # the owner may be about to write its name
    for _ in range(5):
        try:
            os.lseek(descriptor, 0, os.SEEK_SET)
            said = json.loads(os.read(descriptor, _MOST))
        except (OSError, ValueError, RecursionError):
            said = None
        if isinstance(said, dict) and said:
            return said
        time.sleep(0.02)
    return {}


def _words(owner: dict[str, object]) -> str:
    """The owner of a lock in words."""
    if not owner:
        return "a run that does not give its name"

    def shown(key: str) -> str:
        text = "".join(c if c.isprintable() else "?" for c in str(owner.get(key, "unknown")))
        return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."

    return f"process {shown('pid')} on {shown('host')}, begun {shown('begun')} ({shown('command')})"


def _held(path: Path, owner: dict[str, object]) -> InputError:
    return InputError(
        f"the output folder {path.parent} {HELD}: {_words(owner)}; wait until it "
        f"has ended, or give another --out (if there is no such run any more, remove {path})"
    )


def _not_ours(path: Path) -> InputError:
    return InputError(
        f"{path}: is a link, a folder or something else that is no lock of Sightline; runs keep their lock "
        "under this name: move it away, or give another --out"
    )
