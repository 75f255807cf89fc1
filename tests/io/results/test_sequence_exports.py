"""Poses of a sequence as files: each read back gives the poses that went in, whatever the axes."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.io.sequence_files import flight

from sightline.geometry.earth import from_geodetic, local_axes
from sightline.io.formats.angle_tables import read_angles
from sightline.io.formats.colmap import read_colmap_model
from sightline.io.formats.odm import read_geo
from sightline.io.formats.opensfm import read_opensfm
from sightline.io.results.poses import read_pose_covariance, read_pose_table
from sightline.io.results.sequence_exports import write_pose_exports, write_sequence_poses
from sightline.io.sequence.load import load_sequence, read_sequence
from sightline.photogrammetry.flight.poses import adjust_frames
from sightline.photogrammetry.sightings import Tracks, sight_frames

SOURCE = ("solved", "estimated", "estimated", "interpolated", "estimated", "solved")
ORIGIN = (11.0, 48.0, 500.0)


@pytest.fixture(params=["flat", "about an origin"])
def adjusted(request, tmp_path):
    """A flight over flat ground, its points sighted, and its frames adjusted."""
    made = flight()
    if request.param != "flat":
        made.toml = made.toml.replace('frame = "local"', f'frame = "local"\norigin = {list(ORIGIN)}')
        made.toml = made.toml.replace("height = 0.0", "height = 500.0")
    sequence = read_sequence(made.write(tmp_path))
    problem = sequence.problem
    rng = np.random.default_rng(0)
    local = np.column_stack([rng.uniform(-30, 30, 60), rng.uniform(-20, 45, 60), np.zeros(60)])
    image, point, pixels = [], [], []
    for k in range(6):
        # lines forward (north), columns left (west), f = 40 px from 100 m up
        seen = np.column_stack([local[:, 1] - 5.0 * k, -local[:, 0]]) * 0.4 + np.array([11.5, 15.5])
        inside = np.flatnonzero((seen > 0).all(axis=1) & (seen < [23, 31]).all(axis=1))
        image += [k] * len(inside)
        point += inside.tolist()
        pixels += seen[inside].tolist()
    _, number = np.unique(point, return_inverse=True)
    noisy = np.array(pixels) + rng.normal(0.0, 0.1, (len(image), 2))
    tracks = Tracks(np.array(image), number, noisy, np.full(len(image), 0.1))
    sightings = sight_frames(problem.images, [problem.detector], [problem.mount], tracks)
    return sequence, adjust_frames(problem.images, sightings, problem.known), tracks


def test_poses_csv_is_in_the_axes_of_the_world(adjusted, tmp_path):
    sequence, poses, _ = adjusted
    write_sequence_poses(tmp_path, sequence, poses, SOURCE)
    read = read_pose_table(tmp_path / "poses.csv")
    assert read.frames == tuple("012345") and read.source == SOURCE
    level, origin = Rotation.identity(), np.zeros(3)
    if sequence.problem.radii is not None:
        level = local_axes(*np.radians(ORIGIN[:2]))
        origin = from_geodetic([[*np.radians(ORIGIN[:2]), ORIGIN[2]]])[0]
    np.testing.assert_allclose(origin + level.apply(np.array(read.position)), poses.position, atol=1e-6)
    # five sigma of the tables, their biases with them
    assert np.abs(read.position - [[0.0, 5.0 * k, 100.0] for k in range(6)]).max() < 5.0 * np.hypot(2.0, 2.0)
    covariance = read_pose_covariance(tmp_path / "covariance.npz")
    np.testing.assert_allclose(np.sqrt(np.einsum("mii->mi", covariance.covariance)), read.sigma, rtol=1e-7)
    assert covariance.datum_covariance.shape == (6, 6)
    # poses as a table of positions and attitudes: the same sequence again
    text = (tmp_path / "sequence.toml").read_text()
    (tmp_path / "again.toml").write_text(
        text.replace('"positions.csv"', '"poses.csv"').replace('"attitudes.csv"', '"poses.csv"')
    )
    again = load_sequence(tmp_path / "again.toml")
    np.testing.assert_allclose(again.images.position, poses.position, atol=1e-6)
    assert (again.images.world_from_body.inv() * poses.world_from_body).magnitude().max() < 1e-9


def test_pixels_of_a_rolling_shutter_are_exported_as_of_the_first_line(adjusted, tmp_path):
    # the formats know one pose a frame, that of its first line: where points would be seen from there
    sequence, poses, tracks = adjusted
    rolling = replace(sequence, problem=replace(sequence.problem, readout_time=0.02))
    later = replace(tracks, pixels=np.add(tracks.pixels, [1.0, 0.3]))  # raw: of lines exposed later
    write_pose_exports(tmp_path, rolling, poses, SOURCE, later)
    model = read_colmap_model(tmp_path / "colmap")
    good = ~poses.rejected & np.isfinite(poses.points[tracks.point]).all(axis=1)
    # residuals are linear in the pixels but for distortion, of which there is none
    np.testing.assert_allclose(model.pixels, tracks.pixels[good], atol=1e-4)


def test_every_export_read_back_is_the_same_flight(adjusted, tmp_path):
    sequence, poses, tracks = adjusted
    notes = write_pose_exports(tmp_path, sequence, poses, SOURCE, tracks)
    flat = sequence.problem.radii is None
    assert len(notes) == (1 if flat else 0)
    model = read_colmap_model(tmp_path / "colmap")
    other, reference = read_opensfm(tmp_path / "reconstruction.json")
    opk, ypr = read_angles(tmp_path / "opk.csv"), read_angles(tmp_path / "ypr.csv")
    place = None if flat else reference
    if place is None:
        level, origin = Rotation.identity(), np.zeros(3)
    else:
        level = local_axes(*np.radians(place[:2]))
        origin = from_geodetic([[*np.radians(place[:2]), place[2]]])[0]
    camera = poses.world_from_body * sequence.problem.mount
    text = (tmp_path / "sequence.toml").read_text()
    for name in ("opk.csv", "ypr.csv"):
        (tmp_path / "again.toml").write_text(text.replace("attitudes.csv", name))
        again = load_sequence(tmp_path / "again.toml").images.world_from_body
        assert (again.inv() * poses.world_from_body).magnitude().max() < 1e-9
    start = text.index("positions =")
    for name in ("colmap", "reconstruction.json", "opk.csv", "ypr.csv"):
        keys = f'poses = "{name}"\n' + text[text.index("[sequence]", start) :]
        if not flat:  # whatever the axes of the tables
            keys = keys.replace('frame = "local"\norigin = [11.0, 48.0, 500.0]', 'frame = "lonlat"')
        (tmp_path / "again.toml").write_text(text[:start] + keys)
        again = load_sequence(tmp_path / "again.toml").images
        np.testing.assert_allclose(again.position, poses.position, atol=1e-6)
        assert (again.world_from_body.inv() * poses.world_from_body).magnitude().max() < 1e-9
    assert reference == place and opk.origin == place and ypr.origin == place
    for position in (model.position, other.position, opk.position, ypr.position):
        np.testing.assert_allclose(origin + level.apply(np.array(position)), poses.position, atol=1e-6)
    mount = sequence.problem.mount
    for attitude in (model.world_from_camera, other.world_from_camera, opk.camera(mount), ypr.camera(mount)):
        assert ((level * attitude).inv() * camera).magnitude().max() < 1e-9
    assert len(model.points) > 20
    # every sighting is where its point projects to, without the package's projection: five sigma
    q = np.einsum(
        "nji,nj->ni",
        model.world_from_camera.as_matrix()[model.image],
        model.points[model.point] - model.position[model.image],
    )
    seen = q[:, [1, 0]] / q[:, 2:] * 40.0 + [11.5, 15.5]
    np.testing.assert_allclose(seen, model.pixels, atol=0.5)
    if flat:
        return
    geo = read_geo(tmp_path / "geo.txt")
    assert geo.names == tuple(f"f{k}.npy" for k in range(6))
    radians = np.column_stack([np.radians(geo.lonlat[:, :2]), geo.lonlat[:, 2]])
    np.testing.assert_allclose(from_geodetic(radians), poses.position, atol=1e-3)  # heights to .1 mm
    features = json.loads((tmp_path / "footprints.geojson").read_text())["features"]
    assert [f["properties"]["source"] for f in features] == list(SOURCE)
    ring = np.array(features[0]["geometry"]["coordinates"][0])
    # 24 lines of 2.5 m along the north, 111.2 km a degree (sphere; the ellipsoid's own within .5 %)
    assert np.ptp(ring[:, 1]) * 111.2e3 == pytest.approx(60.0, rel=0.01)


def test_files_of_one_name_and_names_with_spaces_stay_distinct(tmp_path):
    made = flight(3)
    made.images = {f"{k}/f.npy": content for k, content in enumerate(made.images.values())}
    made.frames = [[f"frame {k}", 0.5 * k, f"{k}/f.npy"] for k in range(3)]
    for k in range(3):
        (tmp_path / str(k)).mkdir()
        made.positions[k][0] = made.attitudes[k][0] = f"frame {k}"
    from sightline.io.results.sequence_exports import picture_names

    assert picture_names(read_sequence(made.write(tmp_path))) == ("frame_0", "frame_1", "frame_2")
