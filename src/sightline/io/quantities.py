"""Numbers that a TOML file may give: each kind of quantity once, with its unit and what of it can be real.

Bounds are far outside of what is built: they refuse slips of unit, exponent and column, and numbers that
nothing can be reckoned with, not daring instruments. The widest real case stands beside each. A sigma may be
0, where that means "exactly"; what is smaller than its least is a slip.

Not here: which key is of which kind (the schemas), what combinations of allowed values cost
(``applications/expected_cost.py``), numbers in tables (``io/formats/tables.py``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import date, time
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

#: Characters of a value that a message repeats.
_SHOWN = 80
#: A quaternion whose length differs from 1 by more than this is a mistake, not rounding.
QUATERNION_TOLERANCE = 1e-3


def shown(value: object) -> str:
    """A value as a message repeats it: as TOML has it, of what is long the beginning."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, date | time):  # a datetime is a date
        return value.isoformat()
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list | tuple) and len(value) > 8:
        return f"[{', '.join(shown(item) for item in value[:3])}, ...] ({len(value)} values)"
    if isinstance(value, list | tuple):
        return f"[{', '.join(shown(item) for item in value)}]"
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > 10**20:
        return f"a {'negative ' if value < 0 else ''}number of {int(value.bit_length() * 0.30103) + 1} digits"
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}... ({len(text)} characters)"


