"""HiRISE raw images (PDS3 EDR, one channel of one CCD): the image, what was read beside it, and the label.

A line is 6 bytes of identification, 12 buffer pixels (empty, through the electronics), the image, and 16 dark
reference pixels (masked detectors). Before the image stand calibration lines of the same form: 20 read while
the charge was clocked the other way, then lines of masked rows, then the ramp in which the TDI fills. Counts,
offsets and the 8-bit look-up table are the label's; the split of the calibration lines is that of ISIS
``histat`` (20, 20 / binning, TDI / binning). GDAL's PDS driver skips no line prefix, so bytes are read here.

Not here: what the pixels say of noise (``imaging/noise_estimation.py``).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.access import LARGE, check_file, read_bytes
from sightline.errors import FormatError, InputError, foreign_errors, reads
from sightline.imaging.noise_estimation import CodeTable
from sightline.imaging.strip_noise import StripPixels

Codes = NDArray[np.uint8]

#: Bytes of a label that are looked at for its END; all HiRISE labels stop well before.
LABEL_BYTES = 65536
#: Bytes before and behind the image in a line, and bytes of the prefix that identify the line.
PREFIX, SUFFIX, IDENTITY = 18, 16, 6
#: A line that arrived begins with this (the first 19 bits of the label's synchronisation pattern).
SYNCHRONISATION = 0b1111111100000000111
#: Ticks of the spacecraft's clock in a second.
TICKS = 65536
#: Calibration lines that are read with the charge clocked backwards, and rows of the mask (unbinned).
REVERSE_LINES, MASK_ROWS = 20, 20
#: Codes that are no value: low saturation, high saturation, gap (as ISIS ``hi2isis`` takes them).
SPECIAL = (0, 254, 255)


@dataclass(frozen=True, eq=False)
class HiriseLines:
    """Lines of one kind, 8-bit codes.

    Attributes
    ----------
    buffer : (lines, 12) uint8
    image : (lines, columns) uint8
    dark : (lines, 16) uint8
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
        14-bit values behind each code.
    image, calibration : HiriseLines
    """

    product: str
    stages: int
    binning: int
    line_period: float
    table: CodeTable
    image: HiriseLines
    calibration: HiriseLines

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
        """What the estimate of noise reads; lines that did not arrive whole are left out."""
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
    count = re.fullmatch(r"(?:\d+/)?(\d+)[:.](\d+)", text)
    if count is None:
        raise label.refused(f"SPACECRAFT_CLOCK_START_COUNT is {text[:40]!r}; seconds:ticks are read")
    return HiriseSetting(
        label.text_of("OBSERVATION_ID"),
        label.integer("MRO:CPMM_NUMBER"),
        label.integer("MRO:CHANNEL_NUMBER"),
        stages,
        binning,
        label.number("MRO:SCAN_EXPOSURE_DURATION") * 1e-6,
        int(count[1]) * TICKS + int(count[2]),
        text,
        label.text_of("START_TIME"),
    )


def _counts(label: _Label) -> tuple[int, int]:
    """Binning and TDI stages."""
    binning, stages = label.integer("MRO:BINNING"), label.integer("MRO:TDI")
    if binning < 1 or stages < 1:
        raise label.refused(f"TDI {stages} and binning {binning} are no counts")
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
    table = _code_table(label)
    binning, stages = _counts(label)
    period = label.number("MRO:LINE_EXPOSURE_DURATION") * 1e-6
    return HiriseEdr(
        label.text_of("PRODUCT_ID"),
        stages,
        binning,
        period,
        table,
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
            return float(text.split("<")[0])
        except ValueError:
            raise self.refused(f"{key} is {text!r}, no number") from None

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


def _code_table(label: _Label) -> CodeTable:
    key = "MRO:LOOKUP_CONVERSION_TABLE"
    found = re.search(rf"{key}\s*=\s*\(([-\d\s,()]*)\)", label.text)
    if found is None:
        raise label.refused(f"its label has no {key}")
    pairs = np.array(re.findall(r"\(\s*(-?\d+)\s*,\s*(-?\d+)\s*\)", found[1]), dtype=np.float64)
    if pairs.shape != (256, 2):
        raise label.refused(f"{key} has {len(pairs)} nodes; the 256 of an 8-bit table are needed")
    pairs[list(SPECIAL)] = np.nan
    pairs[pairs[:, 0] < 0.0] = np.nan
    try:
        return CodeTable(pairs[:, 0] - 0.5, pairs[:, 1] + 0.5)
    except InputError as error:
        raise label.refused(f"{key}: {error}") from None


def _lines(label: _Label, content: bytes, name: str) -> HiriseLines:
    place = label.object(name)
    lines, columns = label.integer("LINES", place), label.integer("LINE_SAMPLES", place)
    around = (label.integer("LINE_PREFIX_BYTES", place), label.integer("LINE_SUFFIX_BYTES", place))
    if around != (PREFIX, SUFFIX) or label.integer("SAMPLE_BITS", place) != 8:
        raise label.refused(
            f"{name} has {around[0]} + {around[1]} bytes about its lines and "
            f"{label.integer('SAMPLE_BITS', place)}-bit samples; {PREFIX} + {SUFFIX} and 8 are read"
        )
    start, width = label.integer(f"^{name}") - 1, PREFIX + columns + SUFFIX
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
    return HiriseLines(rows[:, IDENTITY:PREFIX], rows[:, PREFIX:-SUFFIX], rows[:, -SUFFIX:], arrived)
