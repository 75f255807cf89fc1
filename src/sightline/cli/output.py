"""The folder a command writes, with what is noted of it on stderr.

Not here: how it is written (``output/folder.py``).
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from sightline.cli.terminal import complain
from sightline.output import folder

if TYPE_CHECKING:
    from sightline.stages import Stages


def _earlier(place: Path) -> Iterable[str]:
    """What a result of whatever command in a folder is made of."""
    if not os.path.lexists(place / "summary.json"):
        return ()
    from sightline.kinds.kind import earlier

    return earlier(place)


#: `sightline.output.folder.output_folder` for a command.
output_folder = partial(folder.output_folder, note=partial(complain, "note"), earlier=_earlier)
stages_folder = folder.stages_folder


def finished_stages(out: Path, *, refuse: bool = False) -> Stages:
    """Stages that wait below `out`; those of another input are named and passed over, or refused."""
    from sightline.stages import Stages

    return Stages(stages_folder(out), partial(complain, "warning"), refuse=refuse)
