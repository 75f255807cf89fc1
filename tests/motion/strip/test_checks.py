"""What images cannot give is refused in one sentence: key, value, what is allowed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from motion.strips import ALTITUDE, IFOV, PERIOD, strip_cameras
from sightline.errors import EstimationError, InputError
from sightline.estimation.prior import Spectrum, TabulatedPsd
from sightline.geometry.conjugate import predict_match
from sightline.geometry.instrument import LineDetector
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.matching.select import Selection
from sightline.motion.band import Band
from sightline.motion.measure.plan import hub_windows
from sightline.motion.sensors import ControlSightings
from sightline.motion.strip.checks import (
    check_images,
    checked,
    farthest_control,
    farthest_sensor,
    windows_in_common,
)
from sightline.motion.strip.hyper import KnownContent
from sightline.motion.strip.strip import RecoverOptions, Strip, prepared, suited
from sightline.motion.strip.warnings import _factor_words

SHAPE = (401, 220)


@pytest.fixture(scope="module")
def strip():
    cameras = strip_cameras((30.0, 0.0), *SHAPE)
    rng = np.random.default_rng(0)
    bands = [
        Band(f"band {k}", ArrayImage(rng.standard_normal(SHAPE)), camera) for k, camera in enumerate(cameras)
    ]
    return prepared(bands, Plane(), RecoverOptions())


def beside_coarse(columns: int, coarse: int, lines: int = 2400) -> list[Band]:
    """Two bands of one field of view, whose pixels are as many times as large as their columns are few."""
    first, second = strip_cameras((0.0, -83.0), lines, columns)
    if coarse < columns:
        ratio = columns / coarse
        detector = LineDetector.from_ifov("coarse", coarse, ratio * IFOV, ratio * PERIOD)
        second = replace(second, detector=detector, lines=int(lines / ratio))
    shapes = (first.lines, first.columns), (second.lines, second.columns)
    return [
        Band(f"band {k}", ArrayImage(np.zeros(shape)), camera)
        for k, (shape, camera) in enumerate(zip(shapes, (first, second), strict=True))
    ]


def ready(bands: list[Band], asked) -> tuple[Strip, RecoverOptions]:
    """What recovery begins with, for options that were asked for."""
    options = suited(RecoverOptions(**asked, asked=tuple(asked)), bands, Plane())
    return checked(prepared(bands, Plane(), options), options), options


def refused(strip, options=None) -> str:
    with pytest.raises(InputError) as problem:
        checked(strip, options or RecoverOptions())
    return str(problem.value)


def test_lines_that_average_over_most_of_the_strip_are_refused(strip):
    def of(stages: int):
        one = strip.bands[1]
        camera = replace(one.camera, stages=np.full((1, SHAPE[1]), stages, dtype=np.int16))
        return replace(strip, bands=(strip.bands[0], replace(one, camera=camera)))

    checked(of(200), RecoverOptions())
    with pytest.raises(InputError, match=r"'band 1' averages over 201 stages, .* half of the 401 lines"):
        checked(of(201), RecoverOptions())


def test_windows_that_all_lie_across_changes_of_stages_are_refused(strip):
    def of(columns: int):
        stages = (8 + np.arange(SHAPE[1]) // columns % 2).astype(np.int16)[None]
        cameras = [replace(one.camera, stages=stages) for one in strip.bands]
        bands = [replace(one, camera=camera) for one, camera in zip(strip.bands, cameras, strict=True)]
        return prepared(bands, Plane(), RecoverOptions())

    # windows of 100 columns are narrowed to a quarter at most: stages that change every 8 leave room for none
    checked(of(40), RecoverOptions())
    said = r"^0 of \d+ windows lie between two changes of TDI stages, .* 20 are needed; let `stages`"
    with pytest.raises(EstimationError, match=said):
        checked(of(8), RecoverOptions())


def test_windows_clear_of_changes_are_counted_in_all_pairs(strip):
    shape = (60, 320)
    rng = np.random.default_rng(1)
    bands = [
        Band(f"band {k}", ArrayImage(rng.standard_normal(shape)), camera)
        for k, camera in enumerate(strip_cameras((0.0, -8.0, -16.0, -24.0), *shape))
    ]
    options = RecoverOptions(pairs=(("band 0", "band 1"), ("band 2", "band 3")))
    short = prepared(bands, Plane(), options)
    # 12 windows of either pair, no TDI: no band sees 20, which are needed, but the images do
    checked(short, options)
    found = windows_in_common(short, options)
    assert found.clear == found.seen == 24.0 and found.clear_of == (12.0,) * 4


def test_one_image_given_as_two_is_refused(strip):
    def of(image: ArrayImage):
        return replace(strip, bands=tuple(replace(one, image=image) for one in strip.bands))

    check_images(strip)
    with pytest.raises(InputError, match="the images of 'band 0' and 'band 1' are the same, pixel for pixel"):
        check_images(of(strip.bands[0].image))
    # two that show nothing are refused by what is matched in them
    check_images(of(ArrayImage(np.full(SHAPE, 7.0))))


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("gain", [1.0, 0.37, 2.6, -0.8])
def test_one_image_times_a_gain_given_as_two_is_refused(strip, gain, whole):
    raw = np.random.default_rng(5).normal(900.0, 60.0, SHAPE)
    raw = np.rint(raw) if whole else raw.astype(np.float32)

    def of(other):
        other = np.rint(other) if whole else other.astype(np.float32)
        images = ArrayImage(raw), ArrayImage(other)
        both = zip(strip.bands, images, strict=True)
        return replace(strip, bands=tuple(replace(one, image=image) for one, image in both))

    with pytest.raises(
        InputError, match=r"'band 1' is that of 'band 0' times -?[\d.]+ plus .*, pixel for pixel"
    ):
        check_images(of(gain * raw + 31.4))
    # a single grey value of noise tells two images apart, and so does one other pixel
    check_images(of(gain * raw + np.random.default_rng(6).standard_normal(SHAPE)))
    marked = gain * raw + 31.4
    marked[57, 13] += 9.0
    check_images(of(marked))


def test_images_of_few_grey_values_may_agree(strip):
    few = np.random.default_rng(5).integers(0, 3, SHAPE).astype(np.float64)
    both = zip(strip.bands, (ArrayImage(few), ArrayImage(2.0 * few)), strict=True)
    check_images(replace(strip, bands=tuple(replace(one, image=image) for one, image in both)))


def test_weights_that_no_band_predicts_are_refused(strip):
    predicted = RecoverOptions(weighting="predicted")
    assert refused(strip, predicted).startswith('`weighting` of [matching] is "predicted", but no band says')
    one = replace(strip.bands[1], match_sigma=np.ones(SHAPE[1]))
    checked(replace(strip, bands=(strip.bands[0], one, *strip.bands[2:])), predicted)


class TestKnownMotion:
    # 401 lines, 400 periods of 0.5 ms: 5 Hz to 1000 Hz
    @pytest.mark.parametrize("tone", [1e-3, 4.9, 0.5 / PERIOD, 5e6])
    def test_a_tone_that_the_lines_cannot_hold_is_refused(self, strip, tone):
        said = refused(replace(strip, known=KnownContent((100.0, tone))))
        assert said.startswith(f"`tones` of [known_motion] holds {tone:g} Hz; allowed are 5 Hz")
        assert "to below 1000 Hz (half the line rate)" in said

    def test_repeated_tones_are_one(self, strip):
        known = KnownContent((100.0, 47.0, 100.0, 100.5, 110.0))
        assert checked(replace(strip, known=known), RecoverOptions()).known.tones == (47.0, 100.0, 110.0)

    def test_a_spectrum_above_what_lines_sample_is_refused(self, strip):
        low = Spectrum((TabulatedPsd((0.0, 10.0), (1e-12, 1e-12)),))
        high = Spectrum((TabulatedPsd((900.0, 1e6, 2e6), (0.0, 0.0, 1e-12)),))
        said = refused(replace(strip, known=KnownContent((), (low, high, low))))
        assert said.startswith("`psd` of [known_motion] has power of pitch only from 1e+06 Hz; allowed is")
        checked(replace(strip, known=KnownContent((), (low, low, low))), RecoverOptions())


class TestWindows:
    @pytest.mark.parametrize(
        ("key", "value"),
        [
            ("window", (402, 100)),
            ("window", (4, 221)),
            ("first_window", (402, 100)),
            ("search_px", (8, 10**6)),
            ("step", 402),
        ],
    )
    def test_sizes_larger_than_the_image_are_refused_by_key(self, strip, key, value):
        said = refused(strip, RecoverOptions(**{key: value}))
        given = value if key == "step" else list(value)
        assert said.startswith(f"`{key}` of [matching] is {given}; the smallest image has 401 lines and 220 ")

    def test_the_error_of_a_detector_too_narrow_for_two_windows_says_which_fit(self, strip):
        narrow = replace(
            strip, bands=tuple(replace(b, image=ArrayImage(np.zeros((401, 40)))) for b in strip.bands)
        )
        with pytest.raises(EstimationError, match=r"band 0 has 40 columns.*first_window = \[10, 20\]"):
            checked(narrow, RecoverOptions())
        checked(narrow, RecoverOptions(first_window=(10, 20), window=(4, 20)))

    @pytest.mark.parametrize(("columns", "coarse", "half"), [(160, 40, 20), (188, 47, 23), (30, 30, 15)])
    def test_what_the_first_error_says_of_narrow_bands_leads_to_a_run(self, columns, coarse, half):
        # windows that nobody asked for are of 48 columns, more than the narrow band has
        bands = beside_coarse(columns, coarse)
        said = rf"band 1 has {coarse} columns, .*first_window = \[10, {half}\], window = \[4, {half}\]"
        if columns == coarse:
            said = said.replace("band 1", "band 0")
        for asked in ({}, {"first_window": (10, coarse)}, {"step": 5}):
            with pytest.raises(EstimationError, match=said):
                ready(bands, asked)
        ready(bands, {"first_window": (10, half), "window": (4, half)})

    def test_sizes_are_compared_in_pixels_of_the_finest(self):
        # 100 columns and 300 lines of four pixels of the other each
        bands = beside_coarse(400, 100, lines=1200)
        for asked in ({"window": (4, 120)}, {"first_window": (10, 120)}, {"search_px": (8, 101)}):
            ready(bands, asked)
        said = r".* the smallest image has 1200 lines and 400 columns in pixels of the finest: at most"
        for key, more in (("window", (4, 401)), ("first_window", (1201, 100)), ("step", 1201)):
            with pytest.raises(InputError, match=f"`{key}`{said}"):
                ready(bands, {key: more})

    def test_a_window_lies_whole_in_a_finer_image_with_all_of_its_pixels_there(self):
        bands = beside_coarse(400, 100, lines=600)
        strip, options = ready(bands, {})
        shapes = [band.image.shape for band in bands]
        plan = strip.plan(options, options.first_window, 2 * options.first_window[0])
        ((hub, _, grid),) = hub_windows(strip.nominal, Plane(), shapes, strip.order, plan)
        assert hub == 1 and grid.window == (2, 25)
        line = predict_match(bands[1].camera, bands[0].camera, Plane(), grid.centres)[:, 0]
        # two lines are eight there; a pixel beyond the image does not matter
        whole, seen = ((line >= edge) & (line <= 599.0 - edge) for edge in (4.0 - 1.0, 0.0))
        found = windows_in_common(strip, options)
        assert found.whole == whole.sum() < seen.sum() == found.seen

    def test_features_outside_every_image_are_refused(self, strip):
        for outside in ([[500.0, 10.0], [10.0, -3.0]], [[10.0, -3.0], [400.0, 220.0]], [[401.0, 5.0]]):
            features = {0: np.array(outside)}
            said = refused(strip, RecoverOptions(selection=Selection("listed", features=features)))
            assert said.startswith("`features` of [matching]: every listed feature lies outside its image")
        features[1] = np.array([[500.0, 300.0], [400.45, 219.45]])
        checked(strip, RecoverOptions(selection=Selection("listed", features=features)))


class TestControlPoints:
    def points(self, strip, moved, sigma=1.0):
        pixel = np.array([[80.0, 100.0]])
        ground = strip.nominal[0].locate(pixel, Plane())
        return ControlSightings(ground + moved, np.array([sigma]), np.array([0]), pixel)

    def test_a_point_grossly_out_of_place_is_named(self, strip):
        # seen across the track under about 0.2 rad instead of 0
        said = refused(replace(strip, control=self.points(strip, [0.2 * ALTITUDE, 0.0, 0.0])))
        assert said.startswith("control point 1 (")
        assert "rad from where 'band 0' looked at line 80, column 100; allowed are 0.1 rad" in said

    def test_a_point_in_other_units_is_named(self, strip):
        said = refused(replace(strip, control=self.points(strip, [1e300, 0.0, 0.0])))
        assert said.startswith("control point 1 (1e+300")

    def test_a_point_some_hundred_pixels_off_is_an_attitude_not_a_mistake(self, strip):
        checked(replace(strip, control=self.points(strip, [1e-3 * ALTITUDE, 0.0, 0.0])), RecoverOptions())

    def test_a_refused_match_names_the_point_it_began_from(self, strip):
        assert farthest_control(strip) == ""
        said = farthest_control(replace(strip, control=self.points(strip, [1e-3 * ALTITUDE, 0.0, 0.0])))
        # 1e-3 rad off the straight line down
        assert said.startswith("; matching began where control points say: control point 1 (")
        assert "lies 0.001 rad from where 'band 0' looked at line 80, column 100" in said


@pytest.mark.parametrize(("kind", "size", "px"), [("star-tracker", 1.2, "2.4e+05"), ("gyro", 0.1, "2e+05")])
def test_a_sensor_that_moves_the_cameras_farther_than_is_searched_is_named(kind, size, px):
    angles = np.tile([size, 0.0, 0.0], (10, 1))
    sensor = SimpleNamespace(name="ST", kind=kind, angles=angles)
    strip = SimpleNamespace(sensors=(sensor,), turn=np.eye(3), scale=np.full(3, 5e-6))
    # increments of a gyro add up
    assert f"attitude sensor ST says, up to {px} px" in farthest_sensor(strip, (8, 8))
    sensor.angles = angles * 1e-6
    assert farthest_sensor(strip, (8, 8)) == ""
    assert farthest_sensor(SimpleNamespace(sensors=()), (8, 8)) == ""


@pytest.mark.parametrize(
    ("factors", "words"),
    [
        ((1.0, 51.0, 1.5), "51 times (pitch)"),
        ((3.0, 1.0, 4.0), "3 times (roll), 4 times (yaw)"),
        ((6.0,), "6 times"),
    ],
)
def test_the_axes_of_a_sensor_that_scatter_are_named(factors, words):
    assert _factor_words(factors) == words and _factor_words((1.0, 1.0, 1.0)) == ""
