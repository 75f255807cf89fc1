"""MTF and SNR predicted per column → how much sharper matches are in one column than in another.

Reads ``choice.csv`` of ``sightline tdi``, or any table ``column,mtf_x,mtf_y,snr``.

Not here: what is made of it (``motion/measure/stars.py``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError, reads
from sightline.io.formats.tables import header_of, read_columns

Array = NDArray[np.float64]

QUALITY = ("column", "mtf_x", "mtf_y", "snr")
#: A column is not taken for less than this share of the best: noise and aliasing are matched there too.
LEAST = 0.02


@reads("a table of quality")
def read_match_sigma(path: Path, columns: int) -> Array:
    """(columns, 2) relative sigma along lines and columns of matches at every column; the best is 1.

    Parameters
    ----------
    path : Path
        ``column,mtf_x,mtf_y,snr``; with a ``signal`` column, as of ``choice.csv``, its rows are averaged.
    columns : int
        Of the image; columns between those of the table are interpolated.

    Raises
    ------
    FormatError
        If values are not positive, or columns lie outside the image.

    Notes
    -----
    What a window knows of its place falls with the contrast of what it shows: sigma ~ 1 / (MTF x SNR), MTF
    along lines (y) or columns (x) at the frequency that the table is for.
    """
    header = header_of(path)
    names = (*QUALITY, "signal") if "signal" in header else QUALITY
    table = {name: np.asarray(value, dtype=np.float64) for name, value in read_columns(path, names).items()}
    at, where = np.unique(table["column"], return_inverse=True)
    if at[0] < 0.0 or at[-1] > columns - 1.0 or (at != np.round(at)).any():
        raise FormatError(
            f"{path}: columns {at[0]:g} to {at[-1]:g} do not lie in an image of {columns} columns (0 to "
            f"{columns - 1}); give the table of this band"
        )
    worth = np.empty((len(at), 2))
    for axis, name in enumerate(("mtf_y", "mtf_x")):
        product = table[name] * table["snr"]
        if not (product > 0.0).all():
            row = int(np.flatnonzero(~(product > 0.0))[0])
            raise FormatError(
                f"{path}: {name} x snr is {product[row]:g} at column {table['column'][row]:g}; MTF and SNR "
                "above 0 are expected"
            )
        # signals weigh alike: each relative to its own mean over the columns
        if "signal" in table:
            _, signal = np.unique(table["signal"], return_inverse=True)
            product = product / (np.bincount(signal, product) / np.bincount(signal))[signal]
        worth[:, axis] = np.bincount(where, product) / np.bincount(where)
    worth = np.maximum(worth / worth.max(axis=0), LEAST)
    every = np.arange(columns)
    return 1.0 / np.column_stack([np.interp(every, at, worth[:, axis]) for axis in range(2)])
