"""What a user may get wrong: one clear message, status 2 (1 where the data are at fault), nothing written."""

from __future__ import annotations

import re
import shutil
import warnings

import numpy as np
import pytest
from tests.terminal_lines import PROGRESS, WARNING

from sightline.cli.main import run

LINES, COLUMNS = 420, 200


@pytest.fixture(scope="module")
def strip(tmp_path_factory):
    """A small rendered strip, long enough for the longest lag (345 lines)."""
    folder = tmp_path_factory.mktemp("strip") / "scene"
    size = ["--lines", str(LINES), "--columns", str(COLUMNS)]
    assert (
        run(
            [
                "simulate",
                "line-of-sight",
                "--case",
                "relief",
                *size,
                "--set",
                "gyro=true",
                "--out",
                str(folder),
            ]
        )
        == 0
    )
    return folder


@pytest.fixture
def scene(strip, tmp_path):
    """A copy of it, to be spoiled."""
    return shutil.copytree(strip, tmp_path / "scene")


def edit(folder, old, new):
    """Replace the first `old` in the TOML file."""
    path = folder / "acquisition.toml"
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def write_tiff(path, array):
    import rasterio

    profile = {"driver": "GTiff", "count": 1, "height": array.shape[0], "width": array.shape[1]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, "w", dtype=array.dtype, **profile) as target:
            target.write(array, 1)


def spoil_image(folder, array):
    write_tiff(folder / "B1.tif", array)


def cut_short(folder):
    path = folder / "B1.tif"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def image_of_nan(folder):
    spoil_image(folder, np.full((LINES, COLUMNS), np.nan, dtype=np.float32))


def every_second_line_nan(folder):
    image = np.random.default_rng(0).normal(700.0, 90.0, (LINES, COLUMNS)).astype(np.float32)
    image[1::2] = np.nan
    spoil_image(folder, image)


def gyro_parted_by_semicolons(folder):
    path = folder / "gyro.csv"
    path.write_text(path.read_text(encoding="utf-8").replace(",", ";"), encoding="utf-8")


def image_at_home(folder):
    edit(folder, '"B1.tif"', '"~/B1.tif"')


def one_file_under_two_keys(folder):
    """The gyro's table is given where directions of a detector belong."""
    edit(folder, "[[band]]\n", '[[band]]\ndirections = "gyro.csv"\n')


def image_constant(folder):
    spoil_image(folder, np.full((LINES, COLUMNS), 700, dtype=np.uint16))


def image_saturated(folder):
    spoil_image(folder, np.full((LINES, COLUMNS), 4095, dtype=np.uint16))


def image_too_narrow(folder):
    noise = np.random.default_rng(0).integers(500, 900, (LINES, COLUMNS - 4))
    spoil_image(folder, noise.astype(np.uint16))


def line_times(folder, t):
    rows = [f"{line},{float(value)!r}" for line, value in enumerate(t)]
    (folder / "times.csv").write_text("\n".join(["line,t", *rows]) + "\n")
    edit(folder, "first_line_time = 0.0", 'line_times = "times.csv"')


def times_backwards(folder):
    t = 5e-4 * np.arange(LINES)
    t[[100, 101]] = t[[101, 100]]
    line_times(folder, t)


def times_twice(folder):
    t = 5e-4 * np.arange(LINES)
    t[101] = t[100]
    line_times(folder, t)


def only_one_band(folder):
    path = folder / "acquisition.toml"
    head, band, *rest = path.read_text(encoding="utf-8").split("[[band]]")
    tail = rest[-1][rest[-1].index("[surface]") :]
    path.write_text(f"{head}[[band]]{band}{tail}", encoding="utf-8")


def dem_elsewhere(folder):
    import rasterio
    from rasterio.transform import Affine

    with rasterio.open(folder / "dem.tif", "r+") as dem:
        dem.transform = Affine.translation(5e5, 0.0) @ dem.transform


