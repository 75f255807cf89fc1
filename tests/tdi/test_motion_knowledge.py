"""What is known of a motion: TDI's own low-pass undone, errors grown with it, bad input refused."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sightline.errors import InputError, SpanError
from sightline.geometry.trajectory import Motion
from sightline.tdi.motion_knowledge import MotionKnowledge, error_and_jitter, prolonged

PERIOD, LINES = 1e-3, 2000
T = PERIOD * np.arange(LINES)
STAGES, RATIO = 16, 0.8


def averaged(signal) -> np.ndarray:
    """What lines of so many stages show of a signal: its mean over all exposures, centred, by brute force."""
    k = np.arange(STAGES) - 0.5 * (STAGES - 1)
    inside = RATIO * ((np.arange(40) + 0.5) / 40 - 0.5)
    return signal(T[:, None] + PERIOD * (k[:, None] + inside).ravel()).mean(axis=1)


def signal(t):
    """Drift, and tones of 0.004 and 0.02 cycles per line: the latter keeps 0.83 of its size."""
    return 5.0 * t + np.sin(2 * np.pi * 4.0 * t + 0.3) + 0.5 * np.sin(2 * np.pi * 20.0 * t)


def test_the_low_pass_of_tdi_is_undone_where_it_leaves_half():
    """16 stages leave half at 0.0376 cycles per line (sinc(x) = 1/2 at x = 0.603): 37.6 Hz.

    Near the ends the motion beyond is a guess; a filter of 16 lines reaches as far some times over.
    """
    knowledge = MotionKnowledge(Motion(T, np.outer(averaged(signal), [1.0, 0.0, 0.0])))
    found, highest = knowledge.without_tdi(STAGES, RATIO, PERIOD)
    assert highest == pytest.approx(0.603 / STAGES / PERIOD, rel=0.02)
    inner = slice(200, -200)
    before = np.abs(knowledge.motion.angles[inner, 0] - signal(T)[inner]).max()
    after = np.abs(found.motion.angles[inner, 0] - signal(T)[inner]).max()
    assert before > 0.07  # 0.17 of the faster tone
    assert after < 0.004  # leakage of two tones through ends 200 lines away, 1 % of what was lost
    assert_allclose(found.motion.angles[:, 1:], 0.0, atol=1e-12)


def test_errors_grow_as_the_motion_is_restored_and_beyond_they_are_the_motion():
    f = np.linspace(0.0, 500.0, 1001)
    level = 1e-9
    rng = np.random.default_rng(1)
    noise = np.cumsum(rng.normal(size=LINES)) * 1e-3
    knowledge = MotionKnowledge(Motion(T, np.outer(noise, [1.0, 0.0, 0.0])), f, np.full((1001, 3), level))
    found, highest = knowledge.without_tdi(STAGES, RATIO, PERIOD)
    at = np.searchsorted(f, 20.0)
    seen = np.sinc(RATIO * 0.02) * np.sin(np.pi * STAGES * 0.02) / (STAGES * np.sin(np.pi * 0.02))
    assert found.error_psd[at, 0] == pytest.approx(level / seen**2, rel=1e-9)
    assert_allclose(found.error_psd[f > highest, 1], 4.0 * level)
    just, far = np.searchsorted(f, [highest + 1.0, 2.0 * highest])
    # a random walk of 1e-3 per line: 2 T 1e-6 / (2 sin(pi nu))^2, at 28 Hz; the mean over 38 values of 100 %
    walk = 2.0 * PERIOD * 1e-6 / (2.0 * np.sin(np.pi * 0.028)) ** 2
    assert 0.3 * walk < found.error_psd[just, 0] < 3.0 * walk
    assert found.error_psd[far, 0] / found.error_psd[just, 0] == pytest.approx(
        (f[far] / f[just]) ** -4.0, rel=0.01
    )


def test_errors_that_are_not_known_are_the_motion_itself():
    error, jitter = error_and_jitter(
        np.array([1.0, 10.0]), np.array([[1.0, np.inf, 2.0], [3.0, 0.3, 0.0]]), np.full((2, 3), 7.0)
    )
    assert_allclose(error, [[1.0, 7.0, 2.0], [3.0, 0.3, 0.0]])
    # the integral of s (f / 10)^-4 from 10 on is 10 s / 3
    assert_allclose(jitter, np.sqrt([10.0, 1.0, 0.0]))


def test_directions_go_straight_on_beyond_their_ends():
    t = np.linspace(0.0, 1.0, 101)
    line = np.stack([2.0 * t - 1.0, 0.0 * t + 3.0, -t], axis=1)[:, :, None]
    at = np.array([-0.5, 0.25, 1.5])
    expected = np.stack([2.0 * at - 1.0, 0.0 * at + 3.0, -at], axis=1)[:, :, None]
    assert_allclose(prolonged(t, line, at), expected, atol=1e-12)


def test_directions_that_bend_are_straight_between_their_times_and_go_on_at_the_mean_slope_of_the_end():
    t = np.cumsum(1.0 + 0.3 * np.cos(np.arange(60.0)))
    bent = np.stack([t**2, np.exp(0.05 * t)], axis=1)
    inside = 0.5 * (t[1:] + t[:-1])
    between = [np.interp(inside, t, column) for column in bent.T]
    assert_allclose(prolonged(t, bent, inside), np.stack(between, axis=1), rtol=1e-12)
    assert_allclose(prolonged(t, bent, t), bent, rtol=1e-12)
    # a twentieth of 60 times: three steps
    for end, inner, beyond in ((0, 3, t[0] - 2.0), (59, 56, t[59] + 5.0)):
        slope = (bent[end] - bent[inner]) / (t[end] - t[inner])
        expected = bent[end] + (beyond - t[end]) * slope
        assert_allclose(prolonged(t, bent, np.array([beyond])), expected[None], rtol=1e-12)


def test_bad_input_is_refused():
    motion = Motion(T, np.zeros((LINES, 3)))
    with pytest.raises(InputError, match="error_psd"):
        MotionKnowledge(motion, np.array([1.0, 2.0]), np.zeros((3, 3)))
    with pytest.raises(InputError, match="finite and 0 or more"):
        MotionKnowledge(motion, np.array([1.0]), np.full((1, 3), -1.0))
    with pytest.raises(InputError, match="belong together"):
        MotionKnowledge(motion, hidden=np.zeros((LINES, 3, 1)))
    with pytest.raises(InputError, match=r"`hidden` has shape \(5, 3, 1\)"):
        MotionKnowledge(motion, hidden=np.zeros((5, 3, 1)), hidden_covariance=np.eye(1))
    for stages, ratio in ((0, 0.5), (4, 0.0), (4, 1.5)):
        with pytest.raises(InputError, match=r"\[motion\] `stages`"):
            MotionKnowledge(motion).without_tdi(stages, ratio, PERIOD)
    with pytest.raises(SpanError, match="at least four line periods"):
        MotionKnowledge(Motion.zero(0.0, 2.0 * PERIOD)).without_tdi(4, 0.5, PERIOD)
