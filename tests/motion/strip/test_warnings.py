"""What a user should know of a strip before trusting its numbers."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from sightline.geometry.trajectory import Motion
from sightline.motion.strip.hyper import KnownContent
from sightline.motion.strip.warnings import _far_off


def test_what_was_found_far_from_what_was_given_is_named():
    parameters = [
        SimpleNamespace(name=name, unit=unit, sigma=sigma)
        for name, unit, sigma in (
            ("R offset across", "px", 1.0),
            ("R rotation", "rad", 3e-4),
            ("R scale", "", 1e-3),
        )
    ]
    # 2 s long: from its middle to its end a drift goes as many rad as its rate is in rad/s
    grid = SimpleNamespace(step=1.0, count=3)
    strip = SimpleNamespace(parameters=parameters, known=KnownContent(attitude_sigma=1e-3), grid=grid)
    held = SimpleNamespace(constant_sigma=(1e-5, 1e-5, 1e-3), drift_sigma=(1e-5, 1e-5, 1e-3))

    def state(*statics, prior=held):
        return SimpleNamespace(estimate=SimpleNamespace(statics=np.array(statics)), prior=prior)

    still = Motion(np.arange(3.0), np.zeros((3, 3)))
    # two and a half sigmas each
    near = state(2.5, -7.5e-4, 2.5e-3)
    assert _far_off(strip, near, still) == []
    far = state(-8.6, 0.0, 4e-3)
    turned = Motion(np.arange(3.0), np.tile([0.0, 0.0, 0.042], (3, 1)))
    (said,) = _far_off(strip, far, turned)
    assert "R offset across is -8.6 px (8.6 sigmas), R scale is 0.004 (4 sigmas)" in said
    assert "a constant yaw of 0.042 rad (42 sigmas)" in said and "rotation is" not in said
    drifting = Motion(np.arange(3.0), np.outer(np.arange(3.0) - 1.0, [0.0, 2.5e-3, -0.03]))
    (said,) = _far_off(strip, near, drifting)
    assert "an even rate of yaw of -0.03 rad/s (30 sigmas)" in said and "pitch" not in said
    # where nothing is given, yaw may turn as fast as its motion does
    wide = SimpleNamespace(constant_sigma=(1e-5, 1e-5, 1e-3), drift_sigma=(1e-5, 1e-5, 0.02))
    assert _far_off(strip, state(2.5, -7.5e-4, 2.5e-3, prior=wide), drifting) == []
