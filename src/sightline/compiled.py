"""``njit`` for every kernel, and where compiled kernels are kept between runs.

They are kept where numba keeps them: the folder that ``NUMBA_CACHE_DIR`` names, the package's own folder, the
user's cache folder. Where none of these can be used (a read-only installation, no home) a folder of this
user in the temporary directory serves, and where that cannot be either they are compiled anew in every run.
What is kept is code, and loading it runs it: no folder is used that another user could have filled.

Not here: the kernels. They stand beside what calls them, and take ``njit`` from here alone.
"""

from __future__ import annotations

import atexit
import gc
import multiprocessing
import os
import shutil
import stat
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache as once
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError, foreign_errors

with foreign_errors(
    "the compiler of the kernels",
    "numba cannot be loaded",
    "look at the environment variables that begin with NUMBA_, and unset them",
    raises=InputError,
):
    import numba
    from numba.core import config, event
    from numba.core.caching import (
        CompileResultCacheImpl,
        FunctionCache,
        InTreeCacheLocator,
        UserProvidedCacheLocator,
        UserWideCacheLocator,
    )

Array = NDArray[Any]

# Modules may be imported on several threads: one choice, said once.
_LOCK = threading.RLock()


class _Uncollected(event.Listener):  # type: ignore[misc]
    """No cycles are sought while a kernel is compiled: nearly all that it makes is kept until it is done.

    The search took a sixth of the time. Compilations are nested, and the compiler's lock holds about each.
    """

    _depth, _sought = 0, False

    def on_start(self, begun: Any) -> None:
        """Stop the search, if it is on."""
        if self._depth == 0:
            self._sought = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, ended: Any) -> None:
        """Go on with it, if it was on."""
        self._depth -= 1
        if self._depth == 0 and self._sought:
            gc.enable()


event.register("numba:compile", _Uncollected())


