"""A sensor model of any kind that is read, by what the file holds: ISDs, model states, metadata of products.

Not here: the readers (``isd.py``, ``products/``).
"""

from __future__ import annotations

from pathlib import Path

from sightline.io.formats.isd import read_line_scan_model
from sightline.io.formats.line_scan import LineScanModel
from sightline.io.formats.products.recognise import product_kind, read_product


def read_sensor_model(
    path: Path, reference: tuple[float, float] | None = None, band: int = 1
) -> LineScanModel:
    """A line-scan sensor model.

    Parameters
    ----------
    path : Path
        USGS CSM ISD or model state (JSON), or metadata of a product (``products/``).
    reference : (float, float), optional
        That of another model, whose t = 0 is meant; the first line of the image if not given.
    band : int
        Which band of its image is meant, from 1, where a product gives each its own looks.

    Returns
    -------
    LineScanModel

    Raises
    ------
    FormatError
        Names the file, and the key where one is wrong.
    """
    if product_kind(path) is None:
        return read_line_scan_model(path, reference)
    return read_product(path, reference, band).model
