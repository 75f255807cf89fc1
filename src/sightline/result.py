"""What every result of the package can do: show itself, become tables, a plot, files, a page.

How each kind of result does it lies in a later layer (``kinds/``), which the package hangs in here (`serve`)
when it is first imported; nothing of it is loaded before a result is asked for more than its attributes.
What a call was given, and how long it took, stays with its result (`makes_result`), and what a file gave with
the objects that were read from it (`set_source`): so a result can be written as its command writes it.

Not here: the results themselves (each in the layer that makes it), files, pages, tables.
"""

from __future__ import annotations

import inspect
import logging
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, Protocol, TypeVar

from sightline.errors import InputError, printable, shortened

if TYPE_CHECKING:
    import matplotlib.axes
    import pandas
    import xarray

#: Of the whole package: progress of its calls as INFO (stages) and DEBUG (steps).
logger = logging.getLogger("sightline")
logger.addHandler(logging.NullHandler())

_Given = ParamSpec("_Given")
_Found = TypeVar("_Found", bound="Result")

#: Characters of a `repr`, and of one fact in it.
_LONGEST, _LONGEST_FACT = 380, 90
#: Where an object keeps what it was read from.
_SOURCE = "_source"


@dataclass(frozen=True, eq=False)
class Made:
    """How a result came to be by a call.

    Attributes
    ----------
    call : str
        Name of the function.
    given : mapping
        Its arguments by name.
    seconds : float
        s; what it took.
    """

    call: str
    given: Mapping[str, Any]
    seconds: float


class Opened(Protocol):
    """A folder that a result was opened from."""

    @property
    def folder(self) -> Path:
        """Where it lies."""
        ...


class Kind(Protocol):
    """What one kind of result does; see ``kinds/``."""

    def facts(self, result: Any) -> Mapping[str, str]:
        """A few words by what they are about."""
        ...

    def summary(self, result: Any) -> dict[str, Any]:
        """The content of ``summary.json``."""
        ...

    def frame(self, result: Any, table: str | None) -> Any:
        """A table, as a DataFrame."""
        ...

    def dataset(self, result: Any) -> Any:
        """The main table, as a dataset."""
        ...

    def plot(self, result: Any, axes: Any) -> Any:
        """Draw it."""
        ...

    def write(self, result: Any, folder: Path, *, overwrite: bool, **options: Any) -> None:
        """Write every file."""
        ...

    def export(
        self, result: Any, to: str, folder: Path, *, acquisition: Any, kernels: Any, overwrite: bool
    ) -> dict[str, Any]:
        """Write a form of other programs."""
        ...

    def report(self, result: Any, path: Path) -> None:
        """Write the page."""
        ...


_kind_of: list[Callable[[Any], Kind]] = []


