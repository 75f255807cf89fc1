"""What may be opened: files of this machine that are what they seem, in bounded size; the network on demand.

Files that the user names are opened wherever they lie. What these refer to in turn (the sources of a VRT, the
data of a detached label) lies at or below the folder of the TOML file, or of the file itself; ``[files]
allow`` names further folders. No request leaves the machine outside `allow_network`.

Not here: what the files of other programs refer to (``imaging/rasters.py``), what is in them (``io/``).
"""

from __future__ import annotations

import json
import os
import re
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sightline.errors import FormatError, foreign_errors
from sightline.inputs import note

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Bytes of a file that are read at most: of TOML; of tables and messages; of images and models of flights.
SMALL, TABLE, LARGE = 2 << 20, 512 << 20, 4 << 30

#: Drivers of GDAL that ask servers.
NETWORK_DRIVERS = (
    "WMS", "WMTS", "WCS", "WFS", "OAPIF", "OGCAPI", "HTTP", "STACIT", "STACTA", "PLMOSAIC", "PLSCENES",
    "EEDA", "EEDAI", "DAAS", "NGW", "DODS", "RASDAMAN", "PostGISRaster", "GeoRaster", "CSW", "Carto",
    "AmigoCloud", "Elastic",
)  # fmt: skip
#: Schemes of addresses, and the virtual file systems of GDAL that ask servers.
_SCHEMES = {"http": "curl", "https": "curl", "ftp": "curl", "s3": "s3", "gs": "gs", "az": "az", "oss": "oss"}
_VIRTUAL = ("curl", "s3", "gs", "az", "adls", "oss", "swift", "webhdfs")
#: An address (its two slashes may have become one in a path), and a virtual path of GDAL.
_ADDRESS = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/+(.+)")
_VSI = re.compile(r"/vsi([a-z0-9]+?)(?:_streaming)?/.*", re.IGNORECASE)
#: Archives of GDAL, endings of their files, subdatasets, and the parts of those that are read.
_ARCHIVES, _PACKS = ("zip", "tar", "gzip"), (".zip", ".kmz", ".tar", ".tgz", ".gz")
_PACKED = re.compile(r"/vsi(zip|tar|gzip)/(.+)", re.IGNORECASE)
_SUBDATASET = re.compile(
    r"(?:(.*?)/)?(NETCDF|GTIFF_DIR|HDF4?5?(?:_SDS|_GR|IMAGE)?|SENTINEL2_\w+|SENTINEL1_\w+|BAG|ZARR|"
    r"NITF_IM|RADARSAT_2_CALIB|DERIVED_SUBDATASET|DOQ2|GPKG|MBTILES|RASTERLITE2?|PDF|EEDAI):(.+)",
    re.IGNORECASE,
)
_SENTINEL2 = re.compile(r'"?(?P<file>[^"]+?)"?:(?P<inner>[^":/]+(?::EPSG_\d+)?)')
_PARTS = {
    "NETCDF": re.compile(r'"?(?P<file>[^"]+?)"?:/*(?P<inner>[^":]+)'),
    "HDF5": re.compile(r'"?(?P<file>[^"]+?)"?:/*(?P<inner>[^":/][^":]*)'),
    "GTIFF_DIR": re.compile(r"(?P<inner>\d+):(?P<file>.+)"),
    **{f"SENTINEL2_{level}": _SENTINEL2 for level in ("L1B", "L1C", "L1C_TILE", "L2A")},
}
#: What is read for a mistake about the kind of a file, by its mode.
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFIFO: "a pipe (FIFO)",
    stat.S_IFSOCK: "a socket",
}


@dataclass(frozen=True)
class Access:
    """What the files that are being read may refer to.

    Attributes
    ----------
    folders : tuple of Path
        Beside the folder of each file itself, at any depth.
    network : bool
        Whether pixels may be asked of servers.
    """

    folders: tuple[Path, ...] = ()
    network: bool = False


