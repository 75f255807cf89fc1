"""Tables of Earth orientation: IERS finals2000A and C04, of a file or of the package astropy-iers-data.

Not here: what they are used for (``geometry/earth_orientation.py``).
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.access import read_text
from sightline.errors import FormatError, reads
from sightline.geometry.earth_orientation import EarthOrientation, FixedAxes, fixed_axes, orbit_package
from sightline.io.formats.instants import modified_julian_day, tai_offset

Array = NDArray[np.float64]

_ARCSECOND = np.pi / 180.0 / 3600.0
#: Columns of finals2000A (its README counts from 1), and factors to arcseconds and seconds.
_FINALS = {
    "mjd": (7, 15, 1.0), "x": (18, 27, 1.0), "x_sigma": (27, 36, 1.0), "y": (37, 46, 1.0),
    "y_sigma": (46, 55, 1.0), "ut1": (58, 68, 1.0), "ut1_sigma": (68, 78, 1.0), "dx": (97, 106, 1e-3),
    "dy": (116, 125, 1e-3),
}  # fmt: skip
#: Places of the same numbers in rows of C04: of the series 20 (with hours), and of 14 and before.
_C04 = {
    21: {"mjd": 4, "x": 5, "y": 6, "ut1": 7, "dx": 8, "dy": 9, "x_sigma": 13, "y_sigma": 14, "ut1_sigma": 15},
    16: {"mjd": 3, "x": 4, "y": 5, "ut1": 6, "dx": 8, "dy": 9, "x_sigma": 10, "y_sigma": 11, "ut1_sigma": 12},
}
#: Where each number must lie: days of 1846 to 2200, arcseconds, seconds.
_BOUNDS = {"mjd": (-4400.0, 125_000.0), "x": (-3.0, 3.0), "y": (-3.0, 3.0), "ut1": (-70.0, 70.0)}
#: Arcseconds; of dX on most days.
_LARGEST_OFFSET = 0.005
_MJD_0 = datetime(1858, 11, 17, tzinfo=UTC)
_WHAT = "a table of Earth orientation (IERS finals2000A or C04)"


@reads(_WHAT)
def read_earth_orientation(path: Path) -> EarthOrientation:
    """A file of IERS finals2000A or C04, whichever it is.

    Parameters
    ----------
    path : Path
        As the IERS writes them: finals2000A(.all, .data, .daily) in fixed columns; eopc04 with a row per day.

    Raises
    ------
    FormatError
        If it is neither, its days do not rise, or a number is impossible.
    """
    lines = read_text(path, _WHAT).splitlines()
    first = next((line for line in lines if line.strip()), "")
    return _table(path, _finals(lines) if _is_finals(first) else _c04(path, lines), path.name)


def packaged_earth_orientation(mjd: float) -> EarthOrientation:
    """The table of astropy-iers-data for a day: C04 where it reaches so far, else finals2000A, with "
    "predictions."""
    known = _packaged("eopc04.1962-now")
    return known if mjd <= known.mjd[-1] else _packaged("finals2000A.all")


@cache
def _packaged(name: str) -> EarthOrientation:
    package = orbit_package(
        "astropy_iers_data", "Earth orientation (or `[platform] earth_orientation = FILE`)"
    )
    table = read_earth_orientation(Path(str(package.__file__)).parent / "data" / name)
    what = "IERS C04" if name.startswith("eopc04") else "IERS finals2000A"
    version = getattr(package, "__version__", "")
    return EarthOrientation(
        table.mjd, table.pole, table.ut1_less_tai, table.cip, table.sigma_pole, table.sigma_ut1,
        f"{what} of astropy-iers-data {version}".strip(),
    )  # fmt: skip


def _is_finals(line: str) -> bool:
    """Whether a line has its day where finals2000A has it, with a point two digits before its end."""
    day = line[7:15].strip()
    return len(line) >= 60 and day[-3:-2] == "." and day.replace(".", "").isdigit()


def _number(cell: str) -> float:
    return float(cell) if cell.strip() else np.nan


def _finals(lines: list[str]) -> dict[str, Array]:
    """Columns of finals2000A; rows without UT1 are of days that nobody has predicted."""
    rows = [line for line in lines if line[58:68].strip()]
    return {
        name: factor * np.array([_number(line[low:high]) for line in rows])
        for name, (low, high, factor) in _FINALS.items()
    }


def _c04(path: Path, lines: list[str]) -> dict[str, Array]:
    """Columns of C04: rows that begin with a year."""
    rows = [line.split() for line in lines if line[:4].strip().isdigit()]
    width = len(rows[0]) if rows else 0
    if width not in _C04 or any(len(row) != width for row in rows):
        raise FormatError(
            f"{path}: is no table of Earth orientation; finals2000A or C04 of the IERS is expected, as "
            "they are "
            "written there"
        )
    values = np.array(rows, dtype=np.float64)
    return {name: values[:, place] for name, place in _C04[width].items()}


