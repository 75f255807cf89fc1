"""Pictures and maps of colours inside a page: PNG as a ``data:`` address, palettes.

Not here: what is shown.
"""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

Array = NDArray[np.float64]
Pixels = NDArray[np.uint8]

#: Colours of a palette from its least value to its largest; those between are interpolated.
PALETTES = {
    "viridis": "#440154 #472c7a #3b518b #2c718e #21908d #27ad81 #5cc863 #aadc32 #fde725".split(),
    "cividis": "#00204d #00336f #39486b #575c6d #707173 #8a8779 #a69d75 #c4b56c #e4cf5b #ffea46".split(),
    "heat": "#ffffcc #ffeda0 #fed976 #feb24c #fd8d3c #fc4e2a #e31a1c #bd0026 #800026".split(),
    "diverging": (
        "#053061 #2166ac #4393c3 #92c5de #d1e5f0 #f7f7f7 #fddbc7 #f4a582 #d6604d #b2182b #67001f".split()
    ),
}
PALETTES["depth"] = PALETTES["viridis"][::-1]
#: Steps of a palette; the colour after the last is that of no value.
STEPS = 255


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green, blue of ``#rrggbb``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def lookup(colours: list[str]) -> Pixels:
    """(`STEPS`, 3) colours of a palette."""
    stops = np.array([rgb(colour) for colour in colours], dtype=np.float64)
    place = np.linspace(0.0, len(stops) - 1.0, STEPS)
    return (
        np.stack([np.interp(place, np.arange(len(stops)), s) for s in stops.T], axis=1)
        .round()
        .astype(np.uint8)
    )


def codes(values: Array, low: float, high: float) -> Pixels:
    """Steps of a palette from `low` to `high` for values; `STEPS` where they are not finite."""
    with np.errstate(invalid="ignore"):
        place = np.clip((values - low) / ((high - low) or 1.0), 0.0, 1.0) * (STEPS - 1)
    return np.where(np.isfinite(values), np.nan_to_num(place).round(), STEPS).astype(np.uint8)


def data_png(pixels: Pixels, palette: Pixels | None = None, clear: int | None = None) -> Markup:
    """A picture as a ``data:`` address of a PNG, which a page takes as it is.

    Parameters
    ----------
    pixels : (lines, columns, 3) or (lines, columns)
        Colours, or numbers of colours.
    palette : (n, 3), optional
        The colours that numbers stand for.
    clear : int, optional
        Number that is not painted.
    """
    lines, columns = pixels.shape[:2]
    rows = np.concatenate([np.zeros((lines, 1), np.uint8), pixels.reshape(lines, -1)], axis=1)
    header = struct.pack(">IIBBBBB", columns, lines, 8, 2 if palette is None else 3, 0, 0, 0)
    parts = [(b"IHDR", header)]
    if palette is not None:
        parts.append((b"PLTE", palette.astype(np.uint8).tobytes()))
    if clear is not None:
        parts.append((b"tRNS", b"\xff" * clear + b"\x00"))
    parts += [(b"IDAT", zlib.compress(rows.tobytes(), 9)), (b"IEND", b"")]
    body = b"".join(_chunk(kind, content) for kind, content in parts)
    return Markup("data:image/png;base64," + base64.b64encode(b"\x89PNG\r\n\x1a\n" + body).decode("ascii"))


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