_access: ContextVar[Access | None] = ContextVar("access", default=None)


def current_access() -> Access:
    """What may be opened here and now; images keep it for when they are read."""
    return _access.get() or Access()


@contextmanager
def allow_network() -> Iterator[None]:
    """Let what is loaded in the block ask servers for pixels, now and when they are read.

    Examples
    --------
    >>> import sightline
    >>> with sightline.allow_network():
    ...     acquisition = sightline.load_acquisition("acquisition.toml")
    """
    with using(replace(current_access(), network=True)):
        yield


@contextmanager
def allow_folders(folders: Sequence[Path]) -> Iterator[None]:
    """Let files that are read in the block refer to what lies in `folders`, in place of those before."""
    with using(replace(current_access(), folders=tuple(folders))):
        yield


@contextmanager
def using(access: Access) -> Iterator[None]:
    """Let the block open what `access` says: in another thread, what was said where an image was named."""
    token = _access.set(access)
    try:
        yield
    finally:
        _access.reset(token)


def let_network() -> None:
    """The same as `allow_network` for all that this thread still does: of a command."""
    _access.set(replace(current_access(), network=True))


def shut_network() -> None:
    """Take from GDAL and PROJ, in this process and its children, all that asks servers.

    To be called before either is loaded. What refers to servers is refused by name before it is opened; this
    stands behind that.
    """
    given = os.environ.get("GDAL_SKIP", "").replace(",", " ").split()
    os.environ["GDAL_SKIP"] = " ".join(dict.fromkeys([*given, *NETWORK_DRIVERS]))
    os.environ["PROJ_NETWORK"] = "OFF"


def remote_name(path: str | os.PathLike[str]) -> str | None:
    """The name by which GDAL asks a server for what an address stands for; None for paths of this machine.

    Raises
    ------
    FormatError
        If it is neither: an address of another kind, or a virtual path within this machine.
    """
    text = os.fspath(path)
    virtual = _VSI.fullmatch(text)
    address = None if virtual else _ADDRESS.fullmatch(text)
    if (virtual is None and address is None) or _exists(Path(text)):
        return None
    if virtual is not None and virtual[1].lower() in _VIRTUAL:
        return re.sub(r":/(?!/)", "://", text, count=1)
    if address is not None and address[1].lower() in _SCHEMES:
        scheme = address[1].lower()
        place = f"{scheme}://{address[2]}" if _SCHEMES[scheme] == "curl" else address[2]
        return f"/vsi{_SCHEMES[scheme]}/{place}"
    raise FormatError(
        f"{text}: is no path of a file; give one (of an archive: unpack it first), or an address that begins "
        "with http:// or https://"
    )


@dataclass(frozen=True)
class InnerImage:
    """Pixels inside a file, as GDAL names them.

    Attributes
    ----------
    file : Path
        The archive, HDF5, netCDF or TIFF; metadata of a Sentinel-2 product.
    kind : str
        ``"zip"``, ``"tar"``, ``"gzip"``, ``"HDF5"``, ``"NETCDF"``, ``"GTIFF_DIR"``, ``"SENTINEL2_L1B"``...
    inner : str
        The file in an archive, the path of the data, the number of the directory, the resolution.
    """

    file: Path
    kind: str
    inner: str

    @property
    def name(self) -> str:
        """By which GDAL opens it."""
        place = os.path.abspath(self.file)
        if self.kind in _ARCHIVES:
            return f"/vsi{self.kind}/{place}" + (f"/{self.inner}" if self.inner else "")
        if self.kind == "GTIFF_DIR":
            return f"GTIFF_DIR:{self.inner}:{place}"
        if self.kind == "HDF5":
            return f'HDF5:"{place}"://{self.inner}'
        if self.kind == "NETCDF":  # a path of groups begins at the root, a variable of the root has none
            return f'NETCDF:"{place}":{"/" if "/" in self.inner else ""}{self.inner}'
        return f"{self.kind}:{place}:{self.inner}"


