"""A simulated pass of synchronous cameras against S2's equations written out (photogrammetry/s2_scene.py)."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine
from scipy.spatial.transform import Rotation
from tests.photogrammetry import s2_scene

from sightline.errors import FormatError, GeometryError, InputError
from sightline.geometry.earth import WGS84, to_geodetic
from sightline.geometry.surface import Dem, Ellipsoid
from sightline.geometry.units import ARCSEC
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.simulate.stereo import MISMATCH_PX, stereo_case
from sightline.simulate.stereo_options import CASE_OPTIONS

SMALL = {"shots": 6, "points": 40}
CASE = "A_paper_T6_K64"
QUIET = {**SMALL, "noise_scale": 0.0}


def grid(scenario, values):
    """Values of tracks or images as (C, K, n, ...) or (C, K, ...), where all were seen."""
    options = scenario.options
    if len(values) == len(scenario.images):
        return values.reshape(options.cameras, options.shots, *values.shape[1:])
    return values.reshape(options.cameras, options.shots, options.points, *values.shape[1:])


def s2_axes(scenario):
    """S2's nominal axes (rows), and which signs lead from them to body axes."""
    d = grid(scenario, scenario.true_images.position) - scenario.pair.aim_point
    flip = np.array([1.0, 1.0, 1.0] if scenario.options.leader == 1 else [-1.0, -1.0, 1.0])
    return d, s2_scene.camera_axes(*d), flip


def errors_per_shot(scenario, given_axes=None):
    """S2's angles (2, K, 3) that the true attitudes hold, taken out of Q = A_z A_y A_x by its elements."""
    _, axes, flip = s2_axes(scenario)
    body = grid(scenario, scenario.true_images.world_from_body.as_matrix())
    out = []
    for own, nominal in zip(body, axes if given_axes is None else given_axes, strict=True):
        q = np.swapaxes(own * flip, 1, 2) @ np.swapaxes(nominal, 1, 2)
        out.append(
            np.stack(
                [
                    np.arctan2(q[:, 2, 1], q[:, 2, 2]),
                    -np.arcsin(q[:, 2, 0]),
                    np.arctan2(q[:, 1, 0], q[:, 0, 0]),
                ],
                axis=-1,
            )
        )
    return np.stack(out)


@pytest.mark.parametrize("leader", [1, 2])
def test_pixels_are_those_of_s2_equation_3(leader):
    # errors a thousand times S2's: what is linear in them would be wrong by 60 px
    w = np.array([[0.17, -0.12, 0.15], [-0.1, 0.14, 0.2]]) * 0.1
    scenario = stereo_case(
        CASE, 1, **QUIET, leader=leader, angles=tuple(map(tuple, w)), columns=2000, fov=0.1
    )
    d, axes, flip = s2_axes(scenario)
    points = scenario.points - scenario.pair.aim_point
    detector = scenario.detectors[0]
    expected = [
        s2_scene.pixels(
            flip[0] * s2_scene.project(w[j], axes[j][:, None], d[j][:, None], points),
            detector.focal_length_px,
            detector.principal_point_px,
        )
        for j in range(2)
    ]
    assert len(scenario.tracks) == 2 * 6 * 40
    # 6e6 m carry 1e-9 m of rounding: 1e-10 of tangent, some 1e-6 px
    np.testing.assert_allclose(grid(scenario, scenario.tracks.pixels), expected, atol=1e-5)
    np.testing.assert_array_equal(scenario.true_pixels, scenario.tracks.pixels)