def serve(kind_of: Callable[[Any], Kind]) -> None:
    """Hang in what finds the kind of a result; the package does so once."""
    _kind_of[:] = [kind_of]


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """A result: its numbers as attributes, and what can be done with it.

    A result that a call gave knows what the call was given. One that `open_result` gave has the numbers that
    its files hold: attributes that no file holds (images, matches, cameras) are not there, and asking for
    them says so. What is too large to be held, such as registered bands and maps, stays in the files of its
    folder, which must then stay as they are.

    Attributes
    ----------
    origin : Made, opened folder or None
        Where it came from.
    """

    origin: Any = field(default=None, kw_only=True, compare=False)

    def __repr__(self) -> str:
        """One line."""
        return one_line(type(self).__name__, _kind_of[0](self).facts(self))

    def _repr_html_(self) -> str:
        """A small table, for notebooks."""
        return html_table(type(self).__name__, _kind_of[0](self).facts(self))

    def __getattr__(self, name: str) -> Any:
        """Say why an attribute of an opened result is not there."""
        opened = self.__dict__.get("origin")
        if name.startswith("_") or opened is None or not hasattr(opened, "folder"):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        raise AttributeError(
            f"`{name}` of this {type(self).__name__} is not there: it was opened from {opened.folder}, whose "
            "files do not hold it; what they hold is in `to_dict()`, `to_pandas()` and the attributes that "
            "docs/python.md names"
        )

    def summary(self) -> str:
        """What was found, to be printed: a line per entry of ``summary.json``, long ones cut."""
        entries = self.to_dict()
        width = max((len(key) for key in entries), default=0)
        return "\n".join(
            f"{key:{width}}  {shortened(printable(str(value)), 100)}" for key, value in entries.items()
        )

    def to_dict(self) -> dict[str, Any]:
        """What was found, in names and numbers: the content of ``summary.json``.

        A method and not an attribute, as it may take as long as writing the result does where the summary
        says what was written.
        """
        return _kind_of[0](self).summary(self)

    def to_pandas(self, table: str | None = None) -> pandas.DataFrame:
        """A table of the result.

        Parameters
        ----------
        table : str, optional
            One of the CSV tables that the command writes, by its name without ``.csv``; the main one by
            default. A name that there is none of is answered with those that there are.

        Returns
        -------
        pandas.DataFrame
            Columns as in the file; the unit of each is in ``attrs["units"]``.

        Raises
        ------
        InputError
            pandas is not installed, or there is no such table.
        """
        frame: pandas.DataFrame = _kind_of[0](self).frame(self, table)
        return frame

    def to_xarray(self) -> xarray.Dataset:
        """The main table as a dataset over its own coordinates (time, frame, column, ...).

        Returns
        -------
        xarray.Dataset
            The unit of each variable is in its ``attrs["units"]``; name, version and epoch in those of the
            dataset.

        Raises
        ------
        InputError
            xarray is not installed.
        """
        dataset: xarray.Dataset = _kind_of[0](self).dataset(self)
        return dataset

    def plot(self, axes: Any = None) -> matplotlib.axes.Axes | Any:
        """Draw the result with matplotlib.

        Parameters
        ----------
        axes : matplotlib Axes, or as many as are drawn, optional
            Where; a new figure by default.

        Returns
        -------
        Axes, or array of Axes

        Raises
        ------
        InputError
            matplotlib is not installed, or another number of axes is needed.
        """
        return _kind_of[0](self).plot(self, axes)

    def write(self, folder: str | Path, *, overwrite: bool = False, **options: Any) -> Path:
        """Write the files that the command of this result writes, bit for bit.

        Nothing half-written carries a final name: the files appear together, or not at all.

        Parameters
        ----------
        folder : str or Path
            Created, with its parents, where it does not exist.
        overwrite : bool
            Allow `folder` to hold something; files of the same names are replaced.
        options
            Those of the command that say what is written: `stack`, `pixels` of registered bands, `maps` of
            poses, `pictures` and `signals` of a TDI choice.

        Returns
        -------
        Path
            `folder`.

        Raises
        ------
        InputError
            The folder is not empty, or cannot be written; an option that this result does not have; how the
            result was made is not known; files that an opened result refers to have changed.
        """
        _kind_of[0](self).write(self, Path(os.fspath(folder)), overwrite=overwrite, **options)
        return Path(folder)

    def export(
        self,
        to: str,
        folder: str | Path,
        *,
        acquisition: Any = None,
        kernels: Sequence[str | Path] = (),
        overwrite: bool = False,
    ) -> Path:
        """Write this result in a form that other programs read.

        Parameters
        ----------
        to : str
            ``"csm"``, ``"isd"``, ``"aem"``, ``"oem"``, ``"rpc"``, ``"quaternions"``, ``"shifts"``,
            ``"ck"`` or ``"isis"``; what each carries is in docs/formats/export.md.
        folder : str or Path
            Created, with its parents, where it does not exist.
        acquisition : path or Acquisition, optional
            What the result was recovered from; forms that hold a camera need it of an opened result.
        kernels : sequence of paths
            SPICE kernels, for the forms that take them.
        overwrite : bool
            Allow `folder` to hold something; files of the same names are replaced.

        Returns
        -------
        Path
            `folder`.

        Raises
        ------
        InputError
            The form cannot hold this result, or lacks something; the folder cannot be written.
        """
        place, files = Path(os.fspath(folder)), [Path(os.fspath(kernel)) for kernel in kernels]
        _kind_of[0](self).export(self, to, place, acquisition=acquisition, kernels=files, overwrite=overwrite)
        return place

    def report(self, file: str | Path) -> Path:
        """Write the page of this result, one self-contained HTML file; one of that name is replaced.

        Of an opened result it is the page of its folder.

        Returns
        -------
        Path
            `file`.

        Raises
        ------
        InputError
            It cannot be written there; an opened folder holds no page.
        """
        _kind_of[0](self).report(self, Path(os.fspath(file)))
        return Path(file)


