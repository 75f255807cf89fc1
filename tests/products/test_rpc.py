"""Rational polynomials of a frame camera, against points on its rays placed by PROJ."""

from __future__ import annotations

import numpy as np
from pyproj import Transformer
from scipy.spatial.transform import Rotation

from sightline.geometry.camera import FrameCamera
from sightline.geometry.earth import WGS84
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.trajectory import Trajectory
from sightline.products.rpc import fit_rpc


def test_polynomials_show_points_on_the_rays_of_a_camera_where_the_camera_does():
    """A camera 600 km above 40 N 30 E, 10 degrees off the nadir; four points on each of 50 rays."""
    to_earth = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    to_places = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    position = np.array(to_earth.transform(30.0, 40.0, 600e3))
    down = -position / np.linalg.norm(position)
    east = np.cross(down, [0.0, 0.0, 1.0])
    east /= np.linalg.norm(east)
    body = Rotation.from_matrix(np.column_stack([np.cross(east, down), east, down]))
    tilted = body * Rotation.from_rotvec([np.radians(10.0), 0.05, 0.1])
    detector = AreaDetector("camera", (300, 500), 8000.0, (149.5, 249.5))
    camera = FrameCamera(detector, Trajectory([0.0], [position], [0.0], tilted), FixedMount(), 0.0)
    rpc = fit_rpc(camera, (300, 500), WGS84, (-100.0, 3000.0))

    rng = np.random.default_rng(0)
    pixels = rng.uniform([0.0, 0.0], [299.0, 499.0], (50, 2))
    rays = camera.rays(pixels)
    origins, looks = np.broadcast_to(rays.origins, (50, 3)), rays.directions
    along = np.linspace(590e3, 640e3, 2000)
    heights = np.array([to_places.transform(*(o[:, None] + d[:, None] * along))[2]
                        for o, d in zip(origins, looks, strict=True)])  # fmt: skip
    for wanted in (0.0, 900.0, 1700.0, 2900.0):
        range_m = np.array([np.interp(-wanted, -h, along) for h in heights])
        places = np.column_stack(to_places.transform(*(origins + range_m[:, None] * looks).T))
        # a frame of 5 degrees is carried by its polynomials to far below a thousandth of a pixel
        assert np.abs(rpc.project(places) - pixels).max() < 1e-3
