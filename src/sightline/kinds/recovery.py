"""A recovered line of sight, of a strip or of frames: `recover`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sightline.access import read_arrays
from sightline.applications.frame_attitude import FrameAttitude
from sightline.applications.spin_attitude import SpinAttitude
from sightline.errors import FormatError, foreign_errors
from sightline.execution import give_back_memory
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Motion
from sightline.io.acquisition.acquired import Acquisition
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats.tables import ANGLES, MOTION, MotionTable, read_attitudes, read_columns, read_motion
from sightline.io.results.exports import Exported
from sightline.io.results.hidden import read_hidden
from sightline.io.results.line_of_sight import (
    AEM_FRAMES,
    RESULT_FILES,
    on_another_body,
    refined_attitude,
    whole_summary,
    write_result,
)
from sightline.io.results.recovered import read_recovered
from sightline.io.results.relief import read_relief
from sightline.kinds.kind import REPORT, Columns, OpenedFolder, ResultKind, Tell, given, per_axis, warned
from sightline.motion.band import ChipKnowledge, LensKnowledge
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.results import LineOfSight, NamedMethod, StaticEstimate, TimeCovariance
from sightline.motion.statics import recovered_cameras
from sightline.motion.strip.fusion import SensorUse
from sightline.motion.strip.hyper import KnownContent
from sightline.motion.strip.withheld import WithheldAxis
from sightline.report.line_of_sight_page import line_of_sight_page
from sightline.report.words import grouped
from sightline.result import Result, source_of


class Recovery(ResultKind):
    """`LineOfSight`, `FrameAttitude`, `SpinAttitude`."""

    types = (LineOfSight, FrameAttitude, SpinAttitude)
    table, index, files = "motion", ("t",), RESULT_FILES
    units = {
        **dict.fromkeys((*ANGLES, "value", "sigma"), "rad"), "t": "s", "lag": "s", "frequency": "Hz",
        "height": "m", "slope": "m",
        **{f"smear:{axis}": "px" for axis in ANGLES},
        **{f"{kind}_{axis}": "rad2/Hz" for kind in ("psd", "error") for axis in ANGLES},
    }  # fmt: skip
    panels = 3

    def facts(self, result: LineOfSight) -> Mapping[str, str]:
        """Images, times, how well the angles are known."""
        t, names = result.motion.t, result.image_names
        sigma = np.sqrt((result.sigma**2).mean(axis=0)) / result.scale
        listed = ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")
        return {
            "images": f"{len(names)} ({listed})",
            "times": f"{len(t)} from {t[0]:.6g} to {t[-1]:.6g} s",
            "sigma": f"{per_axis(sigma)} px rms",
            "hidden": ", ".join(result.hidden_names) or "nothing",
            **({} if result.method is None else {"method": result.method.name}),
            **warned(result),
        }

    def unit(self, column: str, table: str) -> str:
        """As named; hidden directions and what was left out in rad."""
        return "rad" if table == "hidden" and column != "t" else super().unit(column, table)

    def columns(self, result: LineOfSight) -> Columns:
        """``motion.csv``."""
        motion = result.motion
        values = [motion.t, *motion.angles.T, *result.sigma.T, *result.absolute_sigma.T, result.observed]
        values.append([""] * len(motion.t) if result.lines is None else result.lines)
        return dict(zip(MOTION, values, strict=True))

    def summarize(self, result: LineOfSight) -> dict[str, Any]:
        """Nothing has to be written for it."""
        seconds = float(result.origin.seconds) if hasattr(result.origin, "seconds") else 0.0
        return whole_summary(result, acquisition_of(result), wall_seconds=seconds)

    def render(
        self,
        result: LineOfSight,
        folder: Path,
        tell: Tell,
        begun: float,
        *,
        acquisition: Acquisition | None = None,
        truth: MotionTable | None = None,
    ) -> dict[str, Any]:
        """Every file, as the `acquisition` says; a `truth` is drawn over the estimate in the report."""
        tell("writing the result and its report")
        acquired = acquisition or acquisition_of(result)
        summary = write_result(folder, result, acquired, wall_seconds=time.perf_counter() - begun)
        give_back_memory()
        line_of_sight_page(result, acquired, summary, truth).write(folder / REPORT)
        return summary

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """The motion with the sigma of each angle, without covariance between axes; statics and the rest."""
        table = read_motion(folder / "motion.csv")
        count = len(table.t)
        known = table.sigma is not None and table.sigma_absolute is not None
        sigma = table.sigma if table.sigma is not None else np.full((count, 3), np.nan)
        absolute = table.sigma_absolute if known else np.full((count, 3), np.inf)
        place = folder / "summary.json"
        with foreign_errors(place, "is no summary of `recover`", "run `sightline recover` again"):
            scale = np.array([summary["scale"][axis] for axis in ANGLES], dtype=np.float64)
            hidden = read_hidden(folder, summary, count) or (np.zeros((count, 3, 0)), ())
            covariance = (summary["hidden_directions"] or {}).get("covariance")
            return {
                "motion": Motion(table.t, table.angles, np.einsum("ni,ij->nij", sigma**2, np.eye(3))),
                "absolute_sigma": absolute,
                "observed": table.observed,
                "lines": table.lines,
                "hidden": hidden[0],
                "hidden_names": tuple(hidden[1]),
                "hidden_covariance": None if covariance is None else np.array(covariance, dtype=np.float64),
                "scale": scale,
                "ifov": float(summary["ifov"]),
                "half_field": float(summary["half_field"]),
                "statics": tuple(StaticEstimate(**entry) for entry in summary["statics"]),
                "sensors": tuple(
                    SensorUse(**entry | {"sigma_factor": tuple(entry["sigma_factor"])})
                    for entry in summary["sensors"]
                ),
                "image_names": tuple(summary["images"]),
                "changes": tuple(summary["changes"]),
                "warnings": tuple(summary["warnings"]),
                "method": _method(summary["method"], count),
                "withheld": tuple(
                    WithheldAxis(**entry | {"pair": tuple(entry["pair"])})
                    for entry in summary.get("withheld", [])
                ),
                "band": _band(folder / "covariance.npz"),
                "relief": read_relief(folder, summary, tuple(summary["images"])),
                "differences": _differences(folder / "differences.csv", tuple(summary["images"])),
            }

    def exported(self, result: LineOfSight, acquisition: Any) -> Exported:
        """The refined attitude; with the acquisition, cameras of a strip that carry what was found."""
        opened, acquisition = folder_and_acquisition(result, acquisition)
        sigma, absolute = result.sigma, result.absolute_sigma
        held = [axis for axis, tied in zip(ANGLES, np.isfinite(absolute).T, strict=True) if tied.all()]
        unseen = grouped([name for name in result.hidden_names if not name.endswith(tuple(held))])
        if acquisition is None:
            assert opened is not None
            path = opened.folder / "attitude.csv"
            t, quaternions = read_attitudes(path)
            if len(t) != len(sigma):
                raise FormatError(
                    f"{path}: has {len(t)} rows, motion.csv {len(sigma)}; run `sightline recover` again, or "
                    "give --acquisition FILE"
                )
            name, epoch = opened.summary.get("name", ""), opened.summary.get("epoch")
            return Exported(
                str(name), t, quaternions, sigma, epoch if isinstance(epoch, str) else None,
                _message_frame(opened), absolute_sigma=absolute, unseen=unseen,
            )  # fmt: skip
        bands: tuple[PushbroomCamera, ...] = ()
        if opened is not None:
            found = read_recovered(opened.folder, acquisition)
            bands = recovered_cameras(acquisition.bands, found.motion, found.statics)
        elif acquisition.bands:
            bands = tuple(one for one in result.cameras if isinstance(one, PushbroomCamera))
        t, other = result.motion.t, on_another_body(acquisition.surface)
        return Exported(
            acquisition.name,
            t,
            refined_attitude(result, acquisition),
            sigma,
            acquisition.epoch,
            None if other else AEM_FRAMES[acquisition.world],
            acquisition.cameras[0].trajectory.at(t).position,
            acquisition,
            dict(zip([band.name for band in acquisition.bands], bands, strict=True)),
            folder=None if opened is None else opened.folder,
            files=() if opened is None else tuple(opened.names),
            absolute_sigma=absolute,
            unseen=unseen,
        )

    def draw(self, result: LineOfSight, axes: Sequence[Any]) -> None:
        """Roll, pitch, yaw in px against time, with 1 sigma."""
        t = result.motion.t
        for k, (panel, name) in enumerate(zip(axes, ANGLES, strict=True)):
            angle, sigma = result.motion.angles[:, k] / result.scale[k], result.sigma[:, k] / result.scale[k]
            panel.fill_between(t, angle - sigma, angle + sigma, alpha=0.3, linewidth=0, label="1 sigma")
            panel.plot(t, angle, linewidth=1.0)
            panel.set_ylabel(f"{name} (px{' at the edge' if name == 'yaw' else ''})")
        axes[-1].set_xlabel("t (s)")
        axes[0].legend(loc="upper right")


def _message_frame(opened: OpenedFolder) -> str | None:
    """Name of the world axes in the folder's own attitude message; None where it has none."""
    if "attitude.aem" not in opened.names:
        return None
    rows = (line.partition("=") for line in opened.text("attitude.aem").splitlines())
    return next((value.strip() for key, _, value in rows if key.strip() == "REF_FRAME_A"), None)


