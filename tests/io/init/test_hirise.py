"""Channels of HiRISE become bands: joined, masked, each looking where the instrument kernel says."""

from __future__ import annotations

import csv
import tomllib

import numpy as np
import pytest
import rasterio

from sightline import load_acquisition
from sightline.cli.main import run

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

BINNING, TDI, LINES, WIDTH = 16, 64, 200, 64
#: CPMM number by the CCD's name.
CPMM = {"RED4": 5, "RED5": 8, "BG12": 4, "RED0": 0}


def edr(folder, ccd, channel, codes, **changes):
    """A channel whose code c stands for 10 c to 10 c + 9; of 16 bits the values themselves."""
    size = codes.dtype.itemsize
    nodes = [(10 * c, 10 * c + 9) for c in range(254)] + [(2540, 16383), (-9998, -9998)]
    calibration = 20 + 20 // BINNING + TDI // BINNING
    keys = {
        "DATA_SET_ID": '"MRO-M-HIRISE-2-EDR-V1.0"',
        "OBSERVATION_ID": '"PSP_000000_0000"',
        "PRODUCT_ID": f'"PSP_000000_0000_{ccd}_{channel}"',
        "INSTRUMENT_ID": '"HIRISE"',
        "START_TIME": "2006-11-17T03:27:53.118",
        "SPACECRAFT_CLOCK_START_COUNT": '"848201291:32768"',
        "MRO:CPMM_NUMBER": CPMM[ccd],
        "MRO:CHANNEL_NUMBER": channel,
        "MRO:BINNING": BINNING,
        "MRO:TDI": TDI,
        "MRO:SCAN_EXPOSURE_DURATION": "80.0000 <MICROSECONDS>",
        "MRO:LINE_EXPOSURE_DURATION": f"{80 * BINNING} <MICROSECONDS>",
        "MRO:LOOKUP_CONVERSION_TABLE": f"({', '.join(map(str, nodes))})".replace("), ", "),\n     "),
        "^CALIBRATION_IMAGE": "8193 <BYTES>",
        "^IMAGE": f"{8193 + calibration * (6 + size * (codes.shape[1] + 28))} <BYTES>",
    } | changes
    text = "PDS_VERSION_ID = PDS3\r\n" + "".join(f"{k} = {v}\r\n" for k, v in keys.items())
    for name, lines in (("CALIBRATION_IMAGE", calibration), ("IMAGE", len(codes))):
        text += (
            f"OBJECT = {name}\r\n LINES = {lines}\r\n LINE_SAMPLES = {codes.shape[1]}\r\n"
            f" SAMPLE_BITS = {8 * size}\r\n LINE_PREFIX_BYTES = {6 + 12 * size}\r\n"
            f" LINE_SUFFIX_BYTES = {16 * size}\r\nEND_OBJECT = {name}\r\n"
        )
    pixels = np.full((calibration + len(codes), codes.shape[1] + 28), 9, codes.dtype.newbyteorder(">"))
    pixels[calibration:, 12:-16] = codes
    rows = np.zeros((len(pixels), 6 + size * pixels.shape[1]), np.uint8)
    rows[:, :6] = [255, 0, 232, 0, 0, 0]
    rows[:, 6:] = pixels.view(np.uint8)
    path = folder / f"PSP_000000_0000_{ccd}_{channel}.IMG"
    path.write_bytes((text + "END\r\n").encode().ljust(8192) + rows.tobytes())
    return path


def scene(seed, width=2 * WIDTH):
    """Codes that change slowly over the columns, as neighbours across a seam do."""
    rough = np.random.default_rng(seed).normal(size=(LINES, width + 8))
    smooth = np.apply_along_axis(lambda row: np.convolve(row, np.ones(9) / 3.0, "valid"), 1, rough)
    return np.clip(np.round(120 + 30 * smooth), 1, 250).astype(np.uint8)


@pytest.fixture
def observation(tmp_path):
    """RED4 and BG12, both channels; column 5 of RED4 is clipped at places, one pixel of BG12 a gap."""
    folder = tmp_path / "edr"
    folder.mkdir()
    images = {"RED4": scene(1), "BG12": scene(2)}
    images["RED4"][::20, 5] = 254
    images["BG12"][7, 100] = 255
    for name, image in images.items():
        edr(folder, name, 1, image[:, :WIDTH])
        edr(folder, name, 0, image[:, WIDTH:])
    return folder, images


def read(path):
    with rasterio.open(path) as raster:
        return raster.read(1)


