"""Raster files of any GDAL format, opened only if they, and all that they refer to, may be read.

GDAL knows formats by content, not by name: a file called ``.tif`` may be a list of other files (VRT) or ask
a server (WMS). So only formats that hold their own pixels are tried, and what the others refer to is read
here and checked before GDAL sees it.

Not here: what may be opened at all (``access.py``), pixels in windows (``io/formats/images.py``).
"""

from __future__ import annotations

import gzip
import os
import re
import sys
import tarfile
import threading
import warnings
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple
from xml.etree import ElementTree

from sightline.access import (
    NETWORK_DRIVERS,
    Access,
    InnerImage,
    check_file,
    check_inside,
    current_access,
    folders_for,
    inner_image,
    read_text,
    refuse_network,
    remote_name,
)
from sightline.errors import FormatError, SightlineError, foreign_errors
from sightline.imaging.hdf5_links import check_hdf5, hdf5_start

#: MiB of decoded raster blocks that GDAL may keep (its own choice, 5 % of the machine, would hold whole
#: strips); an environment variable GDAL_CACHEMAX that is already set prevails.
CACHE_MIB = 64
#: Drivers of GDAL whose files hold their pixels, or have them in files of the same name beside them, or refer
#: to others by labels that are read here. None of HDF4, PCIDSK, PAux, SNODAS and SDTS: they name other files
#: where only their own libraries find them. HDF5 and netCDF 4 have drivers of their own, once walked through.
LOCAL_DRIVERS = (
    "GTiff", "COG", "LIBERTIFF", "SNAP_TIFF", "JPEG", "JPEGXL", "PNG", "GIF", "BIGGIF", "BMP", "WEBP",
    "AVIF", "HEIF", "JP2OpenJPEG", "JP2KAK", "JP2ECW", "JP2Lura", "JP2MrSID", "JPEGLS", "ECW", "MrSID",
    "ENVI", "EHdr", "NITF", "HFA", "GRIB", "FITS", "ISIS2", "ISIS3", "PDS", "PDS4", "VICAR", "SRTMHGT",
    "DTED", "USGSDEM", "AAIGrid", "GRASSASCIIGrid", "ISG", "GSAG", "GSBG", "GS7BG", "XYZ", "ACE2", "AIG",
    "BT", "BYN", "GTX", "NTv2", "CTable2", "NGSGEOID", "LOSLAS", "ROI_PAC", "ISCE", "RMF", "SAGA", "RST",
    "RRASTER", "PCRaster", "ZMap", "SGI", "PNM", "TGA", "XPM", "Leveller", "Terragen", "HF2", "GXF",
    "SIGDEM", "NWT_GRD", "NWT_GRC", "LCP", "CEOS", "SAR_CEOS", "JAXAPALSAR", "ESAT", "L1B",
    "NOAA_B", "COSAR", "AirSAR", "DIPEx", "ELAS", "FIT", "GFF", "GSC", "IRIS", "JDEM", "KRO", "LAN",
    "MSGN", "NSIDCbin", "BSB", "BLX", "CALS", "CTG", "DOQ1", "DOQ2", "E00GRID", "GenBin",
)  # fmt: skip
#: Bytes of a file that are looked at to find what it is, and that a description of other files may have.
HEAD, LARGEST_LIST = 65536, 64 << 20
#: Files that rasters may refer to, and levels at which these refer to others.
MOST_FILES, DEEPEST = 100_000, 16