def _table(path: Path, columns: dict[str, Array], source: str) -> EarthOrientation:
    """The checked table of columns in arcseconds and seconds."""
    if len(columns["mjd"]) < 2:
        raise FormatError(f"{path}: holds fewer than two days of Earth orientation; give the whole file")
    for name, (low, high) in _BOUNDS.items():
        odd = ~((columns[name] >= low) & (columns[name] <= high))
        if odd.any():
            row = int(np.argmax(odd))
            raise FormatError(
                f"{path}: {name} of row {row + 1} is {columns[name][row]:g}; allowed is {low:g} to "
                f"{high:g}; the "
                "file is damaged, or another one is meant"
            )
    # dX of IAU 2000 is some .0002" (.009" on days of 1982); dPsi of IAU 1980, in the same place, is -.05 to
    # -.1" since 1990
    of_pole = np.abs(columns["dx"])
    if np.isfinite(of_pole).any() and np.nanmedian(of_pole) > _LARGEST_OFFSET:
        raise FormatError(
            f"{path}: its offsets of the pole are of the older model IAU 1980 (dPsi, dEps); give "
            "finals2000A, or C04 of IAU 2000"
        )
    mjd = columns["mjd"]
    if np.any(np.diff(mjd) <= 0.0):
        raise FormatError(f"{path}: the days do not rise at row {int(np.argmin(np.diff(mjd) > 0.0)) + 2}")
    offsets = np.array([tai_offset(_MJD_0 + timedelta(days=float(day))) for day in mjd])
    filled = {name: np.nan_to_num(column) for name, column in columns.items()}
    return EarthOrientation(
        mjd=mjd,
        pole=_ARCSECOND * np.column_stack([columns["x"], columns["y"]]),
        ut1_less_tai=columns["ut1"] - offsets,
        cip=_ARCSECOND * np.column_stack([filled["dx"], filled["dy"]]),
        sigma_pole=_ARCSECOND * np.maximum(filled["x_sigma"], filled["y_sigma"]),
        sigma_ut1=filled["ut1_sigma"],
        source=source,
    )


class TurningEarth:
    """The Earth's rotation about an epoch, by a table that is opened when it is first asked for.

    Parameters
    ----------
    epoch : str or None
        UTC of t = 0; without it nothing can be asked.
    path : Path, optional
        Table of the user; else that of astropy-iers-data.
    """

    def __init__(self, epoch: str | None, path: Path | None = None) -> None:
        """Nothing is read yet."""
        self._epoch, self._path = epoch, path

    @cached_property
    def _start(self) -> tuple[int, float, int]:
        """The epoch: modified Julian day, s of it, TAI - UTC (s)."""
        if self._epoch is None:
            raise FormatError(
                'axes of the stars need an epoch; add [acquisition] epoch = "..." (UTC of t = 0)'
            )
        return modified_julian_day(0.0, self._epoch)

    @cached_property
    def table(self) -> EarthOrientation:
        """The table."""
        return (
            packaged_earth_orientation(self.day())
            if self._path is None
            else read_earth_orientation(self._path)
        )

    def day(self, t: float = 0.0) -> float:
        """Modified Julian day (UTC) at t (s)."""
        return self._start[0] + (self._start[1] + t) / 86400.0

    def ut1_less_utc(self, t: float) -> float:
        """UT1 - UTC (s) at t (s), UTC as at the epoch."""
        return float(self.table.ut1_less_tai_at(self.day(t))) + self._start[2]

    def axes(self, axes: str, t: Array) -> FixedAxes:
        """Earth-fixed axes against others at times (N,), s."""
        day, second, offset = self._start
        return fixed_axes(axes, t, (day, second + offset), self.table)

    def angle_sigma(self, t: float) -> float:
        """rad; how well Earth-fixed axes are known against the stars at t (s)."""
        return self.table.angle_sigma_at(self.day(t))

    def words(self, t: float) -> str:
        """Which table, and what is not known at t (s)."""
        day = self.day(t)
        ut1, pole = self.table.sigma_at(day)
        first, last = (str((_MJD_0 + timedelta(days=float(end))).date()) for end in self.table.mjd[[0, -1]])
        reach = "" if self.table.covers(day) else f", which covers {first} to {last} and not the images"
        return (
            f"Earth orientation by {self.table.source}{reach}: UT1 known to {1e3 * ut1:.2g} ms, the pole to "
            f"{1e3 * pole / _ARCSECOND:.2g} mas"
        )
