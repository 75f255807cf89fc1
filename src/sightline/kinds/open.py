"""Which kind a result is of, and the folder of a command opened as its result.

Not here: the kinds (one file each).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sightline.errors import FormatError
from sightline.io.results.hidden import read_summary
from sightline.kinds.batch import Batches
from sightline.kinds.kind import SUMMARY, ResultKind
from sightline.kinds.layouts import Layouts
from sightline.kinds.matching import BandShifts, Shifts
from sightline.kinds.noise import Noise
from sightline.kinds.orientation import Orientation, Prediction
from sightline.kinds.recovery import Recovery
from sightline.kinds.registration import Picture, Registered
from sightline.kinds.scoring import Scoring
from sightline.kinds.sequence import Cube, Poses
from sightline.kinds.tdi import Choice
from sightline.kinds.tie import ReferenceTies
from sightline.result import Result

#: Every kind.
KINDS: tuple[ResultKind, ...] = (
    Recovery(), Registered(), Picture(), Layouts(), Orientation(), Prediction(), Choice(), Poses(), Cube(),
    Noise(), Shifts(), BandShifts(), ReferenceTies(), Scoring(), Batches(),
)  # fmt: skip
_OF_TYPE: dict[type[Result], ResultKind] = {one: kind for kind in KINDS for one in kind.types}
_OF_NAME: dict[str, type[Result]] = {one.__name__: one for one in _OF_TYPE}


def kind_of(result: Any) -> ResultKind:
    """The kind of a result."""
    return next(_OF_TYPE[one] for one in type(result).__mro__ if one in _OF_TYPE)


def open_result(folder: str | Path) -> Result:
    """The result in a folder that a command, or ``write`` of a result, wrote.

    Parameters
    ----------
    folder : str or Path
        Of `recover`, `register`, `layout`, `orient`, `tdi`, `georeference`, `noise`, `match`,
        `tie` or `batch`.

    Returns
    -------
    Result
        Of the class that the call of this command gives: `LineOfSight`, `FrameAttitude`, `SpinAttitude`,
        `Registration`, `LayoutChoice`, `StereoOrientation`, `TdiResult`, `SequencePoses`, ... It holds what
        the files hold: its tables, its summary and the attributes made of them; asking for others says that
        they are not there. Files beyond 32 MiB (registered bands, maps) are not held: they are read and
        copied where they lie, and must stay as they are.

    Raises
    ------
    FormatError
        If it is no such folder, or a file of it is missing, damaged or of another form.
    """
    place = Path(folder)
    path = place / SUMMARY
    if not path.is_file():
        lacking = f"{SUMMARY} is missing" if place.is_dir() else "there is no such folder"
        raise FormatError(
            f"{place}: no result ({lacking}); give a folder that a command, or `write` of a result, wrote"
        )
    summary = read_summary(place)
    name = summary.get("result")
    if not isinstance(name, str) or name not in _OF_NAME:
        said = "does not say which result it is of" if name is None else f"is of {str(name)[:60]!r}"
        raise FormatError(
            f"{path}: `result` {said}; {', '.join(sorted(_OF_NAME))} can be opened; run the command again"
        )
    cls = _OF_NAME[name]
    return _OF_TYPE[cls].open(place, summary, cls)