#: What begins descriptions of data on servers: WMS, WMTS, WCS, tile services, catalogues.
_ASKS = re.compile(
    rb"<(?:\w+:)?(gdal_wmt?s|wms_\w+|wmt_ms_capabilities|wcs_gdal|wcs_\w+|capabilities|tilemapservice|kml|mrf_meta)"
    rb'\b|"stac_(?:version|extensions)"|"tilejson"',
    re.IGNORECASE,
)
_LISTS = b"<VRTDataset"
#: Elements and attributes of VRT and PDS4 that name files, and keys of metadata and arguments that do.
_NAMES = re.compile(r"(filename|file_name|sourcedataset|dempath)$")
_KEYS = re.compile(r"x_dataset|y_dataset|overview_file|.*filename.*", re.IGNORECASE)
#: Labels of PDS3 and ISIS, and what they point to: ``^IMAGE = ("FILE.IMG", 2)``.
_LABEL = re.compile(rb"PDS_VERSION_ID|ODL_VERSION_ID|Object\s*=\s*IsisCube|CCSD3ZF|NJPL1", re.IGNORECASE)
_POINTER = re.compile(r"^\s*\^\s*\w+\s*=\s*\(?\s*(?:\"([^\"\n]+)\"|'([^'\n]+)'|([^\s(),<]+))", re.MULTILINE)
#: Files that GDAL looks for beside a raster: rasters of their own, begun so, and notes.
_BESIDE, _NOTES = (".ovr", ".OVR", ".msk", ".MSK"), ".aux.xml"
_RASTERS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"EHFA")
#: Files of ERDAS Imagine, and names in them of files that hold their pixels or overviews.
_HFA, _SPILL = b"EHFA", re.compile(rb"[^\0-\x1f\x7f]{1,240}?\.(?:ige|rrd)(?=\0)", re.IGNORECASE)
#: What files begin with that nothing but a driver of `LOCAL_DRIVERS` takes.
_CLASSIC = (b"CDF\1", b"CDF\2", b"CDF\5")  # of netCDF: such files hold all of their data
_KNOWN = (*_RASTERS, b"\xff\xd8\xff", b"\x89PNG", b"\0\0\0\x0cjP", b"NITF", *_CLASSIC)
#: Drivers of files that hold all of their pixels, what these begin with, and bytes that tell it.
_SELF_CONTAINED = ("GTiff", "JPEG", "PNG", "JP2OpenJPEG", "NITF")
_WHOLE = (*_RASTERS[:4], b"\xff\xd8\xff", b"\x89PNG", b"\0\0\0\x0cjP", b"NITF")
_MAGIC = 16
#: Images of a file that a message names at most.
_NAMED = 6
#: Drivers of what lies inside a file, by the kind of its name.
_INSIDE = {
    "NETCDF": ("netCDF",), "HDF5": ("HDF5Image", "HDF5"), "GTIFF_DIR": ("GTiff",),
    **{f"SENTINEL2_{level}": ("SENTINEL2",) for level in ("L1B", "L1C", "L1C_TILE", "L2A")},
}  # fmt: skip
#: Drivers of HDF5 as a file. GDAL asks that of netCDF first.
_HDF5 = ("netCDF", "HDF5", "HDF5Image")
_JPEG2000 = b"\0\0\0\x0cjP"

# Filters of warnings and hooks belong to the process: only one thread at a time may change them.
_OPENING = threading.Lock()


def raster_errors(path: Path) -> AbstractContextManager[None]:
    """Turn what the raster library raises into a FormatError that names the file."""
    return foreign_errors(
        path,
        "the pixels cannot be read",
        "the file is truncated, damaged or not a raster; copy or make it again",
    )


def _inner_errors(path: Path) -> AbstractContextManager[None]:
    """The same for pixels inside a file, whose name has two parts."""
    return foreign_errors(path, "is not in the file, or that is damaged", "check both names")


@contextmanager
def raster_environment(access: Access) -> Iterator[None]:
    """What GDAL may do while it opens and reads: no Python of a VRT, no cache of tiles, no server unasked."""
    import rasterio

    options = {
        "GDAL_VRT_ENABLE_PYTHON": "NO",
        "GDAL_ENABLE_WMS_CACHE": "NO",
        "CPL_VSIL_GZIP_WRITE_PROPERTIES": "NO",  # beside the user's file
    }
    if access.network:
        options |= {"GDAL_HTTP_CONNECTTIMEOUT": "10", "GDAL_HTTP_TIMEOUT": "60"}
    else:
        options |= {"CPL_VSIL_CURL_ALLOWED_EXTENSIONS": ".none"}
    with rasterio.Env.from_defaults(**options):
        yield


@contextmanager
def raster_cache(size: int) -> Iterator[None]:
    """In the block GDAL keeps at most so many bytes of decoded blocks, unless the user has said how many."""
    import rasterio

    if os.environ.get("GDAL_CACHEMAX", str(CACHE_MIB)) != str(CACHE_MIB):
        yield
        return
    with rasterio.Env(GDAL_CACHEMAX=size):
        yield


