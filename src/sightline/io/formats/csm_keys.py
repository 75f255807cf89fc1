"""Keys of USGS CSM files (JSON): values checked for shape, size and finiteness, errors that name the key.

Not here: what the keys mean (``isd.py``, ``focal_plane.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.access import read_json
from sightline.errors import FormatError

Array = NDArray[np.float64]

#: The sensor models whose files are read.
LINE_SCANNER = "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
FRAME = "USGS_ASTRO_FRAME_SENSOR_MODEL"
#: m in the units of ISDs.
_UNITS = {"km": 1e3, "m": 1.0}
#: Stands for no default.
_NEEDED = object()


@dataclass(frozen=True, eq=False)
class CsmKeys:
    """The values of a file, by names of keys with a dot between a table and its key.

    Attributes
    ----------
    path : Path
    values : dict
        What the file holds.
    model : str
        What was expected, for messages.
    """

    path: Path
    values: dict[str, Any]
    model: str

    @property
    def is_state(self) -> bool:
        """Whether the file is a model state (keys ``m_...``) and no ISD."""
        return any(key.startswith("m_") for key in self.values)

    def refused(self, key: str, why: str) -> FormatError:
        """The error of a key that is not as it should be."""
        return FormatError(
            f"{self.path}: the key {key!r} {why}; an ISD or model state of {self.model} is expected"
        )

    def value(self, key: str, default: Any = _NEEDED) -> Any:
        """What a key holds."""
        inner: Any = self.values
        names = key.split(".")
        for depth, name in enumerate(names, 1):
            if not isinstance(inner, dict) or name not in inner:
                if default is _NEEDED:
                    raise self.refused(".".join(names[:depth]), "is missing")
                return default
            inner = inner[name]
        return inner

    def has(self, key: str) -> bool:
        """Whether a key is there and holds something."""
        return self.value(key, None) is not None

    def array(self, key: str, *shape: int) -> Array:
        """Finite numbers of a shape; -1 stands for any length of 1 or more."""
        try:
            array = np.array(self.value(key), dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise self.refused(key, "does not hold numbers, as many in every row") from None
        if not np.isfinite(array).all():
            raise self.refused(key, "holds what is no finite number")
        fits = len(array.shape) == len(shape) and all(
            size == want or (want < 0 and size > 0) for size, want in zip(array.shape, shape, strict=True)
        )
        if not fits:
            wanted = " x ".join("n" if want < 0 else str(want) for want in shape) or "one number"
            raise self.refused(key, f"is of shape {list(array.shape)}, not {wanted}")
        return array

    def numbers(self, key: str) -> Array:
        """A number or a list of them, which may be empty."""
        given = self.value(key)
        if isinstance(given, list):
            return self.array(key, len(given))
        return np.atleast_1d(self.array(key))

    def number(self, key: str) -> float:
        """A finite number."""
        return float(self.array(key))

    def positive(self, key: str) -> float:
        """A number above 0."""
        number = self.number(key)
        if number <= 0.0:
            raise self.refused(key, f"is {number:g}, not above 0")
        return number

    def count(self, key: str, least: int, most: int) -> int:
        """A whole number."""
        number = self.number(key)
        if number != round(number) or not least <= number <= most:
            raise self.refused(key, f"is {number:g}, no whole number from {least} to {most:,}")
        return int(number)

    def times(self, key: str) -> Array:
        """Instants (n,) s that increase."""
        t = self.array(key, -1)
        if (np.diff(t) <= 0.0).any():
            raise self.refused(key, "does not increase")
        return t

    def rows(self, table: str, key: str, width: int, times: Array) -> Array:
        """Rows of a table, one for each of its instants."""
        rows = self.array(f"{table}.{key}", -1, width)
        if len(rows) != len(times):
            raise self.refused(
                f"{table}.{key}", f"has {len(rows)} rows, {table}.ephemeris_times {len(times)}"
            )
        return rows

    def metres(self, key: str) -> float:
        """Metres in the unit of length that a key names."""
        unit = self.value(key, "km")
        if not isinstance(unit, str) or unit.lower() not in _UNITS:
            raise self.refused(key, f"is {str(unit)[:40]!r}, none of {', '.join(_UNITS)}")
        return _UNITS[unit.lower()]


def read_keys(path: Path, model: str) -> CsmKeys:
    """The JSON of a file, checked to be of a sensor model; the name of a model may stand before it."""
    data = read_json(path, "an ISD or model state", advice="check the name in the TOML file", before="{")
    name = data.get("name_model", data.get("m_modelName")) if isinstance(data, dict) else None
    if name != model:
        raise FormatError(f"{path}: is of model {name!r:.80}; {model} is read here")
    return CsmKeys(path, dict(data), model)
