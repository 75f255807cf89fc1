"""HDF5 whose links lead elsewhere or in circles is refused first; the rest is read.

Files with such links are written here byte by byte after the format's specification (superblock of version
0, object headers of version 1); those to be read come from the library itself, through GDAL's netCDF 4.
"""

from __future__ import annotations

import mmap
import struct

import numpy as np
import pytest
import rasterio
from rasterio.shutil import copy

from sightline.errors import FormatError
from sightline.imaging.hdf5_links import _Bytes, _Walk, check_hdf5, hdf5_start
from sightline.imaging.rasters import open_raster
from sightline.io.formats.images import open_image

#: Where groups of the written files stand.
ROOT, INNER, DATA = 96, 1024, 2048


def message(kind: int, body: bytes, flags: int = 0) -> bytes:
    body += bytes(-len(body) % 8)
    return struct.pack("<HHB3x", kind, len(body), flags) + body


def link(name: str, target: int | str, kind: int = 1) -> bytes:
    text = name.encode()
    if isinstance(target, int):
        return message(6, struct.pack("<BBB", 1, 0, len(text)) + text + struct.pack("<Q", target))
    path = target.encode()
    body = struct.pack("<BBBB", 1, 8, kind, len(text)) + text + struct.pack("<H", len(path)) + path
    return message(6, body)


def header(*messages: bytes) -> bytes:
    body = b"".join(messages)
    return struct.pack("<BBHII4x", 1, 0, len(messages), 1, len(body)) + body


def write(path, objects: dict[int, bytes], driver: int = 2**64 - 1, before: bytes = b""):
    nothing = 2**64 - 1
    start = b"\x89HDF\r\n\x1a\n" + bytes([0, 0, 0, 0, 0, 8, 8, 0]) + struct.pack("<HHI", 4, 16, 0)
    start += struct.pack("<QQQQ", len(before), nothing, 4096, driver)
    start += struct.pack("<QQII16x", 0, ROOT, 0, 0)
    content = bytearray(4096)
    content[: len(start)] = start
    for at, held in objects.items():
        content[at : at + len(held)] = held
    path.write_bytes(before + bytes(content))
    return path


SECOND = "group / is linked to a second time"
CASES = {
    "circle": ({ROOT: header(link("g", INNER)), INNER: header(link("up", ROOT))}, SECOND),
    "itself": ({ROOT: header(link("g", ROOT))}, SECOND),
    "twice": ({ROOT: header(link("g", INNER), link("h", INNER)), INNER: header(link("a", DATA))},
              "is linked to a second time"),
    "soft": ({ROOT: header(link("g", INNER)), INNER: header(link("up", "/"))}, "as /g/up"),
    "chain": ({ROOT: header(link("g", INNER), link("l", "g/here")), INNER: header(link("here", "."))},
              "group /g is linked to a second"),
    "external": ({ROOT: header(link("g", INNER)), INNER: header(link("e", "\0/etc/passwd\0/a", 64))},
                 "/g/e is a link to another file"),
    "user": ({ROOT: header(link("e", "anything", 70))}, "/e is a link to another file"),
    "files": ({ROOT: header(link("d", DATA)), DATA: header(message(7, bytes(16)))}, "/d lie in other"),
    "virtual": ({ROOT: header(link("d", DATA)), DATA: header(message(8, bytes([4, 3]) + bytes(14)))},
                "/d lie in other"),
    "continued": ({ROOT: header(message(16, struct.pack("<QQ", INNER, 64))), INNER: link("e", "x", 64)},
                  "/e is a link to another file"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("before", [b"", bytes(512)], ids=["", "behind a block"])
def test_links_that_lead_elsewhere_or_in_circles_are_refused(tmp_path, case, before):
    objects, said = CASES[case]
    path = write(tmp_path / "a.h5", objects, before=before)
    assert hdf5_start(path) == len(before)
    for name in (path, f"HDF5:{path}://g", f'NETCDF:"{path}":g'):
        with pytest.raises(FormatError, match=said):
            open_raster(name)


def test_files_of_several_members_are_refused(tmp_path):
    with pytest.raises(FormatError, match="of several files"):
        check_hdf5(write(tmp_path / "a.h5", {ROOT: header()}, driver=512))


@pytest.mark.parametrize("damage", ["cut", "lists in circles", "no names"])
def test_what_cannot_be_walked_is_damaged(tmp_path, damage):
    loop = header(message(16, struct.pack("<QQ", ROOT + 16, 64)))
    tree = header(message(17, struct.pack("<QQ", INNER, DATA)))
    path = write(tmp_path / "a.h5", {ROOT: loop if damage == "lists in circles" else tree})
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:90])
    with pytest.raises(FormatError, match="cannot be read; it is truncated"):
        check_hdf5(path)


