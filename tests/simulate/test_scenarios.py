"""The named cases: what is random in them, what is given, and what is kept back."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from sightline.errors import FormatError, InputError
from sightline.geometry.surface import Dem
from sightline.simulate.scenarios import line_of_sight_case
from sightline.simulate.scene import Extent, scattered_clouds
from sightline.simulate.strip_options import CASES, StripOptions

SMALL = {"lines": 160, "columns": 96}


def test_the_seed_decides_everything():
    first, second, other = (line_of_sight_case("hard", seed, **SMALL) for seed in (7, 7, 8))
    np.testing.assert_array_equal(first.image(2), second.image(2))
    np.testing.assert_array_equal(first.truth, second.truth)
    np.testing.assert_array_equal(first.star_tracker(), second.star_tracker())
    assert first.bands[1].offset_px == second.bands[1].offset_px
    assert not np.array_equal(first.image(2), other.image(2))
    assert not np.array_equal(first.truth, other.truth)


def test_bands_are_drawn_with_noise_of_their_own():
    scenario = line_of_sight_case("nominal", 1, **SMALL)
    from sightline.simulate.sensor import render_block

    noise = [
        scenario.image(k) - 1200.0 * render_block(scenario.cameras[k], scenario.scene, k, (0, 160), 96)
        for k in range(2)
    ]
    # 15 360 pixels: the correlation of independent noise has sd 0.008
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.035


def test_the_nominal_case_is_the_reference_scene():
    options = StripOptions()
    assert options.gsd == pytest.approx((3.4, 3.4))
    assert (options.lines, options.columns) == (3000, 1000)
    assert options.lags == (0.0, 0.15, 0.1574, 0.1722)
    assert (options.coherence, options.snr) == (0.97, 120.0)
    np.testing.assert_allclose(options.rad_per_px, [5e-6, 5e-6, 1.0 / 499.5])


def test_offsets_and_rotations_have_the_sizes_given():
    drawn = [line_of_sight_case("nominal", seed, lines=16, columns=16).bands for seed in range(40)]
    offsets = np.array([band.offset_px for bands in drawn for band in bands])
    rotations = np.array([band.rotation for bands in drawn for band in bands])
    # 320 and 160 draws: relative sd of the rms 4 % and 5.6 %; four of them
    assert np.sqrt(np.mean(offsets**2)) == pytest.approx(1.0, rel=0.16)
    assert np.sqrt(np.mean(rotations**2)) == pytest.approx(3e-4, rel=0.23)


def test_true_lines_bend_or_break_as_the_keys_say_and_nothing_else_of_the_scene_changes():
    plain, bent, broken = (
        line_of_sight_case("nominal", 4, **SMALL, **keys)
        for keys in ({}, {"bend_sigma_px": 0.3}, {"pieces": (32, 64), "piece_sigma_px": 0.5})
    )
    assert plain.bands[1].departure_px is None
    for scene in (bent, broken):
        assert scene.bands[1].offset_px == plain.bands[1].offset_px
        truth, nominal = (detector.tangents / 5e-6 for detector in (scene.bands[1].true, plain.bands[1].true))
        # camera x and y: towards larger columns, forward
        np.testing.assert_allclose((truth - nominal)[:, ::-1], scene.bands[1].departure_px, atol=1e-4)
        assert np.abs(scene.bands[1].departure_px.mean(axis=0)).max() < 0.01
    fourth = np.diff(bent.bands[1].departure_px, 4, axis=0)
    np.testing.assert_allclose(fourth, 0.0, atol=1e-12)
    steps = np.abs(np.diff(broken.bands[1].departure_px, axis=0)).max(axis=1)
    assert np.flatnonzero(steps > 1e-9).tolist() == [31, 63]
    assert [band.shape for band in (*bent.as_given()[:1], *broken.as_given()[:1])] == ["polynomial", "pieces"]
    assert broken.as_given()[0].pieces == (32, 64)


def test_a_step_is_in_the_image_from_its_column_on():
    keys = {
        "lines": 64,
        "columns": 96,
        "motion": "none",
        "snr": 1e5,
        "offset_sigma_px": 0.0,
        "rotation_sigma": 0.0,
    }
    plain, broken = (
        line_of_sight_case("nominal", 4, **keys, pieces=(40,), piece_sigma_px=size).image(0)
        for size in (0.0, 0.8)
    )
    # before the column the image is that of a line moved by the mean of the step, so both halves differ
    moved = np.abs(plain.astype(float) - broken).mean(axis=0)
    assert moved[:40].mean() > 5.0 and moved[40:].mean() > 5.0
    shift = line_of_sight_case("nominal", 4, **keys, pieces=(40,), piece_sigma_px=0.8).bands[0].departure_px
    whole = map_coordinates(plain.astype(float), np.mgrid[20:40, 10:30] + shift[0].reshape(2, 1, 1), order=3)
    # light is interpolated to some 2 % of its contrast of 240
    np.testing.assert_allclose(broken[20:40, 10:30], whole, atol=40.0)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"pieces": (64, 32)}, "`pieces` must rise within columns 1 to 95"),
        ({"pieces": (96,)}, "`pieces` must rise within columns 1 to 95"),
        ({"pieces": (32,), "bend_sigma_px": 0.1}, "keep one of them"),
        ({"bend_sigma_px": 10.0}, "`bend_sigma_px` = 10 folds the line of band"),
    ],
    ids=["falling", "beyond", "both", "folded"],
)
def test_shapes_that_cannot_be_are_refused(keys, words):
    with pytest.raises(InputError, match=words):
        line_of_sight_case("nominal", 0, **SMALL, **keys)


def test_the_nominal_cameras_know_neither_motion_nor_offsets():
    scenario = line_of_sight_case("nominal", 2, **SMALL)
    nominal = scenario.nominal_cameras[0]
    rays = nominal.rays(np.array([[40.0, 47.5]]))
    np.testing.assert_allclose(rays.directions[0], [0.0, 0.0, -1.0], atol=1e-15)
    np.testing.assert_allclose(rays.origins[0], [0.0, 40 * 3.4, 680e3], atol=1e-6)


def test_the_truth_is_the_motion_at_every_line():
    scenario = line_of_sight_case("nominal", 3, **SMALL)
    truth = scenario.truth
    assert truth.shape == (160, 4)
    np.testing.assert_allclose(truth[:, 0], np.arange(160) * 5e-4)
    inside = np.isclose(scenario.motion.t[:, None], truth[None, :, 0], atol=1e-9).any(axis=1)
    np.testing.assert_allclose(scenario.motion.angles[inside], truth[:, 1:], atol=1e-15)


def test_the_hard_case_has_relief_of_300_m_and_clouds():
    scenario = line_of_sight_case("hard", 0, **SMALL)
    assert scenario.scene.relief.heights.std() == pytest.approx(300.0)
    assert scenario.scene.relief.heights.mean() == pytest.approx(0.0, abs=1e-6)
    assert scenario.scene.clouds is not None
    assert scenario.radiometry.snr == 40.0


def test_clouds_cover_the_share_asked_for():
    cover = []
    extent = Extent(-2000.0, 2000.0, 0.0, 6000.0)
    for seed in range(6):
        clouds = scattered_clouds(np.random.SeedSequence(seed), extent, 0.25, (3.4, 3.4))
        x, y = np.random.default_rng(seed).uniform(-2000.0, 2000.0, (2, 20_000))
        cover.append(clouds.opacity(x, y + 2000.0, np.zeros(20_000)).mean())
    # some ten clouds in a scene: a scene's cover spreads by about 0.1, the mean of six by 0.04
    assert np.mean(cover) == pytest.approx(0.25, abs=0.12)


def test_a_cloud_bank_blinds_one_band_before_the_other():
    scenario = line_of_sight_case("nominal", 0, lines=700, columns=64, cloud_banks=((200, 100),))
    bright = [scenario.image(k).mean(axis=1) / scenario.bands[k].nominal.columns for k in (0, 3)]
    middle = [float(np.flatnonzero(b > 1.7 * np.median(b)).mean()) for b in bright]
    # the lag of 344.4 lines, less the parallax of a cloud at 2 km (1.0) and wind, offsets and motion
    assert middle[1] - middle[0] == pytest.approx(344.4, abs=15.0)
    np.testing.assert_allclose(middle[0], 250.0, atol=15.0)


def test_a_blank_stretch_has_no_texture():
    scenario = line_of_sight_case("nominal", 0, lines=300, columns=96, blank=((100, 100),))
    inside = scenario.image(0)[140:160].astype(float)
    # noise alone: 10 DN at a level of 1200
    assert inside.std() == pytest.approx(10.0, rel=0.1)
    assert inside.mean() == pytest.approx(1200.0, abs=1.0)


def test_attitude_sensors_feel_the_drift_and_not_the_tones():
    scenario = line_of_sight_case("nominal", 5, lines=2000, columns=64)
    tracker = scenario.star_tracker(rate=8.0, sigma=1e-9)
    body = scenario.body.at(tracker[:, 0])
    np.testing.assert_allclose(tracker[:, 1:4], body, atol=1e-8)
    tones = scenario.motion.angles - scenario.body.angles
    # 0.30, 0.15 and 0.08 px rms together
    expected = np.sqrt(0.3**2 + 0.15**2 + 0.08**2) * scenario.options.rad_per_px
    np.testing.assert_allclose(tones.std(axis=0), expected, rtol=0.03)


def test_gyro_increments_add_up_to_the_turn_of_the_body():
    scenario = line_of_sight_case("nominal", 5, lines=2001, columns=64)
    gyro = scenario.gyro(rate=100.0, random_walk=1e-12)
    np.testing.assert_allclose(gyro[1:, 0], gyro[:-1, 1])
    turn = scenario.body.at(gyro[[-1], 1])[0] - scenario.body.at(gyro[[0], 0])[0]
    np.testing.assert_allclose(gyro[:, 2:5].sum(axis=0), turn, atol=1e-10)


def test_an_unknown_case_or_option_names_the_known_ones():
    with pytest.raises(InputError, match=r"unknown case: got 'easy'; allowed are nominal, relief"):
        line_of_sight_case("easy")
    with pytest.raises(InputError, match=r"unknown option: line; allowed are .*lines"):
        line_of_sight_case("nominal", line=100)
    with pytest.raises(InputError, match="one entry per band"):
        line_of_sight_case("nominal", lags=(0.0, 0.1))


def test_missing_real_data_say_where_they_were_looked_for(tmp_path):
    with pytest.raises(FormatError, match="SIGHTLINE_DATA"):
        line_of_sight_case("real", 0, data=tmp_path)


def test_the_real_case_shows_real_ground_real_relief_and_a_real_curve(real_data):
    data = [
        real_data(name).parent for name in ("landsat7_everest", "srtm_n44e005", "hirise_jitter_psp008469")
    ]
    scenario = line_of_sight_case("real", 0, data=data[0], lines=200, columns=128)
    assert scenario.scene.relief.heights.std() > 100.0
    image = scenario.image(0)
    assert image.shape == (200, 128) and image.std() > 50.0
    # red and green of the same ground, carried over by the true cameras: Landsat's own correlate to 0.96-0.99
    # from place to place; 5 lines aside it is 0.6
    pixels = np.argwhere(np.ones((100, 60))) + np.array([40.0, 34.0])
    ground = Dem(scenario.scene.relief.heights, scenario.scene.relief.transform)
    there = scenario.cameras[2].project(scenario.cameras[1].locate(pixels, ground))
    green = map_coordinates(scenario.image(2).astype(float), there.T)
    red = scenario.image(1)[40:140, 34:94].ravel()
    assert np.corrcoef(red, green)[0, 1] > 0.9


def test_the_real_ground_lies_eight_ways(real_data):
    data = real_data("landsat7_everest").parent
    options = {"lines": 40, "columns": 40, "relief": "none", "motion": "none"}
    images = [line_of_sight_case("real", seed, data=data, **options).image(1) for seed in range(9)]
    alike = np.corrcoef([image.ravel() for image in images])
    # seed 8 sees the ground of seed 0 some pixels aside (offsets): 5 lines aside it correlates to 0.6
    assert alike[0, 8] > 0.5
    assert np.abs(alike[:8, :8] - np.eye(8)).max() < 0.5


@pytest.mark.parametrize("motion", ["curve", "other-family", "isd"])
def test_measured_motions_fill_the_scene(motion, real_data):
    data = real_data("linescan_isds" if motion == "isd" else "hirise_jitter_psp008469").parent
    scenario = line_of_sight_case("nominal", 0, data=data, lines=2900, columns=16, motion=motion)
    spread = scenario.motion.angles.std(axis=0) / scenario.options.rad_per_px
    assert np.all((spread > 0.2) & (spread < 4.0))


def test_every_case_has_a_name_that_the_command_lists():
    assert CASES == ("nominal", "relief", "clouds", "hard", "real", "other-family", "pan-xs")


def test_a_coarse_pixel_is_the_mean_of_the_fine_ones_it_covers():
    # one ground, one lag, nothing unknown, hardly any noise: rounding to whole numbers is what is left
    same = {"names": ("FINE", "COARSE"), "lags": (0.0, 0.0), "gains": (1.0, 1.0), "gammas": (1.0, 1.0)}
    exact = {"coherence": 1.0, "snr": 1e5, "offset_sigma_px": 0.0, "rotation_sigma": 0.0}
    scenario = line_of_sight_case(
        "nominal", 3, **SMALL, **same, **exact, pixel_ratios=(1.0, 4.0), line_ratios=(1.0, 2.0)
    )
    assert scenario.shapes == ((160, 96), (80, 24))
    fine, coarse = scenario.image(0).astype(float), scenario.image(1).astype(float)
    means = fine.reshape(80, 2, 24, 4).mean(axis=(1, 3))
    assert means.std() > 20.0
    assert np.sqrt(np.mean((coarse - means) ** 2)) < 0.5
    # lines of both begin together, and the truth reaches over the exposures of all
    first, second = scenario.cameras
    assert second.times(np.array([0.0]))[0] == pytest.approx(first.times(np.array([0.5]))[0])
    assert scenario.truth[0, 0] < 0.0 and scenario.truth[-1, 0] > first.times(np.array([159.0]))[0]


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"pixel_ratios": (1.0, 7.0)}, "`pixel_ratios` must be from 1 to 6"),
        ({"pixel_ratios": (1.0, 2.0)}, "one entry per band, or none; got 2 for 4 bands"),
        ({"line_ratios": (1.0, 1.0, 1.0, 6.0), "lines": 90}, "band B2 would have 15 lines"),
    ],
    ids=["beyond six", "of other bands", "too few lines"],
)
def test_ratios_that_cannot_be_are_refused(options, reason):
    with pytest.raises(InputError, match=reason):
        line_of_sight_case("nominal", 0, **{**SMALL, **options})


def test_a_still_strip_imaged_stage_by_stage_is_the_strip():
    still = {**SMALL, "motion": "none", "snr": 1e4}
    plain = line_of_sight_case("nominal", 2, **still).image(1).astype(float)
    for reference in ("centre", "first-stage"):
        tdi = line_of_sight_case("nominal", 2, **still, stages=(4, 8), time_reference=reference)
        assert np.abs(tdi.image(1) - plain).max() < 3.0


def test_columns_have_their_own_stages():
    uneven, even = (line_of_sight_case("nominal", 2, **SMALL, stages=s).image(1) for s in ((16, 1), (16, 16)))
    half = uneven.shape[1] // 2
    assert np.abs(uneven[:, :half].astype(float) - even[:, :half]).max() <= 1.0  # rounding
    assert (uneven[:, half:].astype(float) - even[:, half:]).std() > 5.0
