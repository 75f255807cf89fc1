"""Results of finished stages kept in a folder, so that a run that was stopped goes on from them.

Each stage's file carries a fingerprint of all that the stage depends on: the problem with names, sizes and
times of its files, the options, the stages before, the version of the package. A file of other inputs, or one
that cannot be read, is reported and passed over. Files appear whole or not at all.

Not here: which stages there are (``applications/``).
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import time
import types
import typing
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from sightline.errors import InputError, said_by
from sightline.version import VERSION
from sightline.writing import let_go, scratch_copy

T = TypeVar("T")
Packed = dict[str, NDArray[Any]]

_KEY = "fingerprint"
_SECONDS = "cpu-seconds"
#: Suffixes of names: nothing, the class of a dataclass, the number of items, the size of what is kept in
#: parts. None is the name of a field.
_NONE, _CLASS, _COUNT, _SIZE = "none", "class", "#", "size"
#: Items of tuples that are kept as one array.
_PLAIN = (str, bool, int, float)
_SUFFIX = ".stage.npz"
#: Bytes of an array that are written at a time.
_PIECE = 1 << 20
#: What is said of a stage whose fingerprint is another.
_OTHER = "it is of other images, options or another version"


class Stages:
    """Stages of one run.

    Parameters
    ----------
    folder : Path, optional
        Where results are kept, made when the first is; None: nowhere, everything is computed.
    warn : callable, optional
        Called with a text where a file is passed over.
    refuse : bool
        Whether a stage of other inputs is refused in place of being passed over, unless some of these inputs
        are there: the user asked to go on.

    Attributes
    ----------
    computed, found : list of str
        Names of stages that were computed now, and of those that were taken from the folder.
    taken_over : float
        CPU seconds of earlier runs in what was taken from the folder so far.
    """

    def __init__(
        self, folder: Path | None = None, warn: Callable[[str], None] | None = None, *, refuse: bool = False
    ) -> None:
        self._folder, self._warn, self._refuse = folder, warn, refuse
        self._key = hashlib.sha256(VERSION.encode())
        self.computed: list[str] = []
        self.found: list[str] = []
        self._passed_over = False
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
        found = self.held(name, kind)
        if found is not None:
            return found
        key, before = self._key.copy(), self.taken_over
        begun = self._since = time.process_time()
        try:
            packed = pack(compute())
        finally:
            self._key = key  # what stages within this one depend on is their own affair
        # those of them that were found are part of its work
        spent = time.process_time() - begun + self.taken_over - before
        self._keep(name, packed, spent)
        return unpack(kind, packed)

    def once(self, name: str, kind: type[T], compute: Callable[[], T]) -> T:
        """As `stage`, but what was computed is given as it is, and what was found may be written to.

        For results that compiled kernels go on with, and stages that have none within them.
        """
        found = self.held(name, kind, writeable=True)
        if found is None:
            self._refuse_others()
            self._since = time.process_time()
            found = compute()
            self.put(name, found)
        return found

    def held(self, name: str, kind: type[T], *, writeable: bool = False) -> T | None:
        """A stage's result where an earlier run has left it; None otherwise.

        Parameters
        ----------
        name : str
        kind : type
            Dataclass that the result is one of.
        writeable : bool
            Whether its arrays may be written to, as those of a run that computes them may.

        Raises
        ------
        InputError
            If it is of other inputs, and such are refused.
        """
        packed = self._read(name)
        if packed is None:
            return None
        try:
            seconds = float(packed.pop(_SECONDS))
            result = unpack(kind, packed, writeable=writeable)
        except Exception as error:  # whatever arrays that are not those of `kind` lead to
            self._pass_over(name, said_by(error))
            return None
        self.found.append(name)
        self.taken_over += seconds
        return result

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
        packed = pack(value)
        self._keep(name, packed, self._spent())
        return unpack(type(value), packed)

    def put(self, name: str, value: object) -> None:
        """Keep a result, which `held` will find, and leave it as it is.

        Parameters
        ----------
        name : str
        value : dataclass
            It took the time since the last one was kept.
        """
        self._keep(name, pack(value) if self._folder is not None else {}, self._spent())

    def _spent(self) -> float:
        """CPU seconds since this was last asked, or since the stage under way began."""
        now = time.process_time()
        spent, self._since = now - self._since, now
        return spent

    def _keep(self, name: str, packed: Packed, seconds: float) -> None:
        """Keep a stage that was computed now."""
        self._refuse_others()
        self.computed.append(name)
        if self._folder is not None:
            self._write(name, packed | {_SECONDS: np.array(seconds)})

    def _refuse_others(self) -> None:
        """Where the user asked to go on, and none of the stages that wait is one of this run's: InputError.

        They are of another command, and at the end of this run they would be removed.
        """
        if self._refuse and not (self.found or self.computed or self._passed_over):
            waiting = self._waiting()
            if waiting:
                raise InputError(
                    f"{waiting[0]}: it is of another command or of other options, and --resume cannot go on "
                    "from it; go on with the command that left it, or give another --out, or leave --resume "
                    "out to begin anew"
                )

    def has(self, name: str) -> bool:
        """Whether a stage of these inputs is there."""
        return self._folder is not None and self._path(name).is_file() and self._read(name) is not None

    @property
    def size(self) -> int:
        """Bytes of what is kept already."""
        return sum(path.stat().st_size for path in self._waiting())

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

    def _waiting(self) -> list[Path]:
        """Files of stages that are kept already."""
        if self._folder is None or not self._folder.is_dir():
            return []
        return sorted(self._folder.glob(f"*{_SUFFIX}"))

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
                    # beside stages of these inputs it is what a run before those left
                    own = self.found or self.computed
                    self._pass_over(name, _OTHER, refuse=self._refuse and not own)
                    return None
                return {key: _laid(file[key]) for key in file.files if key != _KEY}
        except InputError:
            raise
        except Exception as error:  # a damaged file: whatever unpacking it raises
            self._pass_over(name, f"it cannot be read ({said_by(error)})")
            return None

    def _pass_over(self, name: str, why: str, *, refuse: bool = False) -> None:
        self._passed_over = True
        if refuse:
            raise InputError(
                f"{self._path(name)}: {why} than those given now, and --resume cannot go on from it; give "
                "what that run was given, or another --out, or leave --resume out to do it again"
            )
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
                _save(file, {_KEY: np.array(self._fingerprint(name))} | packed)
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


def _save(file: BinaryIO, packed: Packed) -> None:
    """Write arrays as `numpy.savez` does; those in scratch files come into memory a piece at a time."""
    with zipfile.ZipFile(file, "w") as archive:
        for name, item in packed.items():
            array = np.asanyarray(item)
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                if not array.flags.c_contiguous or array.nbytes <= _PIECE:
                    npy.write_array(entry, array, allow_pickle=False)
                    continue
                npy.write_array_header_1_0(entry, npy.header_data_from_array_1_0(array))
                values = array.reshape(-1).view(np.uint8)
                for begin in range(0, len(values), _PIECE):
                    entry.write(values[begin : begin + _PIECE].data)
                    let_go()


def _laid(array: NDArray[Any]) -> NDArray[Any]:
    """What was read, in a scratch array where it is large; its order in memory stays."""
    out = scratch_copy(array) if array.flags.c_contiguous else array
    let_go()
    return out


def pack(value: object) -> Packed:
    """A dataclass as arrays: of arrays, rotations, numbers, texts, None, dataclasses, and tuples of such."""
    out: Packed = {}
    for field in dataclasses.fields(value):  # type: ignore[arg-type]
        _put(out, field.name, getattr(value, field.name))
    return out


def _put(out: Packed, name: str, item: Any) -> None:
    if item is None:
        out[f"{name}.{_NONE}"] = np.zeros(0)
    elif isinstance(item, Rotation):
        out[name] = item.as_quat()
    elif isinstance(item, csr_array):
        parts = {"data": item.data, "indices": item.indices, "indptr": item.indptr, "shape": item.shape}
        out |= {f"{name}.{part}": np.asarray(array) for part, array in parts.items()}
    elif dataclasses.is_dataclass(item):
        out[f"{name}.{_CLASS}"] = np.array(type(item).__name__)
        out |= {f"{name}.{key}": inner for key, inner in pack(item).items()}
    elif hasattr(item, "of_parts"):
        out[f"{name}.{_SIZE}"] = np.array(item.size)
        # each read when it is written
        out |= {f"{name}.{k}": _Part(part) for k, part in enumerate(item.parts)}  # type: ignore[misc]
    elif isinstance(item, tuple) and any(all(type(one) is plain for one in item) for plain in _PLAIN):
        out[name] = np.array(item, dtype=None if item else np.str_)
    elif isinstance(item, tuple):
        out[f"{name}.{_COUNT}"] = np.array(len(item))
        for number, one in enumerate(item):
            _put(out, f"{name}.{number}", one)
    else:
        out[name] = np.asarray(item)


class _Part:
    """An array that is made when it is asked for."""

    def __init__(self, make: Callable[[], NDArray[Any]]) -> None:
        self._make = make

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return self._make()


def unpack(kind: type[T], packed: Mapping[str, NDArray[Any]], *, writeable: bool = False) -> T:
    """What `pack` made arrays of; arrays are read-only unless they are to be `writeable`.

    Raises
    ------
    KeyError, TypeError, ValueError
        If the arrays are not those of `kind`.
    """
    hints = typing.get_type_hints(kind)
    names = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
    return kind(**{name: _take(hints[name], packed, name, writeable=writeable) for name in names})


def _take(hint: Any, packed: Mapping[str, NDArray[Any]], name: str, *, writeable: bool) -> Any:
    """One item that `_put` put under a name."""
    kinds = _kinds(hint)
    first = kinds[0]
    if f"{name}.{_NONE}" in packed:
        return None
    if f"{name}.{_CLASS}" in packed:
        called = packed[f"{name}.{_CLASS}"].item()
        which = next((one for one in kinds if getattr(one, "__name__", "") == called), None)
        if which is None:
            raise ValueError(f"{name} is no {called}")
        inner = {key[len(name) + 1 :]: item for key, item in packed.items() if key.startswith(f"{name}.")}
        return unpack(which, inner, writeable=writeable)
    if first is Rotation:
        return Rotation.from_quat(packed[name])
    if hasattr(first, "of_parts"):
        size = tuple(packed[f"{name}.{_SIZE}"].tolist())
        count = sum(key.startswith(f"{name}.") for key in packed) - 1
        return first.of_parts(size, (packed[f"{name}.{k}"] for k in range(count)))
    if first is csr_array:
        data, indices, indptr, shape = (packed[f"{name}.{p}"] for p in ("data", "indices", "indptr", "shape"))
        return csr_array((data, indices, indptr), shape=tuple(shape.tolist()))
    if typing.get_origin(first) is tuple:
        if f"{name}.{_COUNT}" not in packed:
            return tuple(packed[name].tolist())
        items, count = typing.get_args(first), packed[f"{name}.{_COUNT}"].item()
        return tuple(
            _take(items[0] if items[-1] is ... else items[k], packed, f"{name}.{k}", writeable=writeable)
            for k in range(count)
        )
    if first in _PLAIN:
        return first(packed[name].item())
    if typing.get_origin(first) is typing.Literal:
        return packed[name].item()
    array = packed[name]
    array.setflags(write=writeable)
    return array


def _kinds(hint: Any) -> list[Any]:
    """The types that a field may be of, but for None."""
    if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union:
        return [part for part in typing.get_args(hint) if part is not type(None)]
    return [hint]


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
    elif isinstance(getattr(value, "path", None), Path):
        add_to(key, value.path)  # type: ignore[attr-defined]  # an image in a file
    elif value is None or isinstance(value, bool | int | float | str | bytes | np.generic):
        key.update(repr(value).encode())