def inner_image(path: str | os.PathLike[str]) -> InnerImage | None:
    """What a name stands for that is of pixels inside a file of this machine; None for all other names.

    Raises
    ------
    FormatError
        If it is of a kind whose data may lie in other files that cannot be checked.
    """
    text = os.fspath(path)
    if _exists(Path(text)):
        return None
    archive, inside = _PACKED.fullmatch(text), _SUBDATASET.fullmatch(text)
    if archive is not None:
        place = Path("/") / archive[2]
        file = next((one for one in (place, *place.parents) if one.is_file()), None)
        if file is None:  # the archive is missing: name it, not what is in it
            file = next((one for one in reversed(place.parents) if one.suffix.lower() in _PACKS), place)
        inner = place.relative_to(file).as_posix() if place != file else ""
        return InnerImage(file, archive[1].lower(), inner)
    if inside is None:
        return None
    folder, kind = Path(inside[1] or ""), inside[2].upper()
    found = _PARTS.get(kind)
    parts = None if found is None else found.fullmatch(inside[3])
    if parts is None:
        raise FormatError(
            f"{text}: data of {kind} may lie in other files that cannot be checked, or are not named so; "
            'read are HDF5:"FILE"://PATH, NETCDF:"FILE":VARIABLE, GTIFF_DIR:NUMBER:FILE, '
            'SENTINEL2_L1B:"FILE":10m, /vsizip/FILE/INNER, /vsitar/ and /vsigzip/; make a GeoTIFF of it '
            "(gdal_translate)"
        )
    return InnerImage(folder / parts["file"], kind, parts["inner"])


def located(folder: Path, name: str) -> Path:
    """The path behind a name in a file of `folder`; an address stays as it is."""
    packed = _PACKED.fullmatch(name)
    if packed is not None and not _VSI.fullmatch(f"/{packed[2]}"):
        return Path(f"/vsi{packed[1].lower()}/{os.path.abspath(folder / packed[2])}")
    path = folder / name
    elsewhere = _VSI.fullmatch(name) or _ADDRESS.fullmatch(name)
    return Path(name) if elsewhere and not _exists(path) else path


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def refuse_network(place: object, what: str) -> FormatError:
    """The error of what asks a server, where that is not allowed."""
    return FormatError(
        f"{place}: {what}, and no request leaves this machine unless that is allowed; add --allow-network "
        "(in Python: with sightline.allow_network()), or give a file that holds the data themselves"
    )


def _advice(error: BaseException, advice: str) -> str:
    """What to do about an error of opening: the name is right where only the right to read is missing."""
    if isinstance(error, PermissionError):
        return "the file is there, but may not be read: see its permissions and those of its folder"
    return advice


def check_file(path: Path, advice: str = "check the name", place: object = None, most: int = 0) -> None:
    """FormatError unless `path` is a regular file that is there.

    Parameters
    ----------
    path : Path
        Links are followed.
    advice : str
        What to do where it is not there.
    place : object, optional
        What the message begins with; the path if not given.
    most : int, optional
        Bytes that it may hold.
    """
    where = f"{path}" if place is None else f"{place}: {path}"
    note(path)
    if remote_name(path) is not None:
        raise FormatError(f"{where}: is an address; only images and heights are read from servers; fetch it")
    try:
        status = os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        if "~" in path.parts:
            advice = "~ is not replaced by the home folder in a file: give the whole path"
        raise FormatError(f"{where}: no such file; {advice}") from None
    except (OSError, ValueError) as error:  # too long a name, a zero in it
        said = error.strerror if isinstance(error, OSError) else str(error)
        raise FormatError(f"{where}: cannot be opened ({said}); {_advice(error, advice)}") from None
    if not stat.S_ISREG(status.st_mode):
        kind = _KINDS.get(stat.S_IFMT(status.st_mode), "no file")
        raise FormatError(f"{where}: is {kind}; a regular file is expected; {advice}")
    if most and status.st_size > most:
        raise FormatError(
            f"{where}: holds {status.st_size:,} bytes; {most:,} at most are read of such a file; {advice}"
        )