@dataclass(frozen=True)
class Within:
    """Bounds of a number, for ``Annotated[float, Within(...)]`` and ``Annotated[int, Within(...)]``.

    Truth values and words in quotation marks are no numbers; whole numbers may be written 5.0.

    Attributes
    ----------
    least, most : float
        Both allowed, unless `above` or `below` says otherwise.
    unit : str
        Of both; empty for shares and counts.
    why : str
        What is meant, or what the widest real case is; ends the message.
    above, below : bool
        Whether `least` or `most` itself is not allowed.
    zero, infinite : bool
        Whether 0 or inf is allowed besides.
    signed : bool
        Whether the bounds are of the size of a number of either sign.
    """

    least: float
    most: float
    unit: str = ""
    why: str = ""
    above: bool = False
    below: bool = False
    zero: bool = False
    infinite: bool = False
    signed: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check in place of pydantic, which takes true for 1 and "7" for 7."""
        return core_schema.no_info_plain_validator_function(self.whole if source is int else self.number)

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Type and bounds as JSON Schema has them."""
        whole = core["type"] == "function-plain" and core["function"]["function"] == self.whole
        least = -self.most if self.signed else 0.0 if self.zero else self.least
        bounds = {
            "exclusiveMinimum" if self.above and not self.zero else "minimum": least,
            "exclusiveMaximum" if self.below else "maximum": self.most,
        }
        cast = int if whole else float
        return {"type": "integer" if whole else "number", **{k: cast(v) for k, v in bounds.items()}}

    def number(self, value: Any) -> float:
        """`value` as a float within the bounds; a pydantic error otherwise."""
        if isinstance(value, str) and not any(sign.isdigit() for sign in value):  # a word
            raise _not_allowed(self.words())
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise _not_allowed(f"a number{' without quotation marks' if isinstance(value, str) else ''} is")
        try:
            number = float(value)
        except OverflowError:
            raise _not_allowed(self.words()) from None
        if not self.holds(number):
            raise _not_allowed(self.words())
        return number + 0.0  # no -0.0

    def whole(self, value: Any) -> int:
        """`value` as an int within the bounds; a pydantic error otherwise."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise _not_allowed(
                f"a whole number{' without quotation marks' if isinstance(value, str) else ''} is"
            )
        if isinstance(value, float) and not value.is_integer():
            raise _not_allowed("a whole number is")
        number = int(value)
        if not self.holds(number):
            raise _not_allowed(self.words())
        return number

    def holds(self, number: float) -> bool:
        """Whether a number is allowed."""
        if (self.zero and number == 0.0) or (self.infinite and number == math.inf):
            return True
        size = abs(number) if self.signed else number
        low = size > self.least if self.above else size >= self.least
        return low and (size < self.most if self.below else size <= self.most)

    def words(self) -> str:
        """What is allowed, to end "... is not allowed: "."""
        least, most = _digits(self.least), _digits(self.most)
        low = "above " if self.above else ""
        text = f"{low}{least} {'to below' if self.below else 'to'} {most}"
        if self.signed:
            text = (
                f"-{most} to {most}"
                if self.least == 0.0
                else f"{low}{least} to {most} in size, of either sign,"
            )
        text = f"{'0, or ' if self.zero else ''}{text}"
        unit, most_of_all = f" {self.unit}" if self.unit else "", ", or inf" if self.infinite else ""
        return f"{text}{unit}{most_of_all} are" + (f"; {self.why}" if self.why else "")


def _digits(value: float) -> str:
    """A bound as people write it: 1000000 as 1e6."""
    text = f"{value:.10g}"
    if len(text.lstrip("-")) > 5 and value == float(f"{value:.0e}"):
        text = f"{value:.0e}"
    return text.replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")


def _not_allowed(words: str) -> PydanticCustomError:
    """A pydantic error with words of ours."""
    return PydanticCustomError("bound", "{words}", {"words": words})


def _of_length_one(value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    length = math.hypot(*value)
    if abs(length - 1.0) > QUATERNION_TOLERANCE:
        raise ValueError(
            f"{list(value)} has length {length:.6g}; a unit quaternion [x, y, z, w], scalar last, is expected"
        )
    return value


def _with_direction(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(value):
        raise ValueError("[0, 0, 0] has no direction; give it in body axes")
    return value


def _two_whole_numbers(value: object) -> object:
    pair = value if isinstance(value, list | tuple) and len(value) == 2 else [None]
    if not all(isinstance(v, int) or (isinstance(v, float) and v.is_integer()) for v in pair):
        raise ValueError(f"{shown(value)} is not allowed: two whole numbers [lines, columns] are")
    return value


def _no_control_characters(value: str) -> str:
    if any(ord(letter) < 32 for letter in value):
        raise ValueError(f"{shown(value)} holds a control character; the name of a file is expected")
    return value


# Words. A title is a line on a page; the longest path that systems open has 4096 bytes.
Name = Annotated[str, Field(min_length=1, max_length=500)]
Title = Annotated[str, Field(max_length=500)]
FileName = Annotated[str, Field(min_length=1, max_length=4096), AfterValidator(_no_control_characters)]

# Places. Sedna's orbit ends at 1e14 m; frame cameras have been as far as Pluto (5e12 m).
Latitude = Annotated[float, Within(-90.0, 90.0, "degrees of latitude", "are latitude and longitude swapped?")]
Longitude = Annotated[
    float, Within(-360.0, 360.0, "degrees of longitude", "are these metres, or another axis?")
]
#: Of ground above an ellipsoid or a plane: trenches to -11 km, Olympus Mons 22 km, airglow at 1000 km.
Height = Annotated[float, Within(-1e7, 1e7, "m")]
Coordinate = Annotated[float, Within(-1e14, 1e14, "m")]
Place = tuple[Coordinate, Coordinate, Coordinate]
#: Any length but none; so small a component is rounding.
_Part = Annotated[float, Within(1e-12, 1e9, zero=True, signed=True)]
Direction = Annotated[tuple[_Part, _Part, _Part], AfterValidator(_with_direction)]
_Quarter = Annotated[float, Within(-1.001, 1.001)]
UnitQuaternion = Annotated[tuple[_Quarter, _Quarter, _Quarter, _Quarter], AfterValidator(_of_length_one)]
#: Above ground: from a camera on a bench (0.1 m) to one at the Sun-Earth point L1 (1.5e9 m).
Altitude = Annotated[float, Within(0.01, 1e10, "m", "metres above the ground")]
#: Of circular orbits: GOCE flew at 224 km; the Moon is at 3.8e8 m.
OrbitAltitude = Annotated[float, Within(100e3, 1e9, "m", "no orbit lasts lower; are these km?")]
#: Of bodies: asteroids of 2 m have been seen, the Sun has 7e8 m; a ball on a bench 0.1 m.
Radius = Annotated[float, Within(0.01, 1e9, "m")]
#: Sides of scenes on the ground, from a bench to a planet.
Extent = Annotated[float, Within(1e-3, 1e9, "m")]
#: Sides of a map's pixels: microscopes 1e-7 m, weather maps of a planet 1e5 m.
GroundSample = Annotated[float, Within(1e-7, 1e6, "m")]
#: A slide under a microscope 1e-4 m/s, comet fly-bys 7e4 m/s, Parker Solar Probe 2e5 m/s.
Speed = Annotated[float, Within(1e-6, 1e6, "m/s")]
LengthSigma = Annotated[float, Within(1e-7, 1e7, "m", zero=True)]
#: In files and in tables.
LENGTH_SIGMA = Within(1e-7, 1e7, "m")
LengthSigmaAbove0 = Annotated[float, LENGTH_SIGMA]

# Angles.
LookAngle = Annotated[float, Within(-1.5, 1.5, "rad", "are these degrees?", above=True, below=True)]
LineRotation = Annotated[float, Within(-0.8, 0.8, "rad", "are these degrees?", above=True, below=True)]
#: Of any angle: the best star trackers reach 1e-9 rad, Gaia 1e-10; above a turn nothing is known.
AngleSigma = Annotated[float, Within(1e-13, 6.3, "rad", "are these degrees?", zero=True)]
ANGLE_SIGMA = Within(1e-13, 6.3, "rad", "are these degrees?")
AngleSigmaAbove0 = Annotated[float, ANGLE_SIGMA]
#: Of rates; gyros drift by 1e-12 rad/s at best, tumbling cubesats turn by 1 rad/s.
RateSigma = Annotated[float, Within(1e-16, 1e3, "rad/s", zero=True)]
#: Spin: the Moon 2.7e-6, Juno 0.21, Meteosat 10.5, sounding rockets 60 rad/s.
SpinRate = Annotated[float, Within(1e-9, 1e4, "rad/s", zero=True, signed=True)]
#: Of a world: Venus 3e-7 rad/s, the fastest asteroids 3 rad/s.
WorldRate = Annotated[float, Within(-100.0, 100.0, "rad/s")]
#: Orbits; 90 degrees and more are retrograde.
Inclination = Annotated[float, Within(1e-3, 180.0, "degrees", "of an orbit over the equator 0.001")]

# Optics and detectors.
#: Tangent of a pixel: microscopes 1e-8 as seen from far, HiRISE 1e-6, JunoCam 7e-4, thermopiles of 8 x 8 0.1.
PixelTangent = Annotated[
    float, Within(1e-10, 0.5, "", "a tangent, pixel pitch / focal length, is 1e-6 (HiRISE) to 1e-3 as a rule")
]
#: Its inverse.
FocalLengthPx = Annotated[
    float, Within(1.0, 1e10, "px", "focal length / pixel pitch: 8 mm and pixels of 0.005 mm make 1600")
]
FocalSigmaPx = Annotated[float, Within(1e-6, 1e10, "px", zero=True)]
#: In images and beside them: principal points of off-axis telescopes lie 1e5 px beside their detector.
PixelPlace = Annotated[float, Within(-1e7, 1e7, "px")]
PixelSigma = Annotated[float, Within(1e-7, 1e7, "px", zero=True)]
PIXEL_SIGMA = Within(1e-7, 1e7, "px")
PixelSigmaAbove0 = Annotated[float, PIXEL_SIGMA]
#: Lines of detectors: Pleiades 40,000; mosaics of chips 300,000. Area detectors: film scans 40,000 a side.
Pixels = Annotated[int, Within(2, 1_000_000, "px")]
FrameShape = Annotated[tuple[Pixels, Pixels], BeforeValidator(_two_whole_numbers)]
#: In normalised coordinates: at fields of 1e-3 rad a distortion of a pixel is a k1 of 1e3, a k3 of 1e15.
Distortion = Annotated[float, Within(-1e18, 1e18)]
#: Relative.
Scale = Annotated[float, Within(1e-12, 10.0, "", "a share of 1", zero=True)]
#: Extreme ultraviolet 10 nm is made by no filter camera; far infrared 1e5 nm, millimetre waves 1e7 nm.
Wavelength = Annotated[float, Within(100.0, 1e7, "nm")]
WavelengthReach = Annotated[float, Within(1e-3, 1e7, "nm", zero=True)]
#: Bands of a raster: imaging spectrometers 500, Fourier cubes some thousand; GDAL ends at 65,536.
BandNumber = Annotated[int, Within(1, 65_536)]

# Time.
#: From an epoch: J2000, GPS and POSIX seconds are below 4e9, those of Modified Julian Dates 5.3e9.
Seconds = Annotated[float, Within(-1e10, 1e10, "s", "seconds from the epoch; are these ms or ns?")]
TimeSigma = Annotated[float, Within(1e-9, 1e8, "s", zero=True)]
#: Between lines or of any interval: line cameras 3e-6 s, lines of a spin scan 0.6 s, drift scans minutes.
LinePeriod = Annotated[float, Within(1e-8, 1e5, "s", "seconds from line to line; are these ms, or Hz?")]
#: Slow readouts of astronomical cameras take minutes.
Readout = Annotated[float, Within(-1e4, 1e4, "s", "seconds from the first to the last line; are these ms?")]
ReadoutForward = Annotated[
    float, Within(0.0, 1e4, "s", "seconds from the first to the last line; are these ms?")
]
#: Passes, windows and separations of satellites: a GEO camera watches for days.
Duration = Annotated[float, Within(1e-6, 1e8, "s")]
Offset = Annotated[float, Within(-1e8, 1e8, "s")]
CorrelationTime = Annotated[float, Within(1e-6, 1e9, "s", zero=True)]
#: Of motion: thermal drifts 1e-6 Hz, reaction wheels 100 Hz, lines of a fast camera 1e5 Hz.
Frequency = Annotated[float, Within(1e-9, 1e8, "Hz")]

# Shares and counts.
Share = Annotated[float, Within(0.0, 1.0, "", above=True)]
OpenShare = Annotated[float, Within(0.0, 1.0, "", above=True, below=True)]
ShareBelow1 = Annotated[float, Within(0.0, 1.0, "", below=True)]
ShareOrNone = Annotated[float, Within(0.0, 1.0, "")]
Factor = Annotated[float, Within(1e-6, 1e6)]
