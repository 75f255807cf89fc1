"""What a user should know of a strip before trusting its numbers."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from motion.strips import plain_star, strip_cameras
from sightline.estimation.prior import Matern, Spectrum, TabulatedPsd, Tone
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Motion
from sightline.imaging.source import ArrayImage
from sightline.matching.matches import KEPT, LOW_SCORE, OUTSIDE
from sightline.motion.band import Band
from sightline.motion.measure.stars import StarRecord
from sightline.motion.strip.hyper import BROAD, KnownContent, PriorModel
from sightline.motion.strip.lost_bands import compared_through, without_lost
from sightline.motion.strip.normal_equations import TimeGrid
from sightline.motion.strip.strip import RecoverOptions, prepared
from sightline.motion.strip.warnings import (
    _far_off,
    _hidden_by_stages,
    _large_hidden,
    _other_speed,
    _unsettled,
    _why_unmatched,
    blind_warnings,
    out_of_step,
)
from sightline.simulate.scenarios import line_of_sight_case


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
    known = KnownContent(attitude_sigma=1e-3)
    strip = SimpleNamespace(parameters=parameters, known=known, grid=grid, bands=())
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
    # only what is not said is said to be taken for granted
    assert "(not given, and taken as: rate_sigma 0.001 rad/s, of yaw" in said
    drifting = Motion(np.arange(3.0), np.outer(np.arange(3.0) - 1.0, [0.0, 2.5e-3, -0.03]))
    (said,) = _far_off(strip, near, drifting)
    assert "an even rate of yaw of -0.03 rad/s (30 sigmas)" in said and "pitch" not in said
    # where nothing is given, yaw may turn as fast as its motion does
    wide = SimpleNamespace(constant_sigma=(1e-5, 1e-5, 1e-3), drift_sigma=(1e-5, 1e-5, 0.02))
    assert _far_off(strip, state(2.5, -7.5e-4, 2.5e-3, prior=wide), drifting) == []


def test_an_even_rate_of_pitch_that_a_wrong_speed_would_look_like_is_said():
    scene = line_of_sight_case("nominal", 0, lines=900, columns=80)
    strip = prepared(scene.as_given(), Plane(0.0), RecoverOptions())
    # the ground passes by a pixel of 5 urad in .5 ms
    t = np.arange(3.0)

    def turning(rate: float) -> Motion:
        return Motion(t, np.outer(t, [0.02, rate, 0.02]))

    assert _other_speed(strip, turning(2.5e-4)) == []
    (said,) = _other_speed(strip, turning(-5e-4))
    assert said.startswith("pitch turns evenly by -0.0005 rad/s, 5 % of the rate")
    # offsets known to 6 px pass for 3 x sqrt(2) x 30 urad over the longest lag, .172 s
    loose = replace(strip, bands=tuple(replace(band, offset_sigma_px=6.0) for band in strip.bands))
    assert _other_speed(loose, turning(-5e-4)) == [] != _other_speed(loose, turning(-1e-3))
    # what ties the attitude tells it from a wrong speed
    sensors: Any = ("gyro",)
    assert _other_speed(replace(strip, sensors=sensors), turning(-5e-4)) == []


@pytest.mark.parametrize(("of_c", "left"), [(7, 0), (60, 60)])
def test_what_chance_keeps_of_a_band_that_matches_nothing_takes_no_part(of_c, left):
    # 200 windows of A sought in B and C, 100 of B in C: of C fewer than a tenth are kept, or more
    def record(hub, images, *kept):
        count = 200 if hub == 0 else 100
        residual = np.full((count, len(images), 2), np.nan)
        for k, number in enumerate(kept):
            residual[:number, k] = 0.1
        status = np.where(np.isfinite(residual[..., 0]), KEPT, LOW_SCORE).astype(np.uint8)
        plain = plain_star(count // 10, 10, len(images))
        star = replace(plain, hub=hub, images=images, residual_px=residual)
        return StarRecord(star, status, np.ones(status.shape))

    first, second = without_lost([record(0, (1, 2), 150, of_c), record(1, (2,), 5)], 3)
    assert first.star.present.sum(axis=0).tolist() == [150, left]
    assert second.star.present.sum() == (5 if left else 0)
    assert (first.status == KEPT).sum(axis=0).tolist() == [150, left]
    # few windows that all match are few, not chance
    short = record(1, (2,), 5)
    short = replace(short, status=np.where(short.status == KEPT, KEPT, OUTSIDE).astype(np.uint8))
    assert without_lost([first, short], 3)[1].star.present.sum() == 5
    # where no band matches, none is the odd one
    alone = [record(0, (1, 2), 5, 5)]
    assert without_lost(alone, 3) == tuple(alone)


@pytest.mark.parametrize(
    ("offsets", "named"),
    [
        # B1 and B0 look 14.8 px apart: the image of the one in the place of the other lies so far off. What
        # cameras are off by anyway comes on top, two sigmas of 1 px at most
        ({"B1": -14.8, "B0": 14.8}, True),
        ({"B1": -13.0, "B0": 16.0}, True),
        ({"B1": 14.8, "B0": -14.8}, False),
        ({"B1": -14.8}, False),
        ({"B1": -12.0, "B0": 12.0}, False),
        ({"B0": -29.6, "B2": 29.6}, True),  # 29.6 px apart
        ({"PAN": -14.8, "B1": 14.8}, False),
    ],
)
@pytest.mark.parametrize("period", [5e-4, 4e-4])  # at .4 ms the ground passes .8 px a line
def test_two_bands_that_lie_where_the_other_should_are_named(offsets, named, period):
    scene = line_of_sight_case("nominal", 0, lines=200, columns=80, line_period=period)
    strip = prepared(scene.as_given(), Plane(0.0), RecoverOptions())
    statics = [offsets.get(p.name.removesuffix(" offset along"), 0.0) for p in strip.parameters]
    held = SimpleNamespace(constant_sigma=(1e-5, 1e-5, 1e-3), drift_sigma=(1e-5, 1e-5, 1e-3))
    state: Any = SimpleNamespace(estimate=SimpleNamespace(statics=np.array(statics)), prior=held)
    (said,) = _far_off(strip, state, Motion(np.arange(3.0), np.zeros((3, 3))))
    assert ("look exchanged" in said) == named
    if named:
        one, other = offsets
        assert f"the images of {one} and {other} look exchanged" in said


@pytest.mark.parametrize(
    ("period", "smear"), [(5e-4, None), (1e-3, "3 px"), (5.5e-4, None), (6e-4, "0.6 px")]
)
def test_stages_that_do_not_follow_the_ground_are_named(period: float, smear: str | None) -> None:
    # .5 ms at 6800 m/s is a pixel of 5e-6 rad from 680 km; at 1 ms three steps of four stages are 3 px behind
    scene = line_of_sight_case("nominal", 0, lines=200, columns=120, stages=(4,), line_period=period)
    strip = prepared(scene.as_given(), Plane(0.0), RecoverOptions())
    said = out_of_step(strip)
    assert len(said) == (0 if smear is None else 4)
    assert all("smears over " in one and smear in one and "4 TDI stages" in one for one in said)


@pytest.mark.parametrize(("columns", "said"), [(16, False), (100, True)])
def test_changes_of_stages_are_said_of_the_windows_that_were_used(columns: int, said: bool) -> None:
    shape = (600, 400)
    rng = np.random.default_rng(0)
    # stages that change every 20 columns: between two changes lies a window of 16 columns, none of
    # 100, nor of a quarter of that
    stages = np.where((np.arange(shape[1]) // 20) % 2 == 0, 16, 32)[None]
    bands = [
        Band(f"band {k}", ArrayImage(rng.standard_normal(shape)), replace(camera, stages=stages))
        for k, camera in enumerate(strip_cameras((0.0, -83.0), *shape))
    ]
    # the searching pass had windows of the other width
    options = RecoverOptions(first_window=(10, 116 - columns), window=(4, columns))
    strip = prepared(bands, Plane(0.0), options)
    found = _why_unmatched(strip, 1, np.array([], dtype=int), options)
    assert found.startswith("nearly all of its windows lie across" if said else "check its `look_ahead`")


def test_hidden_modes_too_large_for_their_blur_are_named_with_axis_frequency_and_size() -> None:
    strip = SimpleNamespace(scale=np.array([5e-6, 5e-6, 4e-5]))
    large, usual = Tone(1.5e-6, 47.2, 1.0), Tone(4e-7, 121.0, 0.3)
    model = PriorModel(BROAD.spectra, unseen=((usual, large), (), (large,)), blur_shows=True)
    (said,) = _large_hidden(strip, SimpleNamespace(model=model))
    # 1.5e-6 rad are .3 px of roll, and of yaw .04
    assert "average away 47 Hz of roll (0.3 px): " in said
    for quiet in (replace(model, blur_shows=False), replace(model, unseen=((usual,), (), (large,)))):
        assert _large_hidden(strip, SimpleNamespace(model=quiet)) == []


def test_modes_that_stages_hide_and_rows_do_not_tell_of_are_named_where_sigma_holds_none() -> None:
    # modes of .2 px up to 83 Hz let expect .11 px at 121 Hz, more than the sigma of .02 px: 600 instants of
    # 20 px tell nothing of them, of .02 px that there are none
    pixel = 5e-6
    strip = SimpleNamespace(
        scale=np.full(3, pixel),
        nominal=[SimpleNamespace(stage_times=(8e-3,)), SimpleNamespace(stage_times=(8e-3,))],
        known=KnownContent(),
        turn=np.eye(3),
    )
    seen = (Tone(pixel * 0.25, 47.0, 0.1), Tone(pixel * 0.2, 83.0, 0.1))
    loud = Spectrum((Matern(pixel, 1.0, "5/2"), Matern(0.1 * pixel, 0.01, "3/2"), *seen))
    star = SimpleNamespace(stretches=lambda: [slice(None)], t=np.array([[0.0, 0.3]]), t_hub=np.array([0.0]))
    star.present = np.ones((1, 2), dtype=bool)
    motion = SimpleNamespace(covariance=np.tile((0.02 * pixel) ** 2 * np.eye(3), (9, 1, 1)))

    def state(noise_px: float, **changed: Any) -> Any:
        model = replace(PriorModel((loud,) * 3, blur_shows=True), **changed)
        noise = noise_px * pixel
        rows = noise * np.random.default_rng(0).standard_normal((600, 3))

        def shown_of(waves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            flat = waves.reshape(-1, waves.shape[2])
            return flat.T @ rows.ravel() / noise**2, flat.T @ flat / noise**2

        estimate = SimpleNamespace(grid=TimeGrid(0.0, 5e-4, 600), shown_of=shown_of)
        return SimpleNamespace(model=model, estimate=estimate, records=[SimpleNamespace(star=star)])

    (said,) = _hidden_by_stages(strip, state(20.0), motion)
    assert "average away 1" in said and "by those of 47, 83 Hz" in said and "sigma holds none" in said
    # modes of s = .25^2 47^3 and .2^2 83^3 count for n = (sum s)^2 / sum s^2 = 1.5, of sum s^2 / sum s.
    # Beyond them lie n^2 / (n + 1) 83^n / f^(n + 1) in every Hz of which stages leave less than .15, up to
    # four of their cycles, of variances exponential about strength / f^3
    f, s = np.arange(1.0, 500.0, 0.1), np.array([0.25, 0.2]) ** 2 * np.array([47.0, 83.0]) ** 3
    n, strength = s.sum() ** 2 / (s @ s), s @ s / s.sum()
    larger = np.exp(-(0.02**2) * f**3 / strength)
    odds = (larger * n**2 / (n + 1.0) * 83.0**n / f ** (n + 1.0) * 0.1)[
        np.abs(np.sinc(8e-3 * f)) < 0.15
    ].sum()
    chance = float(said.split("probability ")[1].split(",")[0])
    assert chance == pytest.approx(odds / (1.0 + odds), rel=0.08)
    # where rows cannot show them at all, it is all the same
    assert _hidden_by_stages(strip, state(20.0, blur_shows=False), motion)
    assert _hidden_by_stages(strip, state(0.02), motion) == []
    owned = state(20.0, unseen=((Tone(pixel, 121.0, 8.0),), (), ()))
    assert _hidden_by_stages(strip, owned, motion) == []
    without = SimpleNamespace(**{**vars(strip), "nominal": [*strip.nominal, SimpleNamespace(stage_times=())]})
    assert _hidden_by_stages(without, state(20.0), motion) == []
    sure = SimpleNamespace(covariance=np.tile((3.0 * pixel) ** 2 * np.eye(3), (9, 1, 1)))
    assert _hidden_by_stages(strip, state(20.0), sure) == []
    # roll of the estimate is pitch of the body, of a sigma of .02 px
    faint = Spectrum((*loud.components[:2], Tone(1e-4 * pixel, 47.0, 0.1)))
    about_roll = state(20.0, spectra=(loud, faint, faint))
    one_axis = SimpleNamespace(covariance=motion.covariance * np.diag([1.0, 3e4, 1.0]))
    across = SimpleNamespace(covariance=motion.covariance * np.diag([3e4, 1.0, 1.0]))
    assert not _hidden_by_stages(strip, about_roll, across) and _hidden_by_stages(strip, about_roll, one_axis)
    strip.turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert _hidden_by_stages(strip, about_roll, across) and not _hidden_by_stages(strip, about_roll, one_axis)
    # spectra that are given hold what is hidden as they hold the rest
    flat = (Spectrum((TabulatedPsd((0.0, 100.0), (1e-12, 1e-12)),)),) * 3
    strip.known = KnownContent(spectra=flat)
    assert _hidden_by_stages(strip, state(20.0, spectra=flat, blur_shows=False), motion) == []


def matched(*lags: float, tones: Any = ((), (), ())) -> SimpleNamespace:
    """A second of matches at these lags, of a motion of 50 and, about another axis, 41 Hz."""
    t_hub = np.linspace(0.0, 1.0, 300)
    star = SimpleNamespace(
        present=np.ones((300, len(lags)), bool),
        t_hub=t_hub,
        t=t_hub[:, None] + np.array(lags),
        stretches=lambda: [slice(None)],
    )
    spectra = [Spectrum((*BROAD.spectra[0].components, Tone(0.2, f, 0.1))) for f in (50.3, 41.0)]
    model = PriorModel((spectra[0], spectra[1], spectra[1]), blind=tones)
    return SimpleNamespace(records=[SimpleNamespace(star=star)], model=model)


def test_frequencies_that_all_pairs_are_blind_to_are_named_where_modes_are_not_unlikely() -> None:
    # multiples of 1 / 37.5 ms up to one and a half times 50.3 Hz, in 1.075 s
    (said,) = blind_warnings(matched(0.0375, 0.075))
    assert "blind at 26.7, 53.3 Hz: nothing is known of a tone there" in said and "within 0.93 Hz" in said
    assert "those of 41, 50 Hz; sigma holds none but those that were found" in said
    (said,) = blind_warnings(matched(0.0375, 0.075, tones=((Tone(0.1, 53.3, 0.3),),) * 3))
    assert "Something moves at 53.3 Hz" in said and "of each" in said
    # lags that differ leave no frequency in common; 1 / 12 ms is far beyond what is seen
    assert blind_warnings(matched(0.15, 0.1574, 0.1722)) == blind_warnings(matched(0.012)) == []


def test_passes_that_change_what_no_pair_sees_blame_no_camera() -> None:
    strip: Any = SimpleNamespace(bands=[SimpleNamespace(camera=SimpleNamespace(stages=None))])
    state = matched(0.0375, 0.075)
    assert "about 53.1 Hz: all pairs of bands are blind at 53.3 Hz" in _unsettled(strip, state, 2.0, 53.1)
    for elsewhere in (0.0, 47.0):
        assert "check the camera description, or allow more" in _unsettled(strip, state, 2.0, elsewhere)


def test_bands_are_compared_through_the_one_that_windows_of_two_others_were_cut_from() -> None:
    def of(hub: int, images: tuple[int, ...], tried: int, beside: int = 0):
        status = np.array([[LOW_SCORE] * len(images)] * tried + [[OUTSIDE] * len(images)] * beside)
        return SimpleNamespace(star=SimpleNamespace(hub=hub, images=images), status=status)

    # 60 pairs of windows through band 0; 15 of band 1 in band 2 alone, and none where nothing was compared
    records: Any = [of(0, (1, 2), 30, beside=50), of(1, (2,), 15)]
    assert compared_through(records, 3).tolist() == [60 / 75, 0.0, 0.0]
    assert compared_through([], 2).tolist() == [0.0, 0.0]