def test_channels_are_joined_and_clipped_columns_masked(observation, tmp_path, capsys):
    folder, images = observation
    out = tmp_path / "acq"
    assert run(["init", str(folder), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "RED4: channel 1 and 0, 200 lines x 128 columns, 64 TDI stages, binning 16; 1 columns" in said
    assert (
        "kernels of SPICE (lsk, sclk, pck, fk, and spk and ck of MRO" in said and "mro_hirise_v12.ti" in said
    )
    toml = tomllib.loads((out / "acquisition.toml").read_text())
    assert [band["name"] for band in toml["band"]] == ["RED4", "BG12"]
    for name, image in images.items():
        mask = read(out / f"{name}_mask.tif").astype(bool)
        wanted = np.isin(image, (0, 254, 255))
        wanted[:, wanted.mean(axis=0) > 0.01] = True
        np.testing.assert_array_equal(mask, wanted)
        # the middle of 10 c to 10 c + 9 lies on a half, which rounds either way
        off = read(out / f"{name}.tif")[~mask] - (10.0 * image[~mask] + 4.5)
        np.testing.assert_allclose(np.abs(off), 0.5)
    for band in toml["band"]:
        assert band["stages"] == 4 and band["line_period"] == pytest.approx(1.28e-3)
        # 64 lines of the CCD summed, 16 of them in a line of the image: 24 before its begin
        assert band["first_line_time"] == pytest.approx(-24 * 80e-6)
    assert len(load_acquisition(out / "acquisition.toml").bands) == 2


def test_channels_of_16_bits_are_joined_and_clipped_columns_masked(tmp_path, capsys):
    """Values of one CCD, codes of the other; a clipped column in each, a gap."""
    wide, narrow = scene(1).astype(np.uint16) * 60, scene(2)
    wide[::20, 70], wide[9, 3] = 16383, 0xFFFF
    narrow[::20, 5] = 254
    none = {"MRO:LOOKUP_CONVERSION_TABLE": "((0, 0))"}
    for channel, columns in ((1, slice(0, WIDTH)), (0, slice(WIDTH, None))):
        edr(tmp_path, "RED4", channel, wide[:, columns], **none)
        edr(tmp_path, "BG12", channel, narrow[:, columns])
    assert run(["init", str(tmp_path), "--out", str(tmp_path / "acq")]) == 0
    said = capsys.readouterr().out
    assert "RED4: values of 14 bits, no look-up table" in said and "BG12: codes stand for" in said
    mask = read(tmp_path / "acq" / "RED4_mask.tif").astype(bool)
    wanted = np.zeros(wide.shape, bool)
    wanted[:, 70] = wanted[9, 3] = True
    np.testing.assert_array_equal(mask, wanted)
    np.testing.assert_array_equal(read(tmp_path / "acq" / "RED4.tif")[~mask], wide[~mask])
    assert read(tmp_path / "acq" / "BG12_mask.tif")[:, 5].all()
    # codes whose table is not there do not go together with values
    edr(tmp_path, "BG12", 0, narrow[:, WIDTH:], **none)
    assert run(["init", str(tmp_path), "--out", str(tmp_path / "acq2")]) == 2
    assert "codes of a table that is not there" in capsys.readouterr().err


def test_ccds_look_where_the_kernel_says(observation, tmp_path):
    folder, _ = observation
    out = tmp_path / "acq"
    assert run(["init", str(folder), "--out", str(out)]) == 0
    looks = {}
    for name in ("RED4", "BG12"):
        with (out / f"{name}.csv").open() as table:
            looks[name] = np.array([[float(row[k]) for k in "xyz"] for row in csv.DictReader(table)])
    # by hand, mm: 14.2965 further ahead, the lens at 98 and 84 mm from its axis of 11 994.9988 mm
    ideal = {}
    for name, x in (("RED4", -96.4998), ("BG12", -82.2033)):
        x += 0.012 * (-64 + 32 - 7.5)
        # mean of the columns 1 to 128: the middle of the CCD
        square = x**2 + 16.9992**2
        ideal[name] = x * (1 + 0.0048509 - 2.41312e-7 * square + 1.62369e-13 * square**2) / 11994.9988
    ahead = {name: (look[:, 1] / look[:, 2]).mean() for name, look in looks.items()}
    assert ahead["BG12"] - ahead["RED4"] == pytest.approx(ideal["BG12"] - ideal["RED4"], rel=2e-4)
    assert abs(ahead["RED4"]) < 1e-6  # the first CCD looks straight down
    step = np.diff(looks["RED4"][:, 0] / looks["RED4"][:, 2])
    assert step == pytest.approx(
        np.full(127, 16 * 0.012 * 1.0026 / 11994.9988), rel=1e-3
    )  # to larger x: left


def test_a_mirrored_channel_is_found_and_turned(observation, tmp_path, capsys):
    folder, images = observation
    edr(folder, "BG12", 0, images["BG12"][:, :63:-1])
    assert run(["init", str(folder), "--out", str(tmp_path / "acq")]) == 0
    assert "BG12: channel 0 was mirrored" in capsys.readouterr().out
    values = read(tmp_path / "acq" / "BG12.tif")
    assert abs(values[50, 120] - (10.0 * images["BG12"][50, 120] + 4.5)) == 0.5


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ([("RED4", 1, {}), ("RED4", 0, {})], "of one CCD (RED4) alone"),
        ([("RED4", 1, {}), ("RED5", 1, {"OBSERVATION_ID": '"ESP_1"'})], "is of observation"),
        ([("RED4", 1, {}), ("RED4", 0, {"MRO:TDI": "32"}), ("RED5", 1, {})], "differ in stages (64 and 32)"),
        ([("RED4", 1, {"MRO:CPMM_NUMBER": "14"}), ("RED5", 1, {})], "electronics 14"),
        ([("RED4", 1, {"SPACECRAFT_CLOCK_START_COUNT": '"now"'}), ("RED5", 1, {})], "seconds:ticks are read"),
        (
            [("RED4", 1, {"SPACECRAFT_CLOCK_START_COUNT": '"848201291:65536"'}), ("RED5", 1, {})],
            "ticks below 65536",
        ),
        ([("RED4", 1, {"START_TIME": "2006-13-17T03:27:53.118"}), ("RED5", 1, {})], "START_TIME"),
        (
            [("RED4", 1, {"SPACECRAFT_CLOCK_START_COUNT": '"848202291:32768"'}), ("RED5", 1, {})],
            "1000 s after",
        ),
    ],
)
def test_sets_that_do_not_go_together_are_refused(files, said, tmp_path, capsys):
    paths = [edr(tmp_path, ccd, channel, scene(3, WIDTH), **changes) for ccd, channel, changes in files]
    assert run(["init", *map(str, paths), "--out", str(tmp_path / "acq")]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "acq").exists()


