"""Pixels inside archives, netCDF, TIFF, products; what may refer elsewhere is refused by name."""

from __future__ import annotations

import gzip
import io
import tarfile
import zipfile

import numpy as np
import pytest
import rasterio
from scipy.io import netcdf_file
from tests.io.conftest import write_tif

from sightline.access import inner_image
from sightline.cli.main import run
from sightline.errors import FormatError
from sightline.imaging.rasters import open_raster
from sightline.io.formats.images import open_image

PIXELS = np.arange(48 * 40, dtype=np.uint16).reshape(48, 40)


@pytest.fixture
def packed(tmp_path):
    """One image in every kind of file."""
    write_tif(tmp_path / "PAN.tif", PIXELS)
    data = (tmp_path / "PAN.tif").read_bytes()
    with zipfile.ZipFile(tmp_path / "strip.zip", "w") as archive:
        archive.writestr("deep/PAN.tif", data)
        archive.writestr("list.vrt", b"<VRTDataset></VRTDataset>")
    with tarfile.open(tmp_path / "strip.tar", "w") as archive:
        info = tarfile.TarInfo("PAN.tif")
        info.size = len(data)
        archive.addfile(info, io.BytesIO(data))
    (tmp_path / "PAN.tif.gz").write_bytes(gzip.compress(data))
    with netcdf_file(tmp_path / "strip.nc", "w") as held:
        held.createDimension("line", 48)
        held.createDimension("column", 40)
        held.createVariable("pan", "f4", ("line", "column"))[:] = PIXELS
        held.createVariable("xs", "f4", ("line", "column"))[:] = PIXELS + 1
    with rasterio.open(
        tmp_path / "pages.tif", "w", driver="GTiff", width=40, height=48, count=1, dtype="uint16"
    ) as page:
        page.write(PIXELS, 1)
    (tmp_path / "PAN.tif").unlink()
    return tmp_path


@pytest.mark.parametrize(
    ("name", "more"),
    [("/vsizip/{}/strip.zip/deep/PAN.tif", 0), ("/vsitar/{}/strip.tar/PAN.tif", 0),
     ("/vsigzip/{}/PAN.tif.gz", 0),
     ('NETCDF:"{}/strip.nc":xs', 1), ("NETCDF:{}/strip.nc:pan", 0), ("GTIFF_DIR:1:{}/pages.tif", 0)],
)  # fmt: skip
def test_pixels_inside_a_file_are_those_of_the_image(packed, name, more):
    image = open_image(name.format(packed))
    found = image.read((0, 48), (0, 40))
    np.testing.assert_array_equal(found, PIXELS + more)


@pytest.mark.parametrize(
    ("name", "said"),
    [("/vsizip/{}/strip.zip/list.vrt", "of an archive TIFF, JPEG, PNG, JPEG 2000 and NITF are read"),
     ("/vsizip/{}/strip.zip/none.tif", "is not in the archive, or that is damaged"),
     ("/vsizip/{}/none.zip/PAN.tif", r"none\.zip: no such file"),
     ("/vsitar/{}/strip.zip/PAN.tif", "is not in the archive, or that is damaged"),
     ('NETCDF:"{}/none.nc":pan', r"none\.nc: no such file"),
     ('NETCDF:"{}/pages.tif":pan', "is no netCDF"),
     ('HDF5:"{}/pages.tif"://pan', "is no HDF5"), ('HDF5:"{}/a.h5"://pan', "a.h5: no such file"),
     ("SENTINEL2_L1B:{}/a.xml:10m", "a.xml: no such file"),
     ("HDF4_SDS:UNKNOWN:{}/a.hdf:0", "data of HDF4_SDS may lie in other files that cannot be checked"),
     ("/vsizip//vsicurl/http://127.0.0.1:9/a.zip/PAN.tif", "no such file|is an address")],
)  # fmt: skip
def test_what_cannot_be_checked_is_refused_by_name(packed, name, said):
    with pytest.raises(FormatError, match=said):
        open_raster(name.format(packed))