@pytest.fixture(scope="module")
def strip(tmp_path_factory):
    """Twelve images in netCDF 4: more than a group keeps in its header."""
    path = tmp_path_factory.mktemp("hdf5") / "strip.nc"
    pixels = np.arange(40 * 30, dtype=np.float32).reshape(40, 30)
    plain = path.with_suffix(".tif")
    with rasterio.open(plain, "w", driver="GTiff", width=30, height=40, count=12, dtype="float32") as held:
        held.write(np.stack([pixels + band for band in range(1, 13)]))
    copy(plain, path, driver="netCDF", FORMAT="NC4")
    return path, pixels


def test_netcdf_4_and_hdf5_are_read_in_the_order_of_the_file(strip):
    path, pixels = strip
    # GDAL wrote its first line last
    for name in (f'NETCDF:"{path}":Band7', f"HDF5:{path}://Band7"):
        found = open_image(name).read((0, 40), (0, 30))
        np.testing.assert_array_equal(found, pixels[::-1] + 7)


def test_names_that_a_file_does_not_hold_are_said(strip):
    path, _ = strip
    with pytest.raises(FormatError, match=r"several images: name one, .*Band.* \(\d+ in all\)"):
        open_image(path)
    with pytest.raises(FormatError, match="is not in the file, or that is damaged"):
        open_image(f"HDF5:{path}://Band13")


def test_a_driver_that_gdal_lacks_is_named(strip, monkeypatch):
    monkeypatch.setattr("rasterio.Env.drivers", lambda self: {"GTiff": "GeoTIFF"})
    with pytest.raises(FormatError, match="has no driver HDF5Image or HDF5; install rasterio with it"):
        open_image(f"HDF5:{strip[0]}://Band1")


def walked(path):
    """Links of the root and of what lies below, by what the walk found of them."""
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        walk = _Walk(_Bytes(path, content, hdf5_start(path)))
        walk.check()
        return {
            walk.names[group]: {name: link.target for name, link in links.items()}
            for group, links in walk.groups.items()
        }


def test_every_link_of_an_old_group_is_found_by_its_tree_and_its_heap(tmp_path):
    """A tree of two levels over three nodes of symbols, as section III.A.1 and III.B draw them."""
    names = {"": 0, "a": 8, "bee": 16, "c": 24, "g": 32, "/a": 40, "here": 48, "d": 56}
    held = bytearray(64)
    for name, at in names.items():
        held[at : at + len(name)] = name.encode()

    def symbols(*entries: tuple[str, int | str]) -> bytes:
        out = struct.pack("<4sBBH", b"SNOD", 1, 0, len(entries))
        for name, target in entries:
            if isinstance(target, str):
                out += struct.pack("<QQIII12x", names[name], 2**64 - 1, 2, 0, names[target])
            else:
                out += struct.pack("<QQII16x", names[name], target, 0, 0)
        return out

    def tree(level: int, *below: int) -> bytes:
        out = struct.pack("<4sBBHQQ", b"TREE", 0, level, len(below), 2**64 - 1, 2**64 - 1)
        return out + b"".join(struct.pack("<QQ", 0, at) for at in below) + bytes(8)

    objects = {
        ROOT: header(message(17, struct.pack("<QQ", 400, 700))),
        400: tree(1, 500, 600),
        500: tree(0, 900, 1100),
        600: tree(0, 1300),
        700: struct.pack("<4sB3xQQQ", b"HEAP", 0, 64, 2**64 - 1, 800),
        800: bytes(held),
        900: symbols(("a", DATA), ("bee", DATA + 64)),
        1100: symbols(("c", "/a")),
        1300: symbols(("d", DATA + 128), ("g", 1500)),
        1500: header(message(17, struct.pack("<QQ", 1600, 700))),
        1600: tree(0, 1700),
        1700: symbols(("here", DATA)),
        DATA: header(), DATA + 64: header(), DATA + 128: header(),
    }  # fmt: skip
    path = write(tmp_path / "old.h5", objects)
    assert walked(path) == {
        "/": {"a": DATA, "bee": DATA + 64, "c": "/a", "d": DATA + 128, "g": 1500},
        "/g/": {"here": DATA},
    }
    # a name that was not there, in the last byte but one
    names["/"] = 62
    held[62:63] = b"/"
    objects[800], objects[1700] = bytes(held), symbols(("here", "/"))
    with pytest.raises(FormatError, match="linked to a second time, as /g/here"):
        check_hdf5(write(tmp_path / "circle.h5", objects))


def test_every_link_of_a_group_of_many_is_found_by_a_deep_tree_and_blocks_of_blocks(tmp_path):
    """The library keeps 1,500 names in a tree of three levels and a heap of many blocks."""
    count, plain = 1500, tmp_path / "plain.tif"
    with rasterio.open(plain, "w", driver="GTiff", width=1, height=1, count=count, dtype="uint8") as held:
        held.write(np.ones((count, 1, 1), dtype=np.uint8))
    copy(plain, tmp_path / "many.nc", driver="netCDF", FORMAT="NC4")
    links = walked(tmp_path / "many.nc")["/"]
    assert {f"Band{k + 1}" for k in range(count)} <= set(links)
    assert len(set(links.values())) == len(links)
