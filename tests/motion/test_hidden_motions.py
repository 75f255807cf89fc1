"""What images cannot see, by exact rays written out here: docs/theory/s1.md, section 7.

Flat ground, level flight north; x forward, y right, z down. A detector line looks ahead by phi and its
columns look left, so the ray of column tangent c is (phi, -c, 1) in body axes.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

H, V, PIXEL = 680e3, 6800.0, 5e-6
LOOK_AHEAD = np.array([0.0, 1.5e-3, 1.722e-3])  # lags 150 and 172 ms
T0 = np.linspace(0.0, 2.0, 41)  # s; when each ground point is below the platform
ACROSS = 2.5e-3 * H * np.linspace(-1.0, 1.0, 5)  # m to the right


def seen(phi, motion):
    """Time and column tangent (times, columns) at which a line sees each ground point, by Newton's method."""
    x0, y0 = np.meshgrid(V * T0, ACROSS, indexing="ij")
    t = T0[:, None] - H * phi / V + 0.0 * y0
    for _ in range(6):
        ahead, left = _body_tangents(t, x0, y0, motion)
        t = t + (ahead - phi) * H / V
    return t, left


def _body_tangents(t, x0, y0, motion):
    ray = np.stack([x0 - V * t, y0, np.full_like(t, H)], axis=-1).reshape(-1, 3)
    body = Rotation.from_rotvec(motion(t.ravel())).apply(ray, inverse=True)
    return [(s * body[:, k] / body[:, 2]).reshape(t.shape) for k, s in ((0, 1.0), (1, -1.0))]


def visible_px(truth, other, *, free_offsets, direction=None):
    """Rms px, over pairs of lines, of what tells two motions apart once the hidden image shifts are removed.

    The ground is unknown up to where the first line sees it: only differences between lines count. Along the
    track (0), across it (1), or both.
    """
    shifts = []
    for phi in LOOK_AHEAD:
        (t, left), (t2, left2) = seen(phi, truth), seen(phi, other)
        shifts.append(np.stack([(t2 - t) * V / H, left2 - left]))
    left_over = []
    columns = np.stack([np.ones(len(ACROSS)), ACROSS / ACROSS[-1]])
    for shift in shifts[1:]:
        for k, rows in ((0, columns), (1, columns[:1])):
            if direction not in (None, k):
                continue
            pair = (shift - shifts[0])[k]
            if free_offsets:
                # A free offset takes the mean, a free rotation what grows with the column (along only).
                mean = pair.mean(axis=0)
                fit = np.linalg.lstsq(rows.T, mean, rcond=None)[0]
                pair = pair - fit @ rows
            left_over.append(pair)
    return np.sqrt(np.mean(np.square(left_over))) / PIXEL


def nothing(t):
    return np.zeros((len(t), 3))


def test_a_drift_of_yaw_is_hidden_with_minus_v_over_2h_t_squared_of_roll():
    rate = 1e-3

    def hidden(sign):
        return lambda t: np.stack([-sign * V / (2 * H) * rate * t**2, 0 * t, rate * t], axis=1)

    tied = visible_px(nothing, hidden(+1), free_offsets=True)
    assert tied < 0.02 * visible_px(nothing, hidden(0), free_offsets=True)
    assert tied < 0.02 * visible_px(nothing, hidden(-1), free_offsets=True)
    # rate * t0 * (difference of look-ahead) of up to 2 s and 1.7 mrad: 0.2 px rms, along columns only.
    assert visible_px(nothing, hidden(0), free_offsets=True) > 0.05


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_drift_of_any_axis_is_seen_when_the_offsets_are_known_and_hidden_when_they_are_free(axis):
    def drift(t):
        out = np.zeros((len(t), 3))
        out[:, axis] = 1e-4 * t
        if axis == 2:
            out[:, 0] = -V / (2 * H) * 1e-4 * t**2
        return out

    known = visible_px(nothing, drift, free_offsets=False)
    assert visible_px(nothing, drift, free_offsets=True) < 0.02 * known


def test_a_constant_yaw_is_hidden_with_minus_v_over_h_t_of_roll_even_when_the_offsets_are_known():
    def turned(roll_rate):
        return lambda t: np.stack([roll_rate * t, 0 * t, 1e-3 + 0 * t], axis=1)

    tied = visible_px(nothing, turned(-V / H * 1e-3), free_offsets=False)
    assert tied < 0.01 * visible_px(nothing, turned(0.0), free_offsets=False)
    assert visible_px(nothing, turned(+V / H * 1e-3), free_offsets=False) > 0.1


def test_a_constant_yaw_over_a_moving_yaw_brings_v_over_h_times_its_integral_of_pitch():
    size, rate, constant = 2e-3, 2 * np.pi * 0.1, 0.02

    def yaw(t):
        return size * np.sin(rate * t)

    def truth(t):
        return np.stack([0 * t, 0 * t, yaw(t)], axis=1)

    def turned(factor):
        def motion(t):
            roll = -V / H * constant * t
            integral = size * (1.0 - np.cos(rate * t)) / rate
            # The roll is about the axis of the yawed body: half of roll x yaw in the rotation vector.
            pitch = factor * V / H * constant * integral + 0.5 * roll * yaw(t)
            return np.stack([roll, pitch, constant + yaw(t)], axis=1)

        return motion

    along = {
        factor: visible_px(truth, turned(factor), free_offsets=False, direction=0)
        for factor in (-1.0, 0.0, 1.0)
    }
    # Left over: the change of yaw within the time T0 - t, at most 0.25 s, against the 2 s of the integral.
    assert along[1.0] < 0.25 * along[0.0]
    assert along[-1.0] > 1.5 * along[0.0]