def open_raster(path: Path, access: Access | None = None) -> Any:
    """A raster as a dataset of rasterio, which the caller closes.

    Parameters
    ----------
    path : Path
        The file, or the address of one on a server.
    access : Access, optional
        What it may refer to; that of the context if not given.

    Raises
    ------
    FormatError
        If it is missing, not a raster that can be read, or refers to what may not be read.
    """
    access = current_access() if access is None else access
    path = Path(path)
    inside = inner_image(path)
    if inside is not None:
        return _opened_within(path, inside, access)
    remote = remote_name(path)
    if remote is not None and not access.network:
        raise refuse_network(path, "is an address")
    drivers: Sequence[str] = (*LOCAL_DRIVERS, *NETWORK_DRIVERS) if access.network else LOCAL_DRIVERS
    if remote is not None:
        return _opened(path, remote, drivers, access)
    check_file(path)
    check = _References(path, access)
    try:
        drivers = check.follow(path) or drivers
    except FormatError as error:
        if str(error).startswith(f"{path}: "):
            raise
        raise FormatError(f"{path}: {error}") from error
    dataset = _opened(path, os.path.abspath(path), drivers, access)
    try:
        check.counted(dataset.files)
        if dataset.count == 0:
            raise FormatError(f"{path}: holds several images: name one, {_several(dataset)}")
        _refuse_complex(path, dataset)
    except SightlineError:
        dataset.close()
        raise
    return dataset


def _several(dataset: Any) -> str:
    """Names of the first images of a file that holds several."""
    names = [name.replace(os.path.dirname(dataset.name) + "/", "") for name in dataset.subdatasets]
    return ", ".join(names[:_NAMED]) + (f" ... ({len(names)} in all)" if len(names) > _NAMED else "")