def read_bytes(path: Path, what: str, *, most: int = TABLE, advice: str = "check the name") -> bytes:
    """The content of a file, of `most` bytes at most.

    Parameters
    ----------
    path : Path
    what : str
        What is expected, for messages: ``"a CSV table"``.
    most : int
    advice : str
        What to do where it is not there.

    Raises
    ------
    FormatError
        If it is missing, no regular file, too large, or cannot be read.
    """
    check_file(path, advice, most=most)
    with foreign_errors(path, f"cannot be read as {what}", advice):
        try:
            with path.open("rb") as stream:
                size = min(os.fstat(stream.fileno()).st_size, most)
                content = stream.read(size + 1)  # memory is taken for all that is asked for
        except PermissionError as error:
            said = f"cannot be opened ({error.strerror}); {_advice(error, advice)}"
            raise FormatError(f"{path}: {said}") from None
    if len(content) > size:
        raise FormatError(f"{path}: grows while it is read; give a file that is finished")
    return content


def read_text(path: Path, what: str, *, most: int = TABLE, advice: str = "check the name") -> str:
    """The same as `read_bytes`, as UTF-8 without the byte order mark."""
    content = read_bytes(path, what, most=most, advice=advice)
    refuse_utf16(path, content)
    with foreign_errors(path, f"cannot be read as {what}", "text in UTF-8 is expected"):
        return content.decode("utf-8-sig")


def refuse_utf16(path: Path, content: bytes) -> None:
    """FormatError where text begins with a byte order mark of UTF-16, or with Latin letters of 16 bits."""
    head = content[:4]
    latin = len(head) == 4 and any(head[k::2] == b"\0\0" and all(head[1 - k :: 2]) for k in (0, 1))
    if latin or head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise FormatError(f"{path}: is text in UTF-16; text in UTF-8 is expected: save it as UTF-8")


def read_json(path: Path, what: str, *, advice: str = "check the name", before: str = "") -> Any:
    """The content of a JSON file.

    Parameters
    ----------
    path : Path
    what, advice : str
        As of `read_bytes`.
    before : str
        What the value begins with where other text may stand before it, as ``"{"``.
    """
    text = read_text(path, what, advice=advice)
    start = max(text.find(before), 0) if before else 0
    with foreign_errors(path, "not valid JSON", f"{what} is expected"):
        return json.loads(text[start:])


def read_arrays(path: Path, what: str, advice: str) -> Mapping[str, NDArray[Any]]:
    """All arrays of an ``.npz`` file by name; FormatError where it is none, or too large unpacked."""
    import zipfile

    import numpy as np

    check_file(path, advice, most=LARGE)
    with foreign_errors(path, f"cannot be read as {what}", advice):
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > LARGE:
            raise FormatError(f"{path}: unpacks to {size:,} bytes; {LARGE:,} at most are read; {advice}")
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}


def check_inside(path: Path, folders: Sequence[Path], owner: Path) -> None:
    """FormatError unless what `owner` refers to lies in one of the folders, links followed."""
    real = path.resolve()
    if any(real.is_relative_to(folder) for folder in folders):
        return
    link = f" (a link to {real})" if real != Path(os.path.abspath(path)) else ""
    raise FormatError(
        f"{owner}: refers to {path}{link}, which lies outside the folders that it may refer to "
        f"({', '.join(map(str, folders))}); move it there, or name its folder in the TOML file: "
        f'[files] allow = ["{real.parent}"]'
    )


def folders_for(path: Path, access: Access) -> tuple[Path, ...]:
    """Folders, links followed, that a file may refer to: of the access, its own, and that it is linked to."""
    own = (Path(os.path.abspath(path)).parent, path.resolve().parent)
    return tuple(dict.fromkeys(folder.resolve() for folder in (*own, *access.folders)))
