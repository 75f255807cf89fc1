"""``poses.csv``, ``covariance.npz`` and their score from a folder."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.cli.main import run
from sightline.errors import FormatError, InputError
from sightline.geometry.earth import WGS84, from_geodetic, local_axes
from sightline.io.acquisition.schema import WorldSection
from sightline.io.results.poses import (
    FramePoseTable,
    PoseCovariance,
    in_table_axes,
    read_pose_covariance,
    read_pose_table,
    read_pose_truth,
    write_pose_covariance,
    write_poses,
)


def poses(count=5, seed=0):
    rng = np.random.default_rng(seed)
    quat = Rotation.from_rotvec(rng.normal(size=(count, 3))).as_quat()
    sigma = rng.uniform(0.1, 1.0, (count, 6))
    sigma[-1, 2] = np.inf
    source = ("solved", "estimated", "interpolated", "estimated", "solved")[:count]
    names = tuple(f"f{k}.tif" for k in range(count))
    return FramePoseTable(names, np.arange(count) * 0.1, rng.normal(0, 1e6, (count, 3)), quat, sigma, source)


def covariances(table):
    square, follow = np.tile(np.eye(6), (len(table), 1, 1)), np.tile(0.5 * np.eye(6), (len(table) - 1, 1, 1))
    return PoseCovariance(table.frames, square, np.arange(6.0), np.eye(6), None, follow, None, 1e-3)


def test_poses_round_trip(tmp_path):
    table = poses()
    write_poses(tmp_path / "poses.csv", table)
    header = (tmp_path / "poses.csv").read_text().splitlines()[0]
    assert header == (
        "frame,t,x,y,z,qx,qy,qz,qw,sigma_x,sigma_y,sigma_z,sigma_roll,sigma_pitch,sigma_yaw,source"
    )
    read = read_pose_table(tmp_path / "poses.csv")
    assert (read.frames, read.source) == (table.frames, table.source)
    np.testing.assert_array_equal(read.position, table.position)
    np.testing.assert_allclose(read.quat_xyzw, table.quat_xyzw, atol=1e-16)
    np.testing.assert_allclose(read.sigma, table.sigma, rtol=1e-8)
    truth = FramePoseTable(table.frames, table.t, table.position, table.quat_xyzw)
    write_poses(tmp_path / "truth.csv", truth)
    assert read_pose_truth(tmp_path / "truth.csv").sigma is None
    np.testing.assert_array_equal(read_pose_truth(tmp_path / "poses.csv").position, table.position)


def test_covariances_round_trip(tmp_path):
    given = covariances(poses())
    write_pose_covariance(tmp_path / "covariance.npz", given)
    assert [path.name for path in tmp_path.iterdir()] == ["covariance.npz"]
    read = read_pose_covariance(tmp_path / "covariance.npz")
    assert read.frames == given.frames
    for name in ("covariance", "datum", "datum_covariance", "next_covariance", "scale_sigma"):
        np.testing.assert_array_equal(getattr(read, name), getattr(given, name))


def test_covariances_of_an_earlier_version_are_read_without_those_between_frames(tmp_path):
    path = tmp_path / "covariance.npz"
    write_pose_covariance(path, covariances(poses()))
    with np.load(path) as file:
        kept = {k: file[k] for k in file.files if k not in ("next_covariance", "scale_sigma")}
    np.savez(path, **kept)
    read = read_pose_covariance(path)
    assert np.isnan(read.next_covariance).all() and read.next_covariance.shape == (4, 6, 6)
    assert np.isnan(read.scale_sigma)
    write_pose_covariance(path, read)
    assert np.isnan(read_pose_covariance(path).next_covariance).all()


def test_covariances_that_are_damaged_are_refused_by_name(tmp_path):
    path = tmp_path / "covariance.npz"
    write_pose_covariance(path, covariances(poses()))
    whole = path.read_bytes()
    negative = replace(covariances(poses()), covariance=-covariances(poses()).covariance)
    for said, content in {
        "cannot be read": whole[:300],
        "no such": None,
        "BadZipFile": b"",
        "KeyError": None,
    }.items():
        if said == "no such":
            path.unlink()
        elif said == "KeyError":
            np.savez(path, frame=np.array(["a"]))
            said = "'covariance' is missing|covariance is not a file"
        else:
            path.write_bytes(content)
        with pytest.raises(FormatError, match=rf"covariance\.npz: .*({said})"):
            read_pose_covariance(path)
    write_pose_covariance(path, negative)
    with pytest.raises(FormatError, match="holds a variance that is not above 0"):
        read_pose_covariance(path)


def test_poses_are_written_in_the_axes_of_the_world():
    origin = (11.0, 48.0, 500.0)
    world = WorldSection(frame="local", origin=origin)
    level = local_axes(*np.radians(origin[:2]))
    place = from_geodetic([[*np.radians(origin[:2]), 500.0]])[0]
    position = place + level.apply([[3.0, 4.0, 5.0]])
    attitude = level * Rotation.from_rotvec([[0.1, 0.2, 0.3]])
    covariance = np.zeros((1, 6, 6))
    covariance[0, :3, :3] = level.as_matrix() @ np.diag([1.0, 4.0, 9.0]) @ level.as_matrix().T
    covariance[0, 3:, 3:] = np.diag([0.1, 0.2, 0.3])
    moved, turned, turned_covariance = in_table_axes(world, WGS84, position, attitude, covariance)
    np.testing.assert_allclose(moved, [[3.0, 4.0, 5.0]], atol=1e-6)
    np.testing.assert_allclose(turned.as_rotvec(), [[0.1, 0.2, 0.3]], atol=1e-12)
    np.testing.assert_allclose(turned_covariance[0], np.diag([1.0, 4.0, 9.0, 0.1, 0.2, 0.3]), atol=1e-12)
    same = in_table_axes(WorldSection(frame="lonlat"), None, position, attitude, covariance)
    np.testing.assert_array_equal(same[0], position)


def test_score_of_a_folder_is_printed(tmp_path, capsys):
    table = poses()
    folder = tmp_path / "result"
    folder.mkdir()
    write_poses(folder / "poses.csv", table)
    write_pose_covariance(folder / "covariance.npz", covariances(table))
    true = FramePoseTable(
        (*table.frames[1:], "other"), table.t, np.roll(table.position, -1, axis=0) + np.array([1.0, 0, 0]),
        np.roll(table.quat_xyzw, -1, axis=0),
    )  # fmt: skip
    write_poses(tmp_path / "poses-truth.csv", true)
    assert run(["score", str(folder), str(tmp_path / "poses-truth.csv")]) == 0
    score = json.loads(capsys.readouterr().out)
    assert (score["frames"], score["not_in_truth"], score["not_in_result"]) == (4, 1, 1)
    assert score["absolute"]["x"]["rms"] == pytest.approx(1.0) and score["absolute"]["y"]["rms"] == 0.0
    assert score["absolute"]["nees"] == pytest.approx(1.0)  # 1 m of sigma 1 m, no error else
    assert score["rigid"]["x"]["rms"] == pytest.approx(0.0, abs=1e-6)
    assert set(score["by_source"]) == {"solved", "estimated", "interpolated"}


def row(number, column, value):
    def spoil(text):
        lines = [line.split(",") for line in text.splitlines()]
        lines[number][lines[0].index(column)] = value
        return "\n".join(",".join(line) for line in lines) + "\n"

    return spoil


BAD = {
    "source": (row(2, "source", "guessed"), "row 2: source = 'guessed' is not known"),
    "sigma": (row(2, "sigma_x", "-1"), "row 2 has a negative sigma"),
    "nan": (row(2, "sigma_x", "nan"), "sigma_x"),
    "quaternion": (row(3, "qw", "7"), "quaternion of length"),
    "twice": (row(3, "frame", "f0.tif"), "has 2 rows"),
    "column": (lambda text: text.replace("sigma_yaw", "sigma_z2"), "'sigma_yaw' is missing"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_poses_are_reported(tmp_path, case):
    spoil, words = BAD[case]
    path = tmp_path / "poses.csv"
    write_poses(path, poses())
    path.write_text(spoil(path.read_text()))
    with pytest.raises(FormatError, match=words):
        read_pose_table(path)


def test_bad_folders_are_reported(tmp_path, capsys):
    table = poses()
    write_poses(tmp_path / "poses.csv", table)
    assert run(["score", str(tmp_path), str(tmp_path / "none.csv")]) == 2
    assert "simulate` writes poses-truth.csv" in capsys.readouterr().err
    renamed = FramePoseTable(tuple("abcde"), table.t, table.position, table.quat_xyzw)
    write_poses(tmp_path / "truth.csv", renamed)
    assert run(["score", str(tmp_path), str(tmp_path / "truth.csv")]) == 2
    assert "no frame of" in capsys.readouterr().err
    write_pose_covariance(tmp_path / "covariance.npz", covariances(renamed))
    assert run(["score", str(tmp_path), str(tmp_path / "poses.csv")]) == 2
    assert "is of other frames" in capsys.readouterr().err
    (tmp_path / "covariance.npz").write_bytes(b"no archive")
    assert run(["score", str(tmp_path), str(tmp_path / "poses.csv")]) == 2
    assert "cannot be read as covariances" in capsys.readouterr().err


def test_tables_of_wrong_sizes_are_refused():
    table = poses()
    with pytest.raises(InputError, match="row per frame"):
        FramePoseTable(table.frames, table.t[:3], table.position, table.quat_xyzw)
    with pytest.raises(InputError, match="`source` must be one of"):
        FramePoseTable(table.frames, table.t, table.position, table.quat_xyzw, table.sigma, ("guess",) * 5)