def made(result: Result) -> Made:
    """How a result came to be.

    Raises
    ------
    InputError
        Where it was put together by hand.
    """
    if isinstance(result.origin, Made):
        return result.origin
    raise InputError(
        f"how this {type(result).__name__} was made is not known, so its files cannot be written: it was not "
        "given by a call of the package; call it, or open the folder of a command with open_result"
    )


def makes_result(function: Callable[_Given, _Found]) -> Callable[_Given, _Found]:
    """A call of the package whose result keeps what it was made of; its progress is logged."""
    signature = inspect.signature(function)
    name = function.__name__

    @wraps(function)
    def called(*args: _Given.args, **kwargs: _Given.kwargs) -> _Found:
        bound = signature.bind(*args, **kwargs)
        # what only concerns how the call went is no part of its result, which can then be pickled
        given = {key: value for key, value in bound.arguments.items() if key not in ("progress", "stages")}
        if "progress" in signature.parameters:
            bound.arguments["progress"] = _logged(name, bound.arguments.get("progress"))
        begun = time.perf_counter()
        logger.info("%s: begun", name)
        result = function(*bound.args, **bound.kwargs)
        seconds = time.perf_counter() - begun
        logger.info("%s: done in %.3g s", name, seconds)
        object.__setattr__(result, "origin", Made(name, given, seconds))
        return result

    return called


def _logged(name: str, progress: Callable[..., None] | None) -> Callable[..., None]:
    """The same progress, also in the log: stages as INFO, steps as DEBUG.

    One that takes a stage alone is called once for each.
    """
    last, counts = [""], progress is not None and _takes_steps(progress)

    def report(stage: str, *step: Any, **more: Any) -> None:
        new = stage != last[0]
        if new:
            last[0] = stage
            logger.info("%s: %s", name, stage)
        if len(step) == 2 and step[1]:
            logger.debug("%s: %s: %s of %s", name, stage, *step)
        if progress is not None and counts:
            progress(stage, *step, **more)
        elif progress is not None and new:
            progress(stage)

    return report


def _takes_steps(progress: Callable[..., None]) -> bool:
    """Whether it can be called with a stage, how much of it is done, and how much it is."""
    try:
        inspect.signature(progress).bind("", 0, 1)
    except TypeError:
        return False
    except ValueError:  # it has no signature that could be asked
        return True
    return True


def set_source(read: Any, source: Any) -> None:
    """Keep with an object what it was read from: a file with all that it says besides."""
    object.__setattr__(read, _SOURCE, source)


def source_of(read: Any) -> Any:
    """What an object was read from; None where it was made by hand, or changed since."""
    return getattr(read, _SOURCE, None)


def one_line(name: str, facts: Mapping[str, str]) -> str:
    """``<Name: key value; key value>``, some hundred characters at most."""
    said = "; ".join(f"{key} {_fact(value)}".strip() for key, value in facts.items())
    return shortened(f"<{name}: {said}", _LONGEST) + ">"


def html_table(name: str, facts: Mapping[str, str]) -> str:
    """A small table of facts under a name."""
    from html import escape

    rows = "".join(
        f'<tr><th style="text-align:left">{escape(printable(key))}</th>'
        f'<td style="text-align:left">{escape(_fact(value))}</td></tr>'
        for key, value in facts.items()
    )
    return f"<table><caption><b>{escape(name)}</b></caption><tbody>{rows}</tbody></table>"


def _fact(value: str) -> str:
    """A value on one line that ends."""
    return shortened(" ".join(printable(value).split()), _LONGEST_FACT)
