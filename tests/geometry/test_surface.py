"""Where rays meet planes, ellipsoids and grids of heights: against pyproj, scipy and brute force."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pyproj import CRS, Transformer
from scipy.interpolate import RegularGridInterpolator

from sightline.errors import InputError
from sightline.geometry.earth import WGS84, from_geodetic, local_axes, to_geodetic
from sightline.geometry.surface import Dem, Ellipsoid, Infinity, Plane

STEP = 30.0
X, Y = STEP * np.arange(120.0), STEP * np.arange(100.0)
RIDGES = 300.0 + 150.0 * np.sin(X[np.newaxis] / 200.0) * np.cos(Y[:, np.newaxis] / 160.0)
NORTH_UP = (STEP, 0.0, X[0] - STEP / 2, 0.0, -STEP, Y[-1] + STEP / 2)


def local_dem(**options) -> Dem:
    """Ridges of +-150 m, 120 x 100 nodes of 30 m, first node row in the north."""
    return Dem(options.pop("heights", RIDGES[::-1]), NORTH_UP, **options)


def rays_down(count: int, slant: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rays from 5 km that come down inside the grid, up to `slant` (tangent) off the vertical."""
    rng = np.random.default_rng(seed)
    aim = np.stack(
        [rng.uniform(900, 2600, count), rng.uniform(900, 2000, count), np.full(count, 300.0)], axis=1
    )
    lean = rng.uniform(-slant, slant, (count, 2))
    directions = np.concatenate([lean, -np.ones((count, 1))], axis=1)
    directions /= np.sqrt((directions**2).sum(axis=1, keepdims=True))
    return aim - directions * (4700.0 / -directions[:, 2:]), directions


class TestPlane:
    def test_a_ray_that_runs_away_or_along_misses(self):
        hits = Plane().intersect([[0, 0, 10.0]] * 3, [[0, 0, 1.0], [1.0, 0, 0], [np.nan, 0, 0]])
        assert np.isnan(hits).all()

    def test_raised_moves_the_plane_up(self):
        assert Plane(5.0).raised(2.5).intersect([[0, 0, 10.0]], [[0, 0, -1.0]])[0, 2] == 7.5

    def test_origins_and_directions_must_pair(self):
        with pytest.raises(InputError, match="as many rows, got 1 and 2"):
            Plane().intersect([[0, 0, 1.0]], [[0, 0, -1.0]] * 2)


class TestEllipsoid:
    @pytest.mark.parametrize("height", [0.0, 8848.0, -400.0])
    @pytest.mark.parametrize("radii", [WGS84, (3396190.0, 3376200.0)])
    def test_hits_lie_on_the_ray_at_the_geodetic_height(self, height, radii):
        """pyproj's forward conversion of their place at that height gives them back, within 1e-8 m: rounding
        at 7e6 m. (Its inverse is a single step, off by 8 um at 9 km.)"""
        rng = np.random.default_rng(0)
        origins = from_geodetic(
            np.stack([rng.uniform(-3, 3, 200), rng.uniform(-1.5, 1.5, 200), np.full(200, 5e5)], axis=1), radii
        )
        down = -origins / np.sqrt((origins**2).sum(axis=1, keepdims=True))
        directions = down + rng.uniform(-0.3, 0.3, (200, 3))
        directions /= np.sqrt((directions**2).sum(axis=1, keepdims=True))
        hits = Ellipsoid(*radii, height).intersect(origins, directions)
        assert_allclose(np.cross(hits - origins, directions), 0.0, atol=1e-8)
        geocentric = CRS.from_dict({"proj": "geocent", "a": radii[0], "b": radii[1]})
        geographic = CRS.from_dict({"proj": "longlat", "a": radii[0], "b": radii[1]}).to_3d()
        lon, lat, _ = to_geodetic(hits, radii).T
        again = Transformer.from_crs(geographic, geocentric).transform(
            np.rad2deg(lon), np.rad2deg(lat), np.full(200, height)
        )
        assert_allclose(np.transpose(again), hits, rtol=0, atol=1e-8)

    def test_the_near_side_is_met_not_the_far_one(self):
        hit = Ellipsoid().intersect([[7e6, 0, 0]], [[-1.0, 0, 0]])
        assert_allclose(hit, [[WGS84[0], 0, 0]])

    def test_a_ray_past_the_limb_or_away_misses(self):
        hits = Ellipsoid(height=100.0).intersect([[7e6, 0, 0]] * 2, [[0, 1.0, 0], [1.0, 0, 0]])
        assert np.isnan(hits).all()

    def test_kilometres_are_refused(self):
        with pytest.raises(InputError, match="`radii` must be"):
            Ellipsoid(6378137.0, 6356.7)


