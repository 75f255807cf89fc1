"""HiRISE raw images (PDS3 EDR, one channel of one CCD): the image, what was read beside it, and the label.

A line is 6 bytes of identification, 12 buffer pixels (empty, through the electronics), the image, and 16 dark
reference pixels (masked detectors). Before the image stand calibration lines of the same form: 20 read while
the charge was clocked the other way, then lines of masked rows, then the ramp in which the TDI fills. Pixels
are 8-bit codes of a look-up table, which the label or the file holds, or 14-bit values in 16 bits, high byte
first. Counts and offsets are the label's; the split of the calibration lines is that of ISIS ``histat`` (20,
20 / binning, TDI / binning), codes that are no value those of ``hi2isis``. GDAL's PDS driver skips no line
prefix, so bytes are read here.

Not here: what the pixels say of noise (``imaging/noise_estimation.py``).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.access import LARGE, check_file, read_bytes
from sightline.errors import FormatError, InputError, foreign_errors, reads
from sightline.imaging.noise_estimation import CodeTable
from sightline.imaging.strip_noise import StripPixels
from sightline.io.formats.instants import parse_utc

Codes = NDArray[np.unsignedinteger[Any]]

#: Bytes of a label that are looked at for its END; all HiRISE labels stop well before.
LABEL_BYTES = 65536
#: Bytes of a line that identify it, pixels before the image, and pixels behind it.
IDENTITY, BUFFER, DARK = 6, 12, 16
#: A line that arrived begins with this (the first 19 bits of the label's synchronisation pattern).
SYNCHRONISATION = 0b1111111100000000111
#: Ticks of the spacecraft's clock in a second.
TICKS = 65536
#: TDI stages and lines binned into one, at most.
MOST_STAGES, MOST_BINNING = 128, 16
#: Calibration lines that are read with the charge clocked backwards, and rows of the mask (unbinned).
REVERSE_LINES, MASK_ROWS = 20, 20
#: Codes of 8 bits that are no value: low saturation, high saturation, gap.
SPECIAL = (0, 254, 255)
#: Values of 14 bits, whose first and last are saturation; a gap in 16 bits, and in one byte of them.
_VALUES, _GAP, _HALF_GAP = 16384, 0xFFFF, 0xFF
#: Words of a label that says that no look-up table was used.
_NO_TABLE = ("N/A", "NULL", "NONE", "")


@dataclass(frozen=True, eq=False)
class HiriseLines:
    """Lines of one kind, codes of 8 bits or values of 14.

    Attributes
    ----------
    buffer : (lines, 12) uint8 or uint16
    image : (lines, columns) uint8 or uint16
    dark : (lines, 16) uint8 or uint16
    arrived : (lines,) bool
        The line's header is whole.
    """

    buffer: Codes
    image: Codes
    dark: Codes
    arrived: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class HiriseEdr:
    """One channel of one CCD as it came down.

    Attributes
    ----------
    product : str
    stages : int
        TDI lines that were summed.
    binning : int
        Detector rows and columns in one pixel.
    line_period : float
        s between lines of the (binned) image.
    table : CodeTable
        14-bit values behind each code; of values themselves, the values.
    meaning : str
        In words, what the values are.
    image, calibration : HiriseLines
    """

    product: str
    stages: int
    binning: int
    line_period: float
    table: CodeTable
    meaning: str
    image: HiriseLines
    calibration: HiriseLines

    @property
    def none(self) -> NDArray[np.bool_]:
        """(lines, columns) where the image has no value: clipped or unused codes, gaps."""
        codes = self.image.image
        bad = np.isnan(self.table.lower)[codes]
        if codes.dtype != np.uint8:
            # one byte was lost with the pixel beside it
            lost = codes == _GAP
            bad[:, :-1] |= lost[:, 1:] & (codes[:, :-1] & _HALF_GAP == _HALF_GAP)
        return np.asarray(bad)

    @property
    def reverse(self) -> slice:
        """Calibration lines that were clocked backwards: no charge."""
        return slice(0, REVERSE_LINES)

    @property
    def ramp(self) -> slice:
        """Calibration lines in which the TDI fills: binning, 2 binning, ... stages."""
        first = REVERSE_LINES + MASK_ROWS // self.binning
        return slice(first, first + self.stages // self.binning)

    def pixels(self) -> StripPixels:
        """What the estimate of noise reads; lines that did not arrive whole are left out.

        InputError where the values behind its codes are not known.
        """
        if self.meaning == CODES:
            raise InputError(
                f"{self.product}: holds 8-bit codes and no look-up table, which says what values they stand "
                "for; noise needs values: give a product with its table"
            )
        image, calibration = self.image, self.calibration
        whole = image.arrived
        return StripPixels(
            self.table,
            image.image[whole],
            image.buffer[whole],
            image.dark[whole],
            calibration.image[self.reverse],
            calibration.buffer[self.reverse],
            calibration.dark[self.reverse],
            calibration.image[self.ramp],
        )


@dataclass(frozen=True)
class HiriseSetting:
    """What a label sets of one channel.

    Attributes
    ----------
    observation : str
    cpmm, channel : int
        Electronics of its CCD (0 to 13), and which half of it.
    stages, binning : int
        As of `HiriseEdr`.
    scan_period : float
        s between lines of the CCD, before binning.
    clock : int
        Ticks of the spacecraft's clock when line 0 begins, 1/65536 s each.
    clock_text, start : str
        The same as the label has it; in UTC, to a ms.
    """

    observation: str
    cpmm: int
    channel: int
    stages: int
    binning: int
    scan_period: float
    clock: int
    clock_text: str
    start: str


@reads("a HiRISE EDR")
def read_hirise_setting(path: Path) -> HiriseSetting:
    """The label of a HiRISE EDR: which channel it is of, and how that was set.

    Raises
    ------
    FormatError
        If it is not one, or its label lacks what is needed.
    """
    check_file(path)
    with path.open("rb") as stream:
        label = _Label(path, stream.read(LABEL_BYTES).decode("latin-1"))
    binning, stages = _counts(label)
    text = label.text_of("SPACECRAFT_CLOCK_START_COUNT")
    count = re.fullmatch(r"(?:\d+/)?(\d{1,10})[:.](\d{1,5})", text)
    if count is None or int(count[2]) >= TICKS:
        raise label.refused(
            f"SPACECRAFT_CLOCK_START_COUNT is {text[:40]!r}; seconds:ticks are read, ticks below {TICKS}"
        )
    start = label.text_of("START_TIME")
    parse_utc(f"{start}Z", f"{path}: START_TIME")
    return HiriseSetting(
        label.text_of("OBSERVATION_ID"),
        label.integer("MRO:CPMM_NUMBER"),
        label.integer("MRO:CHANNEL_NUMBER"),
        stages,
        binning,
        label.period("MRO:SCAN_EXPOSURE_DURATION"),
        int(count[1]) * TICKS + int(count[2]),
        text,
        start,
    )


def _counts(label: _Label) -> tuple[int, int]:
    """Binning and TDI stages."""
    binning, stages = label.integer("MRO:BINNING"), label.integer("MRO:TDI")
    if not (1 <= binning <= MOST_BINNING and 1 <= stages <= MOST_STAGES):
        raise label.refused(
            f"MRO:TDI is {stages}, MRO:BINNING {binning}; 1 to {MOST_STAGES} and 1 to {MOST_BINNING} are read"
        )
    return binning, stages


def is_hirise(path: Path) -> bool:
    """Whether a regular file begins with a PDS3 label of HiRISE; FormatError for what is no regular file."""
    check_file(path)
    with foreign_errors(path, "cannot be read", "check the name"), path.open("rb") as stream:
        head = stream.read(LABEL_BYTES)
    return head.startswith(b"PDS_VERSION_ID") and b'"HIRISE"' in head


@reads("a HiRISE EDR")
def read_hirise_edr(path: Path) -> HiriseEdr:
    """A HiRISE EDR, the image and all that was read beside it.

    Raises
    ------
    FormatError
        If it is not one, lacks what is needed, or is cut short.
    """
    content = read_bytes(path, "a HiRISE EDR", most=LARGE)
    label = _Label(path, content[:LABEL_BYTES].decode("latin-1"))
    bits = {name: label.integer("SAMPLE_BITS", label.object(name)) for name in ("IMAGE", "CALIBRATION_IMAGE")}
    if set(bits.values()) not in ({8}, {16}):
        raise label.refused(
            f"IMAGE has {bits['IMAGE']}-bit samples, CALIBRATION_IMAGE {bits['CALIBRATION_IMAGE']}-bit ones; "
            "8 or 16, in both alike, are read"
        )
    table, meaning = _table(label, content, bits["IMAGE"])
    binning, stages = _counts(label)
    period = label.period("MRO:LINE_EXPOSURE_DURATION")
    return HiriseEdr(
        label.text_of("PRODUCT_ID"),
        stages,
        binning,
        period,
        table,
        meaning,
        _lines(label, content, "IMAGE"),
        _lines(label, content, "CALIBRATION_IMAGE"),
    )


class _Label:
    """The text of a PDS3 label, key by key."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        end = re.search(r"^END\s*$", text, re.MULTILINE)
        self.text = re.sub(r"/\*.*?\*/", "", text[: end.start()] if end else text, flags=re.DOTALL)
        if not text.startswith("PDS_VERSION_ID"):
            raise self.refused("it does not begin with a PDS3 label")
        if end is None:
            raise self.refused("its label has no END")
        if self.text_of("INSTRUMENT_ID") != "HIRISE" or "EDR" not in self.text_of("DATA_SET_ID"):
            raise self.refused(
                f"instrument {self.text_of('INSTRUMENT_ID')}, data set {self.text_of('DATA_SET_ID')}"
            )

    def refused(self, why: str) -> FormatError:
        return FormatError(f"{self.path}: not a HiRISE EDR that can be used: {why}")

    def text_of(self, key: str, where: str | None = None) -> str:
        found = re.search(rf"^\s*{re.escape(key)}\s*=\s*(.+?)\s*$", where or self.text, re.MULTILINE)
        if found is None:
            raise self.refused(f"its label has no {key}")
        return found[1].strip('"')

    def number(self, key: str, where: str | None = None) -> float:
        text = self.text_of(key, where)
        try:
            value = float(text.split("<")[0])
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise self.refused(f"{key} is {text!r}, no finite number")
        return value

    def period(self, key: str) -> float:
        """s between lines, of a label's us."""
        value = self.number(key)
        if not 1.0 <= value <= 1e7:
            raise self.refused(f"{key} is {value:g} us; line scanners take 1 us to 10 s a line")
        return value * 1e-6

    def integer(self, key: str, where: str | None = None) -> int:
        return int(self.number(key, where))

    def object(self, name: str) -> str:
        """The statements of one OBJECT."""
        found = re.search(
            rf"^OBJECT\s*=\s*{name}\s*$(.*?)^END_OBJECT\s*=\s*{name}\s*$", self.text, re.MULTILINE | re.DOTALL
        )
        if found is None:
            raise self.refused(f"its label has no OBJECT {name}")
        return found[1]


