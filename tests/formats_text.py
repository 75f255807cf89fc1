"""The pages of all files, one after the other, as their contents page lists them."""

from __future__ import annotations

import re
from pathlib import Path

_DOCS = Path(__file__).resolve().parents[1] / "docs"


def _deeper(text: str) -> str:
    """Headings one level lower; what is in fenced code stays."""
    text = text.replace("\n\n[All files](../formats.md)\n", "\n")
    parts = re.split(r"(```.*?```)", text, flags=re.DOTALL)
    return "".join(part if k % 2 else re.sub(r"(?m)^#(?=#* )", "##", part) for k, part in enumerate(parts))


_CONTENTS = (_DOCS / "formats.md").read_text(encoding="utf-8")
_PAGES = [_DOCS / name for name in re.findall(r"(?m)^- .*\]\((formats/[\w-]+\.md)\)", _CONTENTS)]
FORMATS = "\n".join([_CONTENTS, *(_deeper(page.read_text(encoding="utf-8")) for page in _PAGES)])
