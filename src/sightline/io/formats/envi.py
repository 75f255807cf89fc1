"""Wavelengths in an ENVI header (``.hdr``): ``wavelength = {...}``, nm unless it says otherwise.

Not here: pixels (``images.py``).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.access import read_bytes
from sightline.errors import FormatError, reads

Array = NDArray[np.float64]

_LIST = re.compile(r"^\s*wavelength\s*=\s*\{([^}]*)\}", re.IGNORECASE | re.MULTILINE)
_UNITS = re.compile(r"^\s*wavelength units\s*=\s*\{?\s*([^}\n]*?)\s*\}?\s*$", re.IGNORECASE | re.MULTILINE)
#: nm of each unit, in the singular; the last two are the micro sign and the Greek letter.
_NM = {"nanometer": 1.0, "nanometre": 1.0, "nm": 1.0, "unknown": 1.0, "": 1.0}
_UM = dict.fromkeys(("micrometer", "micrometre", "micron", "um", "\u00b5m", "\u03bcm"), 1e3)


@reads("an ENVI header")
def read_envi_wavelengths(path: Path) -> Array:
    """Wavelengths (n,) nm, in the order of the header.

    Raises
    ------
    FormatError
        If the file is no ENVI header, has no wavelengths, or has them in a unit that is no length.
    """
    content = read_bytes(path, "an ENVI header", advice="check [camera] wavelength_nm")
    text = content.decode("utf-8", "replace")
    if not text.lstrip("\ufeff").startswith("ENVI"):
        raise FormatError(f"{path}: is no ENVI header (its first line is not ENVI)")
    found, unit = _LIST.search(text), _UNITS.search(text)
    if found is None:
        raise FormatError(f"{path}: has no wavelength = {{...}}; give wavelength_nm as a list")
    name = unit[1].strip().lower().rstrip("s") if unit else ""
    scale = {**_NM, **_UM}.get(name)
    if scale is None:
        raise FormatError(
            f"{path}: wavelength units = {unit[1] if unit else ''!r}; nanometers or micrometers are expected"
        )
    try:
        values = scale * np.array([float(word) for word in found[1].replace("\n", " ").split(",")])
    except ValueError:
        raise FormatError(
            f"{path}: wavelength holds {found[1].strip()[:40]!r}; numbers are expected"
        ) from None
    if not (np.isfinite(values).all() and (values > 0.0).all()):
        raise FormatError(f"{path}: a wavelength is not positive; positive numbers are expected")
    return values
