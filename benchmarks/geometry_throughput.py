"""Pixels per second of locate and project, on one core, and the peak memory of the run.

    python benchmarks/geometry_throughput.py [--pixels 1000000]

A pushbroom image of 12,000 lines x 6,000 columns at 680 km, with motion at every line: once over a flat
world, once from an orbit over the turning Earth, 15 degrees off nadir. Targets: locate on a plane 1e6/s, on
a DEM 3e5/s. Each figure is the best of three passes over random pixels, compilation excluded.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("NUMBA_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import resource
import time
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.earth import fixed_from_inertial, to_geodetic
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.rotations import orbital_axes
from sightline.geometry.surface import Dem, Ellipsoid, Plane
from sightline.geometry.trajectory import Motion, Trajectory

LINES, COLUMNS, IFOV, PERIOD = 12_000, 6_000, 5e-6, 5e-4


def motion() -> Motion:
    """Three tones and a drift, at every line."""
    t = PERIOD * np.arange(-40, LINES + 40)
    tones = np.stack([np.sin(2 * np.pi * f * t + f) for f in (47.0, 83.0, 121.0)], axis=1)
    return Motion(t, 1e-6 * tones + 1e-5 * np.sin(t)[:, np.newaxis])


def flat_camera() -> PushbroomCamera:
    """Level flight."""
    flight = Trajectory.level_flight(680e3, 6800.0, -1.0, 8.0).with_motion(motion())
    return PushbroomCamera(detector(), flight, FixedMount(), 0.0, LINES)


def orbit_camera() -> PushbroomCamera:
    """Polar orbit, 15 degrees off nadir; attitude at 8 Hz."""
    radius, rate, inclination = 7058e3, np.sqrt(3.986e14 / 7058e3**3), np.deg2rad(98.0)
    t = np.arange(-8.0, 16.0, 0.125)
    u = (0.75 + rate * t)[:, np.newaxis]
    across = np.array([0.0, np.cos(inclination), np.sin(inclination)])
    position, velocity = fixed_from_inertial(
        t,
        radius * (np.cos(u) * [1.0, 0, 0] + np.sin(u) * across),
        radius * rate * (-np.sin(u) * [1.0, 0, 0] + np.cos(u) * across),
        angle=0.5,
    )
    attitude = orbital_axes(position, velocity) * Rotation.from_rotvec([0.26, 0.0, 0.0])
    path = Trajectory(t, position, t, attitude, motion(), velocity=velocity)
    return PushbroomCamera(detector(), path, FixedMount(), 0.0, LINES)


def detector() -> LineDetector:
    """A row that looks ahead and is slightly turned."""
    return LineDetector.from_ifov("PAN", COLUMNS, IFOV, PERIOD, look_ahead=0.02, rotation=3e-4)


def hills(x: np.ndarray, y: np.ndarray, wavelength: float) -> np.ndarray:
    """Heights of 400 +- 400 m, first row in the north."""
    k = 2 * np.pi / wavelength
    return (400.0 + 200.0 * (np.sin(k * x)[np.newaxis] + np.cos(1.3 * k * y)[:, np.newaxis]))[::-1]


def dem_of(points: np.ndarray, crs: str | None, step: float) -> Dem:
    """A DEM that covers `points` generously."""
    x, y = points[:, 0], points[:, 1]
    if crs is not None:
        from pyproj import Transformer

        lon, lat = np.rad2deg(to_geodetic(points)[:, :2]).T
        x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon, lat)
    east = np.arange(x.min() - 50 * step, x.max() + 50 * step, step)
    north = np.arange(y.min() - 50 * step, y.max() + 50 * step, step)
    transform = (step, 0.0, east[0] - step / 2, 0.0, -step, north[-1] + step / 2)
    return Dem(hills(east, north, 60 * step), transform, crs)


def best_rate(work: Callable[[], object], count: int) -> float:
    """Items per second, best of three passes after one that compiles."""
    work()
    times = []
    for _ in range(3):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return count / min(times)


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pixels", type=int, default=1_000_000)
    count = parser.parse_args().pixels
    rng = np.random.default_rng(0)
    pixels = rng.uniform([-0.5, 0.0], [LINES - 0.5, COLUMNS - 1.0], (count, 2))

    flat, orbit = flat_camera(), orbit_camera()
    sample = pixels[:2000]
    on_plane, on_earth = flat.locate(sample, Plane()), orbit.locate(sample, Ellipsoid())
    zone = int(np.rad2deg(to_geodetic(on_earth)[0, 0]) // 6) + 31
    cases = {
        "plane": (flat, Plane()),
        "DEM, local axes, 90 m": (flat, dem_of(on_plane, None, 90.0)),
        "ellipsoid": (orbit, Ellipsoid()),
        "ellipsoid + 500 m": (orbit, Ellipsoid(height=500.0)),
        'DEM, geographic, 3"': (orbit, dem_of(on_earth, "EPSG:4326", 1 / 1200)),
        "DEM, UTM, 90 m": (orbit, dem_of(on_earth, f"EPSG:{32600 + zone}", 90.0)),
    }
    print(f"{count} pixels, one core; peak memory before {peak():.0f} MiB")
    print(f"{'surface':24}{'locate /s':>14}{'project /s':>14}{'closes to px':>14}")
    for name, (camera, surface) in cases.items():
        points = camera.locate(pixels, surface)
        located = best_rate(lambda c=camera, s=surface: c.locate(pixels, s), count)
        projected = best_rate(lambda c=camera, p=points: c.project(p), count)
        worst = np.nanmax(np.abs(camera.project(points) - pixels))
        print(f"{name:24}{located:14.3g}{projected:14.3g}{worst:14.1e}")
    for name, camera in (("level flight", flat), ("orbit", orbit)):
        turned = camera.trajectory.with_motion(camera.trajectory.motion.shifted([1e-6, 0.0, 0.0]))
        point = camera.locate([[0.0, 0.0]], Plane() if camera is flat else Ellipsoid())
        rate = best_rate(lambda c=camera, t=turned, p=point: c.with_trajectory(t).project(p), 1)
        print(f"poses of {LINES} lines, {name}: {1e3 / rate:.1f} ms")
    print(f"peak memory {peak():.0f} MiB")


def peak() -> float:
    """Peak resident memory of this process, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    main()
