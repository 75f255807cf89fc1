"""Units that people read: names for their size in SI."""

from __future__ import annotations

import math

#: rad
ARCSEC = math.pi / 648_000.0
