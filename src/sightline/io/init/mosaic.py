"""A VRT for images of products whose files are no raster by themselves: tiles of one image, or bare numbers.

Not here: what the metadata say of them (``io/formats/products/``).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import escape

from sightline.io.formats.products.product import Pixels
from sightline.io.init.bands import path_from


def mosaic(pixels: Pixels, files: Sequence[Path], shape: tuple[int, int], bands: int, folder: Path) -> str:
    """The text of a VRT.

    Parameters
    ----------
    pixels : Pixels
    files : sequence of Path
        Where each of its tiles is.
    shape : (int, int)
        Lines and columns of the whole image.
    bands : int
    folder : Path
        Where the VRT will lie; sources are relative to it where they can be.
    """
    part = _bare if pixels.skipped is not None else _sources
    inner = "".join(part(pixels, files, shape, bands, band, folder) for band in range(1, bands + 1))
    return f'<VRTDataset rasterXSize="{shape[1]}" rasterYSize="{shape[0]}">\n{inner}</VRTDataset>\n'


def _named(file: Path, folder: Path) -> str:
    """An element that names a file."""
    place = path_from(file, folder)
    relative = 0 if Path(place).is_absolute() else 1
    return f'<SourceFilename relativeToVRT="{relative}">{escape(place)}</SourceFilename>'


def _sources(
    pixels: Pixels, files: Sequence[Path], shape: tuple[int, int], bands: int, band: int, folder: Path
) -> str:
    """A band of tiles side by side."""
    held = [
        (tile, file, band - (tile.bands[0] if tile.bands else 0))
        for tile, file in zip(pixels.tiles, files, strict=True)
        if tile.bands is None or tile.bands[0] < band <= sum(tile.bands)
    ]
    inner = "".join(
        f"    <SimpleSource>{_named(file, folder)}<SourceBand>{number}</SourceBand>"
        f'<SourceProperties RasterXSize="{tile.columns}" RasterYSize="{tile.lines}" '
        f'DataType="{pixels.type}"/>'
        f'<SrcRect xOff="0" yOff="0" xSize="{tile.columns}" ySize="{tile.lines}"/>'
        f'<DstRect xOff="{tile.column}" yOff="{tile.line}" xSize="{tile.columns}" ySize="{tile.lines}"/>'
        "</SimpleSource>\n"
        for tile, file, number in held
    )
    return f'  <VRTRasterBand dataType="{pixels.type}" band="{band}">\n{inner}  </VRTRasterBand>\n'


def _bare(
    pixels: Pixels, files: Sequence[Path], shape: tuple[int, int], bands: int, band: int, folder: Path
) -> str:
    """A band of bare numbers, lines of all bands in turn."""
    size = 1 if pixels.type == "Byte" else 2
    line = shape[1] * size
    return (
        f'  <VRTRasterBand dataType="{pixels.type}" band="{band}" subClass="VRTRawRasterBand">'
        f"{_named(files[0], folder)}<ImageOffset>{(pixels.skipped or 0) + (band - 1) * line}</ImageOffset>"
        f"<PixelOffset>{size}</PixelOffset><LineOffset>{bands * line}</LineOffset>"
        f"<ByteOrder>{'MSB' if pixels.big_endian else 'LSB'}</ByteOrder></VRTRasterBand>\n"
    )