#: What values are: by the table of the label, or of the file; not coded; not known.
BY_LABEL = "codes stand for the middle of their range in the label's look-up table; 0, 254 and 255 are none"
ON_BOARD = (
    "codes stand for the middle of their range in the table that was used on board; 0, 254, 255 are none"
)
VALUES = "values of 14 bits, no look-up table; 0 and 16383 are clipped, larger ones gaps"
CODES = (
    "8-bit codes as they are: neither the label nor the file holds their look-up table; 0, 254, 255 are none"
)


def _table(label: _Label, content: bytes, bits: int) -> tuple[CodeTable, str]:
    """The value behind each code, and in words what that is."""
    key = "MRO:LOOKUP_CONVERSION_TABLE"
    found = re.search(rf"{key}\s*=\s*\(([-\d\s,()]*)\)", label.text)
    pairs = [] if found is None else re.findall(r"\(\s*(-?\d+)\s*,\s*(-?\d+)\s*\)", found[1])
    kind = re.search(r"^\s*MRO:LOOKUP_TABLE_TYPE\s*=\s*\"?(.*?)\"?\s*$", label.text, re.MULTILINE)
    # (0, 0) alone stands for none
    without = pairs == [("0", "0")] or (not pairs and kind is not None and kind[1].upper() in _NO_TABLE)
    if bits == 16 and (without or not pairs):
        return _themselves(2**16, (0, *range(_VALUES - 1, 2**16))), VALUES
    if bits == 16:
        raise label.refused(f"{key} has {len(pairs)} nodes, but samples are of 16 bits, which none codes")
    if without:
        board = _on_board(label, content)
        return (_themselves(256, SPECIAL), CODES) if board is None else (board, ON_BOARD)
    if found is None:
        raise label.refused(f"its label has no {key}")
    return _code_table(label, key, np.array(pairs, dtype=np.float64)), BY_LABEL