@pytest.mark.parametrize("leader", [1, 2])
def test_our_angles_are_the_rotation_vector_of_s2s_error_reversed(leader):
    scenario = stereo_case(CASE, 1, **QUIET, leader=leader)
    w = scenario.s2_angles
    np.testing.assert_allclose(w, 36.0 * ARCSEC * np.array([[1, -1, 1], [-1, 1, 1]]))
    flip = np.array([1.0, 1.0, 1.0] if leader == 1 else [-1.0, -1.0, 1.0])
    exact = flip[:, None] * np.swapaxes(s2_scene.error_matrix(w), 1, 2) * flip
    np.testing.assert_allclose(Rotation.from_rotvec(scenario.angles.copy()).as_matrix(), exact, atol=1e-15)
    # second order: products of two of the angles, 3e-8 rad
    assert 0.0 < np.abs(scenario.angles + flip * w).max() < (36.0 * ARCSEC) ** 2
    # actual = planned * rotation by the angles
    planned, actual = scenario.images.world_from_body, scenario.true_images.world_from_body
    turned = planned * Rotation.from_rotvec(np.repeat(scenario.angles, 6, axis=0))
    assert (turned.inv() * actual).magnitude().max() < 1e-12
    body_x = planned.as_matrix()[:, :, 0]
    forward = np.diff(scenario.true_images.position, axis=0)[[0, 1, 2, 3, 4, 4, 6, 7, 8, 9, 10, 10]]
    assert (np.einsum("ni,ni->n", body_x, forward) > 0.0).all()


def test_white_jitter_is_added_to_s2s_angles():
    scenario = stereo_case(CASE, 2, shots=400, points=5)
    jitter = errors_per_shot(scenario) - scenario.s2_angles[:, None]
    # 2400 draws: relative sd of a standard deviation 1.4 %; correlations 1/sqrt(400) = 5 %
    assert jitter.std() == pytest.approx(1.8 * ARCSEC, rel=0.06)
    series = jitter.transpose(0, 2, 1).reshape(6, 400)
    apart = np.corrcoef(series)[~np.eye(6, dtype=bool)]
    assert np.abs(apart).max() < 0.2
    assert abs(np.corrcoef(series[:, 1:].ravel(), series[:, :-1].ravel())[0, 1]) < 0.1


@pytest.mark.parametrize("shared", [False, True])
def test_a_mirror_that_swings_has_one_frequency_and_the_rms_given(shared):
    frequency = 0.11
    scenario = stereo_case(
        CASE, 2, shots=200, points=5, jitter="harmonic", jitter_frequency=frequency, jitter_shared=shared,
        window=100.0,
    )  # fmt: skip
    jitter = errors_per_shot(scenario) - scenario.s2_angles[:, None]
    t = grid(scenario, scenario.images.t)[0]
    phase = 2.0 * np.pi * frequency * t
    basis = np.stack([np.sin(phase), np.cos(phase)], axis=1)
    series = jitter.transpose(1, 0, 2).reshape(200, 6)
    fitted, *_ = np.linalg.lstsq(basis, series, rcond=None)
    # angles taken out of matrices of numbers near 1: 1e-12 rad or so
    np.testing.assert_allclose(basis @ fitted, series, atol=1e-11)
    np.testing.assert_allclose(np.hypot(*fitted), np.sqrt(2.0) * 1.8 * ARCSEC, rtol=1e-5)
    same = np.abs(jitter[0] - jitter[1]).max() < 1e-11
    assert same == shared


def test_noise_has_the_size_that_is_given():
    scenario = stereo_case(CASE, 3, shots=64, points=100)
    moved = scenario.images.position - scenario.true_images.position
    # 384 numbers: relative sd 3.6 %; 25 600 pixels: 0.45 %; four of each
    assert moved.std() == pytest.approx(7.5, rel=0.15)
    assert (scenario.tracks.pixels - scenario.true_pixels).std() == pytest.approx(0.1, rel=0.02)
    assert scenario.noise.position == 7.5 and scenario.noise.aim_point is None
    np.testing.assert_array_equal(scenario.tracks.sigma_px, 0.1)
    # independent: the given attitudes are those of the true positions
    _, axes, _ = s2_axes(scenario)
    given = grid(scenario, scenario.images.world_from_body.as_matrix())
    np.testing.assert_allclose(np.swapaxes(given, 2, 3), axes, atol=1e-12)
    louder = stereo_case(CASE, 3, shots=64, points=100, noise_scale=2.0)
    np.testing.assert_allclose(louder.images.position - louder.true_images.position, 2.0 * moved, atol=1e-6)
    assert louder.noise.position == 7.5


