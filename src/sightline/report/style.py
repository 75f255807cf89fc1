"""How every figure of a report looks: its colours, and names of the user as its texts.

Not here: what is drawn, and how (``figure.py``).
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

from sightline.errors import printable, shortened
from sightline.io.names import numbered

AXES = ("roll", "pitch", "yaw")

#: One colour per axis, in every figure.
AXIS_COLOURS = ("#2f6ca3", "#c1502e", "#38805a")
#: What one pixel of each axis means, for the titles of ordinates.
AXIS_UNITS = ("px", "px", "px at field edge")
INK, MUTED, RULE, GRID = "#24292f", "#57606a", "#d8dee4", "#e9edf1"
#: Frequencies that cannot be seen, and lines that no match sees; what stands out as doubtful.
BLIND, DOUBT = "#d69e2e", "#a8740a"
#: Before and after the estimate.
BEFORE, AFTER = "#7d8792", "#2f6ca3"
#: Characters of a name in a figure; of words that hold names, and of each of their lines.
LABEL, _WORDS, _LINE = 28, 140, 52


def labels(names: Iterable[str], longest: int = LABEL) -> list[str]:
    """Names of the user as texts of a figure: on one line, none too long, no two alike."""
    return list(numbered((shortened(printable(name), longest) for name in names), str))


def short_label(name: str, longest: int = LABEL) -> str:
    """One name as `labels` has it."""
    return labels([name], longest)[0]


def wrapped(words: str) -> str:
    """Words that may hold names, as a text of a figure of few short lines."""
    return "\n".join(textwrap.wrap(shortened(printable(words), _WORDS), _LINE))