def folder_and_acquisition(
    result: Result, acquisition: Any
) -> tuple[OpenedFolder | None, Acquisition | None]:
    """The folder that a result was opened from, and the acquisition, loaded where a file is given.

    No folder: the result was made by a call, whose own acquisition serves. An opened one has what is given.
    """
    opened = result.origin if isinstance(result.origin, OpenedFolder) else None
    if isinstance(acquisition, str | Path):
        acquisition = load_acquisition(acquisition, look=False)
    if acquisition is None and opened is None:
        acquisition = acquisition_of(result)
    return opened, acquisition


def acquisition_of(result: Result) -> Acquisition:
    """What a result was recovered from: the acquisition that was loaded, or what the call was given."""
    values = given(result)
    bands, frames = tuple(values.get("bands", ())), tuple(values.get("frames", ()))
    source, surface = source_of((bands or frames)[0]), values["surface"]
    if isinstance(source, Acquisition):
        same = all(
            len(mine) == len(theirs) and all(one is other for one, other in zip(mine, theirs, strict=True))
            for mine, theirs in ((bands, source.bands), (frames, source.frames))
        )
        if same and surface is source.surface:
            return source
        return replace(source, bands=bands, frames=frames, surface=surface)
    strips = range(1 + max((frame.strip for frame in frames), default=0))
    return Acquisition(
        path=Path("acquisition.toml"),
        name="line of sight",
        epoch=None,
        bands=bands,
        frames=frames,
        surface=surface,
        height_sigma=values.get("height_sigma", 0.0),
        sensors=tuple(values.get("sensors", ())),
        control_points=values.get("control_points"),
        known_motion=values.get("known") or KnownContent(),
        lens=values.get("lens") or LensKnowledge(),
        matching={},
        platform="",
        world="local" if isinstance(surface, Plane) else "earth-fixed",
        spin=values.get("spin"),
        chip=values.get("chip") or ChipKnowledge(tuple(f"strip {k}" for k in strips)),
        attitude_sigma=values.get("attitude_sigma"),
        parallax_sigma=values.get("parallax_sigma", 0.0),
        inputs=(),
    )


