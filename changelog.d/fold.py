"""Fold the fragments of this folder into CHANGELOG.md under a version and its date, and delete them.

python changelog.d/fold.py 1.2.0 2026-12-01
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
#: Kinds in their order, as the ends of the names of fragments.
KINDS = ("added", "changed", "fixed", "removed")


def folded(changelog: str, fragments: dict[str, str], version: str, date: str) -> str:
    """The text of CHANGELOG.md with the fragments (name: text) under their version.

    A section of it that says "not yet released" is replaced; else the new one stands above all others.
    """
    wrong = [name for name in fragments if name.split(".")[-2] not in KINDS]
    if wrong:
        raise SystemExit(f"{', '.join(wrong)}: the kind must be one of {', '.join(KINDS)}")
    parts = [f"## {version}, {date}\n"]
    for kind in KINDS:
        texts = [fragments[name].strip() for name in sorted(fragments) if name.split(".")[-2] == kind]
        if texts:
            lines = ["- " + " ".join(text.split()) for text in texts]
            parts.append(f"### {kind.capitalize()}\n\n" + "\n".join(lines) + "\n")
    section = "\n".join(parts)
    open_section = rf"(?ms)^## {re.escape(version)}, not yet released.*?(?=^## |\Z)"
    if re.search(open_section, changelog):
        return re.sub(open_section, lambda _: section + "\n", changelog).rstrip() + "\n"
    first = re.search(r"(?m)^## ", changelog)
    at = first.start() if first else len(changelog)
    return (changelog[:at] + section + "\n" + changelog[at:]).rstrip() + "\n"


def main(version: str, date: str) -> None:
    """Fold all fragments."""
    paths = [path for path in sorted(HERE.glob("*.md")) if path.name != "README.md"]
    changelog = HERE.parent / "CHANGELOG.md"
    text = folded(
        changelog.read_text(encoding="utf-8"),
        {p.name: p.read_text(encoding="utf-8") for p in paths},
        version,
        date,
    )
    changelog.write_text(text, encoding="utf-8")
    for path in paths:
        path.unlink()
    print(f"{len(paths)} fragments folded into {changelog.name} as {version}")


if __name__ == "__main__":
    if len(sys.argv) != 3 or not re.fullmatch(r"\d{4}-\d\d-\d\d", sys.argv[2]):
        raise SystemExit(__doc__)
    main(*sys.argv[1:])
