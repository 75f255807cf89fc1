"""What a product says of itself, whatever its maker calls it.

Not here: reading one (``worldview.py``, ...), which reader a file is for (``recognise.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from sightline.io.formats.line_scan import LineScanModel
from sightline.products.rpc import Rpc


@dataclass(frozen=True)
class ProductBand:
    """One band of a product, and where its pixels are.

    Attributes
    ----------
    name : str
    image : str
        File that the metadata names, without folders; empty where it names none.
    image_band : int
        Which band of that file, from 1.
    """

    name: str
    image: str
    image_band: int = 1


def bands_of(names: Sequence[str], files: Sequence[str]) -> tuple[ProductBand, ...]:
    """Every band, in its order in the one file that there is; of several (tiles) none is named."""
    image = files[0] if len(files) == 1 else ""
    return tuple(ProductBand(name, image, number) for number, name in enumerate(names, 1))


@dataclass(frozen=True)
class GroundMark:
    """A pixel whose place on the ground the product gives: a corner, a vertex.

    Attributes
    ----------
    name : str
    line, column : float
        px, 0-based; an integer is the centre of a pixel.
    longitude, latitude : float
        Degrees.
    height : float or None
        m above the ellipsoid; None where the product does not say it.
    """

    name: str
    line: float
    column: float
    longitude: float
    latitude: float
    height: float | None = None


@dataclass(frozen=True)
class Tile:
    """A file of pixels, and which part of the image it holds.

    Attributes
    ----------
    image : str
        File that the metadata name, without folders.
    line, column, lines, columns : int
        px; where it begins, from 0, and its size.
    bands : (int, int) or None
        Its first band and how many it holds, of those of the image, from 0; None: all of them.
    """

    image: str
    line: int
    column: int
    lines: int
    columns: int
    bands: tuple[int, int] | None = None


@dataclass(frozen=True)
class Pixels:
    """Files of an image that are no raster by themselves: tiles of one, or bare numbers.

    Attributes
    ----------
    tiles : tuple of Tile
    type : str
        As GDAL calls it.
    skipped : int or None
        Bytes before the first number where the one file holds bare numbers, lines of all bands in turn (BIL);
        None where tiles are rasters.
    big_endian : bool
        Order of the bytes of bare numbers.
    """

    tiles: tuple[Tile, ...]
    type: str
    skipped: int | None = None
    big_endian: bool = False


@dataclass(frozen=True)
class RawBands:
    """What metadata tell of bands before they were resampled.

    Attributes
    ----------
    lags : mapping
        Band to the s by which it sees the ground after the first.
    line_period : float
        s, of the first.
    begin : float
        s from line 0 of the product's model to when the first band sees that line's ground.
    doubt : str
        Why these cannot be used; empty where they can.
    """

    lags: Mapping[str, float]
    line_period: float
    begin: float = 0.0
    doubt: str = ""


@dataclass(frozen=True, eq=False)
class Product:
    """A product: the rigorous model of its scene, and what its maker says beside it.

    Attributes
    ----------
    path : Path
        Its metadata, as ``[platform] model`` names it.
    kind : str
        Maker and level in words.
    name : str
        Title of the acquisition.
    model : LineScanModel
        t = 0 at `epoch`.
    epoch : str
        UTC of t = 0, ISO 8601.
    bands : tuple of ProductBand
    height : float or None
        m above the ellipsoid: of the ground, as far as the product tells.
    marks : tuple of GroundMark
        Corners and vertices.
    rpc : Rpc or None
        The maker's own rational polynomials, ground to pixels.
    attitude_sigma : float or None
        rad about each axis: error of the attitudes, one for the whole strip.
    assumed, unknown : tuple of str
        What was assumed of it; what it does not say.
    raw : RawBands or None
    pixels : Pixels or None
        Where the files that the metadata name are no raster by themselves.
    """

    path: Path
    kind: str
    name: str
    model: LineScanModel
    epoch: str
    bands: tuple[ProductBand, ...]
    height: float | None = None
    marks: tuple[GroundMark, ...] = ()
    rpc: Rpc | None = None
    attitude_sigma: float | None = None
    assumed: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
    raw: RawBands | None = None
    pixels: Pixels | None = None


def image_name(given: str) -> str:
    """The file that metadata name, without the folders of the machine that wrote them (Windows' too)."""
    return given.strip().replace("\\", "/").rstrip("/").rpartition("/")[2]
