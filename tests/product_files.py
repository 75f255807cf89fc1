"""Small products as makers would deliver them: a scene from a circular orbit, with no code of the readers.

The camera looks along the body's z, columns towards its -y; x of the body points where it flies over the
turning Earth. ``ray`` is what a pixel of the scene looks along by that design.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

RATE = 7.292115e-5


def orbit(t):
    """Position (N, 3) m and Earth-fixed velocity (N, 3) m/s of a polar circle, t = 0 near the equator."""
    t = np.atleast_1d(t)
    radius, turn = 7.05e6, 1.06e-3
    a, b = turn * t + 0.2, -RATE * t + 0.7
    inertial = np.stack([np.cos(a), np.zeros_like(a), np.sin(a)], axis=1) * radius
    rate = np.stack([-np.sin(a), np.zeros_like(a), np.cos(a)], axis=1) * radius * turn
    c, s = np.cos(b)[:, None], np.sin(b)[:, None]

    def fixed(v):
        return np.hstack([c * v[:, :1] - s * v[:, 1:2], s * v[:, :1] + c * v[:, 1:2], v[:, 2:]])

    place = fixed(inertial)
    return place, fixed(rate) - np.cross([0.0, 0.0, RATE], place)


def attitude(t, roll=0.1):
    """N rotations, Earth-fixed from body: z down turned about x by `roll`, x along the flight."""
    place, velocity = orbit(t)
    down = -place / np.linalg.norm(place, axis=1, keepdims=True)
    forward = velocity - (velocity * down).sum(axis=1, keepdims=True) * down
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    level = np.stack([forward, np.cross(down, forward), down], axis=-1)
    return Rotation.from_matrix(level) * Rotation.from_euler("x", roll)


@dataclass
class WorldViewScene:
    """A scene of 320 lines of 1 ms and 200 columns; every number that its files hold."""

    rows: int = 320
    columns: int = 200
    rate: float = 1000.0
    distance: float = 8000.0
    pitch: float = 0.08
    origin: tuple[float, float] = (0.4, 8.0)
    start: str = "2013-05-08T00:03:30.500000"
    band: str = "P"
    bands: tuple[str, ...] = ("P",)
    image: str = "scene.TIF"
    tlc: list = field(default_factory=list)
    more: dict = field(default_factory=dict)
    before: float = 1.0

    def instant(self, t: float) -> str:
        whole = datetime.fromisoformat(self.start) + timedelta(seconds=t)
        return f"{whole:%Y-%m-%dT%H:%M:%S.%f}Z"

    def records(self):
        t = np.arange(round((2 * self.before + self.rows / self.rate) / 0.02) + 1) * 0.02 - self.before
        place, velocity = orbit(t)
        sign = np.array([1.0, -1.0])[(np.arange(len(t)) == 7).astype(int)]
        quaternions = attitude(t).as_quat() * sign[:, None]
        return t, place, velocity, quaternions

    def parts(self) -> dict:
        """The content as nested dicts; a list of tuples is a table, a tuple one of its rows."""
        t, place, velocity, quaternions = self.records()
        number = np.arange(1.0, len(t) + 1.0)
        tlc = self.tlc or [(0.0, 0.0), (float(self.rows), self.rows / self.rate)]
        # uncorrelated turns of 20 urad about the axes of the body, as a covariance of the quaternion
        covariances = []
        for q in quaternions:
            x, y, z, w = q
            by_turn = 0.5 * np.array([[w, -z, y], [z, w, -x], [-y, x, w], [-x, -y, -z]])
            covariances.append((4e-10 * by_turn @ by_turn.T)[np.triu_indices(4)])
        ends = {"SATID": "XX01", "STARTTIME": self.instant(-self.before), "NUMPOINTS": len(t)}
        array = {
            "DETARRID": 1, "DETORIGINX": self.origin[0], "DETORIGINY": self.origin[1], "DETROTANGLE": 0.0,
            "DETPITCH": self.pitch,
        }  # fmt: skip
        content = {
            "IMD": {
                "BANDID": self.band,
                "NUMROWS": self.rows,
                "NUMCOLUMNS": self.columns,
                **{f"BAND_{name}": {"TDILEVEL": 8} for name in self.bands},
                "IMAGE": {
                    "SATID": "XX01",
                    "SCANDIRECTION": "Forward",
                    "TLCTIME": self.instant(0.0),
                    "NUMTLC": len(tlc),
                    "TLCLIST": [tuple(row) for row in tlc],
                    "AVGLINERATE": self.rate,
                },
            },
            "EPH": {
                **ends,
                "TIMEINTERVAL": 0.02,
                "EPHEMLIST": [
                    (n, *p, *v, *[1e-3] * 6) for n, p, v in zip(number, place, velocity, strict=True)
                ],
            },
            "ATT": {
                **ends,
                "TIMEINTERVAL": 0.02,
                "ATTLIST": [
                    (n, *q, *c) for n, q, c in zip(number, quaternions, covariances, strict=True)
                ],
            },
            "GEO": {
                "PRINCIPAL_DISTANCE": {"PD": self.distance},
                "OPTICAL_DISTORTION": {"POLYORDER": -1},
                "PERSPECTIVE_CENTER": {"CX": 0.0, "CY": 0.0, "CZ": 0.0},
                "CAMERA_ATTITUDE": {"QCS1": 0.0, "QCS2": 0.0, "QCS3": 0.0, "QCS4": 1.0},
                "DETECTOR_MOUNTING": {f"BAND_{name}": {"DETECTOR_ARRAY": array} for name in self.bands},
            },
            "TIL": {
                "NUMTILES": 1, "TILESIZEX": self.columns, "TILESIZEY": self.rows,
                "TILE": {"FILENAME": self.image},
            },
        }  # fmt: skip
        for place_, value in self.more.items():
            *tables, key = place_.split("/")
            inner = content
            for name in tables:
                inner = inner.setdefault(name, {})
            if value is None:
                inner.pop(key)
            else:
                inner[key] = value
        return content

    def xml(self, folder: Path, name: str = "scene.XML") -> Path:
        path = folder / name
        path.write_text(f'<?xml version="1.0" encoding="UTF-8"?>\n<isd>{_xml(self.parts())}</isd>\n')
        return path

    def text(self, folder: Path, name: str = "scene") -> Path:
        for part, content in self.parts().items():
            (folder / f"{name}.{part}").write_text(_text(content) + "END;\n")
        return folder / f"{name}.IMD"

    def ray(self, line: float, column: float):
        """Origin and direction (not of unit length) of a pixel, light taken as straight."""
        t = line / self.rate
        x, y = self.origin
        look = np.array([x, y - column * self.pitch, self.distance])
        return orbit(t)[0][0], attitude(t)[0].apply(look)


def _row(values) -> str:
    return " ".join(f"{value!r}" for value in map(float, values))


def _xml(content: dict) -> str:
    out = []
    for key, value in content.items():
        if isinstance(value, dict):
            out.append(f"<{key}>{_xml(value)}</{key}>")
        elif isinstance(value, list):
            rows = "\n".join(f"<{key}>{_row(row)}</{key}>" for row in value)
            out.append(f"<{key}List>\n{rows}\n</{key}List>")
        else:
            out.append(f"<{key}>{value}</{key}>")
    return "\n".join(out)


_GROUPS = {"IMAGE": "IMAGE_1", "DETECTOR_ARRAY": "DETECTOR_ARRAY_1", "TILE": "TILE_1"}


def _text(content: dict) -> str:
    out = []
    for key, value in content.items():
        if isinstance(value, dict):
            group = _GROUPS.get(key, key)
            out.append(f"BEGIN_GROUP = {group}\n{_text(value)}END_GROUP = {group}\n")
        elif isinstance(value, list):
            rows = ",\n".join(f"({', '.join(_row(row).split())})" for row in value)
            out.append(f"{key.lower()} = (\n{rows});\n")
        elif isinstance(value, str) and not value.startswith("20"):
            out.append(f'{key.lower()} = "{value}";\n')
        else:
            out.append(f"\t{key.lower()} = {value};\n")
    return "".join(out)
