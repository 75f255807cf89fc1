"""The keys of a SCENE.toml by kind and case: the options of the simulations, and what is written of a scene.

Names, types, defaults, words and ranges are those of the classes of options in ``simulate/``; what their
docstrings say of an option describes its key. Not here: reading the file (``recipe.py``).
"""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel, BeforeValidator, Field, create_model

from sightline.io.acquisition.schema import MOST_LISTED, SchemaSection
from sightline.io.quantities import Within, shown
from sightline.io.scene.schema import SceneFile
from sightline.simulate.acquired import AcquiredOptions
from sightline.simulate.frames import FrameCaseOptions
from sightline.simulate.instruments import INSTRUMENT_OPTIONS, InstrumentOptions
from sightline.simulate.option_checks import descriptions
from sightline.simulate.sequence_options import CASE_OPTIONS as SEQUENCE_OPTIONS
from sightline.simulate.sequence_options import SequenceOptions
from sightline.simulate.spinning_frames import SPINNING_OPTIONS, SpinningFrameOptions
from sightline.simulate.stereo_options import CASE_OPTIONS as STEREO_OPTIONS
from sightline.simulate.stereo_options import StereoOptions
from sightline.simulate.strip_options import CASE_OPTIONS as STRIP_OPTIONS
from sightline.simulate.strip_options import StripOptions

#: Frames that a text such as "20-40" may name.
_MOST_FRAMES = 1_000_000

ControlCount = Annotated[int, Within(0, 100_000)]


class StripWritten(SceneFile):
    """What is written of a strip over a flat world."""

    dem: bool = Field(default=True, description="Write the relief, or only how rough it is")
    star_tracker: bool = Field(default=False, description="Also write a star tracker's table")
    gyro: bool = Field(default=False, description="Also write a gyro's table")
    control_points: ControlCount = Field(
        default=0, description="Also write so many ground control points, known to a metre"
    )


class PhotographsWritten(SceneFile):
    """What is written of photographs."""

    estimate_camera: bool = Field(
        default=False, description="Leave focal length (written 1 % off) and distortion to be estimated"
    )


class StereoWritten(SceneFile):
    """What is written of a pass of cameras."""

    control_points: ControlCount = Field(
        default=0, description="Also write so many control points, known to a metre"
    )
    images: bool = Field(
        default=False, description="Write rendered frames, in which points are yet to be found"
    )


class FlightWritten(SceneFile):
    """What is written of a flight."""

    dem: bool = Field(default=False, description="Write the relief, or only its mean and scatter")
    image_format: Literal["tif", "png"] = Field(default="tif", description="Of the images")
    truth_bands: Annotated[int, Within(0, 200)] = Field(
        default=5, description="Bands of truth-bands.tif; 0: it is not written"
    )


@dataclass(frozen=True)
class Family:
    """The cases of a kind that have one class of options.

    Attributes
    ----------
    name : str
    kind : str
        Word after ``sightline simulate``.
    options : type
        Class of options, a dataclass.
    cases : mapping
        What each case changes of the defaults.
    written : type
        Keys of what is written.
    """

    name: str
    kind: str
    options: type[Any]
    cases: Mapping[str, Mapping[str, Any]]
    written: type[SceneFile]

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the keys that say what is written."""
        return tuple(set(self.written.model_fields) - set(SceneFile.model_fields))

    def options_of(self, case: str, given: Mapping[str, Any]) -> Any:
        """The options of a case, some replaced."""
        return self.options(**{**self.cases[case], **given})


FAMILIES = (
    Family("strip", "line-of-sight", StripOptions, STRIP_OPTIONS, StripWritten),
    Family("orbit", "line-of-sight", InstrumentOptions, INSTRUMENT_OPTIONS, SceneFile),
    Family("acquired", "line-of-sight", AcquiredOptions, {"acquisition": {}}, SceneFile),
    Family("photographs", "line-of-sight", FrameCaseOptions, {"frames": {}}, PhotographsWritten),
    Family("spinning", "line-of-sight", SpinningFrameOptions, SPINNING_OPTIONS, SceneFile),
    Family("pass", "stereo", StereoOptions, STEREO_OPTIONS, StereoWritten),
    Family("flight", "frames", SequenceOptions, SEQUENCE_OPTIONS, FlightWritten),
)


@functools.cache
def scene_model(family: str) -> type[SceneFile]:
    """The model of the files of a family, by its name."""
    found = next(one for one in FAMILIES if one.name == family)
    own: dict[str, Any] = {
        name: (Literal[words] | None, Field(default=None, description=_said(SceneFile, name)))
        for name, words in (("kind", (found.kind,)), ("case", tuple(found.cases)))
    }
    model: type[SceneFile] = create_model(
        f"{found.name.capitalize()}Scene", __base__=found.written, **own, **_fields(found.options)
    )
    return model


def _said(model: type[BaseModel], name: str) -> str:
    return model.model_fields[name].description or ""


def _fields(options: type[Any]) -> dict[str, Any]:
    """The options of a class as fields of a pydantic model."""
    hints, said = get_type_hints(options, include_extras=True), descriptions(options)
    out = {}
    for field in dataclasses.fields(options):
        name = field.name
        if name in options.WORDS:
            kind: Any = Literal[options.WORDS[name]]
        elif name in _FRAME_LISTS:
            kind = _FRAME_LISTS[name]
        else:
            kind = _annotation(hints[name], _bounds(options, name, said.get(name, "")))
        # those of a case may be others; a file that leaves a key out leaves it to its case
        default = ... if field.default is dataclasses.MISSING else _plain(field.default)
        out[name] = (kind, Field(default=default, description=said.get(name)))
    return out


def _bounds(options: type[Any], name: str, said: str) -> Within | None:
    """Bounds of an option's numbers, with their unit."""
    if name not in options.RANGES:
        return None
    first = said.split(" ")[0].rstrip(",;:.")
    unit = first if first in ("m", "m/s", "s", "rad", "rad/s", "px", "Hz", "nm") else ""
    least, most = options.RANGES[name]
    return Within(least, most, unit, "are these degrees?" if unit == "rad" else "")