class TestInfinity:
    def test_the_position_of_the_camera_does_not_matter(self):
        sky = Infinity()
        here, there = sky.intersect([[0, 0, 0], [1e7, 0, 0]], [[0, 0.6, 0.8]] * 2)
        assert_allclose(here / sky.distance, there / sky.distance, atol=1e-12)
        assert sky.raised(100.0) is sky


class TestLocalDem:
    @pytest.mark.parametrize("slant", [0.0, 0.02, 0.6, 1.5])
    def test_hits_lie_on_the_bilinear_surface_and_on_the_ray(self, slant):
        """Against scipy's own bilinear grid; 1e-8 m is where the search ends."""
        origins, directions = rays_down(500, slant)
        hits = local_dem().intersect(origins, directions)
        expected = RegularGridInterpolator((Y, X), RIDGES)(hits[:, 1::-1])
        assert_allclose(hits[:, 2], expected, rtol=0, atol=1e-8)
        assert_allclose(np.cross(hits - origins, directions), 0.0, atol=1e-8)

    def test_the_first_meeting_counts_when_a_ridge_hides_the_ground_behind(self):
        """Brute force: the surface sampled every 0.25 m along grazing rays."""
        origins, directions = rays_down(60, 3.0, seed=1)
        hits = local_dem().intersect(origins, directions)
        surface = RegularGridInterpolator((Y, X), RIDGES, bounds_error=False)
        checked = 0
        for origin, direction, hit in zip(origins, directions, hits, strict=True):
            s = np.arange(0.0, 3 * 4700.0 * np.sqrt(19.0) / 3, 0.25)
            path = origin + s[:, None] * direction
            below = path[:, 2] < surface(path[:, 1::-1])
            if np.isfinite(hit).all():
                assert abs(s[np.argmax(below)] - (hit - origin) @ direction) < 0.25
                checked += 1
        assert checked > 40

    def test_rays_that_leave_the_grid_or_miss_it_are_nan(self):
        dem = local_dem()
        outside, away = [-100.0, 500.0, 1e3], [500.0, 500.0, 1e3]
        hits = dem.intersect([outside, away], [[0, 0, -1.0], [0, 0, 1.0]])
        assert np.isnan(hits).all()

    def test_a_void_gives_nan_and_so_does_ground_hidden_behind_it(self):
        heights = RIDGES[::-1].copy()
        heights[40:60, 50:70] = np.nan
        dem = local_dem(heights=heights)
        inside = [[X[60], Y[-1] - 50 * STEP, 2e3]]
        assert np.isnan(dem.intersect(inside, [[0, 0, -1.0]])).all()
        assert not dem.covers(inside)[0]
        assert dem.covers([[X[10], Y[10], 0.0]])[0]

    def test_a_ray_from_below_the_ground_misses(self):
        assert np.isnan(local_dem().intersect([[1500.0, 1500.0, 10.0]], [[0.1, 0, -0.995]])).all()

    def test_raised_and_geoid_lift_the_same_ground(self):
        origins, directions = rays_down(50, 0.0)
        plain = local_dem().intersect(origins, directions)[:, 2]
        lifted = local_dem().raised(30.0).intersect(origins, directions)[:, 2]
        constant = local_dem(geoid=47.5).raised(-17.5).intersect(origins, directions)[:, 2]
        table = local_dem(geoid=np.full(RIDGES.shape, 47.5)).intersect(origins, directions)[:, 2]
        assert_allclose(lifted - plain, 30.0, atol=1e-8)
        assert_allclose(constant - plain, 30.0, atol=1e-8)
        assert_allclose(table - plain, 47.5, atol=1e-8)

    def test_raising_shares_the_grid(self):
        dem = local_dem(geoid=1.0)
        dem.intersect([[0.0, 0, 1e3]], [[0, 0, -1.0]])
        assert dem.raised(1.0).ellipsoidal is dem.ellipsoidal
        assert dem.raised(1.0).height_range == pytest.approx(tuple(v + 1.0 for v in dem.height_range))

    def test_height_at_reads_the_surface_under_a_point(self):
        points = [[500.0, 700.0, 9e3], [500.0, 700.0, -50.0]]
        expected = RegularGridInterpolator((Y, X), RIDGES)([[700.0, 500.0]])
        assert_allclose(local_dem().height_at(points), np.repeat(expected, 2), atol=1e-10)

    def test_a_dem_survives_a_trip_to_another_process(self):
        dem = local_dem()
        origins, directions = rays_down(5, 0.1)
        expected = dem.intersect(origins, directions)
        again = pickle.loads(pickle.dumps(dem))
        assert_allclose(again.intersect(origins, directions), expected)
        assert not again.heights.flags.writeable

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"heights": np.zeros((1, 5))}, "2 x 2 nodes or more"),
            ({"heights": np.full((3, 3), np.nan)}, "no finite height; check the no-data value"),
            ({"heights": np.array([[0.0, np.inf], [0, 0]])}, "holds infinities"),
            ({"transform": (1.0, 0.0, 0.0)}, "six finite numbers"),
            ({"transform": (1.0, 0, 0, 1.0, 0, 0)}, "maps the grid onto a line"),
            ({"geoid": np.zeros((2, 3))}, "`geoid` must be one number or like `heights`"),
        ],
    )
    def test_impossible_grids_are_refused(self, change, message):
        parts = {"heights": np.zeros((4, 4)), "transform": NORTH_UP}
        with pytest.raises(InputError, match=message):
            Dem(**(parts | change))


