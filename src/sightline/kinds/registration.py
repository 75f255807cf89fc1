"""Registered bands of a strip, and the picture of a spinning camera: `register`."""

from __future__ import annotations

import glob
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.registration import Registration, fit_every_pair
from sightline.errors import FormatError, InputError, foreign_errors
from sightline.execution import part_of, steps_of
from sightline.io.acquisition.acquired import Acquisition
from sightline.io.formats.images import open_image
from sightline.io.results.exports import OF_PLACE, Exported
from sightline.io.results.line_of_sight import peak_memory, write_json
from sightline.io.results.recovered import Recovered
from sightline.io.results.registered import write_products
from sightline.io.results.registered_frames import without_margin, write_colours, write_values
from sightline.io.results.registration import summarize_registration
from sightline.kinds.kind import REPORT, SUMMARY, Columns, ResultKind, Tell, given
from sightline.kinds.recovery import acquisition_of, folder_and_acquisition
from sightline.products.frame_mosaic import Mosaic
from sightline.report.register_page import register_page
from sightline.result import source_of
from sightline.stages import Stages
from sightline.version import VERSION


class Registered(ResultKind):
    """`Registration`. Its bands are images in files: they are read in windows, never held whole."""

    types = (Registration,)
    table, index = "pairs", ("pair",)
    files = ("*.tif", SUMMARY, REPORT)
    units = {
        name: "px"
        for name in (
            "before_along",
            "before_across",
            "after_along",
            "after_across",
            "noise_along",
            "noise_across",
        )
    }
    options = ("pixels", "stack")

    def facts(self, result: Registration) -> Mapping[str, str]:
        """How many bands, their shape, onto which one."""
        lines, columns = result.after[result.reference].shape
        return {
            "bands": str(len(result.after)),
            "onto": f"band {result.reference}",
            "shape": f"{lines} lines x {columns} columns",
        }

    def columns(self, result: Registration) -> Columns:
        """How far the bands of each pair were apart and are, along lines and across."""
        pairs = self.summary(result)["pairs"]
        found: dict[str, Any] = {"pair": [" - ".join(pair["images"]) for pair in pairs]}
        for name, state, key in (
            ("before", "before", "rms_px"), ("after", "after", "rms_px"), ("noise", "after", "noise_px"),
        ):  # fmt: skip
            both = np.array([pair[state][key] for pair in pairs], dtype=np.float64).reshape(-1, 2)
            found |= {f"{name}_along": both[:, 0], f"{name}_across": both[:, 1]}
        return found | {key: [pair["after"][key] for pair in pairs] for key in ("windows", "kept")}

    def patterns(self, summary: Mapping[str, Any]) -> Sequence[str]:
        """The bands by their names."""
        return (*(glob.escape(name) for name in summary.get("files", ()) if _beside(name)), SUMMARY, REPORT)

    def left(self, folder: Path, summary: dict[str, Any]) -> list[str]:
        """The bands that the summary lists."""
        return [SUMMARY, REPORT, *(name for name in summary["files"] if _beside(name))]

    def render(
        self,
        result: Registration,
        folder: Path,
        tell: Tell,
        begun: float,
        *,
        pixels: str | None = None,
        stack: bool = False,
        stages: Stages | None = None,
    ) -> dict[str, Any]:
        """Resample all bands into files, match them with each other, write summary and page.

        `stages` keep blocks of lines and fits of pairs.
        """
        acquired = acquisition_of(result)
        search = tuple(acquired.matching.get("search_px", (8, 8)))
        search_px = (int(search[0]), int(search[1]))
        with write_products(
            folder, result, acquired, pixels=pixels, stack=stack, tell=tell, stages=stages
        ) as written:
            step = steps_of(tell, "matching all pairs of bands, as they were and as they are now")
            fit = partial(fit_every_pair, search_px=search_px, coarse=result.coarse, stages=stages)
            before = fit(written.before, step=part_of(step, 0, 2), name="fit-before")
            after = fit(written.after, step=part_of(step, 1, 2), name="fit-after")
            summary = summarize_registration(acquired, result, _recovered(result), written, before, after)
            summary["wall_seconds"] = time.perf_counter() - begun
            tell("writing the report")
            register_page(written, before, after, summary).write(folder / REPORT)
        write_json(folder / SUMMARY, summary)
        return summary

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """The reference, and the bands as images that are read where they lie."""
        with foreign_errors(
            folder / SUMMARY, "is no summary of `register`", "run `sightline register` again"
        ):
            names = [band["name"] for band in summary["bands"]]
            files = [str(name) for name in summary["files"]]
            reference = names.index(summary["onto"])
        for name in files:
            if not _beside(name):
                raise FormatError(
                    f"{folder / SUMMARY}: files holds {name!r}; allowed are names of .tif files in the same "
                    "folder; run `sightline register` again"
                )
        one = len(files) == 1 < len(names)
        places = [
            (files[0], k + 1) if one else (file, 1)
            for k, file in enumerate(files * len(names) if one else files)
        ]
        after = tuple(open_image(folder / file, number) for file, number in places)
        return {"reference": reference, "after": after}

    def exported(self, result: Registration, acquisition: Any) -> Exported:
        """What the images cover: the ground of the band whose grid they have, by its camera as given."""
        opened, acquisition = folder_and_acquisition(result, acquisition)
        if acquisition is None:
            raise InputError(
                "registered images hold no camera: add --acquisition FILE, the ACQUISITION.toml that they "
                "were registered from"
            )
        names = [band.name for band in acquisition.bands]
        onto = names[result.reference] if opened is None else str(opened.summary["onto"])
        if onto not in names:
            raise InputError(f"{acquisition.path}: has no band {onto!r}, onto whose grid images were laid")
        camera = acquisition.bands[names.index(onto)].camera
        t = camera.times(np.arange(float(camera.lines)))
        pose = camera.trajectory.at(t)
        return Exported(
            acquisition.name, t, pose.world_from_body.as_quat(), None, acquisition.epoch, None, pose.position,
            acquisition, {onto: camera},
            folder=None if opened is None else opened.folder,
            files=() if opened is None else tuple(opened.names), only=OF_PLACE,
        )  # fmt: skip

    def draw(self, result: Registration, axes: Sequence[Any]) -> None:
        """How far each pair was apart and is."""
        found = self.numbers(result, self.table)
        place = np.arange(len(found["pair"]))
        for k, when in enumerate(("before", "after")):
            apart = np.hypot(found[f"{when}_along"], found[f"{when}_across"])
            axes[0].bar(place + 0.4 * k - 0.2, apart, width=0.4, label=when)
        axes[0].set_xticks(place, found["pair"])
        axes[0].set_ylabel("apart (px rms)")
        axes[0].set_yscale("log")
        axes[0].legend()