def _method(entry: Mapping[str, Any], count: int) -> NamedMethod | None:
    """The estimator; how far it lies from the joint estimate line by line is in no file."""
    if entry["name"] == "joint":
        return None
    unknown = np.full((count, 3), np.nan)
    return NamedMethod(str(entry["name"]), unknown, unknown)


def _differences(path: Path, names: tuple[str, ...]) -> tuple[AngleDifferences, ...]:
    """``differences.csv``, where it is there: each pair's angles with the sigma of each."""
    if not path.is_file():
        return ()
    words = ("first", "second", "axis")
    table = read_columns(path, (*words, "t", "lag", "value", "sigma"), text=words, infinite=("sigma",))
    numbers = {key: np.asarray(table[key], dtype=np.float64) for key in ("t", "lag", "value", "sigma")}
    images = np.array([[names.index(word) for word in table[key]] for key in words[:2]], dtype=np.intp).T
    found = []
    for pair in dict.fromkeys(map(tuple, images.tolist())):
        rows = np.flatnonzero((images == pair).all(axis=1)).reshape(-1, 3)
        sigma = numbers["sigma"][rows]
        covariance = np.einsum("ni,ij->nij", sigma**2, np.eye(3))
        first = rows[:, 0]
        found.append(
            AngleDifferences(
                numbers["t"][first], numbers["lag"][first], numbers["value"][rows], covariance, pair
            )
        )
    return tuple(found)


def _band(path: Path) -> TimeCovariance | None:
    """``covariance.npz``, where it is there."""
    if not path.is_file():
        return None
    what, advice = "the covariance of a motion", "run `sightline recover` again"
    stored = read_arrays(path, what, advice)
    with foreign_errors(path, f"cannot be read as {what}", advice):
        return TimeCovariance(stored["t"], stored["angles"], stored["band"])