def _themselves(count: int, none: Sequence[int]) -> CodeTable:
    """Codes that stand for their own number; some for none."""
    values = np.arange(float(count))
    values[list(none)] = np.nan
    return CodeTable(values - 0.5, values + 0.5)


def _code_table(label: _Label, key: str, pairs: NDArray[np.float64]) -> CodeTable:
    """The label's pairs of first and last value."""
    if pairs.shape != (256, 2):
        raise label.refused(f"{key} has {len(pairs)} nodes; the 256 of an 8-bit table are needed")
    pairs[list(SPECIAL)] = np.nan
    pairs[pairs[:, 0] < 0.0] = np.nan
    try:
        return CodeTable(pairs[:, 0] - 0.5, pairs[:, 1] + 0.5)
    except InputError as error:
        raise label.refused(f"{key}: {error}") from None


def _on_board(label: _Label, content: bytes) -> CodeTable | None:
    """The table of the file, a code for each of 16,384 values; None where there is none."""
    start = re.search(r"^\s*\^LOOKUP_TABLE\s*=\s*(\d+)", label.text, re.MULTILINE)
    first = -1 if start is None else int(start[1]) - 1
    codes = np.frombuffer(content, np.uint8)[first : first + _VALUES]
    if first < 0 or len(codes) < _VALUES or (np.diff(codes.astype(int)) < 0).any() or codes[0] == codes[-1]:
        return None
    lower, upper = (np.full(256, np.nan) for _ in range(2))
    used, begin, count = np.unique(codes, return_index=True, return_counts=True)
    lower[used], upper[used] = begin - 0.5, begin + count - 0.5
    lower[list(SPECIAL)] = upper[list(SPECIAL)] = np.nan
    return CodeTable(lower, upper)


