"""Shape, finiteness and type of array arguments, and the wording of the errors about them.

Arrays that leave this module are C-contiguous float64 and read-only: a frozen class does not freeze its
arrays, and compiled kernels see one type only.

Not here: the exceptions themselves (``errors.py``).
"""

from __future__ import annotations

from mmap import mmap
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError

Array = NDArray[np.float64]


def read_only(values: ArrayLike) -> Array:
    """Read-only C-contiguous float64 view of `values`; copies only where the type or layout asks for it."""
    array = np.ascontiguousarray(values, dtype=np.float64).view()
    array.setflags(write=False)
    return array


def frozen(values: ArrayLike) -> Array:
    """Read-only float64 array that nobody else can change: a copy, unless `values` is read-only already."""
    if isinstance(values, np.ndarray) and values.dtype == np.float64 and values.flags.c_contiguous:
        owner: Any = values
        while isinstance(owner, np.ndarray) and not owner.flags.writeable:
            owner = owner.base
        if owner is None or isinstance(owner, mmap):
            return values
    array = np.array(values, dtype=np.float64, order="C")
    array.setflags(write=False)
    return array


class ReadOnlyArrays:
    """Base of classes whose arrays stay read-only when they are copied or sent to another process."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore attributes; numpy forgets on the way that an array was read-only."""
        for value in state.values():
            for item in value if isinstance(value, tuple) else (value,):
                if isinstance(item, np.ndarray):
                    item.setflags(write=False)
        self.__dict__.update(state)


def as_points(values: ArrayLike, name: str = "points") -> Array:
    """Points or vectors as (N, 3) float64.

    Parameters
    ----------
    values : (N, 3) or (3,)
        x, y, z. A NaN row stands for a point that is not known and stays NaN; infinities are refused.
    name : str
        Argument name for the message.

    Returns
    -------
    (N, 3)
        Read-only view.

    Raises
    ------
    InputError
        Wrong shape or infinite values.
    """
    return _rows(values, name, 3, "(x, y, z)")


def as_pixels(values: ArrayLike, name: str = "pixels") -> Array:
    """Pixels as (N, 2) float64 (line, column); a NaN row stays NaN. Raises InputError like `as_points`."""
    return _rows(values, name, 2, "(line, column)")


def _rows(values: ArrayLike, name: str, width: int, order: str) -> Array:
    """Body of `as_points` and `as_pixels`."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as problem:
        raise InputError(f"`{name}` must be numbers of shape (N, {width}) as {order}: {problem}") from None
    if array.shape == (width,):
        array = array[np.newaxis]
    if array.ndim != 2 or array.shape[1] != width:
        hint = f"; did you mean {name}.T?" if array.ndim == 2 and array.shape[0] == width else ""
        raise InputError(f"`{name}` must have shape (N, {width}) as {order}, got {array.shape}{hint}")
    if np.isinf(array).any():
        row = int(np.flatnonzero(np.isinf(array).any(axis=1))[0])
        raise InputError(f"`{name}` must be finite, or NaN where unknown: row {row} is {array[row].tolist()}")
    return read_only(array)


def as_times(values: ArrayLike, name: str = "t", *, increasing: bool = False) -> Array:
    """Times as (N,) float64 s.

    Parameters
    ----------
    values : (N,) or scalar
        Seconds from the epoch.
    name : str
        Argument name for the message.
    increasing : bool
        Whether they must increase strictly, as the nodes of a table do.

    Returns
    -------
    (N,)
        Read-only view.

    Raises
    ------
    InputError
        Not one-dimensional, not finite, or not increasing where that is asked; names the first offender.
    """
    array = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if array.ndim != 1:
        raise InputError(f"`{name}` must have shape (N,) in seconds, got {array.shape}")
    if not np.isfinite(array).all():
        row = int(np.flatnonzero(~np.isfinite(array))[0])
        raise InputError(f"`{name}` must be finite: element {row} is {array[row]}; remove that row")
    if increasing and len(array) > 1:
        steps = np.diff(array)
        if (steps <= 0).any():
            row = int(np.flatnonzero(steps <= 0)[0])
            what = "twice" if steps[row] == 0 else "out of order"
            raise InputError(
                f"`{name}` must increase strictly: {array[row + 1]:.9g} s (element {row + 1}) comes {what}, "
                f"after {array[row]:.9g} s; sort the rows and drop repeated times"
            )
    return read_only(array)


def as_vector(values: ArrayLike, name: str, length: int = 3) -> Array:
    """One finite vector of `length` numbers, read-only. Raises InputError otherwise."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (length,) or not np.isfinite(array).all():
        raise InputError(f"`{name}` must be {length} finite numbers, got {np.array2string(array)}")
    return frozen(array)


def same_length(a: Array, name_a: str, b: Array, name_b: str) -> None:
    """Raise InputError unless two arrays have as many rows."""
    if len(a) != len(b):
        raise InputError(
            f"`{name_a}` and `{name_b}` must have as many rows, got {len(a)} and {len(b)}; one row per item"
        )


def positive(value: float, name: str, unit: str = "") -> float:
    """`value` as a float, if finite and > 0. Raises InputError otherwise."""
    if not (_is_finite(value) and value > 0):
        raise InputError(f"`{name}` must be positive{_in(unit)}, got {value!r}")
    return float(value)


def finite(value: float, name: str, unit: str = "") -> float:
    """`value` as a float, if finite. Raises InputError otherwise."""
    if not _is_finite(value):
        raise InputError(f"`{name}` must be finite{_in(unit)}, got {value!r}")
    return float(value)


def not_negative(value: float, name: str, unit: str = "") -> float:
    """`value` as a float, if finite and >= 0. Raises InputError otherwise."""
    if not (_is_finite(value) and value >= 0):
        raise InputError(f"`{name}` must be 0 or more{_in(unit)}, got {value!r}")
    return float(value)


def _is_finite(value: float) -> bool:
    """Whether it is one number, and finite: words and lists are none."""
    number = np.asarray(value)
    return number.ndim == 0 and number.dtype.kind in "iuf" and bool(np.isfinite(number))


def _in(unit: str) -> str:
    return f" ({unit})" if unit else ""
