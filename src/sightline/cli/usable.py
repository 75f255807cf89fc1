"""Whether a scene that is asked for is one that its command can use: refused before it is rendered.

Geometry alone decides, by what the command itself refuses first; the message says the least that works.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sightline.geometry.camera import PushbroomCamera
    from sightline.geometry.surface import Surface
    from sightline.simulate.sequence_options import SequenceOptions
    from sightline.simulate.stereo_options import StereoOptions

#: Lines up to which sizes are tried; looking at more takes minutes.
MOST_LINES = 30_000
#: Windows of the first pass that lie in two images: 20 must match, and at edges some do not.
LEAST_WHOLE = 24
#: The same of each band: fewer show nothing of it.
LEAST_SHARED = 8
#: Points of a pass up to which numbers are tried.
MOST_POINTS = 1000
#: px; sides of frames in which points are found.
LEAST_MATCHED = 128


@dataclass(frozen=True)
class _Unread:
    """An image of which only the size is known."""

    shape: tuple[int, int]

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> Any:
        """Never asked for."""
        raise NotImplementedError

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> Any:
        """Never asked for."""
        raise NotImplementedError


def refuse_useless_strip(
    cameras_of: Callable[[int, int], tuple[PushbroomCamera, ...]],
    surface: Surface,
    size: tuple[int, int],
    pairs: tuple[tuple[str, str], ...] = (),
) -> None:
    """InputError for a strip of `size` (lines, columns) that ``recover`` could not use.

    Parameters
    ----------
    cameras_of : callable
        Nominal cameras of a strip of so many lines and columns.
    surface : Surface
    size : (lines, columns)
    pairs : tuple of (str, str)
        Those that the acquisition will name; empty: all.
    """
    from sightline.errors import InputError

    lines, columns = size

    def why(lines: int, columns: int) -> str:
        return _why_useless(cameras_of(lines, columns), surface, pairs)

    reason = why(lines, columns)
    if not reason:
        return
    wide = max(columns, 256)
    least_lines = _least(lambda n: not why(n, wide), lines, max(lines, MOST_LINES))
    said = f"--lines {lines} --columns {columns} make a strip that `recover` could not use: {reason}"
    if least_lines is None:
        raise InputError(said)
    least_columns = _least(lambda n: not why(least_lines, n), columns, wide) or wide
    raise InputError(f"{said}; the least that works is --lines {least_lines} --columns {least_columns}")


def _why_useless(
    cameras: tuple[PushbroomCamera, ...], surface: Surface, pairs: tuple[tuple[str, str], ...]
) -> str:
    """Why a strip of these cameras cannot be recovered; "" where it can."""
    from sightline.applications.line_of_sight import ready_strip
    from sightline.errors import SightlineError
    from sightline.io.acquisition.ground import check_overlap
    from sightline.motion.band import Band
    from sightline.motion.strip.checks import windows_in_common
    from sightline.motion.strip.strip import RecoverOptions

    names = [camera.detector.name for camera in cameras]
    bands = [
        Band(name, _Unread((camera.lines, camera.columns)), camera)
        for name, camera in zip(names, cameras, strict=True)
    ]
    options = RecoverOptions(pairs=pairs)
    try:
        check_overlap(Path("acquisition.toml"), surface, cameras, names)
        strip, options = ready_strip(bands, surface, (), None, None, options)
    except SightlineError as error:
        return str(error).removeprefix("acquisition.toml: ")
    found = windows_in_common(strip, options)
    if found.whole < LEAST_WHOLE:
        return f"{found.whole:.0f} windows lie in two images, too few of which will match"
    for name, whole in zip(names, found.whole_of, strict=True):
        if whole < LEAST_SHARED:
            return f"{whole:.0f} windows of {name} lie in another image, too few of which will match"
    return ""


def _least(works: Callable[[int], bool], first: int, most: int) -> int | None:
    """The least number from `first` to `most` that works, taken to go on working beyond; None: none does."""
    low, high = first - 1, first
    while not works(high):
        if high >= most:
            return None
        low, high = high, min(2 * high, most)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if works(middle) else (middle, high)
    return high


def refuse_useless_flight(options: SequenceOptions) -> None:
    """InputError for a flight of frames that ``georeference`` could not follow."""
    from sightline.errors import InputError
    from sightline.matching.follow import FollowPlan, check_followable

    lines, columns = options.shape
    try:
        check_followable(
            options.shape, FollowPlan(reduction=options.pattern if options.filter == "mosaic" else 1)
        )
    except InputError as error:
        raise InputError(
            f"--lines {lines} --columns {columns} make frames that `georeference` could not use: {error}"
        ) from None


def refuse_useless_pass(options: StereoOptions) -> None:
    """InputError for a pass of cameras with frames too small to be matched."""
    from sightline.errors import InputError

    lines, columns = options.frame
    if min(lines, columns) < LEAST_MATCHED:
        raise InputError(
            f"--lines {lines} --columns {columns} make frames that `orient` could not find points in; "
            f"the least that works is --lines {LEAST_MATCHED} --columns {LEAST_MATCHED}"
        )


def refuse_useless_scene(file: Path, asked: str, least: Callable[[], str] = str) -> None:
    """InputError for a scene just written whose own command would refuse it; `asked` are its options.

    Parameters
    ----------
    file : Path
        The TOML file of the scene, in the folder that is not yet published.
    asked : str
        How the user asked for it.
    least : callable, optional
        Options that work, in words; "" where none are known.
    """
    from sightline.errors import InputError

    reason = why_refused(file)
    if reason:
        works = least()
        raise InputError(
            f"{asked} make a scene that could not be used: {reason}"
            + (f"; the least that works is {works}" if works else "")
        )


def why_refused(file: Path) -> str:
    """Why the command of a scene would refuse it; "" where it would not."""
    from sightline.cli.check import describe
    from sightline.errors import SightlineError

    try:
        describe(file)
    except SightlineError as error:
        return str(error).replace(f"{file.parent}/", "")
    return ""


def least_points(folder: Path, write: Callable[[Path, int], object], points: int) -> str:
    """The least number of points with which a pass of cameras can be oriented, as an option; "" if none.

    Parameters
    ----------
    folder : Path
        Of the scene that is not yet published; trials are made below it, and removed.
    write : callable
        Writes the scene of so many points into a folder.
    points : int
        That are too few.
    """
    from tempfile import TemporaryDirectory

    from sightline.errors import SightlineError

    def works(points: int) -> bool:
        with TemporaryDirectory(dir=folder) as trial:  # below it nothing is an input of the command
            try:
                write(Path(trial), points)
            except SightlineError:
                return False
            return not why_refused(Path(trial) / "stereo.toml")

    least = _least(works, points + 1, max(points + 1, MOST_POINTS))
    return "" if least is None else f"--points {least}"
