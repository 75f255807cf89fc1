"""Lags of the wrong sign, of bands that lie on one another already."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sightline.applications import lag_sign, line_of_sight
from sightline.applications.lag_sign import with_reversed_lags, wrong_lag_sign
from sightline.cli.recover import recover_acquisition
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Plane
from sightline.imaging.part import ImageLines
from sightline.motion.band import Band
from sightline.motion.strip.strip import RecoverOptions
from sightline.simulate.scenarios import line_of_sight_case

GROUND = Plane(0.0)
LINES, COLUMNS = 540, 300


def laid(bands: Sequence[Band]) -> list[Band]:
    """Bands of one strip cut so that the same lines show the same ground, as in a product on one grid."""
    middle = np.array([[0.5 * (bands[0].camera.lines - 1), 0.5 * (bands[0].camera.columns - 1)]])
    at = [predict_match(bands[0].camera, band.camera, GROUND, middle)[0, 0] for band in bands]
    first = np.round(np.array(at) - min(at)).astype(int)
    lines = min(band.camera.lines - int(begin) for band, begin in zip(bands, first, strict=True))
    return [
        replace(
            band,
            image=ImageLines(band.image, int(begin), lines),
            camera=replace(
                band.camera,
                first_line_time=float(band.camera.times(np.array([float(begin)]))[0]),
                lines=lines,
            ),
        )
        for band, begin in zip(bands, first, strict=True)
    ]


@pytest.fixture(scope="module")
def bands() -> list[Band]:
    """Four bands of .37 s at lags of up to .17 s, their places known to 3 px."""
    scene = line_of_sight_case(
        "nominal", 3, lines=LINES, columns=COLUMNS, lags=(0.0, 0.08, 0.17, 0.12), line_period=1e-3,
        names=("A", "B", "C", "D"), gains=(1.0, 0.9, 0.8, 0.9), gammas=(1.0, 1.0, 1.0, 1.0),
    )  # fmt: skip
    return [replace(band, offset_sigma_px=3.0, rotation_sigma=3e-3) for band in laid(scene.as_given())]


@pytest.fixture(scope="module")
def placed(bands) -> dict[bool, list[lag_sign.Placed | None]]:
    """The last band by the motion of the others, with lags as they are (True) and reversed."""
    pairs = ((True, bands), (False, with_reversed_lags(bands)))
    return {right: lag_sign._last_placed(some, GROUND, 0.0, RecoverOptions()) for right, some in pairs}


@pytest.fixture
def said(bands, placed, monkeypatch) -> Callable[..., str]:
    """What is said of bands all of which match, the last a little worse; the `less` last had no part."""
    pairs = [SimpleNamespace(images=(0, k), tried=600, kept=590 - k) for k in range(1, 4)]

    def once(some: Sequence[Band], *_: Any) -> Any:
        ahead = [band.camera.first_line_time for band in some]
        return placed[(ahead[2] > ahead[0]) == (bands[2].camera.first_line_time > 0.0)]

    monkeypatch.setattr(lag_sign, "_last_placed", once)
    return lambda some, less=0: wrong_lag_sign(
        SimpleNamespace(pairs=pairs[: len(some) - 1 - less]),
        some,
        GROUND,  # type: ignore[arg-type]
    )


def test_reversed_lags_show_the_same_ground_at_mirrored_times(bands):
    turned = with_reversed_lags(bands)
    points = np.array([[100.0, 20.0], [200.0, 250.0]])
    for band, other in zip(bands[1:], turned[1:], strict=True):
        as_given = predict_match(bands[0].camera, band.camera, GROUND, points)
        mirrored = predict_match(turned[0].camera, other.camera, GROUND, points)
        # cut to whole lines, they lie up to half a line off: on the other side where the sign is another
        np.testing.assert_allclose(mirrored - points, -(as_given - points), atol=0.02)
        lag, wrong = (
            float(each.camera.times(np.array([100.0]))[0] - first.camera.times(np.array([100.0]))[0])
            for each, first in ((band, bands[0]), (other, turned[0]))
        )
        assert abs(lag) > 0.04
        assert wrong == pytest.approx(-lag, abs=1e-9)


def test_lags_of_the_wrong_sign_are_told_by_a_fourth_band(bands, said):
    words = said(with_reversed_lags(bands))
    assert "wrong sign: D, placed by the motion of A, B, C" in words
    assert "look_ahead" in words


def test_nothing_is_said_of_lags_of_the_right_sign(bands, said):
    assert said(bands) == ""
    assert said(bands, less=1) == ""


def test_a_band_that_was_given_no_part_tells_too_beside_three_that_match(bands, said):
    turned = with_reversed_lags(bands)
    assert "wrong sign: D, placed by the motion of A, B, C" in said(turned, less=1)
    assert said(turned, less=2) == ""


def test_errors_of_the_band_itself_are_not_taken_for_the_other_sign(bands, placed, said, monkeypatch):
    rng = np.random.default_rng(0)
    clean = {right: list(some) for right, some in placed.items()}
    for _ in range(40):
        periods, phase, size = rng.uniform(0.7, 2.5), rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.06, 0.12)

        def wrong(one: lag_sign.Placed, periods=periods, phase=phase, size=size) -> lag_sign.Placed:
            wave = size * np.sin(2.0 * np.pi * periods * one.lines / bands[0].image.shape[0] + phase)
            free = np.vander(one.lines / one.lines.mean(), 2)
            wave -= free @ np.linalg.lstsq(free, wave, rcond=None)[0]
            return replace(one, means=one.means + wave)

        for right, some in clean.items():
            placed[right] = [wrong(one) for one in some]
        assert said(bands) == ""
    placed.update(clean)


def test_a_recovered_strip_warns_of_it_unless_sensors_tie_the_motion(monkeypatch):
    @dataclass(frozen=True)
    class Found:
        warnings: tuple[str, ...] = ("other",)

    monkeypatch.setattr(line_of_sight, "recover_line_of_sight", lambda *_, **__: Found())
    monkeypatch.setattr(lag_sign, "wrong_lag_sign", lambda *_, **__: "wrong sign")
    acquired = SimpleNamespace(
        bands=(), frames=(), surface=GROUND, height_sigma=0.0, sensors=(), control_points=None,
        known_motion=None, matching={}, path="a.toml",
    )  # fmt: skip
    report: Any = lambda *_: None  # noqa: E731
    assert recover_acquisition(acquired, report).warnings == ("other", "wrong sign")
    acquired.sensors = ("gyro",)
    assert recover_acquisition(acquired, report).warnings == ("other",)


def test_nothing_is_said_where_no_fourth_band_tells(bands, said):
    turned = with_reversed_lags(bands)
    assert said(turned[:3]) == ""
    # of exact places, of other pixels, far off in the image, of the time of another band: nothing is tried
    camera = turned[3].camera
    for other in (
        replace(turned[3], offset_sigma_px=0.0),
        replace(turned[3], camera=replace(camera, detector=camera.detector.adjusted(scale=1.0))),
        replace(turned[3], camera=replace(camera, detector=camera.detector.adjusted(40.0))),
        replace(turned[3], camera=turned[2].camera),
    ):
        assert said([*turned[:3], other]) == ""


def test_a_band_without_part_in_the_motion_lies_where_its_sigma_says(placed):
    for one in placed[True]:
        assert one is not None
        # eight means less offset and slope: chi-square of 6, 99.9 % below 22.5, .1 % below .38
        expected = np.hypot(one.noise_px, one.stated_px)
        assert np.sqrt(0.38 / 6.0) * expected < one.left_px < np.sqrt(22.5 / 6.0) * expected