def _beside(name: object) -> bool:
    """Whether a name is that of an image in the folder of the result itself."""
    return isinstance(name, str) and name.endswith(".tif") and not set(name) & set("/\\\0")


class Picture(ResultKind):
    """`Mosaic`."""

    types = (Mosaic,)
    table, index = "strips", ("strip",)
    files = ("picture.tif", "picture.png", SUMMARY)

    def facts(self, result: Mosaic) -> Mapping[str, str]:
        """Strips and shape."""
        strips, lines, columns = result.pixels.shape
        return {
            "strips": f"{strips} ({', '.join(result.names)})",
            "shape": f"{lines} lines x {columns} columns",
        }

    def columns(self, result: Mosaic) -> Columns:
        """What each strip saw."""
        seen = np.isfinite(result.pixels)
        mean = [
            float(one[good].mean()) if good.any() else np.nan
            for one, good in zip(result.pixels, seen, strict=True)
        ]
        return {"strip": list(result.names), "share_seen": seen.mean(axis=(1, 2)), "mean": mean}

    def variables(self, result: Mosaic) -> Mapping[str, Any]:
        """The picture."""
        return {"picture": (("strip", "line", "column"), result.pixels, "1")}

    def render(self, result: Mosaic, folder: Path, tell: Tell, begun: float) -> dict[str, Any]:
        """The picture cut to what every strip saw, in values and in colours."""
        frames = given(result).get("frames", ())
        source = source_of(frames[0]) if frames else None
        acquired = source if isinstance(source, Acquisition) else None
        cut = without_margin(result)
        write_values(folder / "picture.tif", cut)
        write_colours(folder / "picture.png", cut)
        summary = {
            "name": "picture" if acquired is None else acquired.name,
            "result": "Mosaic",
            "version": VERSION,
            "strips": list(cut.names),
            "lines": cut.pixels.shape[1],
            "columns": cut.pixels.shape[2],
            "focal_length_px": cut.camera.detector.focal_length_px,
            "files": ["picture.tif", "picture.png"],
            "warnings": [],
            "wall_seconds": time.perf_counter() - begun,
            "peak_memory_bytes": peak_memory(),
            "inputs": {} if acquired is None else acquired.input_hashes(),
        }
        write_json(folder / SUMMARY, summary)
        return summary

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """Names and pixels."""
        with foreign_errors(folder / SUMMARY, "is no summary of a picture", "run `sightline register` again"):
            names = tuple(str(name) for name in summary["strips"])
        images = [open_image(folder / "picture.tif", k + 1) for k in range(len(names))]
        lines, columns = images[0].shape
        pixels = np.stack([image.read((0, lines), (0, columns)) for image in images])
        return {"names": names, "pixels": pixels}

    def draw(self, result: Mosaic, axes: Sequence[Any]) -> None:
        """The picture in grey."""
        axes[0].imshow(np.nan_to_num(result.pixels).mean(axis=0), cmap="gray")
        axes[0].set_xlabel("column")
        axes[0].set_ylabel("line")


def _recovered(result: Registration) -> Recovered:
    """The recovery whose motion was given; one that was not read from its folder has nothing to say."""
    values = given(result)
    source = source_of(values["motion"])
    return (
        source
        if isinstance(source, Recovered)
        else Recovered(values["motion"], dict(values.get("statics") or {}), {})
    )
