"""Results of finished stages kept in a folder, so that a run that was stopped goes on from them.

Each stage's file carries a fingerprint of all that the stage depends on: the problem with names, sizes and
times of its files, the options, the stages before, the version of the package. A file of other inputs, or one
that cannot be read, is reported and passed over. Files appear whole or not at all.

Not here: which stages there are (``applications/sequence_poses.py``).
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import time
import types
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import said_by
from sightline.version import VERSION

T = TypeVar("T")
Packed = dict[str, NDArray[Any]]

_KEY = "fingerprint"
_SECONDS = "cpu-seconds"
_NONE = "none"
_SUFFIX = ".stage.npz"


class Stages:
    """Stages of one run.

    Parameters
    ----------
    folder : Path, optional
        Where results are kept, made when the first is; None: nowhere, everything is computed.
    warn : callable, optional
        Called with a text where a file is passed over.

    Attributes
    ----------
    computed, found : list of str
        Names of stages that were computed now, and of those that were taken from the folder.
    taken_over : float
        CPU seconds of earlier runs in what was taken from the folder so far.
    """

    def __init__(self, folder: Path | None = None, warn: Callable[[str], None] | None = None) -> None:
        self._folder, self._warn = folder, warn
        self._key = hashlib.sha256(VERSION.encode())
        self.computed: list[str] = []
        self.found: list[str] = []
        self.taken_over = 0.0
        self._since = time.process_time()

    def depend(self, inputs: object) -> None:
        """All stages from now on depend on `inputs` too.

        These are dataclasses, arrays, rotations, paths of files, numbers, texts, and lists of such.
        """
        if self._folder is not None:
            add_to(self._key, inputs)

    def stage(self, name: str, kind: type[T], compute: Callable[[], T]) -> T:
        """A stage's result, found or computed.

        Parameters
        ----------
        name : str
            Of letters, digits and hyphens; no two stages of a run have the same.
        kind : type
            Dataclass that the result is one of.
        compute : callable

        Returns
        -------
        kind
            The same numbers, bit for bit, whether it was found or computed, with or without a folder.
        """
        held = self._read(name)
        if held is not None:
            try:
                seconds = float(held.pop(_SECONDS))
                result = unpack(kind, held)
            except Exception as error:  # whatever arrays that are not those of `kind` lead to
                self._pass_over(name, said_by(error))
            else:
                self.found.append(name)
                self.taken_over += seconds
                return result
        key, before = self._key.copy(), self.taken_over
        begun = self._since = time.process_time()
        packed = pack(compute())
        # what stages within this one depend on is their own affair
        self._key = key
        # those of them that were found are part of its work
        spent = time.process_time() - begun + self.taken_over - before
        return self._kept(name, kind, packed, spent)

    def keep(self, name: str, value: T) -> T:
        """Keep how far a stage under way has come, as a stage of its own.

        Parameters
        ----------
        name : str
        value : dataclass
            It took the time since the last one was kept, or since the stage around it began.

        Returns
        -------
        dataclass
            What `stage` will find under this name.
        """
        now = time.process_time()
        spent, self._since = now - self._since, now
        return self._kept(name, type(value), pack(value), spent)

    def _kept(self, name: str, kind: type[T], packed: Packed, seconds: float) -> T:
        """A stage that was computed now, as it will be found."""
        self.computed.append(name)
        if self._folder is not None:
            self._write(name, packed | {_SECONDS: np.array(seconds)})
        return unpack(kind, packed)

    def has(self, name: str) -> bool:
        """Whether a stage of these inputs is there."""
        return self._folder is not None and self._path(name).is_file() and self._read(name) is not None

    def drop(self, name: str) -> None:
        """Forget a stage that a later one holds."""
        if self._folder is not None:
            self._path(name).unlink(missing_ok=True)

    def remove(self) -> None:
        """Remove all that was kept: the run has ended well."""
        if self._folder is None or not self._folder.is_dir():
            return
        for path in self._folder.glob(f"*{_SUFFIX}*"):
            path.unlink(missing_ok=True)
        if not any(self._folder.iterdir()):
            self._folder.rmdir()

    def _path(self, name: str) -> Path:
        assert self._folder is not None
        return self._folder / f"{name}{_SUFFIX}"

    def _fingerprint(self, name: str) -> str:
        key = self._key.copy()
        key.update(name.encode())
        return key.hexdigest()

    def _read(self, name: str) -> Packed | None:
        if self._folder is None or not self._path(name).is_file():
            return None
        if self._path(name).is_symlink():
            self._pass_over(name, "it is a link, which no run made")
            return None
        try:
            with np.load(self._path(name), allow_pickle=False) as file:
                if str(file[_KEY]) != self._fingerprint(name):
                    self._pass_over(name, "it is of other frames, options or another version")
                    return None
                return {key: file[key] for key in file.files if key != _KEY}
        except Exception as error:  # a damaged file: whatever unpacking it raises
            self._pass_over(name, f"it cannot be read ({said_by(error)})")
            return None

    def _pass_over(self, name: str, why: str) -> None:
        if self._warn is not None:
            self._warn(f"{self._path(name)} is passed over, {why}; the stage is done again")

    def _write(self, name: str, packed: Packed) -> None:
        path = self._path(name)
        temporary = path.with_name(path.name + ".tmp")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # what a killed run left is not written into: under its name there may be a link by now
            temporary.unlink(missing_ok=True)
            with temporary.open("xb") as file:
                np.savez(file, allow_pickle=False, **{_KEY: np.array(self._fingerprint(name))}, **packed)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        except OSError as error:
            # the run itself is none the worse for it, and has the room that was taken
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            if self._warn is not None:
                self._warn(f"stages are not kept: {path} cannot be written ({error.strerror or error})")
            self._folder = None


def pack(value: object) -> Packed:
    """A dataclass as arrays: of arrays, rotations, numbers, texts, tuples of texts, None and dataclasses."""
    out: Packed = {}
    for field in dataclasses.fields(value):  # type: ignore[arg-type]
        item = getattr(value, field.name)
        if item is None:
            out[f"{field.name}.{_NONE}"] = np.zeros(0)
        elif isinstance(item, Rotation):
            out[field.name] = item.as_quat()
        elif dataclasses.is_dataclass(item):
            out |= {f"{field.name}.{key}": inner for key, inner in pack(item).items()}
        elif isinstance(item, tuple):
            out[field.name] = np.array(item, dtype=np.str_)
        else:
            out[field.name] = np.asarray(item)
    return out


def unpack(kind: type[T], packed: Mapping[str, NDArray[Any]]) -> T:
    """What `pack` made arrays of; arrays are read-only.

    Raises
    ------
    KeyError, TypeError, ValueError
        If the arrays are not those of `kind`.
    """
    hints = typing.get_type_hints(kind)
    values: dict[str, Any] = {}
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        name, hint = field.name, _without_none(hints[field.name])
        if f"{name}.{_NONE}" in packed:
            values[name] = None
        elif dataclasses.is_dataclass(hint):
            inner = {key[len(name) + 1 :]: item for key, item in packed.items() if key.startswith(f"{name}.")}
            values[name] = unpack(hint, inner)  # type: ignore[arg-type]
        elif hint is Rotation:
            values[name] = Rotation.from_quat(packed[name])
        elif hint in (int, float, str, bool):
            values[name] = hint(packed[name].item())
        elif typing.get_origin(hint) is tuple:
            values[name] = tuple(packed[name].tolist())
        else:
            array = packed[name]
            array.setflags(write=False)
            values[name] = array
    return kind(**values)


def _without_none(hint: Any) -> Any:
    """The type of a field that may be None."""
    if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union:
        return next(part for part in typing.get_args(hint) if part is not type(None))
    return hint


def add_to(key: Any, value: object) -> None:
    """Add what a value is to a hash: its numbers, of a file its name, size and time.

    Objects that are none of these count by their type.
    """
    key.update(type(value).__name__.encode())
    if isinstance(value, Path):
        known = value.stat() if value.exists() else None
        key.update(f"{value}{known and (known.st_size, known.st_mtime_ns)}".encode())
    elif isinstance(value, np.ndarray):
        key.update(f"{value.dtype}{value.shape}".encode())
        key.update(np.ascontiguousarray(value).data)
    elif isinstance(value, Rotation):
        key.update(np.ascontiguousarray(value.as_quat()).data)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            key.update(field.name.encode())
            add_to(key, getattr(value, field.name))
    elif isinstance(value, Mapping):
        for name, item in value.items():
            key.update(str(name).encode())
            add_to(key, item)
    elif isinstance(value, list | tuple):
        key.update(str(len(value)).encode())
        for item in value:
            add_to(key, item)
    elif value is None or isinstance(value, bool | int | float | str | bytes | np.generic):
        key.update(repr(value).encode())