def _opened_within(path: Path, inside: InnerImage, access: Access) -> Any:
    """Pixels inside a file: of an archive only formats that hold all of theirs, and nothing beside them."""
    import rasterio

    drivers: Sequence[str] = _INSIDE.get(inside.kind, _SELF_CONTAINED)
    if drivers is _SELF_CONTAINED:
        check_file(inside.file, "check the name of the archive", path)
        if not _head_in(path, inside).startswith(_WHOLE):
            raise FormatError(
                f"{path}: of an archive TIFF, JPEG, PNG, JPEG 2000 and NITF are read; unpack it"
            )
    else:
        check_file(inside.file, "check the name", path)
        check = _References(inside.file, access)
        kinds = check.follow(inside.file)
        if inside.kind == "NETCDF" and "netCDF" not in kinds:
            raise FormatError(f"{path}: is no netCDF; name the raster itself, without NETCDF:")
        if inside.kind == "HDF5" and kinds != _HDF5:
            raise FormatError(f"{path}: is no HDF5; name the raster itself, without HDF5:")
        if drivers == ("SENTINEL2",):
            return _checked_product(path, inside, check, access)
    with rasterio.Env(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR"):
        dataset = _opened(path, inside.name, drivers, access, inside=True)
    try:
        _refuse_complex(path, dataset)
    except SightlineError:
        dataset.close()
        raise
    return dataset


def _checked_product(path: Path, inside: InnerImage, check: _References, access: Access) -> Any:
    """Pixels of a Sentinel-2 product: of JPEG 2000 files below its metadata, each looked at beforehand."""
    seen = 0
    for folder, _, names in os.walk(inside.file.parent):
        for name in names:
            if seen > MOST_FILES:
                raise FormatError(f"{path}: holds more than {MOST_FILES:,} files; unpack one product alone")
            seen += 1
            if name.lower().endswith((".jp2", ".xml")):
                check.part(Path(folder, name))
    dataset = _opened(path, inside.name, ("SENTINEL2",), access, inside=True)
    try:
        check.counted(dataset.files)
        for name in dataset.files:
            check.part(Path(name))
        if dataset.count == 0:
            raise FormatError(f"{path}: no image of {inside.inner} lies beside its metadata; unpack it whole")
    except SightlineError:
        dataset.close()
        raise
    return dataset


def _head_in(path: Path, inside: InnerImage) -> bytes:
    """The first bytes of a file in an archive."""
    with foreign_errors(path, "is not in the archive, or that is damaged", "check both names"):
        if inside.kind == "zip":
            with zipfile.ZipFile(inside.file) as archive, archive.open(inside.inner) as stream:
                return stream.read(_MAGIC)
        if inside.kind == "gzip":
            with gzip.open(inside.file) as stream:
                return stream.read(_MAGIC)
        with tarfile.open(inside.file) as packed:
            member = packed.extractfile(inside.inner)
            if member is None:
                raise FormatError(f"{path}: is no regular file of the archive; name one")
            return member.read(_MAGIC)


def _refuse_complex(path: Path, dataset: Any) -> None:
    """FormatError for pixels that are no real numbers: half of each would be lost without a word."""
    for number, kind in enumerate(dataset.dtypes, 1):
        if "complex" in str(kind):
            raise FormatError(
                f"{path}: its band {number} holds complex numbers ({kind}); real ones are expected: give "
                "their magnitude, or another file"
            )


@contextmanager
def _messages_that_are_no_text() -> Iterator[None]:
    """GDAL quotes bytes of a file in its messages; where they are no text, rasterio fails and prints that."""
    uncaught, ignored = sys.excepthook, sys.unraisablehook

    def of_message(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if not issubclass(kind, UnicodeDecodeError):
            uncaught(kind, error, trace)

    def of_callback(what: Any) -> None:
        if not issubclass(what.exc_type, UnicodeDecodeError):
            ignored(what)

    sys.excepthook, sys.unraisablehook = of_message, of_callback
    try:
        yield
    finally:
        sys.excepthook, sys.unraisablehook = uncaught, ignored


def _refuse_missing(path: Path, drivers: Sequence[str]) -> None:
    """FormatError where the raster library was built without the one kind of files that this is."""
    import rasterio

    if len(drivers) > len(_HDF5):
        return
    with rasterio.Env() as environment:
        held = environment.drivers()
    if not any(driver in held for driver in drivers):
        raise FormatError(
            f"{path}: the GDAL of this installation ({rasterio.__gdal_version__}) has no driver "
            f"{' or '.join(drivers)}; install rasterio with it, or make a GeoTIFF elsewhere (gdal_translate)"
        )


def _opened(path: Path, name: str, drivers: Sequence[str], access: Access, *, inside: bool = False) -> Any:
    from rasterio import Env
    from rasterio.errors import NotGeoreferencedWarning, RasterioIOError
    from rasterio.io import DatasetReader

    _refuse_missing(path, drivers)
    os.environ.setdefault("GDAL_CACHEMAX", str(CACHE_MIB))
    os.environ.setdefault("CPL_LOG", os.devnull)  # what GDAL warns of goes to stderr else
    with (
        _OPENING,
        _inner_errors(path) if inside else raster_errors(path),
        raster_environment(access),
        warnings.catch_warnings(),
        _messages_that_are_no_text(),
    ):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            dataset = DatasetReader(name, driver=list(drivers), sharing=False)
            if dataset.driver == "netCDF" and dataset.transform.is_identity:
                # GDAL turns upside down what has no coordinates; lines of a strip follow each other in time
                dataset.close()
                with Env(GDAL_NETCDF_BOTTOMUP="NO"):
                    dataset = DatasetReader(name, driver=list(drivers), sharing=False)
            return dataset
        except RasterioIOError as error:
            if "supported file format" not in str(error):
                raise
            raise FormatError(
                f"{path}: is no raster, a damaged one, or one that only lists other files; copy it again, or "
                "name a file that holds the pixels (gdal_translate makes a GeoTIFF of most)"
            ) from error


class _Name(NamedTuple):
    """A file that another names: whether by a path from the folder of work, and whether as bare bytes."""

    text: str
    anywhere: bool = False
    bare: bool = False


class _References:
    """Everything that a raster refers to, followed and checked before GDAL follows it.

    Parameters
    ----------
    owner : Path
        The raster.
    access : Access
    """

    def __init__(self, owner: Path, access: Access) -> None:
        self.owner, self.access = owner, access
        self.folders = folders_for(owner, access)
        self.seen: set[Path] = set()

    def follow(self, path: Path, depth: int = 0, *, bare: bool = False) -> tuple[str, ...]:
        """Check a file, those beside it and those that it names; the drivers it is for, none: the usual."""
        advice = "check the name" if depth == 0 else f"{self.owner.name} refers to it"
        check_file(path, advice)
        if depth:
            check_inside(path, self.folders, self.owner)
        real = path.resolve()
        if bare or real in self.seen:
            return ()
        self.seen.add(real)
        if len(self.seen) > MOST_FILES or depth > DEEPEST:
            raise FormatError(
                f"{self.owner}: refers to more than {MOST_FILES:,} files, or through more than {DEEPEST} "
                "others to them; make one raster of it (gdal_translate)"
            )
        with foreign_errors(path, "cannot be read", advice), path.open("rb") as stream:
            head = stream.read(HEAD)
        self._beside(path)
        text = head.split(b"\0", 1)[0]  # GDAL looks for words no further
        marked = text.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"<", b"{", b"[")
        asks = _ASKS.search(text)
        if head.startswith(_HFA):
            found = (name.decode("latin-1") for name in dict.fromkeys(_SPILL.findall(_whole(path))))
            named = [_Name(name, bare=name.lower().endswith(".ige")) for name in found]
            self._names(path, named, depth, needed=False)
        if marked and _LISTS in text:
            self._names(path, _named_in(path), depth)
            return ("VRT",)
        if hdf5_start(path) is not None:
            check_hdf5(path)
            return _HDF5
        if marked and asks is not None:
            if not self.access.network:
                word = (asks[1] or asks[0]).decode("latin-1").strip('"')
                raise refuse_network(path, f"holds no pixels but asks a server for them ({word})")
        elif marked and b"<Product_Observational" in text:
            self._names(path, _named_in(path, label=True), depth)
        elif _LABEL.search(text[:1024]):
            found = (next(filter(None, match)) for match in _POINTER.findall(text.decode("latin-1")))
            # labels also point to descriptions that nobody keeps with the data
            self._names(path, [_Name(name) for name in found if not name.isdigit()], depth, needed=False)
        elif depth and (marked or _LISTS in text or asks is not None):
            # GDAL would choose what it takes this for by itself
            raise FormatError(f"{self.owner}: refers to {path}, which holds no pixels; name rasters that do")
        elif depth and not head.startswith(_KNOWN):
            _opened(path, os.path.abspath(path), LOCAL_DRIVERS, self.access).close()
        return ("netCDF",) if head.startswith(_CLASSIC) else ()

    def counted(self, names: Sequence[str]) -> None:
        """Check what GDAL itself counts among the files of the raster."""
        own = self.owner.resolve()
        for name in names:
            if not (self.access.network and remote_name(name)) and Path(name).resolve() != own:
                check_inside(Path(name), self.folders, self.owner)

    def part(self, path: Path) -> None:
        """FormatError unless a file of a product holds its own pixels, or is metadata without entities."""
        check_file(path, "unpack the product again")
        check_inside(path, self.folders, self.owner)
        with foreign_errors(path, "cannot be read", "unpack the product again"), path.open("rb") as stream:
            head = stream.read(_MAGIC)
        if path.suffix.lower() == ".xml":
            _refuse_entities(path, read_text(path, "metadata", most=LARGEST_LIST))
        elif not head.startswith(_JPEG2000):
            raise FormatError(
                f"{path}: is no JPEG 2000, as images of Sentinel-2 are; unpack the product again"
            )

    def _beside(self, path: Path) -> None:
        """Overviews and masks beside a raster, which GDAL opens with any driver, and notes."""
        for suffix in (*_BESIDE, _NOTES):
            other = path.with_name(f"{path.name}{suffix}")
            if not os.path.lexists(other):
                continue
            check_file(other, "remove it, or make it again")
            check_inside(other, self.folders, self.owner)
            if suffix == _NOTES:
                self._names(other, _named_in(other, notes=True), 0)
                continue
            with foreign_errors(other, "cannot be read", "remove it"), other.open("rb") as stream:
                head = stream.read(4)
            if head and head not in _RASTERS:
                raise FormatError(
                    f"{other}: is no TIFF, as overviews and masks beside {path.name} are; remove it"
                )

    def _names(self, path: Path, named: Sequence[_Name], depth: int, *, needed: bool = True) -> None:
        """Check the files that another names."""
        beside = dict.fromkeys((Path(os.path.abspath(path)).parent, path.resolve().parent))
        for name in named:
            if self._asked(path, name.text):
                continue
            places = [folder / name.text for folder in (*beside, *((Path.cwd(),) if name.anywhere else ()))]
            there = [place for place in dict.fromkeys(places) if os.path.lexists(place)]
            if not there and needed:
                raise FormatError(
                    f"{path}: refers to {name.text}: no such file; bring it there, or name where it is"
                )
            for place in there:
                self.follow(place, depth + 1, bare=name.bare)

    def _asked(self, path: Path, name: str) -> bool:
        """Whether a name is that of data on a server, where these are allowed; refuse what is no path."""
        try:
            remote = remote_name(name)
        except FormatError as error:
            raise FormatError(f"{path}: refers to {error}") from None
        if remote is None and re.match(r"\s*(<|[A-Za-z][A-Za-z0-9_.+-]+:)", name):
            raise FormatError(
                f"{path}: refers to {name[:80]!r}, which is no path of a file; write what it means as a file "
                "of its own (gdal_translate)"
            )
        if remote is not None and not self.access.network:
            raise refuse_network(path, f"refers to {name}")
        return remote is not None


def _whole(path: Path) -> bytes:
    """A file of ERDAS Imagine as far as names may stand in it: one with pixels elsewhere is small."""
    with foreign_errors(path, "cannot be read", "make it again"), path.open("rb") as stream:
        return stream.read(LARGEST_LIST)


def _refuse_entities(path: Path, content: str) -> None:
    """FormatError for what means something else to GDAL than to the parser here."""
    if re.search(r"<!\s*(DOCTYPE|ENTITY)", content, re.IGNORECASE):
        raise FormatError(f"{path}: declares entities (DOCTYPE); write it without")


def _named_in(path: Path, *, label: bool = False, notes: bool = False) -> list[_Name]:
    """Files that a VRT, a PDS4 label or notes (.aux.xml) name."""
    content = read_text(path, "a description of a raster", most=LARGEST_LIST)
    _refuse_entities(path, content)
    with foreign_errors(path, "is no XML that can be checked", "make it again"):
        root = ElementTree.fromstring(content)
        within = {child: _plain(element.tag) for element in root.iter() for child in element}
    found: list[_Name] = []
    for element in root.iter():
        # GDAL takes attributes and elements inside for the same, in any case of letters
        tag, inside = _plain(element.tag), {_plain(k): v for k, v in element.attrib.items()}
        value = "".join(element.itertext()).strip()
        if not notes and "python" in {**inside, tag: value}.get("pixelfunctionlanguage", "").lower():
            raise FormatError(
                f"{path}: holds a program in Python, which is not run; make a raster of its result"
            )
        found += (
            [] if notes else [_Name(v.strip(), True) for k, v in inside.items() if _NAMES.search(k) and v]
        )
        names = []
        if tag in ("mdi", "argument", "ooi"):
            names += [value] if _KEYS.fullmatch(inside.get("key") or inside.get("name") or "") else []
        elif not notes and (_NAMES.search(tag) or "/vsi" in (element.text or "")):
            names.append(value if _NAMES.search(tag) else (element.text or "").strip())
        here = [v for k, v in element.attrib.items() if _plain(k) == "relativetovrt"]
        fixed = label or (len(here) == 1 and here[0].strip().lower() in ("1", "yes", "true", "on"))
        bare = within.get(element) == "vrtrasterband"  # of a VRTRawRasterBand
        found += [_Name(name, not fixed, bare) for name in names if name]
    return found


def _plain(tag: object) -> str:
    """Name of an element or attribute as GDAL compares it, without the name space."""
    return str(tag).rsplit("}", 1)[-1].rsplit(":", 1)[-1].lower()
