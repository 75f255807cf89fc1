"""Sequences as they come: frames lost, blurred, of water, far apart, turned, of two flights; wrong control.

Each is a small rendered flight, written, spoilt, read and solved. What cannot be estimated is named with the
reason, the rest is delivered, and no sigma is smaller than its error allows.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation
from tests.sequence_flights import assert_covered, errors_of

from consistency import assert_possible
from sightline.applications.sequence_poses import ESTIMATED, SOLVED, SequencePoses, georeference_sequence
from sightline.errors import EstimationError, FormatError, InputError
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.io.sequence.load import load_sequence
from sightline.photogrammetry.frame_cameras import frame_cameras
from sightline.photogrammetry.sightings import Images
from sightline.simulate.sequence import SequenceScenario, sequence_case
from sightline.simulate.sequence_files import write_sequence


def written(folder: Path, seed: int, **options) -> SequenceScenario:
    scenario = sequence_case("small", seed, **{"frames": 18, "filter": "pan", **options})
    write_sequence(scenario, folder, truth_bands=0)
    return scenario


def solved(folder: Path) -> SequencePoses:
    return georeference_sequence(load_sequence(folder / "sequence.toml"))


def test_lost_frames_are_named_with_the_reason_and_bridged(tmp_path):
    scenario = written(tmp_path, 11, frames=24, blurred=(18,), blur_px=8.0, missing=(7, 8), unreadable=(11,))
    Image.fromarray(np.zeros((50, 60), np.uint8)).save(tmp_path / "frames" / "frame-00014.tif")
    (tmp_path / "frames" / "frame-00021.tif").unlink()
    found = solved(tmp_path)
    names = [str(k) for k in scenario.frames]
    reasons = {name: why for name, why in zip(names, found.reason, strict=True) if why}
    assert set(reasons) == {"11", "14", "18", "21"}
    assert "cannot be read" in reasons["11"] and "50 lines x 60 columns" in reasons["14"]
    assert "looks like none" in reasons["18"] and "no such file" in reasons["21"]
    idle = np.array([name in reasons for name in names])
    assert (np.array(found.source) == "interpolated").tolist() == idle.tolist()
    assert any("4 of 22 frames are interpolated" in words for words in found.warnings)
    # the datum of the tables is common to all; about their neighbours' mean, lost frames are less sure
    assert_covered(scenario, found)


def test_sigmas_of_frames_without_evidence_hold_over_flights(tmp_path):
    squares = []
    for seed in range(60, 63):
        folder = tmp_path / str(seed)
        folder.mkdir()
        # tables without biases: what is left of their noise is common to all, and no more than the path's
        scenario = written(
            folder, seed, blurred=(8, 9, 10, 11), blur_px=8.0, position_bias_sigma=0.0,
            attitude_bias_sigma=0.0,
        )  # fmt: skip
        found = solved(folder)
        assert found.source[8:12] == ("interpolated",) * 4
        error, covariance = errors_of(scenario, found)[10], found.poses.covariance[10]
        squares.append(error @ np.linalg.solve(covariance, error))
    # sigmas may be larger than errors here: a path is taken to be as rough as it is at its roughest
    assert_possible(np.sum(squares), 3 * 6, chance=2e-3)


def test_water_is_bridged_with_sigmas_that_hold(tmp_path):
    scenario = written(tmp_path, 11, frames=30, water=((12, 29),))
    found = solved(tmp_path)
    assert found.source.count("interpolated") > 12
    assert all(why for why, way in zip(found.reason, found.source, strict=True) if way == "interpolated")
    assert_covered(scenario, found)


@pytest.mark.parametrize("spoilt", [{"overlap": 0.05}, {"water": ((0, 4),)}, {"blurred": tuple(range(5))}])
def test_nothing_alike_is_refused_in_words(tmp_path, spoilt):
    written(tmp_path, 12, **{"frames": 5, "blur_px": 8.0, **spoilt})
    with pytest.raises(EstimationError, match="no two frames in a row look alike; check"):
        solved(tmp_path)


def test_no_frame_that_can_be_used_is_refused_in_words(tmp_path):
    written(tmp_path, 12, frames=4, unreadable=(0, 1, 2, 3))
    with pytest.raises(FormatError, match=r"none of 4 frames can be used: .* cannot be read"):
        solved(tmp_path)


def test_a_single_frame_is_refused_in_words(tmp_path):
    written(tmp_path, 12, frames=3, unreadable=(0, 2))
    with pytest.raises(InputError, match=r"1 of 3 frames can be used: .* two or more that overlap"):
        solved(tmp_path)


def test_two_frames_are_solved_and_reported_as_weak(tmp_path):
    scenario = written(tmp_path, 12, frames=2)
    found = solved(tmp_path)
    assert found.source == ("solved", "solved")
    (words,) = [words for words in found.warnings if "very short" in words]
    assert "subset has 2 frames" in words and "degrees" in words
    assert_covered(scenario, found)
    # nothing but the tables tells places: a row's noise of 1 m and the bias of 2 m, of two frames
    options = scenario.options
    least = np.hypot(options.position_sigma / np.sqrt(2.0), options.position_bias_sigma)
    sigma = np.sqrt(np.einsum("kii->ki", found.poses.covariance))
    assert (sigma[:, 0] > 0.95 * least).all()


def test_slightly_blurred_frames_are_estimated_with_larger_sigmas(tmp_path):
    between = []
    for name, blurred in (("sharp", ()), ("soft", tuple(range(12)))):
        (tmp_path / name).mkdir()
        scenario = written(tmp_path / name, 13, frames=12, blurred=blurred, blur_px=3.0)
        found = solved(tmp_path / name)
        assert "interpolated" not in found.source
        assert_covered(scenario, found)
        between.append(np.median(found.tracks.sigma_px))
    # texture above 1 / (2 pi 3 px) is gone
    assert between[1] > 1.5 * between[0]


def test_two_flights_in_one_table_are_solved_apart_and_reported(tmp_path):
    east = 5000.0
    (tmp_path / "second").mkdir()
    flights = written(tmp_path, 21, frames=12), written(tmp_path / "second", 22, frames=12)
    for name in ("frames.csv", "positions.csv", "attitudes.csv"):
        lines = (tmp_path / name).read_text().splitlines()
        for line in (tmp_path / "second" / name).read_text().splitlines()[1:]:
            cells = line.split(",")
            cells[0], cells[1] = f"b{cells[0]}", str(float(cells[1]) + 86400.0)
            if name == "frames.csv":
                cells[2] = f"second/{cells[2]}"
            if name == "positions.csv":
                cells[2] = str(float(cells[2]) + east)
            lines.append(",".join(cells))
        (tmp_path / name).write_text("\n".join(lines) + "\n")
    found = solved(tmp_path)
    assert found.stretch.tolist() == [0] * 12 + [1] * 12
    assert any("are these 2 flights?" in words for words in found.warnings)
    reported = [
        words for words in found.warnings if "2 parts between which no window could be followed" in words
    ]
    assert len(reported) == 1 and "0 to 11 (12), b0 to b11 (12)" in reported[0]
    second = replace(found, poses=replace(found.poses, position=found.poses.position - [east, 0.0, 0.0]))
    for scenario, rows, result in ((flights[0], slice(0, 12), found), (flights[1], slice(12, 24), second)):
        error, covariance = errors_of(scenario, result, rows), found.poses.covariance[rows]
        # biases of two flights, which differ, are taken as one: up to sqrt(2) of their sigma
        assert (np.abs(error) < 3.5 * np.sqrt(2.0 * np.einsum("kii->ki", covariance))).all()


def test_frames_far_apart_are_linked_by_features(tmp_path):
    scenario = written(tmp_path, 14, frames=6, overlap=0.6, shape=(240, 320))
    found = solved(tmp_path)
    assert "interpolated" not in found.source
    assert any("found by features" in words for words in found.warnings)
    assert_covered(scenario, found)
    # neighbours are tied to a pixel, tables leave them apart by 1 m: 3 px
    error = errors_of(scenario, found)
    rays = error[:, :2] / scenario.options.gsd
    assert np.abs(np.diff(rays, axis=0)).max() < 3.0


def test_photographs_turned_since_they_were_taken_are_reported(tmp_path):
    scenario = written(tmp_path, 15, frames=14)
    for k in range(9, 14):
        path = tmp_path / "frames" / f"frame-{k:05d}.tif"
        pixels = np.array(Image.open(path))
        path.unlink()
        Image.fromarray(np.ascontiguousarray(pixels[::-1, ::-1])).save(path)
    problem = load_sequence(tmp_path / "sequence.toml")
    found = georeference_sequence(problem)
    reported = [words for words in found.warnings if "turned by 180 degrees" in words]
    assert len(reported) == 1 and reported[0].startswith("5 of 14 frames (the first: 9)")
    # pixels turned by half a turn: a camera that was turned by half a turn about its axis
    error = errors_of(scenario, found)[:9]
    assert np.abs(error[:, 3:]).max() < 0.1
    _, _, attitude = scenario.poses
    half = Rotation.from_rotvec([0.0, 0.0, np.pi])
    left = attitude[9:].inv() * found.poses.world_from_body[9:] * NADIR_MOUNT * half * NADIR_MOUNT.inv()
    assert np.abs(left.as_rotvec()).max() < 0.1


def test_positions_without_a_fix_do_not_spoil_the_rest(tmp_path):
    scenario = written(tmp_path, 16)
    toml = tmp_path / "sequence.toml"
    toml.write_text(
        toml.read_text().replace('frame = "local"', 'frame = "local"\norigin = [25.0, 60.0, 0.0]')
    )
    origin = np.array([25.0, 60.0])
    scale = np.array([1.0 / np.cos(np.radians(60.0)), 1.0]) / 111.2e3
    rows = [line.split(",") for line in (tmp_path / "positions.csv").read_text().splitlines()[1:]]
    lines = []
    for row in rows:
        lon, lat = origin + scale * np.array([float(row[2]), float(row[3])])
        name = f"frame-{int(row[0]):05d}.tif"
        lon, lat = {"5": (0.0, 0.0), "9": (-lon, lat)}.get(row[0], (lon, lat))
        lines.append(f"{name} {lon:.9f} {lat:.9f} {row[4]}")
    (tmp_path / "geo.txt").write_text("EPSG:4326\n" + "\n".join(lines) + "\n")
    toml.write_text(
        toml.read_text().replace('positions = "positions.csv"', 'geo = "geo.txt"\nposition_sigma = 1.0')
    )
    found = solved(tmp_path)
    assert any("0, 0 (no GPS fix" in words for words in found.warnings)
    assert any("wrong hemisphere" in words for words in found.warnings)
    assert found.source[5] != "interpolated" and found.source[9] != "interpolated"
    # both follow their neighbours, whose places differ from an even flight by the jitter alone (0.1 m)
    place = found.poses.position
    for k in (5, 9):
        assert np.linalg.norm(place[k] - 0.5 * (place[k - 1] + place[k + 1])) < 0.5
    assert len(found.source) == len(scenario.frames)


@pytest.fixture(scope="module")
def controlled(tmp_path_factory) -> tuple[SequenceScenario, Path]:
    """A flight with six control points on its ground, each seen in some frames."""
    folder = tmp_path_factory.mktemp("controlled")
    scenario = written(folder, 3, frames=26)
    rng = np.random.default_rng(0)
    t, position, attitude = scenario.poses
    cameras = frame_cameras(
        Images(np.zeros(26), np.arange(26), t, position, attitude), [scenario.detector], [NADIR_MOUNT]
    )
    at = np.linspace(3, 22, 6).astype(int)
    side = 0.3 * scenario.options.shape[1] * scenario.options.gsd * np.where(np.arange(6) % 2, 1.0, -1.0)
    xy = position[at, :2] + np.column_stack([np.zeros(6), side])
    relief = scenario.ground.relief
    columns = np.rint((xy[:, 0] - relief.west) / relief.posting[0]).astype(int)
    rows = np.rint((relief.north - xy[:, 1]) / relief.posting[1]).astype(int)
    true = np.column_stack([xy, relief.heights[rows, columns]])
    given = true + rng.normal(0.0, 0.1, true.shape)
    lines = ["x,y,z,sigma,image,line,column"]
    for frame in range(0, 26, 3):
        for point, pixel in zip(given, cameras[frame].project(true), strict=True):
            if (pixel > 8.0).all() and (pixel < np.array(scenario.options.shape) - 9.0).all():
                pixel = pixel + rng.normal(0.0, 0.3, 2)
                place = ",".join(f"{v:.4f}" for v in (*point, 0.1))
                lines.append(f"{place},{frame},{pixel[0]:.3f},{pixel[1]:.3f}")
    (folder / "control.csv").write_text("\n".join(lines) + "\n")
    return scenario, folder


def with_control(folder: Path, table: str) -> SequencePoses:
    toml = folder / "sequence.toml"
    problem = toml.read_text()
    spoilt = folder / "with-control.toml"
    spoilt.write_text(f'control_points = "{table}"\ncontrol_sigma_px = 0.3\n' + problem)
    return georeference_sequence(load_sequence(spoilt))


def test_control_points_tie_the_datum(controlled):
    scenario, folder = controlled
    without, found = solved(folder), with_control(folder, "control.csv")
    before, after = (np.sqrt(np.einsum("kii->ki", f.poses.covariance)).mean(axis=0) for f in (without, found))
    # biases of 2 m and 0.5 deg of the tables against points good to 0.1 m
    assert (after[:3] < 0.6 * before[:3]).all() and after[5] < 0.5 * before[5]
    assert_covered(scenario, found)
    assert not any("control point" in words for words in found.warnings)


def test_control_points_alone_tell_the_datum(controlled):
    scenario, folder = controlled
    lines = (folder / "sequence.toml").read_text().splitlines()
    kept = [line for line in lines if not line.startswith("position")]
    toml = folder / "control-alone.toml"
    toml.write_text('control_points = "control.csv"\ncontrol_sigma_px = 0.3\n' + "\n".join(kept) + "\n")
    found = georeference_sequence(load_sequence(toml))
    assert set(found.source) == {SOLVED, ESTIMATED}
    assert_covered(scenario, found)


@pytest.mark.parametrize("wrong", [0, 3])
def test_a_wrong_control_point_is_reported_and_not_used(controlled, wrong):
    scenario, folder = controlled
    lines = (folder / "control.csv").read_text().splitlines()
    points = list(dict.fromkeys(line.rsplit(",", 4)[0] for line in lines[1:]))
    # points are numbered in the order of their coordinates
    points.sort(key=lambda place: [float(v) for v in place.split(",")])
    x, rest = points[wrong].split(",", 1)
    moved = [line.replace(points[wrong], f"{float(x) + 2.0:.4f},{rest}") for line in lines]
    (folder / "wrong.csv").write_text("\n".join(moved) + "\n")
    found = with_control(folder, "wrong.csv")
    reported = [words for words in found.warnings if "control point" in words]
    assert len(reported) == 1 and f"({float(x) + 2.0:.7g}," in reported[0] and "are not used" in reported[0]
    assert_covered(scenario, found)


def test_control_points_that_contradict_each_other_are_reported(controlled):
    _, folder = controlled
    lines = (folder / "control.csv").read_text().splitlines()
    points = list(dict.fromkeys(line.rsplit(",", 4)[0] for line in lines[1:]))[:2]
    few = [lines[0]]
    for line in lines[1:]:
        if line.startswith(points[0]):
            few.append(line)
        elif line.startswith(points[1]):
            x, rest = line.split(",", 1)
            few.append(f"{float(x) + 3.0:.4f},{rest}")
    (folder / "few.csv").write_text("\n".join(few) + "\n")
    reported = [words for words in with_control(folder, "few.csv").warnings if "control point" in words]
    assert reported and all("nothing shows which control points are right" in words for words in reported)
