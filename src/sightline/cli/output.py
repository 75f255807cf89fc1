"""The folder a command writes, with what is noted of it on stderr.

Not here: how it is written (``output/folder.py``).
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from functools import partial
from pathlib import Path

from sightline.cli.terminal import complain
from sightline.output import folder


def _earlier(place: Path) -> Iterable[str]:
    """What a result of whatever command in a folder is made of."""
    if not os.path.lexists(place / "summary.json"):
        return ()
    import sightline.kinds.open  # knows every kind  # noqa: F401
    from sightline.kinds.kind import earlier

    return earlier(place)


#: `sightline.output.folder.output_folder` for a command.
output_folder = partial(folder.output_folder, note=partial(complain, "note"), earlier=_earlier)
stages_folder = folder.stages_folder
