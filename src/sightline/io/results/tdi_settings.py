"""Settings of an image of signals → ``settings.tif`` and ``tags.bin``, some lines at a time.

Both are described in ``docs/formats.md``.

Not here: what is set (``applications/tdi_lines.py``), the bytes of tags (``tdi_tags.py``).
"""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from sightline.access import check_file, remote_name
from sightline.applications.tdi_lines import SignalLines
from sightline.io.formats.images import NpyImage, RasterImage, open_image
from sightline.io.results.tdi_tags import write_tags
from sightline.stages import Stages
from sightline.tdi.tagging import FIELDS, TdiTags
from sightline.writing import whole_raster

SETTINGS, TAGS = "settings.tif", "tags.bin"
#: Bytes of a pixel in both files at most, and in a stage.
STAGE_BYTES = 3 * sum(np.dtype(form).itemsize for form in FIELDS.values())


def open_signals(path: Path) -> RasterImage | NpyImage:
    """An image of signals, electrons of one line: the first band of a raster, or a .npy file.

    Raises
    ------
    FormatError
        If it is missing, cannot be read, or holds no numbers.
    """
    if remote_name(path) is None:
        check_file(path, "--signals needs an image of the electrons of one line, a pixel per column")
    return open_image(path)


def write_signal_lines(
    folder: Path,
    lines: SignalLines,
    progress: Callable[[int, int], None] | None = None,
    stages: Stages | None = None,
) -> dict[str, Any]:
    """Write both files; gives what ``summary.json`` says of them.

    Parameters
    ----------
    folder : Path
        Exists.
    lines : SignalLines
    progress : callable, optional
        Called with the lines that are done, and all.
    stages : Stages, optional
        Where blocks of lines are kept, if the disk has room for them besides the files.
    """
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning
    from rasterio.windows import Window

    counts = lines.counts
    # an earlier run's blocks have taken some of that room
    kept = 0 if stages is None else stages.size
    if shutil.disk_usage(folder).free + kept < STAGE_BYTES * counts.pixels:
        stages = None
    profile: dict[str, Any] = {
        "driver": "GTiff", "height": counts.lines, "width": counts.columns, "count": 2, "dtype": "uint16",
        "compress": "deflate", "predictor": 2, "BIGTIFF": "IF_SAFER",
    }  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with whole_raster(folder / SETTINGS) as draft, rasterio.open(draft, "w", **profile) as target:
            target.set_band_description(1, "stages")
            target.set_band_description(2, "ratio index")
            ratios = ",".join(f"{ratio:.10g}" for ratio in lines.result.problem.grid.ratios)
            target.update_tags(INTEGRATION_RATIOS=ratios)

            def both() -> Iterator[TdiTags]:
                done = 0
                for tags in lines.blocks(stages):
                    bands = np.stack([tags.stages, tags.ratio_index.astype(np.uint16)])
                    target.write(bands, window=Window(0, done, counts.columns, len(tags)))
                    done += len(tags)
                    if progress is not None:
                        progress(done, counts.lines)
                    yield tags

            size = write_tags(folder / TAGS, both(), counts.lines)
    return {
        "lines": counts.lines,
        "columns": counts.columns,
        "stages": {
            "min": float(counts.fewest),
            "mean": counts.total / counts.pixels,
            "max": float(counts.most),
        },
        "changes_per_line_and_column": counts.changes / max(counts.pixels - counts.columns, 1),
        "without_signal": counts.without_signal,
        "below": counts.below,
        "beyond": counts.beyond,
        "infeasible": counts.infeasible,
        "saturated": counts.saturated,
        "tags_bytes": size,
    }
