"""Commented examples of the TOML files that commands read, one of each.

Not here: acquisitions of one's own images (``bands.py``), keys and allowed values (``io/config.py``).
"""

from __future__ import annotations

from importlib.resources import files

from sightline.errors import InputError

#: Templates by their names, and the file that each is written to.
TEMPLATES = {
    "strip": "acquisition.toml",
    "stereo": "stereo.toml",
    "flight": "sequence.toml",
    "tdi": "tdi.toml",
    "layout": "instrument.toml",
}


def template(name: str) -> tuple[str, str]:
    """An example file by the name of its template.

    Parameters
    ----------
    name : str
        One of `TEMPLATES`.

    Returns
    -------
    file : str
        Name of the file that it is written to.
    text : str
        TOML; every key that is needed, with its unit.

    Raises
    ------
    InputError
        If there is no such template; the message lists them.
    """
    if name not in TEMPLATES:
        raise InputError(f"--template {name!r} is not known; allowed: {', '.join(TEMPLATES)}")
    return TEMPLATES[name], files("sightline.io.init").joinpath(f"{name}.toml").read_text(encoding="utf-8")
