"""Which product a file is of, by what it holds; the metadata inside a folder.

Not here: the readers (one file for each maker's format).
"""

from __future__ import annotations

import re
from pathlib import Path

from sightline.access import check_file
from sightline.errors import FormatError, foreign_errors, reads
from sightline.io.formats.products.product import Product

#: Bytes at the begin of a file by which it is recognised.
_HEAD = 8192
#: Kinds of products, and what the begin of their metadata holds.
_KINDS = (
    ("worldview", rb"<isd[\s>]"),
    ("worldview", rb"BEGIN_GROUP\s*=\s*IMAGE_1|\bproductLevel\s*="),
    ("pleiades", rb"<PHR_Dimap_Document[\s>]"),
    ("sentinel2-granule", rb"<(?:\w+:)?Level-1B_Granule_ID[\s>]"),
    ("sentinel2-datastrip", rb"<(?:\w+:)?Level-1B_DataStrip_ID[\s>]"),
    ("dimap1", rb"<METADATA_FORMAT\s+version\s*=\s*[\"']1"),
    ("dimap2", rb"<METADATA_FORMAT\s+version\s*=\s*[\"']2"),
)
#: What is read, in words.
KNOWN = (
    "read are WorldView and QuickBird, level 1B (XML, or IMD with ATT, EPH and GEO), SPOT 6, SPOT 7 and "
    "Pleiades (DIMAP 2, level SENSOR), SPOT 5 (DIMAP 1, level 1A), Pleiades (PHRDIMAP), Sentinel-2 "
    "granules with their datastrip (L1B), channels of HiRISE (EDR) and raw images of JunoCam"
)
#: What packed folders begin with.
_PACKED = ((b"PK\x03\x04", "zip"), (b"\x1f\x8b", "gzip"), (b"BZh", "bzip2"), (b"\xfd7zXZ", "xz"))
#: Where a tar file says that it is one.
_TAR = (257, b"ustar")
#: Endings of metadata files that are looked for in a folder; folders within it that are looked into.
_ENDINGS, _DEPTH = (".xml", ".imd", ".dim"), 3
#: Files that a message names at most.
_NAMED = 10
#: What other files of a DIMAP 2 product (its RPC, its lineage) hold in the begin, which is none of its model.
_OTHER_PART = rb"<METADATA_SUBPROFILE>\s*(?!PRODUCT)"
#: What its volume holds.
_VOLUME = rb"<DATASET_TYPE>\s*VOLUME|<METADATA_PROFILE>[^<]*VOLUME"


def product_kind(path: Path) -> str | None:
    """Name of the reader that a file is for; None where it is no metadata of a product that is read.

    FormatError where the file cannot be opened.
    """
    check_file(path)
    head = _head(path)
    return next((kind for kind, pattern in _KINDS if re.search(pattern, head)), None)


def _head(path: Path) -> bytes:
    """How a file begins."""
    with foreign_errors(path, "cannot be read as a sensor model", "check its permissions"):
        with path.open("rb") as stream:
            head = stream.read(_HEAD)
    for mark, code in ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16")):
        if head.startswith(mark):
            return head.decode(code, "replace").encode("utf-8")
    return head


@reads("metadata of a product")
def read_product(path: Path, reference: tuple[float, float] | None = None, band: int = 1) -> Product:
    """A product.

    Parameters
    ----------
    path : Path
        Its metadata, or a folder that holds one.
    reference : (float, float), optional
        That of another model, whose t = 0 is meant; the first line of the image if not given.
    band : int
        Which band of its image the model is of, from 1, where each has its own looks.

    Returns
    -------
    Product

    Raises
    ------
    FormatError
        Names the file, and the value that is missing or wrong.
    """
    path = metadata_of(path)
    match product_kind(path):
        case "worldview":
            from sightline.io.formats.products.worldview import read_worldview

            return read_worldview(path, reference, band)
        case "dimap2":
            from sightline.io.formats.products.dimap2 import read_dimap2

            return read_dimap2(path, reference)
        case "dimap1":
            from sightline.io.formats.products.dimap1 import read_dimap1

            return read_dimap1(path, reference, band)
        case "pleiades":
            from sightline.io.formats.products.pleiades import read_pleiades

            return read_pleiades(path, reference)
        case "sentinel2-granule" | "sentinel2-datastrip":
            raise FormatError(
                f"{path}: Sentinel-2 L1B tells when lines were exposed, not where columns look (GIPP files "
                "that are no part of it): no model can be made; `sightline init GRANULE.xml DATASTRIP.xml` "
                "takes the metadata of both, with the published look angles"
            )
        case _:
            raise FormatError(f"{path}: is no metadata of a product that is read; {KNOWN}")


def metadata_of(path: Path) -> Path:
    """The metadata that a product is given by: the file itself, or the one that a folder holds.

    Raises
    ------
    FormatError
        If it is not there, is packed, or a folder holds none or several.
    """
    if not path.is_dir():
        check_file(path, "give the metadata file of a product, or its folder")
        with path.open("rb") as stream:
            head = stream.read(_TAR[0] + len(_TAR[1]))
        packed = next((name for begin, name in _PACKED if head.startswith(begin)), None)
        if packed is None and head[_TAR[0] :] == _TAR[1]:
            packed = "tar"
        if packed is not None:
            raise FormatError(f"{path}: is packed ({packed}); unpack it, and give the folder that comes out")
        return path
    found = _inside(path, _DEPTH)
    if len(found) != 1:
        names = [file.relative_to(path).as_posix() for file in found]
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        held = f"it holds {', '.join(names[:_NAMED])}{more}" if found else "it holds none"
        raise FormatError(
            f"{path}: a folder with the metadata of one product is expected, {held}; name the file itself; "
            f"{KNOWN}"
        )
    return found[0]


def _inside(folder: Path, depth: int) -> list[Path]:
    """Metadata of products in a folder; where it holds none, in those within it."""
    with foreign_errors(folder, "cannot be read", "check its permissions"):
        entries = sorted(folder.iterdir())
    files = [file for file in entries if file.suffix.lower() in _ENDINGS and file.is_file()]
    found = [file for file in files if product_kind(file) is not None and _holds_model(file)]
    # some makers deliver the same metadata twice
    whole = {file.stem for file in found if file.suffix.lower() == ".xml"}
    found = [file for file in found if file.suffix.lower() == ".xml" or file.stem not in whole]
    if found or not depth:
        return found
    inner = [entry for entry in entries if entry.is_dir() and not entry.is_symlink()]
    return [file for one in inner for file in _inside(one, depth - 1)]


def _holds_model(path: Path) -> bool:
    """Whether it is no other file of a product: its RPC, its lineage, its volume."""
    head = _head(path)
    return not (re.search(_OTHER_PART, head) or re.search(_VOLUME, head))