def _lines(label: _Label, content: bytes, name: str) -> HiriseLines:
    place = label.object(name)
    lines, columns = label.integer("LINES", place), label.integer("LINE_SAMPLES", place)
    size = label.integer("SAMPLE_BITS", place) // 8
    around = (label.integer("LINE_PREFIX_BYTES", place), label.integer("LINE_SUFFIX_BYTES", place))
    prefix, suffix = IDENTITY + BUFFER * size, DARK * size
    if around != (prefix, suffix):
        raise label.refused(
            f"{name} has {around[0]} + {around[1]} bytes about its lines; with {8 * size}-bit samples "
            f"{prefix} + {suffix} are read"
        )
    start, width = label.integer(f"^{name}") - 1, prefix + columns * size + suffix
    if lines < 1 or columns < 1 or start < 0:
        raise label.refused(f"{name} has {lines} lines of {columns} samples from byte {start + 1}")
    if start + lines * width > len(content):
        raise label.refused(
            f"{name} ends at byte {start + lines * width}, the file at {len(content)}: it is cut short"
        )
    rows = np.frombuffer(content, np.uint8, lines * width, start).reshape(lines, width)
    first = (rows[:, :3].astype(np.int64) << np.array([16, 8, 0])).sum(axis=1)
    # the label calls the prefix's last bit a "bad line" flag, but it is the last bit of the line counter
    arrived = first >> 5 == SYNCHRONISATION
    pixels = _codes(rows[:, IDENTITY:], size)
    return HiriseLines(pixels[:, :BUFFER], pixels[:, BUFFER:-DARK], pixels[:, -DARK:], arrived)


def _codes(rows: NDArray[np.uint8], size: int) -> Codes:
    """Bytes of lines as numbers of so many bytes, the highest first."""
    if size == 1:
        return rows
    return np.ascontiguousarray(rows).view(">u2").astype(np.uint16)
