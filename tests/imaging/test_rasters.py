"""What rasters refer to: nothing is asked of a server unasked, and nothing read outside the folders."""

from __future__ import annotations

import os
import pickle
import sys
import threading
import warnings
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
import rasterio

from sightline.access import Access, allow_folders, allow_network, current_access, remote_name
from sightline.errors import FormatError
from sightline.imaging.rasters import LOCAL_DRIVERS, open_raster
from sightline.io.formats.images import RasterImage

SHAPE = (8, 16)
PIXELS = np.arange(128, dtype=np.uint16).reshape(SHAPE)


class Server:
    """A server of this machine that counts what it is asked, and has nothing."""

    def __init__(self) -> None:
        asked = self.asked = []

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                asked.append(self.path)
                self.send_error(404)

            do_HEAD = do_GET

            def log_message(self, *_):
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.place = f"http://127.0.0.1:{self.server.server_port}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


@pytest.fixture(scope="module")
def the_server():
    server = Server()
    yield server
    server.server.shutdown()


@pytest.fixture
def server(the_server):
    the_server.asked.clear()
    return the_server


def tif(path: Path) -> Path:
    path.parent.mkdir(exist_ok=True, parents=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # no georeference
        profile = {"driver": "GTiff", "dtype": "uint16", "count": 1, "height": 8, "width": 16}
        with rasterio.open(path, "w", **profile) as target:
            target.write(PIXELS, 1)
    return path


def wms(place: str) -> str:
    return (
        f'<GDAL_WMS><Service name="TMS"><ServerUrl>{place}/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service>'
        "<DataWindow><UpperLeftX>0</UpperLeftX><UpperLeftY>0</UpperLeftY><LowerRightX>16</LowerRightX>"
        "<LowerRightY>8</LowerRightY><TileLevel>0</TileLevel><SizeX>16</SizeX><SizeY>8</SizeY>"
        "<TileCountX>1</TileCountX><TileCountY>1</TileCountY><YOrigin>top</YOrigin></DataWindow>"
        "<Projection>EPSG:3857</Projection><BlockSizeX>16</BlockSizeX><BlockSizeY>8</BlockSizeY>"
        "<BandsCount>1</BandsCount></GDAL_WMS>"
    )


def vrt(name: str, relative: str = 'relativeToVRT="1"', more: str = "") -> str:
    return (
        '<VRTDataset rasterXSize="16" rasterYSize="8"><VRTRasterBand dataType="UInt16" band="1">'
        f"<SimpleSource><SourceFilename {relative}>{name}</SourceFilename><SourceBand>1</SourceBand>"
        f"</SimpleSource></VRTRasterBand>{more}</VRTDataset>"
    )


def warped(name: str) -> str:
    return (
        '<VRTDataset rasterXSize="16" rasterYSize="8" subClass="VRTWarpedDataset">'
        '<VRTRasterBand dataType="UInt16" band="1" subClass="VRTWarpedRasterBand"/>'
        f'<GDALWarpOptions><SourceDataset relativeToVRT="0">{name}</SourceDataset></GDALWarpOptions>'
        "</VRTDataset>"
    )


def raw(name: str, relative: str = 'relativeToVRT="1"') -> str:
    return (
        '<VRTDataset rasterXSize="16" rasterYSize="8"><VRTRasterBand dataType="UInt16" band="1" '
        f'subClass="VRTRawRasterBand"><SourceFilename {relative}>{name}</SourceFilename>'
        "<ImageOffset>0</ImageOffset><PixelOffset>2</PixelOffset><LineOffset>32</LineOffset>"
        "</VRTRasterBand></VRTDataset>"
    )


def isis(name: str) -> str:
    return (
        "Object = IsisCube\n  Object = Core\n    StartByte = 1\n    Format = GeoTIFF\n"
        f"    ^Core = {name}\n    Group = Dimensions\n      Samples = 16\n      Lines = 8\n      Bands = 1\n"
        "    End_Group\n    Group = Pixels\n      Type = UnsignedWord\n      ByteOrder = Lsb\n"
        "      Base = 0.0\n      Multiplier = 1.0\n    End_Group\n  End_Object\nEnd_Object\nEnd\n"
    )


def write(folder: Path, **files: str) -> Path:
    """Files of a folder by their names, ``_`` for a dot; the first of them."""
    for name, text in files.items():
        (folder / name.replace("__", "/").replace("_", ".")).write_text(text)
    return folder / next(iter(files)).replace("_", ".")


def mask_beside(folder: Path, place: str) -> Path:
    (folder / "p.tif.msk").write_text(wms(place))
    return tif(folder / "p.tif")


def overviews_beside(folder: Path, place: str) -> Path:
    (folder / "p.tif.ovr").write_text(wms(place))
    return tif(folder / "p.tif")


def notes_beside(folder: Path, place: str) -> Path:
    (folder / "p.tif.aux.xml").write_text(
        '<PAMDataset><Metadata domain="OVERVIEWS"><MDI key="OVERVIEW_FILE">'
        f"/vsicurl/{place}/o.tif</MDI></Metadata></PAMDataset>"
    )
    return tif(folder / "p.tif")


#: Files that ask a server as soon as they are opened or read.
ASKING = {
    "WMS called tif": lambda f, p: write(f, p_tif=wms(p)),
    "WMS after white space": lambda f, p: write(f, p_tif="\ufeff \n" + wms(p)),
    "WMTS": lambda f, p: write(
        f, p_tif=f"<GDAL_WMTS><GetCapabilitiesUrl>{p}</GetCapabilitiesUrl></GDAL_WMTS>"
    ),
    "WCS": lambda f, p: write(f, p_tif=f"<WCS_GDAL><ServiceURL>{p}/?</ServiceURL></WCS_GDAL>"),
    "a catalogue": lambda f, p: write(f, p_tif=f'{{"type": "Feature", "stac_version": "1.0", "a": "{p}"}}'),
    "VRT of an address": lambda f, p: write(f, p_tif=vrt(f"/vsicurl/{p}/a.tif", 'relativeToVRT="0"')),
    "VRT of a bare address": lambda f, p: write(f, p_tif=vrt(f"{p}/a.tif", "")),
    "VRT of a bucket": lambda f, p: write(f, p_tif=vrt("/vsis3/bucket/a.tif", "")),
    "VRT of an archive": lambda f, p: write(f, p_tif=vrt(f"/vsizip//vsicurl/{p}/a.zip/a.tif", "")),
    "VRT in other letters": lambda f, p: write(
        f, p_tif=vrt("b.tif").replace("SourceFilename", "sourcefileNAME").replace("b.tif", f"{p}/a.tif")
    ),
    "VRT with an attribute": lambda f, p: write(
        f, p_tif=vrt("").replace("<SimpleSource>", f'<SimpleSource SourceFilename="/vsicurl/{p}/a.tif">')
    ),
    "VRT of a VRT": lambda f, p: write(f, p_tif=vrt("b.vrt"), b_vrt=vrt(f"/vsicurl/{p}/a.tif", "")),
    "VRT of a WMS": lambda f, p: write(f, p_tif=vrt("b.tif"), b_tif=wms(p)),
    "VRT within a VRT": lambda f, p: write(f, p_tif=vrt(vrt(f"{p}/a.tif").replace("<", "&lt;"), "")),
    "VRT with a mask": lambda f, p: write(
        f, p_tif=vrt("p.tif", more=f"<MaskBand>{vrt(f'/vsicurl/{p}/a.tif', '')}</MaskBand>")
    ),
    "warped VRT": lambda f, p: write(f, p_tif=warped(f"/vsicurl/{p}/a.tif")),
    "raw VRT": lambda f, p: write(f, p_tif=raw(f"/vsicurl/{p}/a.bin")),
    "part of a file": lambda f, p: write(f, p_tif=vrt(f"NETCDF:{p}/a.nc:x", "")),
    "entities": lambda f, p: write(f, p_tif=f'<!DOCTYPE a [<!ENTITY x "{p}">]>' + vrt("&x;/a.tif")),
    "a label": lambda f, p: write(f, p_lbl=isis("b.tif"), b_tif=wms(p)),
    "a mask beside it": mask_beside,
    "overviews beside it": overviews_beside,
    "notes beside it": notes_beside,
    "an address": lambda f, p: Path(f"{p}/a.tif"),
    "a virtual path": lambda f, p: Path(f"/vsicurl/{p}/a.tif"),
    "an archive on a server": lambda f, p: Path(f"/vsizip//vsicurl/{p}/a.zip/a.tif"),
}


@pytest.mark.parametrize("case", ASKING)
def test_nothing_is_asked_of_a_server_unless_that_is_allowed(tmp_path, server, case):
    path = ASKING[case](tmp_path, server.place)
    with pytest.raises(FormatError) as raised:
        RasterImage(path).read((0, 8), (0, 16))
    assert server.asked == []
    assert str(raised.value).startswith(f"{path}")


@pytest.mark.parametrize("case", ["WMS called tif", "VRT of an address", "VRT of a WMS", "an address"])
def test_a_server_is_asked_where_that_is_allowed(tmp_path, server, case):
    # GDAL remembers what a server does not have
    path = ASKING[case](tmp_path, f"{server.place}/{case.replace(' ', '-')}")
    with allow_network(), pytest.raises(FormatError, match=r"the pixels cannot be read \(.*(404|download)"):
        RasterImage(path).read((0, 8), (0, 16))
    assert server.asked


def test_what_was_allowed_ends_with_its_block(tmp_path, server):
    with allow_network():
        assert current_access().network
    assert not current_access().network
    with pytest.raises(FormatError, match="add --allow-network"):
        open_raster(ASKING["WMS called tif"](tmp_path, server.place))


def test_an_image_keeps_what_its_file_may_refer_to_in_other_threads_and_processes(tmp_path):
    tif(tmp_path / "elsewhere" / "a.tif")
    (tmp_path / "here").mkdir()
    path = write(tmp_path / "here", p_tif=vrt("../elsewhere/a.tif"))
    with allow_folders([tmp_path / "elsewhere"]):
        image = RasterImage(path)
    copy = pickle.loads(pickle.dumps(image))
    read = []
    for source in (image, copy):
        thread = threading.Thread(target=lambda source=source: read.append(source.read((0, 8), (0, 16))))
        thread.start()
        thread.join()
    assert len(read) == 2 and all((pixels == PIXELS).all() for pixels in read)


#: A raster in `here` that refers to what lies in `elsewhere`, of which `here` is no part.
OUTSIDE = {
    "VRT, upwards": lambda f: write(f / "here", p_tif=vrt("../elsewhere/a.tif")),
    "VRT, by its full path": lambda f: write(f / "here", p_tif=vrt(str(f / "elsewhere/a.tif"), "")),
    "VRT of a VRT": lambda f: write(f / "here", p_tif=vrt("b.vrt"), b_vrt=vrt("../elsewhere/a.tif")),
    "raw VRT": lambda f: write(f / "here", p_tif=raw("../elsewhere/a.tif")),
    "warped VRT": lambda f: write(f / "here", p_tif=warped(str(f / "elsewhere/a.tif"))),
    "a link": lambda f: (
        (f / "here/b.tif").symlink_to(f / "elsewhere/a.tif"),
        write(f / "here", p_tif=vrt("b.tif")),
    )[1],
    "a label": lambda f: write(f / "here", p_lbl=isis("../elsewhere/a.tif")),
    "a mask that is a link": lambda f: (
        (f / "here/p.tif.msk").symlink_to(f / "elsewhere/a.tif"),
        tif(f / "here/p.tif"),
    )[1],
}


@pytest.fixture
def two_folders(tmp_path):
    tif(tmp_path / "elsewhere" / "a.tif")
    (tmp_path / "here").mkdir()
    return tmp_path


@pytest.mark.parametrize("case", OUTSIDE)
def test_a_raster_refers_to_nothing_outside_its_folders(two_folders, case):
    path = OUTSIDE[case](two_folders)
    with pytest.raises(
        FormatError, match=r"p\.\w+: .*refers to .*a\.tif.*\[files\] allow = \[\".*/elsewhere\"\]"
    ):
        open_raster(path)
    if case != "warped VRT":  # which says not how it is warped
        with open_raster(path, Access((two_folders / "elsewhere",))) as dataset:
            assert dataset.shape == SHAPE


def test_a_name_counts_from_the_folder_of_work_where_gdal_counts_it_from_there(two_folders, monkeypatch):
    monkeypatch.chdir(two_folders / "elsewhere")
    path = write(two_folders / "here", p_tif=vrt("a.tif", ""))
    with pytest.raises(FormatError, match="outside the folders"):
        open_raster(path)


def test_what_lies_below_may_be_referred_to_and_is_read(tmp_path):
    tif(tmp_path / "tiles" / "a.tif")
    (tmp_path / "tiles" / "a.bin").write_bytes(PIXELS.tobytes())
    files = {"one_tif": vrt("tiles/a.tif"), "two_tif": vrt("one.tif"), "raw_tif": raw("tiles/a.bin")}
    write(tmp_path, **files)
    for name in files:
        read = RasterImage(tmp_path / name.replace("_", ".")).read((0, 8), (0, 16))
        assert (read == PIXELS).all(), name


def test_a_raster_that_is_a_link_refers_to_what_lies_beside_its_file(two_folders):
    write(two_folders / "elsewhere", p_vrt=vrt("a.tif"))
    (two_folders / "here" / "p.vrt").symlink_to(two_folders / "elsewhere" / "p.vrt")
    with open_raster(two_folders / "here" / "p.vrt") as dataset:
        assert (dataset.read(1) == PIXELS).all()


REFUSED = {
    "Python": (
        vrt("a.tif").replace(
            "<SimpleSource>",
            "<PixelFunctionType>f</PixelFunctionType><PixelFunctionLanguage>Python</PixelFunctionLanguage>"
            "<PixelFunctionCode>import os</PixelFunctionCode><SimpleSource>",
        ),
        "holds a program in Python, which is not run",
    ),
    "no XML": (vrt("a.tif") + "<", "is no XML that can be checked"),
    "not there": (vrt("b.tif"), r"refers to b\.tif: no such file"),
    "itself a list": (
        "<GDALTileIndexDataset><IndexDataset>a</IndexDataset></GDALTileIndexDataset>",
        "is no raster",
    ),
    "no raster": ("just words", "is no raster"),
    "nothing": ("", "is no raster"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_read_is_refused_by_name(tmp_path, case):
    text, said = REFUSED[case]
    tif(tmp_path / "a.tif")
    with pytest.raises(FormatError, match=rf"p\.tif: .*{said}"):
        open_raster(write(tmp_path, p_tif=text))


def test_a_vrt_that_refers_to_itself_ends(tmp_path):
    write(tmp_path, p_tif=vrt("b.vrt"), b_vrt=vrt("p.tif"))
    with pytest.raises(FormatError):
        RasterImage(tmp_path / "p.tif").read((0, 8), (0, 16))


@pytest.mark.parametrize("kind", ["folder", "pipe", "device", "too long", "zero"])
def test_only_regular_files_are_opened(tmp_path, kind):
    os.mkfifo(tmp_path / "pipe")
    paths = {
        "folder": (tmp_path, "is a folder; a regular file is expected"),
        "pipe": (tmp_path / "pipe", "is a pipe"),
        "device": (Path("/dev/zero"), "is a device"),
        "too long": (tmp_path / ("x" * 300), "cannot be opened"),
        "zero": (tmp_path / "a\0b", "cannot be opened"),
    }
    path, said = paths[kind]
    with pytest.raises(FormatError, match=said):
        open_raster(path)


def test_formats_that_hold_their_pixels_are_drivers_that_there_are():
    with rasterio.Env() as environment:
        known = environment.drivers()
    # those left out of this build of GDAL are in others
    assert {"GTiff", "PNG", "JPEG", "ENVI", "ISIS3", "PDS4", "JP2OpenJPEG"} <= set(LOCAL_DRIVERS) & set(known)
    assert not {"VRT", "GTI", "WMS", "WMTS", "WCS", "HTTP", "STACIT", "STACTA", "MRF"} & set(LOCAL_DRIVERS)
    assert not {"HDF4", "HDF5", "HDF5Image", "netCDF", "BAG", "KEA", "S102", "PCIDSK", "SDTS"} & set(
        LOCAL_DRIVERS
    )


@pytest.mark.parametrize("before", [0, 512, 4096])
@pytest.mark.parametrize("listed", [False, True])
def test_hdf5_is_walked_through_before_it_is_opened_also_where_a_list_names_it(tmp_path, before, listed):
    path = tmp_path / "a.nc"
    path.write_bytes(bytes(before) + b"\x89HDF\r\n\x1a\n" + bytes(2000))
    (tmp_path / "folder").mkdir()
    asked = write(tmp_path / "folder", a_vrt=vrt("../a.nc")) if listed else path
    with pytest.raises(FormatError, match="links of its groups cannot be read"):
        open_raster(asked, Access((tmp_path,)))


def classic_netcdf() -> bytes:
    """Two by three bytes as netCDF-3: dimensions y, x; one variable."""

    def name(text: str) -> bytes:
        return len(text).to_bytes(4, "big") + text.encode().ljust(4, b"\0")

    def number(value: int) -> bytes:
        return value.to_bytes(4, "big")

    head = b"CDF\1" + number(0) + number(10) + number(2) + name("y") + number(2) + name("x") + number(3)
    head += number(0) * 2 + number(11) + number(1) + name("z") + number(2) + number(0) + number(1)
    head += number(0) * 2 + number(1) + number(8)
    return head + number(len(head) + 4) + bytes([1, 2, 3, 4, 5, 6, 0, 0])


def test_classic_netcdf_holds_its_data_and_is_read(tmp_path):
    path = tmp_path / "a.nc"
    path.write_bytes(classic_netcdf())
    with open_raster(path) as dataset:
        assert sorted(dataset.read(1).ravel().tolist()) == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("http://a/b.tif", "/vsicurl/http://a/b.tif"),
        ("HTTPS:/a/b.tif", "/vsicurl/https://a/b.tif"),
        ("s3://a/b.tif", "/vsis3/a/b.tif"),
        ("/vsicurl/http:/a/b.tif", "/vsicurl/http://a/b.tif"),
        ("/vsigs_streaming/a/b.tif", "/vsigs_streaming/a/b.tif"),
        ("a/b.tif", None),
        ("a:b.tif", None),
    ],
)
def test_addresses_are_distinguished_from_paths(text, name):
    assert remote_name(text) == name


@pytest.mark.parametrize("text", ["file:///a/b.tif", "zip://a.zip!b.tif", "/vsizip/a.zip/b.tif", "/vsimem/a"])
def test_other_addresses_are_refused(text):
    with pytest.raises(FormatError, match="is no path of a file"):
        remote_name(text)


def test_pixels_of_imagine_in_another_file_lie_where_they_may_and_are_a_file(tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    made = {"driver": "HFA", "width": 64, "height": 64, "count": 1, "dtype": "uint16", "USE_SPILL": "YES"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(folder / "a.img", "w", **made) as dataset:
            dataset.write(np.ones((1, 64, 64), dtype="uint16"))
    with open_raster(folder / "a.img") as dataset:
        assert dataset.read(1).min() == 1
    (folder / "a.ige").rename(tmp_path / "b.ige")
    (folder / "a.ige").symlink_to(tmp_path / "b.ige")
    with pytest.raises(FormatError, match="outside the folders"):
        open_raster(folder / "a.img")
    (folder / "a.ige").unlink()
    os.mkfifo(folder / "a.ige")
    with pytest.raises(FormatError, match=r"a\.ige: is a pipe"):
        open_raster(folder / "a.img")


def test_messages_of_gdal_that_quote_bytes_which_are_no_text_are_not_printed(tmp_path, capfd):
    path = tmp_path / "band.tif"
    with warnings.catch_warnings(action="ignore"):
        with rasterio.open(path, "w", driver="GTiff", width=8, height=8, count=1, dtype="uint8") as target:
            target.update_tags(A="B" * 40)
    content = path.read_bytes()
    start, end = content.find(b"<GDALMetadata"), content.find(b"</GDALMetadata>") + 15
    spoilt = b"<GDALMetadata>\n  <Item \xff\xfe name>x</Item>\n".ljust(end - start)
    path.write_bytes(content[:start] + spoilt + content[end:])
    hooks = sys.excepthook, sys.unraisablehook
    with open_raster(path) as dataset:
        assert dataset.shape == (8, 8)
    assert capfd.readouterr().err == ""
    assert (sys.excepthook, sys.unraisablehook) == hooks


@pytest.mark.filterwarnings("error::numpy.exceptions.ComplexWarning")
def test_complex_pixels_are_refused_by_the_number_of_their_band(tmp_path):
    path = tmp_path / "slc.tif"
    with warnings.catch_warnings(action="ignore"):
        with rasterio.open(
            path, "w", driver="GTiff", width=8, height=8, count=1, dtype="complex64"
        ) as target:
            target.write(np.ones((1, 8, 8), np.complex64))
    with pytest.raises(FormatError, match=r"slc\.tif: its band 1 holds complex numbers \(complex64\)"):
        open_raster(path)