def gyro_with_nan(folder):
    path = folder / "gyro.csv"
    rows = path.read_text(encoding="utf-8").splitlines()
    rows[3] = ",".join([*rows[3].split(",")[:2], "nan", *rows[3].split(",")[3:]])
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def attitudes_too_short(folder):
    """An ephemeris whose attitudes end in the middle of the strip."""
    t = np.linspace(-0.1, 0.5, 61)
    positions = [f"{a!r},0.0,{6800.0 * a!r},680000.0" for a in t.tolist()]
    half = t[t < 0.1].tolist()
    attitudes = [f"{a!r},0.7071067811865476,0.7071067811865476,0.0,0.0" for a in half]
    (folder / "positions.csv").write_text("\n".join(["t,x,y,z", *positions]) + "\n")
    (folder / "attitudes.csv").write_text("\n".join(["t,qx,qy,qz,qw", *attitudes]) + "\n")
    edit(folder, 'kind = "level-flight"', 'kind = "ephemeris"')
    edit(folder, "altitude = 680000.0", 'positions = "positions.csv"')
    edit(folder, "ground_speed = 6800.0", 'attitudes = "attitudes.csv"\n[world]\nframe = "local"')


def wrong_key(folder):
    edit(folder, "ground_speed", "groundspeed")


def wrong_kind(folder):
    edit(folder, "level-flight", "level-fligth")


def not_toml(folder):
    edit(folder, "[platform]", "[platform")


def negative_altitude(folder):
    edit(folder, "altitude = ", "altitude = -")


def pairs_brought_together_otherwise(folder):
    edit(folder, "[surface]", '[matching]\nhybridise = "both"\n\n[surface]')


def image_missing(folder):
    (folder / "B1.tif").unlink()


def image_is_no_raster(folder):
    (folder / "B1.tif").write_text("not a raster")


def ifov_of_other_units(folder):
    edit(folder, "ifov = 5e-06", "ifov = 5e-08")


BAD = [
    (image_missing, 2, r"B1\.tif.*no such file"),
    (image_is_no_raster, 2, r"B1\.tif"),
    (cut_short, 2, r"B1\.tif.*(truncated|cannot be read)"),
    (image_of_nan, 2, r"B1.*(NaN|not a number|no usable)"),
    (every_second_line_nan, 2, r"B1\.tif.*unusable pixels.*50 % of any 16 x 16 px"),
    (gyro_parted_by_semicolons, 2, r"gyro\.csv.*parted by commas, not by ';'"),
    (image_at_home, 2, r"~.B1\.tif: no such file; ~ is not replaced"),
    (one_file_under_two_keys, 2, r"\[\[band\]\] 1 directions.*\[\[attitude_sensor\]\] 1 table.*gyro\.csv"),
    (image_constant, 2, r"B1.*(constant|same value)"),
    (image_saturated, 2, r"B1.*(saturated|constant|same value)"),
    (image_too_narrow, 2, r"B1.*196.*200"),
    (times_backwards, 2, r"times\.csv.*(increas|order)"),
    (times_twice, 2, r"times\.csv.*(increas|twice|duplicate)"),
    (only_one_band, 2, r"add a \[\[band\]\]"),
    (dem_elsewhere, 1, r"dem\.tif.*cover|does not cover"),
    (gyro_with_nan, 2, r"gyro\.csv"),
    (attitudes_too_short, 2, r"outside|cover"),
    (wrong_key, 2, r"unknown key 'platform\.groundspeed'; did you mean ground_speed\?"),
    (wrong_kind, 2, r"'level-fligth' is not known; did you mean level-flight\?"),
    (not_toml, 2, r"not valid TOML.*line"),
    (pairs_brought_together_otherwise, 2, r"matching\.hybridise = 'both'.*iterative"),
    (ifov_of_other_units, 2, r"pixels 0\.03\d* m wide; these cannot belong together; check ifov"),
    (negative_altitude, 2, r"platform\.altitude = -680000\.0"),
]


@pytest.mark.parametrize(
    ("spoil", "status", "message"), BAD, ids=lambda value: getattr(value, "__name__", "")
)
def test_bad_input_gives_one_clear_message_and_writes_nothing(
    scene, tmp_path, capsys, spoil, status, message
):
    spoil(scene)
    capsys.readouterr()
    out = tmp_path / "result"
    got = run(["recover", str(scene / "acquisition.toml"), "--out", str(out)])
    said = capsys.readouterr()
    assert got == status, said.err
    errors = [line for line in said.err.splitlines() if not line.startswith((WARNING, PROGRESS))]
    assert len(errors) == 1 and re.search(message, errors[0]), said.err
    assert "Traceback" not in said.err
    assert not out.exists()