def njit(*, cache: bool = True, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: `numba.njit`, its code kept between runs wherever that can be.

    Parameters
    ----------
    cache
        Keep the compiled code; where there is no place for it, the kernel works all the same.
    **options
        Those of `numba.njit`.
    """

    # Code that may round as is fastest must stand in the code of its caller. Where it stands by itself too,
    # what was loaded before decides which of the two is called, and a first run would differ from the next.
    if options.get("fastmath"):
        options.setdefault("forceinline", True)

    options.setdefault("no_cfunc_wrapper", True)  # a second way in, for C, that nothing here uses

    def compiled(function: Callable[..., Any]) -> Any:
        kernel = numba.njit(**options)(function)
        if cache and hasattr(kernel, "enable_caching"):  # a plain function under NUMBA_DISABLE_JIT
            with _LOCK, suppress(RuntimeError):  # no folder at all: said where it was sought
                kernel._cache = _KernelCache(function)
        return kernel

    return compiled


def only_read(*arrays: Array) -> tuple[Array, ...]:
    """Read-only C-contiguous views of what a kernel only reads, copied where the layout asks for it.

    An array that may be written to is of another type than one that may not: a kernel that is called with
    either would be compiled twice.
    """
    views = tuple(np.ascontiguousarray(array).view() for array in arrays)
    for view in views:
        view.setflags(write=False)
    return views


class _HomeLocator(UserWideCacheLocator):  # type: ignore[misc]
    """The user's cache folder, if it is the user's: HOME may be a place that all share, or none."""

    def ensure_cache_path(self) -> None:
        """Make the folder and see that it can be written; OSError where it cannot or must not be."""
        if not os.path.isabs(self._cache_path):  # "~" of a user without a home: a folder of that name here
            raise OSError("no home folder")
        super().ensure_cache_path()
        self.check()

    def check(self) -> None:
        """OSError if another user could have filled the folder."""
        _check_ours(os.path.dirname(self._cache_path), shut_to=stat.S_IWOTH)
        _check_ours(self._cache_path, shut_to=stat.S_IWOTH)


class _TemporaryLocator(UserWideCacheLocator):  # type: ignore[misc]
    """A folder of this user in the temporary directory."""

    _cache_path: str

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        super().__init__(function, file)
        self._root = _temporary_folder()
        self._cache_path = os.path.join(self._root, os.path.basename(self._cache_path))

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> Any:
        """Locator of a kernel; None where there is no such folder."""
        return super().from_function(function, file) if _temporary_folder() else None

    def ensure_cache_path(self) -> None:
        """Make the folder, again where the temporary directory was tidied, and see that it can be written."""
        with suppress(FileExistsError):
            os.mkdir(self._root, 0o700)
        self.check()
        super().ensure_cache_path()

    def check(self) -> None:
        """OSError if the folder is not this user's alone."""
        _check_ours(self._root, shut_to=0o077)


class _KernelFiles(CompileResultCacheImpl):  # type: ignore[misc]
    """Where one kernel is kept: the first of these places that can be used."""

    _locator_classes = (UserProvidedCacheLocator, InTreeCacheLocator, _HomeLocator, _TemporaryLocator)


class _KernelCache(FunctionCache):  # type: ignore[misc]
    """numba's own, but what cannot be read or kept is compiled again and ends no run."""

    _impl_class = _KernelFiles

    def _index_key(self, signature: Any, codegen: Any) -> Any:
        # numba numbers the files of a kernel's signatures. Two processes that compile at the same time could
        # give two of them one number, and one would be taken for the other: here each has a name of its own.
        key = super()._index_key(signature, codegen)
        name = f"{self._impl.filename_base}.{sha256(repr(key[:2]).encode()).hexdigest()[:16]}"
        self._cache_file._data_name_pattern = name + ".{number:d}.nbc"
        return key

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Compiled code; None where there is none, or none that can be used."""
        try:
            if hasattr(self._impl.locator, "check"):
                self._impl.locator.check()
            return super().load_overload(signature, target)
        except OSError:
            return None
        except Exception:  # a damaged file: whatever unpickling it raises
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep compiled code; a full disk, or a folder that is gone, is said once."""
        try:
            super().save_overload(signature, compiled)
        except OSError as error:
            self.disable()
            folder = os.path.dirname(self.cache_path)
            _say(f"compiled kernels cannot be kept in {folder}: {error.strerror or error}")


@once
def _temporary_folder() -> str:
    """Folder of this user's kernels in the temporary directory; "" where none can be made."""
    named = f"NUMBA_CACHE_DIR={config.CACHE_DIR}, " if config.CACHE_DIR else ""
    reason = f"as neither {named}the package's folder nor the user's cache folder can be used"
    try:
        parent = _temporary_directory()
        folder = os.path.join(parent, f"sightline-kernels-{_user()}")
        try:
            with suppress(FileExistsError):
                os.mkdir(folder, 0o700)
            _check_ours(folder, shut_to=0o077)
            tempfile.TemporaryFile(dir=folder).close()
        except OSError:
            taken, folder = folder, tempfile.mkdtemp(prefix="sightline-kernels-", dir=parent)
            atexit.register(_remove, folder, os.getpid())
            os.environ["NUMBA_CACHE_DIR"] = folder  # for worker processes
            _say(
                f"compiled kernels are kept in {folder} until this run ends, {reason}; {taken} is not a "
                "folder of this user alone (mode 0700): remove it, or name another with NUMBA_CACHE_DIR"
            )
            return folder
    except OSError:
        _say(
            f"kernels are compiled anew in every run, {reason}, nor the temporary directory; name a folder "
            "that can be written with NUMBA_CACHE_DIR"
        )
        return ""
    _say(f"compiled kernels are kept in {folder}, {reason}; NUMBA_CACHE_DIR can name another folder")
    return folder


def _temporary_directory() -> str:
    """The system's directory for temporary files; OSError where there is none but the working directory."""
    found = tempfile.gettempdir()
    named = {os.environ.get(name) for name in ("TMPDIR", "TEMP", "TMP")} | {"/tmp", "/var/tmp", "/usr/tmp"}
    if found == os.getcwd() and found not in named:
        raise OSError("no temporary directory")
    return found


def _check_ours(folder: str, *, shut_to: int) -> None:
    """OSError unless `folder` is a folder, no link, of this user, without the permissions `shut_to`."""
    found = os.lstat(folder)
    if not stat.S_ISDIR(found.st_mode):
        raise OSError(f"{folder} is not a folder")
    if os.name == "posix" and (found.st_uid != os.geteuid() or found.st_mode & shut_to):
        raise OSError(f"{folder} is open to other users")


def _user() -> str:
    """What distinguishes this user from others in the name of a folder."""
    return str(os.geteuid()) if os.name == "posix" else "own"


def _remove(folder: str, maker: int) -> None:
    """Remove a folder at the end of the process that made it, not of one that was forked off it."""
    if os.getpid() == maker:
        shutil.rmtree(folder, ignore_errors=True)


@once
def _say(message: str) -> None:
    """One line on stderr; worker processes leave it to the process that started them."""
    # by its name: a process knows its parent only after it has imported the modules it works with
    if multiprocessing.current_process().name == "MainProcess":
        with suppress(OSError, ValueError, AttributeError):  # closed, or none
            print(f"sightline: note: {message}", file=sys.stderr)
