"""RPC00B as text: ``*_RPC.TXT`` (as of IKONOS and GeoEye) and ``.RPB`` (as of WorldView).

In both an integer line or sample is the centre of a pixel, the first being 0; heights count from the
ellipsoid.

Not here: the fit (``products/rpc.py``), RPC in tags of GeoTIFF (``io/results/exports.py``).
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from sightline.products.rpc import Rpc
from sightline.writing import whole_text


def rpc_items(rpc: Rpc) -> dict[str, float | list[float]]:
    """The numbers of an RPC under the names of GDAL's metadata domain."""
    ranges = {
        "LINE": rpc.line, "SAMP": rpc.column, "LAT": rpc.latitude, "LONG": rpc.longitude, "HEIGHT": rpc.height
    }  # fmt: skip
    items: dict[str, float | list[float]] = {f"{name}_OFF": value[0] for name, value in ranges.items()}
    items |= {f"{name}_SCALE": value[1] for name, value in ranges.items()}
    items |= {
        "LINE_NUM_COEFF": rpc.line_numerator.tolist(),
        "LINE_DEN_COEFF": rpc.line_denominator.tolist(),
        "SAMP_NUM_COEFF": rpc.column_numerator.tolist(),
        "SAMP_DEN_COEFF": rpc.column_denominator.tolist(),
    }
    return items


def write_rpc_text(path: Path, rpc: Rpc) -> None:
    """``NAME_RPC.TXT``: a keyword, its value, its unit."""
    units = {"LINE": "pixels", "SAMP": "pixels", "LAT": "degrees", "LONG": "degrees", "HEIGHT": "meters"}
    lines = []
    for key, value in rpc_items(rpc).items():
        if isinstance(value, list):
            lines += [f"{key}_{k}: {one:+.16E}" for k, one in enumerate(value, 1)]
        else:
            lines.append(f"{key}: {value:+.12f} {units[key.split('_')[0]]}")
    whole_text(path, "\n".join(lines) + "\n")


def write_rpb(path: Path, rpc: Rpc, *, satellite: str, band: str, rms_m: float) -> None:
    """``NAME.RPB``; `rms_m` (m) is what lines and columns of the camera and of the RPC differ by."""
    names = (
        ("lineOffset", rpc.line[0]), ("sampOffset", rpc.column[0]), ("latOffset", rpc.latitude[0]),
        ("longOffset", rpc.longitude[0]), ("heightOffset", rpc.height[0]), ("lineScale", rpc.line[1]),
        ("sampScale", rpc.column[1]), ("latScale", rpc.latitude[1]), ("longScale", rpc.longitude[1]),
        ("heightScale", rpc.height[1]),
    )  # fmt: skip
    lists = (
        ("lineNumCoef", rpc.line_numerator), ("lineDenCoef", rpc.line_denominator),
        ("sampNumCoef", rpc.column_numerator), ("sampDenCoef", rpc.column_denominator),
    )  # fmt: skip
    lines = [f'satId = "{_quoted(satellite)}";', f'bandId = "{_quoted(band)}";', 'SpecId = "RPC00B";']
    lines += ["BEGIN_GROUP = IMAGE", "\terrBias = 0.0;", f"\terrRand = {rms_m:.4f};"]
    lines += [f"\t{name} = {value:.12f};" for name, value in names]
    for name, values in lists:
        lines += [f"\t{name} = (", ",\n".join(f"\t\t\t{value:+.16E}" for value in values.tolist()) + ");"]
    whole_text(path, "\n".join([*lines, "END_GROUP = IMAGE", "END;"]) + "\n")


def _quoted(text: str | Iterable[str]) -> str:
    """A name within quotes: letters that would end or turn it are left out."""
    return "".join(letter for letter in text if letter.isprintable() and letter not in '"\\')[:40]
