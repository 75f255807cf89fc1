"""Attitudes of a camera → C kernels of SPICE (type 3) with the frame they are of; the jitter table of ISIS.

Not here: reading kernels of real data (``simulate/measured.py``).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.access import LARGE, check_file, read_bytes
from sightline.errors import FormatError, InputError, foreign_errors
from sightline.writing import whole_text

Array = NDArray[np.float64]

#: Instruments of a spacecraft are numbered from its number times 1000 down; so many further lie our cameras.
_FIRST_CAMERA = 990
#: Numbers of instruments of a spacecraft are its own times this, and more.
_INSTRUMENTS = 1000
#: What tells the clock of a spacecraft in a kernel.
_CLOCK = re.compile(rb"SCLK_DATA_TYPE_(\d{1,9})\s*=")
#: Characters of a path that SPICE takes.
_LONGEST_PATH = 255


def spice() -> Any:
    """spiceypy, of the extra `spice`."""
    try:
        return import_module("spiceypy")
    except ImportError:
        raise InputError(
            "a C kernel needs spiceypy, which is not installed; run `pip install spiceypy`"
        ) from None


@dataclass(frozen=True)
class SpacecraftClock:
    """The clock of a spacecraft, of a kernel.

    Attributes
    ----------
    spacecraft : int
        Negative, as NAIF numbers it.
    """

    spacecraft: int

    def ticks(self, et: Array) -> Array:
        """Encoded ticks, with fractions, of instants (N,), s past J2000."""
        library = spice()
        return np.array([library.sce2c(self.spacecraft, float(instant)) for instant in et])


@contextmanager
def spice_kernels(kernels: Sequence[Path]) -> Iterator[Any]:
    """spiceypy with kernels loaded during the block, beside those that the process has loaded itself."""
    library, held = spice(), []
    for path in kernels:
        check_file(path, "give kernels that are there", most=LARGE)
        if len(str(path)) > _LONGEST_PATH:
            raise FormatError(f"{path}: SPICE takes paths of {_LONGEST_PATH} characters; move the file")
    try:
        for path in kernels:
            with foreign_errors(path, "cannot be loaded as a SPICE kernel", "give an LSK and an SCLK"):
                library.furnsh(str(path))
            held.append(str(path))
        yield library
    finally:
        for name in held:
            library.unload(name)


def spacecraft_clock(kernels: Sequence[Path]) -> SpacecraftClock:
    """The one spacecraft clock that the kernels hold."""
    found = set()
    for path in kernels:
        text = read_bytes(path, "a SPICE kernel", most=LARGE, advice="give kernels that are there")
        found |= {int(number) for number in _CLOCK.findall(text)}
    # a spacecraft may have a second, finer clock, numbered as one of its instruments
    spacecraft = {number if number < _INSTRUMENTS else number // _INSTRUMENTS for number in found}
    if len(spacecraft) != 1:
        names = ", ".join(path.name for path in kernels) or "none"
        raise InputError(
            f"--to ck needs the clock of one spacecraft, the kernels given ({names}) hold {len(spacecraft)}: "
            "add --kernel FILE, its SCLK (.tsc), and another of leap seconds (.tls)"
        )
    return SpacecraftClock(-min(found))


def write_ck(
    path: Path,
    et: Array,
    ref_from_camera: Rotation,
    clock: SpacecraftClock,
    *,
    number: int,
    name: str,
    reference: str,
) -> int:
    """A C kernel of type 3, with angular velocities, and beside it a frame kernel that names its axes.

    Parameters
    ----------
    path : Path
        ``.bc``, made; the frame kernel takes its name and ends with ``.tf``.
    et : (N,)
        s past J2000 (TDB), increasing.
    ref_from_camera : Rotation
        N rotations. Camera axes: x towards increasing samples, y towards increasing lines, z to the scene.
    clock : SpacecraftClock
    number : int
        0, 1, ... of the camera among those that are written.
    name : str
        Of the frame.
    reference : str
        SPICE's name of the axes.

    Returns
    -------
    int
        Number of the frame.
    """
    library = spice()
    identity = _INSTRUMENTS * clock.spacecraft - _FIRST_CAMERA - number
    matrices = ref_from_camera.inv().as_matrix()
    quaternions = np.array([library.m2q(matrix) for matrix in matrices])
    turns = (ref_from_camera[1:] * ref_from_camera[:-1].inv()).as_rotvec() / np.diff(et)[:, None]
    rates = np.vstack([turns[:1], 0.5 * (turns[1:] + turns[:-1]), turns[-1:]])
    advice = "do the SCLK and the leap second kernel cover the image?"
    with foreign_errors(path, "cannot be written as a C kernel", advice, raises=InputError):
        ticks = clock.ticks(et)
        if not (np.diff(ticks) > 0.0).all():
            raise InputError(f"{path.name}: the spacecraft clock does not tell neighbouring lines apart")
        handle = library.ckopn(str(path), "Sightline", 0)
        try:
            library.ckw03(
                handle, ticks[0], ticks[-1], identity, reference, True, name[:40], len(ticks), ticks,
                quaternions, rates, 1, [ticks[0]],
            )  # fmt: skip
        finally:
            library.ckcls(handle)
    whole_text(path.with_suffix(".tf"), _frame_kernel(name, identity, clock.spacecraft))
    return identity


def _frame_kernel(name: str, identity: int, spacecraft: int) -> str:
    """The definition of a frame of class 3 (C kernel)."""
    rows = (
        f"FRAME_{name} = {identity}",
        f"FRAME_{identity}_NAME = '{name}'",
        f"FRAME_{identity}_CLASS = 3",
        f"FRAME_{identity}_CLASS_ID = {identity}",
        f"FRAME_{identity}_CENTER = {spacecraft}",
        f"CK_{identity}_SCLK = {spacecraft}",
        f"CK_{identity}_SPK = {spacecraft}",
    )
    return "KPL/FK\n\n\\begindata\n\n" + "\n".join(f"   {row}" for row in rows) + "\n\n\\begintext\n"


def write_jitter_table(path: Path, et: Array, shifts: Array, words: Sequence[str]) -> None:
    """The jitter table of ISIS: sample px, line px, ET (s past J2000) in each row, after lines of words.

    Parameters
    ----------
    path : Path
    et : (N,)
    shifts : (N, 2)
        px, lines and columns.
    words : sequence of str
        What is said of it.
    """
    lines = [f"# {text}" for text in words]
    lines += [
        f"{column:.16f}     {line:.16f}     {instant:.9f}"
        for (line, column), instant in zip(shifts.tolist(), et.tolist(), strict=True)
    ]
    whole_text(path, "\n".join(lines) + "\n")