@pytest.mark.parametrize(
    ("codes", "said"),
    [
        (np.full((LINES, WIDTH), 255, np.uint8), "BG12 holds no value (clipped codes, gaps)"),
        (np.full((LINES, WIDTH), 77, np.uint8), "BG12 holds the same value (774) everywhere"),
        (scene(3, WIDTH)[:7], "BG12 has 7 lines; 8 or more"),
        (scene(3, 100), "has 100 columns, not the "),
    ],
)
def test_a_ccd_that_holds_nothing_is_refused(codes, said, tmp_path, capsys):
    paths = [edr(tmp_path, "RED4", 1, scene(3, WIDTH)), edr(tmp_path, "BG12", 1, codes)]
    assert run(["init", *map(str, paths), "--out", str(tmp_path / "acq")]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "acq").exists()


def test_ccds_that_overlap_by_their_edges_are_matched_in_narrow_windows(tmp_path, monkeypatch, capsys):
    """RED4 and RED5: 24.0002 mm apart, 2000 of 2048 samples: 48 in common, 12 of them 4 x binned."""
    for binning, width in ((1, 1024), (4, 256)):
        monkeypatch.setitem(globals(), "BINNING", binning)
        folder = tmp_path / str(binning)
        folder.mkdir()
        for ccd, channel in (("RED4", 0), ("RED5", 1)):
            edr(folder, ccd, channel, scene(channel, width)[:40])
        assert run(["init", str(folder), "--out", str(folder / "acq")]) == 0
        toml = tomllib.loads((folder / "acq" / "acquisition.toml").read_text())
        said = capsys.readouterr().out
        if binning == 1:
            assert 28 <= toml["matching"]["window"][1] <= 32
        else:
            assert "matching" not in toml and "RED5 shows 12 columns that another shows too: too few" in said


def test_ccds_apart_are_said_to_hold_no_motion(tmp_path, capsys):
    paths = [edr(tmp_path, ccd, 1, scene(3, WIDTH)) for ccd in ("RED0", "RED5")]
    assert run(["init", *map(str, paths), "--out", str(tmp_path / "acq")]) == 0
    said = capsys.readouterr().out
    assert "no two of RED0, RED5 show the same ground" in said and "next: sightline check" in said
    other = tmp_path / "image.img"
    other.write_bytes(b"0" * 100)
    assert run(["init", *map(str, paths), str(other), "--out", str(tmp_path / "acq2")]) == 2
    assert "is no HiRISE EDR" in capsys.readouterr().err
