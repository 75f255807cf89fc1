"""HiRISE raw images: label, look-up table, lines and what is read beside them."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import FormatError, InputError
from sightline.io.formats.hirise_edr import read_hirise_edr

LINES, COLUMNS, TDI, BINNING = 7, 10, 8, 2
CALIBRATION = 20 + 20 // BINNING + TDI // BINNING


def nodes() -> list[tuple[int, int]]:
    """Steps of 10 from 100 up; unused, open and special nodes as in real tables."""
    table = [(0, 99), *((100 + 10 * k, 109 + 10 * k) for k in range(200))]
    table += [(-9998, -9998)] * (254 - len(table))
    return [*table, (9000, 16383), (-9998, -9998)]


def label(**changes: str) -> str:
    keys = {
        "DATA_SET_ID": '"MRO-M-HIRISE-2-EDR-V1.0"',
        "PRODUCT_ID": '"PSP_000000_0000_RED0_0"',
        "INSTRUMENT_ID": '"HIRISE"',
        "MRO:BINNING": str(BINNING),
        "MRO:TDI": str(TDI),
        "MRO:LINE_EXPOSURE_DURATION": "167.5000 <MICROSECONDS>",
        "MRO:LOOKUP_CONVERSION_TABLE": f"({', '.join(str(n) for n in nodes())})".replace("), ", "),\n     "),
        "^CALIBRATION_IMAGE": "8193 <BYTES>",
        "^IMAGE": f"{8193 + CALIBRATION * (COLUMNS + 34)} <BYTES>",
    } | changes
    text = "PDS_VERSION_ID = PDS3\r\n" + "".join(f"{k} = {v}\r\n" for k, v in keys.items() if v)
    text += "/* OBJECT = IMAGE\r\nis not this one */\r\n"
    for name, lines in (("CALIBRATION_IMAGE", CALIBRATION), ("IMAGE", LINES)):
        text += (
            f"OBJECT = {name}\r\n    LINES = {lines}\r\n    LINE_SAMPLES = {COLUMNS}\r\n"
            "    SAMPLE_BITS = 8\r\n    LINE_PREFIX_BYTES = 18\r\n    LINE_SUFFIX_BYTES = 16\r\n"
            f"END_OBJECT = {name}\r\n"
        )
    return text + "END\r\n"


def write(path, text=None, *, cut=0):
    """An EDR whose pixels count up; returns (calibration, image) as written, identification included."""
    rows = np.arange((CALIBRATION + LINES) * (COLUMNS + 34)).reshape(-1, COLUMNS + 34) % 200 + 1
    rows[:, :6] = [255, 0, 232, 0, 0, 0]
    rows[-2, :3] = 255
    body = rows.astype(np.uint8)
    content = (text or label()).encode().ljust(8192) + body.tobytes()
    path.write_bytes(content[: len(content) - cut])
    return body[:CALIBRATION], body[CALIBRATION:]


def test_every_byte_is_where_the_label_says(tmp_path):
    calibration, image = write(tmp_path / "x.IMG")
    edr = read_hirise_edr(tmp_path / "x.IMG")
    assert (edr.product, edr.stages, edr.binning) == ("PSP_000000_0000_RED0_0", TDI, BINNING)
    assert edr.line_period == pytest.approx(167.5e-6)
    for read, written in ((edr.calibration, calibration), (edr.image, image)):
        assert (read.buffer == written[:, 6:18]).all()
        assert (read.image == written[:, 18:-16]).all()
        assert (read.dark == written[:, -16:]).all()
    assert edr.image.arrived.tolist() == [True] * (LINES - 2) + [False, True]
    pixels = edr.pixels()
    assert len(pixels.image) == LINES - 1 and len(pixels.reverse) == 20
    assert (pixels.ramp == edr.calibration.image[-TDI // BINNING :]).all()


def test_codes_stand_for_the_middles_of_their_ranges(tmp_path):
    write(tmp_path / "x.IMG")
    table = read_hirise_edr(tmp_path / "x.IMG").table
    codes = np.array([1, 2, 200], dtype=np.uint8)
    assert table.values(codes).tolist() == [104.5, 114.5, 2094.5]
    # ten values, equally likely: variance (10^2 - 1) / 12, and 1/12 for the rounding to whole values
    assert table.rounding(codes) == pytest.approx([100.0 / 12.0] * 3)
    # below and above the table, unused, and gaps are no values
    assert np.isnan(table.values(np.array([0, 230, 254, 255], dtype=np.uint8))).all()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("hello", "PDS3 label"),
        (label().replace("END\r\n", ""), "no END"),
        (label(INSTRUMENT_ID='"CTX"'), "instrument CTX"),
        (label(DATA_SET_ID='"MRO-M-HIRISE-3-RDR-V1.0"'), "RDR"),
        (label(**{"MRO:TDI": ""}), "no MRO:TDI"),
        (label(**{"MRO:TDI": '"many"'}), "no finite number"),
        (label(**{"MRO:TDI": "nan"}), "no finite number"),
        (label(**{"MRO:BINNING": "0"}), "MRO:BINNING 0; 1 to 128 and 1 to 16"),
        (label(**{"MRO:TDI": "6400"}), "MRO:TDI is 6400"),
        (label(**{"MRO:LINE_EXPOSURE_DURATION": "0"}), "MRO:LINE_EXPOSURE_DURATION is 0 us"),
        (label(**{"MRO:LOOKUP_CONVERSION_TABLE": ""}), "no MRO:LOOKUP_CONVERSION_TABLE"),
        (label(**{"MRO:LOOKUP_CONVERSION_TABLE": "((0, 99), (100, 199))"}), "2 nodes"),
        (label().replace("SAMPLE_BITS = 8", "SAMPLE_BITS = 12"), "12-bit samples"),
        (label().replace("SAMPLE_BITS = 8", "SAMPLE_BITS = 16", 1), "8 or 16, in both alike"),
        (label().replace("SAMPLE_BITS = 8", "SAMPLE_BITS = 16"), "256 nodes, but samples are of 16 bits"),
        (
            label(**{"MRO:LOOKUP_CONVERSION_TABLE": ""}).replace("SAMPLE_BITS = 8", "SAMPLE_BITS = 16"),
            r"with 16-bit samples 30 \+ 32 are read",
        ),
        (label().replace("(110, 119)", "(910, 919)"), "do not rise"),
        (label().replace("OBJECT = CALIBRATION_IMAGE", "OBJECT = OTHER"), "no OBJECT CALIBRATION_IMAGE"),
        (label().replace("LINE_PREFIX_BYTES = 18", "LINE_PREFIX_BYTES = 0"), r"18 \+ 16"),
        (label(**{"^IMAGE": ""}), r"no \^IMAGE"),
    ],
)
def test_what_is_no_such_file_is_refused_by_name(tmp_path, text, said):
    write(tmp_path / "x.IMG", text)
    with pytest.raises(FormatError, match=said) as error:
        read_hirise_edr(tmp_path / "x.IMG")
    assert "x.IMG" in str(error.value)


def wide(path, image, **changes):
    """An EDR of 14-bit values in 16 bits, high byte first, without a table."""
    columns = image.shape[1]
    width = 6 + 2 * (12 + columns + 16)
    keys = {"MRO:LOOKUP_CONVERSION_TABLE": "((0, 0))", "^IMAGE": f"{8193 + CALIBRATION * width} <BYTES>"}
    text = label(**(keys | changes)).replace(f"LINE_SAMPLES = {COLUMNS}", f"LINE_SAMPLES = {columns}")
    for a, b in {"SAMPLE_BITS = 8": "SAMPLE_BITS = 16", "PREFIX_BYTES = 18": "PREFIX_BYTES = 30"}.items():
        text = text.replace(a, b)
    text = text.replace("SUFFIX_BYTES = 16", "SUFFIX_BYTES = 32")
    rows = bytearray()
    for line in (*np.full((CALIBRATION, columns), 900), *image):
        rows += bytes([255, 0, 232, 0, 0, 0])
        for value in (*range(1000, 1012), *line, *range(2000, 2016)):
            rows += int(value).to_bytes(2, "big")
    path.write_bytes(text.encode().ljust(8192) + rows)


def test_values_of_16_bits_are_read_without_a_table(tmp_path):
    image = np.random.default_rng(2).integers(700, 16000, (LINES, COLUMNS))
    none = {(0, 1): 0, (1, 2): 16383, (2, 3): 16384, (3, 4): 65535, (4, 5): 65535, (4, 4): 0x12FF}
    for place, value in none.items():
        image[place] = value
    wide(tmp_path / "x.IMG", image)
    edr = read_hirise_edr(tmp_path / "x.IMG")
    assert edr.image.arrived.all() and "14 bits, no look-up table" in edr.meaning
    assert (edr.image.image == image).all()
    assert (edr.image.buffer == np.arange(1000, 1012)).all()
    assert (edr.image.dark == np.arange(2000, 2016)).all()
    # saturation, what no 14 bits hold, gaps, and the half of a pixel that a gap took
    wanted = np.zeros(image.shape, bool)
    wanted[tuple(zip(*none, strict=True))] = True
    assert (edr.none == wanted).all()
    assert (edr.table.values(edr.image.image)[~wanted] == image[~wanted]).all()
    assert (edr.pixels().ramp == 900).all()
    wide(tmp_path / "y.IMG", image, **{"MRO:LOOKUP_CONVERSION_TABLE": "", "MRO:LOOKUP_TABLE_TYPE": '"N/A"'})
    assert (read_hirise_edr(tmp_path / "y.IMG").image.image == image).all()


def test_codes_without_a_table_in_the_label_have_that_of_the_file(tmp_path):
    board = np.clip(np.arange(16384) // 100, 0, 254).astype(np.uint8)
    for name, held in (("with", board), ("without", None), ("falling", board[::-1])):
        path = tmp_path / f"{name}.IMG"
        end = 8193 + (CALIBRATION + LINES) * (COLUMNS + 34)
        keys = {"MRO:LOOKUP_CONVERSION_TABLE": "((0, 0))"}
        write(path, label(**keys, **({} if held is None else {"^LOOKUP_TABLE": f"{end} <BYTES>"})))
        if held is not None:
            path.write_bytes(path.read_bytes() + held.tobytes())
        edr = read_hirise_edr(path)
        codes = np.array([1, 77, 163, 0, 254, 255], np.uint8)
        if name == "with":
            # code c stands for 100 c to 100 c + 99; the last is cut short by the end of 14 bits
            expected = [149.5, 7749.5, 16341.5, *[np.nan] * 3]
            assert "used on board" in edr.meaning
        else:
            expected = [1, 77, 163, *[np.nan] * 3]
            assert "neither the label nor the file" in edr.meaning
            with pytest.raises(InputError, match="holds 8-bit codes and no look-up table"):
                edr.pixels()
        np.testing.assert_array_equal(edr.table.values(codes), expected)


def test_a_file_cut_short_or_not_there_is_refused(tmp_path):
    write(tmp_path / "x.IMG", cut=1)
    with pytest.raises(FormatError, match="cut short"):
        read_hirise_edr(tmp_path / "x.IMG")
    with pytest.raises(FormatError, match="no such file"):
        read_hirise_edr(tmp_path / "y.IMG")


def test_a_real_image_is_read(real_data):
    path = real_data("hirise_edr_bg12") / "PSP_001446_1790_BG12_0.IMG"
    edr = read_hirise_edr(path)
    assert (edr.product, edr.stages, edr.binning) == ("PSP_001446_1790_BG12_0", 64, 4)
    assert edr.image.image.shape == (5000, 256) and edr.calibration.image.shape == (41, 256)
    assert edr.image.arrived.all() and edr.calibration.arrived.all()
    # the label's table against the one that was used on board: 16,384 codes at byte 33,569
    onboard = np.frombuffer(path.read_bytes(), np.uint8, 16384, 33568)
    codes = np.arange(1, 254, dtype=np.uint8)
    middles = edr.table.values(codes)
    assert (onboard[np.floor(middles).astype(int)] == codes).all()
    assert (onboard[np.ceil(edr.table.lower[codes]).astype(int) - 1] == codes - 1).all()
    # the TDI fills by equal steps: each line of the ramp has binning stages more than the last
    ramp = np.nanmean(edr.table.values(edr.calibration.image[edr.ramp][1:13, 16:240]), axis=1)
    assert np.diff(ramp) == pytest.approx(np.diff(ramp).mean(), rel=0.03)
