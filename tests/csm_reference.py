"""Rays of USGS CSM line scanners, written after the documentation of ALE, usgscsm and ISIS alone.

One pixel at a time, in plain numbers: nothing of the package is used. Lines and samples count as in CSM: the
centre of the first pixel is (0.5, 0.5).
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np


def load(path: Path) -> dict:
    text = path.read_text()
    return json.loads(text[text.index("{") :])


def matrix(w: float, x: float, y: float, z: float) -> np.ndarray:
    """Of a quaternion of any length: v' = q v q*."""
    n = w * w + x * x + y * y + z * z
    return (
        np.array(
            [
                [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
            ]
        )
        / n
    )


def line_time(rows: list, line: float) -> float:
    """s from the centre: rows are [line, time offset, exposure], the last that has begun holds."""
    begun = [row for row in rows if row[0] <= line] or rows[:1]
    first, start, exposure = begun[-1]
    return start + exposure * (line - first + 0.5)


def slerped(table: dict, et: float) -> np.ndarray:
    """Rotation matrix from J2000 at an instant: great circle between neighbours, then the constant one."""
    times, quats = table["ephemeris_times"], table["quaternions"]
    k = max(0, min(len(times) - 2, sum(t <= et for t in times) - 1))
    a, b = (np.array(quats[j]) / np.linalg.norm(quats[j]) for j in (k, k + 1))
    if a @ b < 0:
        b = -b
    part = (et - times[k]) / (times[k + 1] - times[k])
    angle = math.atan2(float(np.linalg.norm(b - (a @ b) * a)), float(a @ b))
    q = (
        a
        if angle < 1e-14
        else (math.sin((1 - part) * angle) * a + math.sin(part * angle) * b) / math.sin(angle)
    )
    turn = matrix(*q)
    return np.reshape(table.get("constant_rotation", np.eye(3)), (3, 3)) @ turn


def hermite(table: dict, et: float) -> np.ndarray:
    """Position (km, J2000): the cubic through two positions and their velocities."""
    times = table["ephemeris_times"]
    k = max(0, min(len(times) - 2, sum(t <= et for t in times) - 1))
    h = times[k + 1] - times[k]
    s = (et - times[k]) / h
    p0, p1, v0, v1 = (np.array(table[key][j]) for key in ("positions", "velocities") for j in (k, k + 1))
    return (
        (1 + 2 * s) * (1 - s) ** 2 * p0 + s * (1 - s) ** 2 * h * v0
        + s * s * (3 - 2 * s) * p1 + s * s * (s - 1) * h * v1
    )  # fmt: skip


def undistorted(kind: str, k: dict, x: float, y: float) -> tuple[float, float]:
    """Focal-plane millimetres without distortion."""
    if kind == "radial":
        k0, k1, k2 = k["coefficients"]
        r2 = x * x + y * y
        return x * (1 - k0 - k1 * r2 - k2 * r2**2), y * (1 - k0 - k1 * r2 - k2 * r2**2)
    if kind == "cahvor":
        *k, cx, cy = k["coefficients"]
        u, v = undistorted("radial", {"coefficients": k}, x - cx, y - cy)
        return u + cx, v + cy
    if kind == "lrolrocnac":
        return x, y / (1 + k["coefficients"][0] * y * y)
    if kind == "kaguyalism":
        r = math.sqrt(x * x + y * y)
        a, b = k["x"], k["y"]
        return (
            x + np.ravel(k["boresight_x"])[0] + a[0] + a[1] * r + a[2] * r**2 + a[3] * r**3,
            y + np.ravel(k["boresight_y"])[0] + b[0] + b[1] * r + b[2] * r**2 + b[3] * r**3,
        )
    if kind == "themisir":  # ISIS: ThemisIrDistortionMap
        root = math.sqrt((1 + k["p_alpha1"]) ** 2 + 4 * k["p_alpha2"] * y)
        return x / k["p_k"], 2 * y / (1 + k["p_alpha1"] + root)
    raise AssertionError(kind)


def affine(first: list, second: list, line: float, sample: float) -> tuple[float, float]:
    """x, y of  line = l0 + l1 x + l2 y,  sample = s0 + s1 x + s2 y."""
    (l0, l1, l2), (s0, s1, s2) = first, second
    u, v = line - l0, sample - s0
    det = l1 * s2 - l2 * s1
    return (s2 * u - l2 * v) / det, (l1 * v - s1 * u) / det


def isd_ray(isd: dict, line: float, sample: float) -> tuple[np.ndarray, np.ndarray]:
    """Body-fixed position (m) and unit direction of a pixel of an ISD."""
    et = isd["center_ephemeris_time"] + line_time(isd["line_scan_rate"], line)
    x, y = affine(
        isd["focal2pixel_lines"],
        isd["focal2pixel_samples"],
        isd["starting_detector_line"] - isd["detector_center"]["line"],
        sample * isd["detector_sample_summing"]
        + isd["starting_detector_sample"]
        - isd["detector_center"]["sample"],
    )
    ((kind, coefficients),) = isd["optical_distortion"].items()
    x, y = undistorted(kind, coefficients, x, y)
    look = np.array([x, y, isd["focal_length_model"]["focal_length"]])
    body = slerped(isd["body_rotation"], et)
    direction = body @ slerped(isd["instrument_pointing"], et).T @ look
    return 1e3 * body @ hermite(isd["instrument_position"], et), direction / np.linalg.norm(direction)


def frame_ray(isd: dict, line: float, sample: float) -> tuple[np.ndarray, np.ndarray]:
    """The same of a frame ISD: every pixel at the one instant of the image."""
    et = isd["center_ephemeris_time"]
    x, y = affine(
        isd["focal2pixel_lines"],
        isd["focal2pixel_samples"],
        line * isd["detector_line_summing"] + isd["starting_detector_line"] - isd["detector_center"]["line"],
        sample * isd["detector_sample_summing"]
        + isd["starting_detector_sample"]
        - isd["detector_center"]["sample"],
    )
    ((kind, coefficients),) = isd["optical_distortion"].items()
    x, y = undistorted(kind, coefficients, x, y)
    look = np.array([x, y, isd["focal_length_model"]["focal_length"]])
    body, pointing = (
        np.reshape(table.get("constant_rotation", np.eye(3)), (3, 3)) @ matrix(*table["quaternions"][0])
        for table in (isd["body_rotation"], isd["instrument_pointing"])
    )
    assert isd["instrument_position"]["ephemeris_times"] == [et]
    direction = body @ pointing.T @ look
    return 1e3 * body @ isd["instrument_position"]["positions"][0], direction / np.linalg.norm(direction)


def even_lagrange(flat: list, width: int, start: float, step: float, t: float, order: int) -> np.ndarray:
    """usgscsm's: of `order` nodes inside, fewer towards the ends: 2, 4, 6."""
    rows = np.reshape(flat, (-1, width))
    place = (t - start) / step
    k = max(0, min(len(rows) - 2, math.floor(place)))
    reach = min(k + 1, len(rows) - 1 - k, order // 2)
    used = range(k - reach + 1, k + reach + 1)
    return sum(np.prod([(place - j) / (i - j) for j in used if j != i]) * rows[i] for i in used)


#: m_distortionType of the model states.
STATE_KINDS = {0: "radial", 4: "lrolrocnac"}


def _state_undistorted(state: dict, x: float, y: float) -> tuple[float, float]:
    k = state["m_opticalDistCoeffs"]
    if state["m_distortionType"] == 2:
        kaguya = {"boresight_x": k[0], "x": k[1:5], "boresight_y": k[5], "y": k[6:]}
        return undistorted("kaguyalism", kaguya, x, y)
    if state["m_distortionType"] == 5:
        return undistorted("cahvor", {"coefficients": k}, x, y)
    if state["m_distortionType"] != 1:
        return undistorted(STATE_KINDS[state["m_distortionType"]], {"coefficients": k}, x, y)
    u, v = x, y
    for _ in range(100):  # d = polynomial of u: fixed point on the difference, which is small
        f = [1, u, v, u * u, u * v, v * v, u**3, u * u * v, u * v * v, v**3]
        u, v = u + x - np.dot(f, k[:10]), v + y - np.dot(f, k[10:])
    return float(u), float(v)


def state_ray(state: dict, line: float, sample: float) -> tuple[np.ndarray, np.ndarray]:
    """The same of a model state."""
    rows = list(zip(state["m_intTimeLines"], state["m_intTimeStartTimes"], state["m_intTimes"], strict=True))
    t = line_time(rows, line)
    x, y = affine(
        state["m_iTransL"],
        state["m_iTransS"],
        state["m_startingDetectorLine"] - state["m_detectorLineOrigin"],
        sample * state["m_detectorSampleSumming"]
        + state["m_startingDetectorSample"]
        - state["m_detectorSampleOrigin"],
    )
    x, y = _state_undistorted(state, x, y)
    look = state["m_zDirection"] * np.array([x, y, state["m_zDirection"] * state["m_focalLength"]])
    order = 4 if state.get("m_platformFlag") == 0 else 8
    qx, qy, qz, qw = even_lagrange(state["m_quaternions"], 4, state["m_t0Quat"], state["m_dtQuat"], t, order)
    origin = even_lagrange(state["m_positions"], 3, state["m_t0Ephem"], state["m_dtEphem"], t, order)
    direction = matrix(qw, qx, qy, qz) @ look
    return origin, direction / np.linalg.norm(direction)
