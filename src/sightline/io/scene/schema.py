"""What every SCENE.toml may hold; the keys that depend on kind and case are in ``models.py``.

Not here: reading the file (``io/config.py``), what is rendered of it (``simulate/``).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from sightline.io.acquisition.schema import SchemaSection
from sightline.io.quantities import Within

#: What ``sightline simulate`` makes.
KINDS = ("line-of-sight", "stereo", "frames")
#: TOML holds whole numbers of 64 bits.
MOST_SEED = 2**63 - 1


class SceneFile(SchemaSection):
    """A scene whose truth is known."""

    kind: Literal["line-of-sight", "stereo", "frames"] | None = Field(
        default=None, description="What is made: the word after `sightline simulate`"
    )
    case: str | None = Field(
        default=None, max_length=500, description="Named set of options, of which the other keys replace some"
    )
    seed: Annotated[int, Within(0, MOST_SEED)] = Field(
        default=0, description="Decides everything that is random: same seed, same scene, bit for bit"
    )
