"""Summaries as JSON text: arrays become lists, numbers that are not finite become null.

Not here: what a summary says (``io/results/line_of_sight.py``).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from sightline.io.names import json_printable


def json_text(summary: Mapping[str, Any]) -> str:
    """A summary as indented JSON, strictly by the standard."""
    return json_printable(json.dumps(plain(summary), indent=2, allow_nan=False, ensure_ascii=False))


def plain(value: Any) -> Any:
    """The same value in types that JSON knows; anything else becomes its text."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)