def looking_down(longitude, latitude, slant, seed=0):
    """Earth-centred rays from 600 km above places (degrees) that meet the ellipsoid near them."""
    rng = np.random.default_rng(seed)
    places = np.stack([np.deg2rad(longitude), np.deg2rad(latitude), np.full(len(longitude), 1000.0)], axis=1)
    up = local_axes(places[:, 0], places[:, 1])
    lean = np.concatenate([rng.uniform(-slant, slant, (len(places), 2)), -np.ones((len(places), 1))], axis=1)
    directions = up.apply(lean / np.sqrt((lean**2).sum(axis=1, keepdims=True)))
    return from_geodetic(places) - 6e5 * directions, directions


def wavy(x, y, scale):
    """Heights (len(y), len(x)) of 1000 +- 400 m."""
    return 1000.0 + 400.0 * np.sin(x / scale)[np.newaxis] * np.cos(y / scale / 1.4)[:, np.newaxis]


class TestEarthDem:
    @pytest.mark.parametrize(
        ("crs", "longitude", "latitude", "step"),
        [
            ("EPSG:4326", 5.5, 44.5, 1 / 600),
            ("EPSG:4326", 179.9, -17.0, 1 / 600),
            ("lonlat", 5.5, 44.5, 1 / 600),
            ("EPSG:4267", -100.0, 40.0, 1 / 600),
            ("EPSG:32631", 5.5, 44.5, 150.0),
            ("EPSG:27700", -2.0, 54.0, 150.0),
            ("EPSG:3413", 30.0, 89.9, 150.0),
            ("EPSG:3031", 100.0, -80.0, 150.0),
        ],
    )
    @pytest.mark.parametrize("slant", [0.01, 0.7])
    def test_hits_have_the_height_of_the_grid_at_their_place_in_its_own_crs(
        self, crs, longitude, latitude, step, slant
    ):
        """Geographic and projected, other datums (NAD 27, OSGB 36), the date line, the pole. The place comes
        from pyproj, the height from scipy's bilinear grid; 1e-4 m is 1 cm of datum times a slope of 0.01."""
        code = "EPSG:4326" if crs == "lonlat" else crs
        to_crs = Transformer.from_crs("EPSG:4326", code, always_xy=True)
        x0, y0 = to_crs.transform(longitude, latitude)
        x, y = x0 + step * np.arange(-200, 201), y0 + step * np.arange(-150, 151)
        heights = wavy(x - x0, y - y0, 30 * step)
        transform = (step, 0.0, x[0] - step / 2, 0.0, -step, y[-1] + step / 2)
        rng = np.random.default_rng(1)
        aim_x, aim_y = x0 + step * rng.uniform(-90, 90, 300), y0 + step * rng.uniform(-90, 90, 300)
        lon, lat = to_crs.transform(aim_x, aim_y, direction="INVERSE")
        origins, directions = looking_down(lon, lat, slant)
        hits = Dem(heights[::-1], transform, crs).intersect(origins, directions)
        assert np.isfinite(hits).all()
        assert_allclose(np.cross(hits - origins, directions), 0.0, atol=1e-8)
        lon, lat, height = to_geodetic(hits).T
        place = np.stack(to_crs.transform(np.rad2deg(lon), np.rad2deg(lat)), axis=1)
        place[:, 0] += 360.0 * (place[:, 0] < x0 - 180.0) if step < 1 else 0.0
        expected = RegularGridInterpolator((y - y0, x - x0), heights)((place - [x0, y0])[:, ::-1])
        tolerance = 1e-6 if crs in ("EPSG:4326", "lonlat") or step > 1 else 1e-4
        assert_allclose(height, expected, rtol=0, atol=tolerance)

    def test_grazing_rays_meet_the_first_of_two_mountains(self):
        """From 3 km up, 1 degree below level: the ridge 40 km ahead hides the one behind it."""
        x = 5.0 + np.arange(600) / 600
        heights = np.zeros((100, 600))
        heights[:, 290:310] = heights[:, 500:520] = 2800.0
        dem = Dem(heights, (1 / 600, 0, x[0], 0, -1 / 600, 44.0 + 50 / 600), "EPSG:4326")
        here = np.array([[np.deg2rad(5.05), np.deg2rad(44.0), 3000.0]])
        east = local_axes(here[0, 0], here[0, 1]).apply([np.cos(0.0175), 0.0, -np.sin(0.0175)])
        hit = dem.intersect(from_geodetic(here), east[np.newaxis])
        lon, _, height = to_geodetic(hit)[0]
        assert x[289] < np.rad2deg(lon) < x[311] and 0 < height < 2800.0

    def test_a_body_of_another_size_needs_its_radii(self):
        with pytest.raises(InputError, match="give the radii of the body"):
            Dem(np.zeros((3, 3)), NORTH_UP, "EPSG:4326", radii=(3396190.0, 3376200.0)).covers([[3.4e6, 0, 0]])
        mars = Dem(
            np.full((3, 3), 10.0), (1.0, 0, -1.5, 0, -1.0, 1.5), "lonlat", radii=(3396190.0, 3376200.0)
        )
        hit = mars.intersect([[4e6, 0.0, 0.0]], [[-1.0, 0, 0]])
        assert_allclose(hit, [[3396200.0, 0, 0]], atol=1e-8)

    def test_a_geocentric_crs_is_no_grid(self):
        with pytest.raises(InputError, match="must be geographic or projected"):
            Dem(np.zeros((3, 3)), NORTH_UP, "EPSG:4978").covers([[6e6, 0, 0]])

    def test_real_relief_with_a_void_reads_as_in_the_file(self, real_data):
        """Mont Ventoux in a 3" tile of whole metres, first node at 45 N 5 E; one void made by hand."""
        raw = np.fromfile(real_data("srtm_n44e005") / "N44E005.hgt", ">i2").reshape(1201, 1201).astype(float)
        raw[600, 600] = np.nan
        dem = Dem(raw, (1 / 1200, 0, 5 - 1 / 2400, 0, -1 / 1200, 45 + 1 / 2400), "EPSG:4326")
        row, column = np.unravel_index(np.nanargmax(raw), raw.shape)
        top = [np.deg2rad(5 + column / 1200), np.deg2rad(45 - row / 1200), 6e5]
        void = [np.deg2rad(5.5), np.deg2rad(44.5), 6e5]
        above = from_geodetic([top, void])
        down = -local_axes(*np.array([top, void])[:, :2].T).apply([0, 0, 1.0])
        hits = to_geodetic(dem.intersect(above, down))
        assert hits[0, 2] == pytest.approx(np.nanmax(raw), abs=1e-6)
        assert np.isnan(hits[1]).all()