def test_attitudes_from_positions_are_rebuilt_from_the_noisy_ones():
    scenario = stereo_case(CASE, 3, **SMALL, attitude_knowledge="from-position", sigma_attitude=0.0)
    np.testing.assert_allclose(
        errors_per_shot(scenario), np.repeat(scenario.s2_angles[:, None], 6, axis=1), atol=1e-12
    )
    d = grid(scenario, scenario.images.position) - scenario.pair.aim_point
    given = grid(scenario, scenario.images.world_from_body.as_matrix())
    np.testing.assert_allclose(np.swapaxes(given, 2, 3), s2_scene.camera_axes(*d), atol=1e-12)
    aimed = scenario.true_images.position - scenario.images.position
    assert np.abs(aimed).max() > 1.0
    np.testing.assert_array_equal(scenario.noise.aim_point, scenario.pair.aim_point)


def test_the_same_seed_gives_the_same_pass_and_another_seed_another():
    case = {**SMALL, "mismatch_share": 0.2, "match_share": 0.8, "dem_sigma": 5.0}
    first, again, other = (stereo_case("A_random_relief_400", seed, **case) for seed in (7, 7, 8))
    for name in ("points", "angles", "displacement"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    np.testing.assert_array_equal(first.tracks.pixels, again.tracks.pixels)
    np.testing.assert_array_equal(first.images.position, again.images.position)
    np.testing.assert_array_equal(
        first.images.world_from_body.as_quat(), again.images.world_from_body.as_quat()
    )
    assert np.abs(first.points - other.points).max() > 100.0
    fixed = [stereo_case(CASE, seed, **SMALL) for seed in (7, 8)]
    np.testing.assert_array_equal(fixed[0].points, fixed[1].points)
    np.testing.assert_array_equal(fixed[0].angles, fixed[1].angles)
    assert (fixed[0].tracks.pixels != fixed[1].tracks.pixels).all()


def test_mismatches_leave_the_rest_as_it_was_and_lie_evenly_in_their_ring():
    clean = stereo_case(CASE, 4, shots=64, points=200)
    wrong = stereo_case(CASE, 4, shots=64, points=200, mismatch_share=0.05)
    bad = wrong.mismatched
    np.testing.assert_array_equal(wrong.tracks.pixels[~bad], clean.tracks.pixels[~bad])
    np.testing.assert_allclose(wrong.tracks.pixels - wrong.displacement, clean.tracks.pixels, atol=1e-9)
    # 12 800 matches: 640 +- 25 wrong, in one image each, as often the first as the second
    by_camera = grid(wrong, bad)
    assert abs(bad.sum() - 640) < 100 and not by_camera.all(axis=0).any()
    assert abs(by_camera[0].sum() - by_camera[1].sum()) < 100
    square = (wrong.displacement[bad] ** 2).sum(axis=1)
    assert square.min() >= MISMATCH_PX[0] ** 2 and square.max() <= MISMATCH_PX[1] ** 2
    # even over the ring: squares of distances are even from 4 to 2500, sd of their mean 720 / sqrt(640)
    assert square.mean() == pytest.approx(1252.0, abs=115.0)
    # mean direction zero: sd of a component 25 / sqrt(640)
    assert np.abs(wrong.displacement[bad].mean(axis=0)).max() < 4.0


def test_a_mismatch_stays_on_the_frame():
    scenario = stereo_case(CASE, 4, shots=20, points=100, mismatch_share=0.5, columns=60, sigma_px=0.01)
    assert (scenario.tracks.pixels >= -0.5).all() and (scenario.tracks.pixels <= 59.5).all()


def test_points_are_missing_as_asked():
    scenario = stereo_case(CASE, 5, shots=40, points=200, match_share=0.7)
    seen = np.zeros((2, 40, 200), dtype=bool)
    camera, shot = (v[scenario.tracks.image] for v in (scenario.images.camera, scenario.images.shot))
    seen[camera, shot, scenario.tracks.point] = True
    np.testing.assert_array_equal(seen[0], seen[1])
    # 8000 draws of 0.7: sd 0.005
    assert seen.mean() == pytest.approx(0.7, abs=0.02)


def test_tracks_of_unequal_length_have_no_holes():
    scenario = stereo_case(CASE, 5, shots=40, points=200, track_shots=(3, 15))
    shot = scenario.images.shot[scenario.tracks.image]
    lengths = []
    for point in range(200):
        own = np.unique(shot[scenario.tracks.point == point])
        lengths.append(len(own))
        assert own[-1] - own[0] + 1 == len(own)
    assert (min(lengths), max(lengths)) == (3, 15)


def test_images_are_missing_and_sightings_stand_alone_as_asked():
    paired = stereo_case(CASE, 5, shots=40, points=50, missing_images=0.2)
    assert 40 < len(paired.images) < 80
    alone = stereo_case(CASE, 5, shots=40, points=50, missing_images=0.2, match_share=0.8, unpaired=True)
    np.testing.assert_array_equal(alone.images.shot, paired.images.shot)
    for scenario in (paired, alone):
        key = scenario.images.shot[scenario.tracks.image] * 50 + scenario.tracks.point
        counts = np.unique(key, return_counts=True)[1]
        assert set(counts) == ({2} if scenario is paired else {1, 2})


def test_points_outside_the_frame_are_not_seen():
    narrow = stereo_case(CASE, 5, **SMALL, fov=np.radians(0.8))
    assert 0 < len(narrow.tracks) < 2 * 6 * 40
    # half the field, 0.4 degrees, is 3.5 km at 500 km: where the camera stands highest the far ones are lost
    assert (np.abs(narrow.tracks.pixels - 349.5) <= 350.0).all()
    with pytest.raises(GeometryError, match="no point is seen"):
        stereo_case(CASE, 5, shots=2, points=2, fov=1e-4)


@pytest.mark.parametrize("relief", ["smooth", "spectrum"])
@pytest.mark.parametrize("earth", ["sphere", "wgs84"])
def test_points_lie_on_the_ground_which_has_the_range_asked_for(relief, earth):
    scenario = stereo_case(CASE, 6, shots=2, points=500, relief=relief, relief_range=300.0, earth=earth)
    radii = (6371000.0, 6371000.0) if earth == "sphere" else WGS84
    assert isinstance(scenario.surface, Dem) and scenario.pair.radii == radii
    height = to_geodetic(scenario.points, radii)[:, 2]
    np.testing.assert_allclose(height, scenario.surface.height_at(scenario.points), atol=1e-6)
    # 500 points find most of the range from -150 to 150 m
    assert -150.1 < height.min() < -100.0 and 100.0 < height.max() < 150.1
    local = (scenario.points - scenario.pair.aim_point) @ scenario.pair.world_from_local.as_matrix()
    assert np.abs(local[:, :2]).max() < 5505.0
    # even over the square: sd of a side's mean 11000 / sqrt(12 x 500) = 142 m
    assert np.abs(local[:, :2].mean(axis=0)).max() < 600.0 and local[:, :2].std() == pytest.approx(
        3175, rel=0.1
    )


def test_smooth_relief_has_periods_of_4_to_12_km():
    dem = stereo_case(CASE, 6, shots=2, points=5, ground_size=48e3).surface
    heights = dem.heights * np.hanning(len(dem.heights))[:, None] * np.hanning(dem.heights.shape[1])
    power = np.abs(np.fft.fft2(heights)) ** 2
    # degrees of latitude and longitude both step by 60 m at the aim point; the window blurs by 1 / 24 km
    f = np.fft.fftfreq(len(power), 60.0)
    period = 1.0 / np.maximum(np.hypot(f[:, None], f), 1e-9)
    inside = (period > 3.4e3) & (period < 25e3)
    assert power[inside].sum() > 0.99 * power.sum()


def test_white_relief_has_no_dem_and_flat_ground_no_height():
    white = stereo_case(CASE, 6, shots=2, points=500, relief="white", relief_range=300.0)
    assert isinstance(white.surface, Ellipsoid)
    height = to_geodetic(white.points, white.pair.radii)[:, 2]
    # even from -150 to 150 m: sd 300 / sqrt(12), known to 2 % from 500
    assert height.std() == pytest.approx(86.6, rel=0.08) and np.abs(height).max() <= 150.0
    flat = stereo_case(CASE, 6, shots=2, points=50, relief="none")
    np.testing.assert_allclose(to_geodetic(flat.points, flat.pair.radii)[:, 2], 0.0, atol=1e-6)


def test_real_relief_is_laid_under_the_aim_point(real_data, monkeypatch):
    folder = real_data("srtm_n44e005")
    monkeypatch.setenv("SIGHTLINE_DATA", str(folder.parent))
    tile = stereo_case(CASE, 6, shots=2, points=50, relief="dem")
    assert 500.0 < np.ptp(tile.surface.heights) < 2000.0  # Mont Ventoux rises 1500 m over its foot
    raw = str(folder / "N44E005.hgt")
    with pytest.raises(InputError, match="has voids"):
        stereo_case(CASE, 6, relief="dem", dem_file=raw)
    with pytest.raises(InputError, match="are needed; give a larger raster"):
        stereo_case(CASE, 6, relief="dem", dem_file=raw, scene_size=200e3)


def test_a_raster_of_heights_lies_as_it_does_on_the_map(tmp_path):
    # 200 x 200 cells of 3 arc seconds about 30 N: rises 1 m per cell to the north, 0.5 m to the east
    row, column = np.mgrid[0:200, 0:200]
    path = tmp_path / "slope.tif"
    profile = {"driver": "GTiff", "dtype": "float64", "count": 1, "height": 200, "width": 200}
    transform = Affine(1 / 1200, 0.0, 10.0, 0.0, -1 / 1200, 30.0 + 100 / 1200)
    with rasterio.open(path, "w", crs="EPSG:4326", transform=transform, **profile) as target:
        target.write(0.5 * column - row, 1)
    scenario = stereo_case(CASE, 6, shots=2, points=50, relief="dem", dem_file=str(path), scene_size=8e3)
    local = (scenario.points - scenario.pair.aim_point) @ scenario.pair.world_from_local.as_matrix()
    height = to_geodetic(scenario.points, scenario.pair.radii)[:, 2]
    cell = np.radians(1 / 1200) * 6371000.0
    expected = local[:, 1] / cell + 0.5 * local[:, 0] / (cell * np.cos(np.radians(30.0)))
    # a cell of 93 m more or less in the middle of raster and scene
    np.testing.assert_allclose(height - expected, (height - expected).mean(), atol=0.05)
    assert abs((height - expected).mean()) < 1.5
    with pytest.raises(FormatError, match="no such file"):
        stereo_case(CASE, 6, relief="dem", dem_file=str(tmp_path / "nowhere.tif"))


def test_points_stand_off_the_dem_by_what_is_given():
    scenario = stereo_case(CASE, 7, shots=2, points=400, dem_sigma=10.0)
    height = to_geodetic(scenario.points, scenario.pair.radii)[:, 2]
    off = height - scenario.surface.height_at(scenario.points)
    # 400 draws: relative sd 3.5 %, mean 0.5 m
    assert off.std() == pytest.approx(10.0, rel=0.15) and abs(off.mean()) < 2.0
    prior = scenario.height_prior
    assert prior.sigma == 10.0 and prior.surface is scenario.surface
    assert stereo_case(CASE, 7, **SMALL).height_prior is None


def test_the_errors_drift_as_given():
    scenario = stereo_case("A_drift", 8, shots=9, points=5, noise_scale=0.0)
    t = grid(scenario, scenario.images.t)[0]
    expected = scenario.s2_angles[:, None] + scenario.s2_rates[:, None] * (t - t.mean())[:, None]
    np.testing.assert_allclose(errors_per_shot(scenario), expected, atol=1e-11)
    np.testing.assert_allclose(np.abs(scenario.s2_rates), 0.05 * ARCSEC)
    # to first order the rate of our angles is minus that of S2's; products of two angles are 2e-4 of it
    np.testing.assert_allclose(scenario.rates, -scenario.s2_rates, rtol=1e-3)


def test_a_wrong_focal_length_is_in_the_pixels_and_not_in_what_is_given():
    right, wrong = (stereo_case(CASE, 8, **QUIET, focal_error=e) for e in (0.0, 1e-3))
    np.testing.assert_allclose(wrong.tracks.pixels - 349.5, 1.001 * (right.tracks.pixels - 349.5), atol=1e-7)
    assert wrong.given_detectors[0].focal_length_px == right.detectors[0].focal_length_px
    # 1.5 degrees across 700 columns
    assert right.detectors[0].focal_length_px == pytest.approx(350.0 / np.tan(np.radians(0.75)))
    assert wrong.problem()["focal_sigma"] == (np.inf, np.inf) and right.problem()["focal_sigma"] is None


def test_a_third_camera_looks_from_between():
    scenario = stereo_case("A_three_cameras", 9, **QUIET)
    assert scenario.cameras == ("1", "2", "3") and scenario.angles.shape == (3, 3)
    assert len(scenario.tracks) == 3 * 6 * 40
    two = stereo_case(CASE, 9, **QUIET)
    outer = grid(scenario, scenario.images.position)[[0, 2]]
    np.testing.assert_allclose(outer, grid(two, two.images.position), atol=1e-6)


def test_a_problem_is_made_without_files():
    scenario = stereo_case(CASE, 9, **SMALL, match_share=0.1, dem_sigma=5.0)
    problem = StereoProblem(**scenario.problem(control_points=3, control_sigma=0.5))
    assert problem.tracks.point.max() + 1 == len(problem.point_names) < 40
    np.testing.assert_array_equal(
        problem.point_names[problem.tracks.point], scenario.tracks.point.astype(float)
    )
    known = problem.control
    names = problem.point_names[known.point].astype(int)
    off = known.position - scenario.points[names]
    assert 0.0 < np.abs(off).max() < 2.5  # nine draws of 0.5 m
    assert problem.heights.sigma == 5.0 and problem.noise.position == 7.5
    with pytest.raises(InputError, match="control points"):
        scenario.control_points(1000)


@pytest.mark.parametrize("case", list(CASE_OPTIONS))
def test_every_case_can_be_drawn_and_its_points_are_seen(case):
    scenario = stereo_case(case, 0)
    images = scenario.options.cameras * scenario.options.shots
    assert len(scenario.images) == images
    assert len(scenario.tracks) > 0.97 * images * scenario.options.points


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"relief": "hilly"}, "`relief` must be one of none, smooth"),
        ({"jitter": "pink"}, "`jitter` must be one of"),
        ({"earth": "flat"}, "`earth` must be one of"),
        ({"attitude_knowledge": "guess"}, "`attitude_knowledge`"),
        ({"signs": "minus"}, "`signs`"),
        ({"sigma_px": 0.0}, "`sigma_px` must be from 1e-06 to 100, got 0"),
        ({"sigma_position": -1.0}, "`sigma_position` must be from 0"),
        ({"sigma_attitude": float("nan")}, "`sigma_attitude` must be finite"),
        ({"shots": 0}, "`shots` must be from 1 to"),
        ({"points": 0}, "`points` must be from 1 to"),
        ({"columns": 4}, "`columns` must be from 16 to"),
        ({"lines": 4}, "`lines` must be 16 or more"),
        ({"fov": 90.0}, "`fov` must be from 1e-07 to 2.0943 rad, got 90.0; 90 degrees are 1.571 rad"),
        ({"focal_error": 1.0}, "`focal_error`"),
        ({"mismatch_share": 1.0}, "`mismatch_share`"),
        ({"match_share": 0.0}, "`match_share`"),
        ({"missing_images": -0.1}, "`missing_images`"),
        ({"missing_images": 0.9, "shots": 1, "unpaired": True}, "no image was taken"),
        ({"track_shots": (5, 3)}, "`track_shots`"),
        ({"track_shots": (1, 65)}, "`track_shots`"),
        ({"angles": ((0.0, 0.0, 0.0),)}, "`angles`"),
        ({"attitude_knowledge": "from-position", "cameras": 3}, "for two cameras"),
        ({"attitude_knowledge": "from-position", "missing_images": 0.1}, "both cameras in every shot"),
        ({"dem_file": "dem.tif"}, "`dem_file` is for relief"),
        ({"relief": "white", "dem_sigma": 1.0}, "no DEM"),
        ({"separation": 0.0}, "no baseline"),
        ({"latitude": 1.5}, "`latitude` must be below"),
        ({"latitude": 1.6}, "`latitude` must be from -1.5708 to 1.5708 rad, got 1.6"),
        ({"colour": 3}, "unknown option: colour"),
    ],
)
def test_impossible_options_are_refused(change, word):
    with pytest.raises(InputError, match=word):
        stereo_case(CASE, 0, **change)


def test_an_unknown_case_names_those_there_are():
    with pytest.raises(InputError, match="unknown case: got 'Z'; allowed are A_paper_T6_K64"):
        stereo_case("Z")
