"""The folder a command writes, with what is noted of it on stderr.

Not here: how it is written (``output/folder.py``).
"""

from __future__ import annotations

from functools import partial

from sightline.cli.terminal import complain
from sightline.output import folder

#: `sightline.output.folder.output_folder` for a command.
output_folder = partial(folder.output_folder, note=partial(complain, "note"))
stages_folder = folder.stages_folder
