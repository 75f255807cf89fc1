"""Pixels inside archives, netCDF 3 and directories of a TIFF; what may refer elsewhere is refused by name."""

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

from sightline.access import within
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
    # netCDF counts its lines from below where it says nothing of them
    rows = found if found[0, 0] <= found[-1, 0] else found[::-1]
    np.testing.assert_array_equal(rows, PIXELS + more)


@pytest.mark.parametrize(
    ("name", "said"),
    [("/vsizip/{}/strip.zip/list.vrt", "of an archive TIFF, JPEG, PNG, JPEG 2000 and NITF are read"),
     ("/vsizip/{}/strip.zip/none.tif", "is not in the archive, or that is damaged"),
     ("/vsizip/{}/none.zip/PAN.tif", r"none\.zip: no such file"),
     ("/vsitar/{}/strip.zip/PAN.tif", "is not in the archive, or that is damaged"),
     ('NETCDF:"{}/none.nc":pan', r"none\.nc: no such file"),
     ('NETCDF:"{}/pages.tif":pan', "is no netCDF 3"),
     ('HDF5:"{}/a.h5"://pan', "data of HDF5 may lie in other files that cannot be checked"),
     ("SENTINEL2_L1B:{}/a.xml:10m", "data of SENTINEL2_L1B may lie in other files"),
     ("/vsizip//vsicurl/http://127.0.0.1:9/a.zip/PAN.tif", "no such file|is an address")],
)  # fmt: skip
def test_what_cannot_be_checked_is_refused_by_name(packed, name, said):
    with pytest.raises(FormatError, match=said):
        open_raster(name.format(packed))


def test_a_file_of_such_a_name_is_itself(tmp_path):
    (tmp_path / "NETCDF:a:b").write_text("")
    assert within(tmp_path / "NETCDF:a:b") is None and within("plain.tif") is None


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