def _annotation(hint: Any, bounds: Within | None) -> Any:
    """A type of an option as that of a key: numbers within bounds, lists of a length that ends."""
    if hint in (int, float):
        return Annotated[hint, bounds] if bounds else hint
    if hint is str:
        return Annotated[str, Field(max_length=4096)]
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return create_model(hint.__name__, __base__=SchemaSection, **_fields(hint))
    parts, origin = get_args(hint), get_origin(hint)
    if origin in (Union, UnionType):
        kinds = [part if part is NoneType else _annotation(part, bounds) for part in parts]
        return functools.reduce(operator.or_, kinds)
    if origin is tuple and parts[-1] is Ellipsis:
        kind: Any = tuple.__class_getitem__((_annotation(parts[0], bounds), ...))
        return Annotated[kind, Field(max_length=MOST_LISTED)]
    if origin is tuple:
        return tuple.__class_getitem__(tuple(_annotation(part, bounds) for part in parts))
    return hint


def _plain(value: Any) -> Any:
    """A default as a file would hold it: numpy's numbers as Python's, options as tables."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {name: _plain(part) for name, part in vars(value).items()}
    if isinstance(value, tuple | list):
        return [_plain(part) for part in value]
    return value.item() if hasattr(value, "item") else value


def plain_options(options: Any) -> dict[str, Any]:
    """All options as a file would hold them."""
    return {field.name: _plain(getattr(options, field.name)) for field in dataclasses.fields(options)}


def _stretch(value: object) -> tuple[int, int]:
    """First and last frame of "20-40", of 7, or of [20, 40]."""
    text = value
    if isinstance(value, str):
        first, _, last = value.partition("-")
        value = [int(word) for word in (first, last or first) if word.strip().isdecimal()]
    elif isinstance(value, int) and not isinstance(value, bool):
        value = [value, value]
    pair = list(value) if isinstance(value, list | tuple) else []
    if len(pair) != 2 or not all(type(part) is int for part in pair) or not 0 <= pair[0] <= pair[1]:
        raise ValueError(f'{shown(text)} is not allowed: frames are, as 3 or "20-40"')
    if pair[1] >= _MOST_FRAMES:
        raise ValueError(f"{shown(text)} is not allowed: frames are numbered below {_MOST_FRAMES:,}")
    return pair[0], pair[1]


def _stretches(value: object) -> Sequence[tuple[int, int]]:
    if not isinstance(value, list | tuple):
        raise ValueError(f'{shown(value)} is not allowed: a list of frames is, as [3, "20-40"]')
    return [_stretch(part) for part in value]


def _frames(value: object) -> Sequence[int]:
    return [frame for first, last in _stretches(value) for frame in range(first, last + 1)]


#: Lists of frames may hold stretches of them, as "20-40".
_Frame = Annotated[int, Within(0, _MOST_FRAMES - 1)]
_Frames = Annotated[tuple[_Frame, ...], Field(max_length=_MOST_FRAMES), BeforeValidator(_frames)]
_FRAME_LISTS = {
    "missing": _Frames,
    "unreadable": _Frames,
    "blurred": _Frames,
    "water": Annotated[
        tuple[tuple[_Frame, _Frame], ...], Field(max_length=MOST_LISTED), BeforeValidator(_stretches)
    ],
}


def scene_schema() -> dict[str, Any]:
    """JSON Schema of a SCENE.toml: one of those of the families."""
    from pydantic import TypeAdapter

    models: list[Any] = [scene_model(family.name) for family in FAMILIES]
    return TypeAdapter(functools.reduce(operator.or_, models)).json_schema()