GRANULE = """<n1:Level-1B_Granule_ID xmlns:n1="https://psd-12.sentinel2.eo.esa.int/PSD/x.xsd"><n1:General_Info>
<GRANULE_ID>S2B_OPER_MSI_L1B_GR_X_20140630T140000_D02_N01.00</GRANULE_ID></n1:General_Info><n1:Geometric_Info>
<Granule_Dimensions><Size resolution="10"><NROWS>48</NROWS><NCOLS>40</NCOLS></Size></Granule_Dimensions>
</n1:Geometric_Info></n1:Level-1B_Granule_ID>"""


@pytest.fixture
def granule(tmp_path):
    """Metadata of a granule of Sentinel-2 L1B, and two of its images."""
    (tmp_path / "product/IMG_DATA").mkdir(parents=True)
    for band, number in (("B02", 3), ("B04", 1)):
        path = tmp_path / f"product/IMG_DATA/S2B_OPER_MSI_L1B_GR_X_20140630T140000_D02_{band}.jp2"
        with rasterio.open(
            path, "w", driver="JP2OpenJPEG", width=40, height=48, count=1, dtype="uint16",
            REVERSIBLE="YES", QUALITY="100",
        ) as image:  # fmt: skip
            image.write(PIXELS + number, 1)
    xml = tmp_path / "product/S2B_OPER_MTD_L1B_GR_X_20140630T140000_D02.xml"
    xml.write_text(GRANULE)
    return xml


def test_bands_of_a_sentinel_2_granule_are_read_by_their_number(granule):
    more = {"B2": 3, "B4": 1}
    for band in (1, 2):
        image = open_image(f"SENTINEL2_L1B:{granule}:10m", band)
        np.testing.assert_array_equal(
            image.read((0, 48), (0, 40)), PIXELS + more.pop(image.description.split(",")[0])
        )


@pytest.mark.parametrize("trick", ["list", "link", "entity", "resolution"])
def test_what_a_product_may_not_hold_is_refused_before_it_is_opened(granule, trick):
    inner = "60m" if trick == "resolution" else "10m"
    (image,) = granule.parent.glob("IMG_DATA/*B04.jp2")
    if trick == "list":
        image.write_text("<VRTDataset/>")
    if trick == "link":
        image.symlink_to(image.rename(granule.parent.parent / "outside.jp2"))
    if trick == "entity":
        granule.write_text("<!DOCTYPE a>" + GRANULE)
    said = {"list": "is no JPEG 2000", "link": "lies outside the folders", "entity": "declares entities",
            "resolution": "no image of 60m|is not in the file"}  # fmt: skip
    with pytest.raises(FormatError, match=said[trick]):
        open_image(f"SENTINEL2_L1B:{granule}:{inner}")


def test_a_file_of_such_a_name_is_itself(tmp_path):
    (tmp_path / "NETCDF:a:b").write_text("")
    assert inner_image(tmp_path / "NETCDF:a:b") is None and inner_image("plain.tif") is None


def test_a_strip_may_be_read_from_an_archive(recovery, tmp_path, capsys):
    """Names are relative to the TOML file; the archive is what is hashed."""
    with zipfile.ZipFile(tmp_path / "strip.zip", "w") as archive:
        for path in recovery.scene.glob("*.tif"):
            archive.write(path, path.name)
    text = (recovery.scene / "acquisition.toml").read_text()
    for name in ("PAN", "B0", "B1", "B2"):
        text = text.replace(f'"{name}.tif"', f'"/vsizip/strip.zip/{name}.tif"')
    (tmp_path / "acquisition.toml").write_text(text)
    assert run(["check", str(tmp_path / "acquisition.toml")]) == 0
    packed = capsys.readouterr().out
    assert run(["check", str(recovery.scene / "acquisition.toml")]) == 0
    assert packed == capsys.readouterr().out
    (tmp_path / "strip.zip").unlink()
    assert run(["check", str(tmp_path / "acquisition.toml")]) == 1
    assert "no such file" in capsys.readouterr().err
