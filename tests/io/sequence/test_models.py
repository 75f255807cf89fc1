"""Models of other programs as rough poses: the flight they are of, wherever it lies."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.io.sequence_files import NORTH, flight

from sightline.errors import FormatError
from sightline.geometry.earth import from_geodetic, local_axes
from sightline.geometry.instrument import AreaDetector
from sightline.io.formats.colmap import write_colmap_model
from sightline.io.formats.opensfm import write_opensfm
from sightline.io.formats.reconstruction import Reconstruction
from sightline.io.sequence.describe import describe_sequence
from sightline.io.sequence.load import load_sequence, read_sequence

PLACE = (20.0, 70.0, 50.0)
#: The nominal camera over a nose to the north: lines to the north, columns to the west, looking down.
CAMERA = Rotation.from_matrix([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
WORLDS = {
    "flat": 'frame = "local"',
    "local": 'frame = "local"\norigin = [20.0, 70.0, 50.0]',
    "lonlat": 'frame = "lonlat"',
    "earth-fixed": 'frame = "earth-fixed"',
}
FORMS = ("colmap text", "colmap binary", "opensfm", "opk", "ypr")


def model_of(names, position, camera=CAMERA):
    count = len(names)
    detector = AreaDetector("camera", (24, 32), 40.0, (11.5, 15.5))
    turns = Rotation.concatenate([camera] * count)
    return Reconstruction(tuple(names), (detector,), np.zeros(count, dtype=int), position, turns)


def sequence(world="lonlat", keys="", count=6):
    """A flight of which nothing is given but what `keys` name."""
    made = flight(count)
    top = made.toml[: made.toml.index("[sequence]")]
    made.toml = made.toml.replace(top, f'frames = "frames.csv"\n{keys}').replace(
        'frame = "local"', WORLDS[world]
    )
    made.toml = made.toml.replace("height = 0.0", f"height = {0.0 if world == 'flat' else 50.0}")
    return made


def write_model(folder, form, names, place):
    """The flight north at 100 m as a model whose axes are east, north, up; what `poses` has to say."""
    folder.mkdir(parents=True, exist_ok=True)
    position = np.array([[0.0, 5.0 * k, 100.0] for k in range(len(names))])
    if form.startswith("colmap"):
        write_colmap_model(folder / "sparse", model_of(names, position), binary=form.endswith("binary"))
        row = (
            "x,y,z\n0,0,0\n" if place is None else f"longitude,latitude,height\n{','.join(map(str, place))}\n"
        )
        (folder / "sparse" / "origin.csv").write_text(row)
        return "sparse"
    if form == "opensfm":
        write_opensfm(folder / "reconstruction.json", model_of(names, position), place)
        return "reconstruction.json"
    top = "" if place is None else f"# origin = {','.join(map(str, place))}\n"
    angles, values = ("omega,phi,kappa", "0,0,180") if form == "opk" else ("yaw,pitch,roll", "0,0,0")
    rows = [f"{name},{x},{y},{z},{values}" for name, (x, y, z) in zip(names, position, strict=True)]
    (folder / f"{form}.csv").write_text("\n".join([f"{top}frame,x,y,z,{angles}", *rows]) + "\n")
    return f"{form}.csv"


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("world", WORLDS)
def test_a_model_tells_positions_and_attitudes(tmp_path, world, form):
    names = [f"images/f{k}.npy" for k in range(6)]
    name = write_model(tmp_path, form, names, None if world == "flat" else PLACE)
    path = sequence(world, f'poses = "{name}"\nposition_sigma = 0.5\nattitude_sigma = 0.002\n').write(
        tmp_path
    )
    read = read_sequence(path)
    problem = read.problem
    level, origin = Rotation.identity(), np.zeros(3)
    if world != "flat":
        level = local_axes(*np.radians(PLACE[:2]))
        origin = from_geodetic([[*np.radians(PLACE[:2]), PLACE[2]]])[0]
    local = level.inv().apply(problem.images.position - origin)
    np.testing.assert_allclose(local, [[0.0, 5.0 * k, 100.0] for k in range(6)], atol=1e-6)
    body = level.inv() * problem.images.world_from_body
    assert (body.inv() * Rotation.from_quat(NORTH)).magnitude().max() < 1e-9
    assert (problem.known.position == 0.5).all() and (problem.known.attitude == 0.002).all()
    # another program's errors are those of the whole model first of all
    assert (problem.known.position_bias, problem.known.attitude_bias) == (0.5, 0.002)
    said = " / ".join(describe_sequence(read)["understood"])
    assert "of 6 of 6 frames; its camera is not used" in said and "sigma 0.5 m" in said
    assert len(read.input_hashes()) >= 4


def test_frames_that_a_model_lacks_are_between_the_others(tmp_path):
    name = write_model(tmp_path, "opensfm", ["f0.npy", "f1.npy", "f2.npy", "other.npy"], PLACE)
    problem = load_sequence(sequence(keys=f'poses = "{name}"\n').write(tmp_path))
    assert np.isfinite(problem.known.position[:3]).all() and np.isinf(problem.known.position[3:]).all()
    assert np.isinf(problem.known.attitude[3:]).all()
    assert (problem.known.position[:3] == 5.0).all() and (problem.known.attitude[:3] == 0.035).all()
    steps = np.linalg.norm(np.diff(problem.images.position, axis=0), axis=1)
    np.testing.assert_allclose(steps, 5.0, atol=1e-6)
    assert any("of 3 of 6 frames" in words for words in problem.warnings)


def test_a_local_world_lends_a_model_its_origin(tmp_path):
    name = write_model(tmp_path, "ypr", list("012345"), None)
    problem = load_sequence(sequence("local", f'poses = "{name}"\n').write(tmp_path))
    origin = from_geodetic([[*np.radians(PLACE[:2]), PLACE[2]]])[0]
    assert np.linalg.norm(problem.images.position[0] - origin) == pytest.approx(100.0, abs=1e-6)


def test_a_colmap_model_in_earth_fixed_coordinates(tmp_path):
    level = local_axes(*np.radians(PLACE[:2]))
    origin = from_geodetic([[*np.radians(PLACE[:2]), PLACE[2]]])[0]
    fixed = origin + level.apply([[0.0, 5.0 * k, 100.0] for k in range(6)])
    write_colmap_model(tmp_path / "sparse", model_of([f"f{k}.npy" for k in range(6)], fixed, level * CAMERA))
    problem = load_sequence(sequence(keys='poses = "sparse"\n').write(tmp_path))
    np.testing.assert_allclose(problem.images.position, fixed, atol=1e-6)


def test_tables_go_before_the_model(tmp_path):
    name = write_model(tmp_path, "opk", list("012345"), None)
    made = sequence("flat", f'poses = "{name}"\npositions = "positions.csv"\n')
    for row in made.positions:
        row[4] = 120.0
    problem = load_sequence(made.write(tmp_path))
    assert (problem.images.position[:, 2] == 120.0).all()
    np.testing.assert_array_equal(problem.known.position, [[1.0, 1.5, 2.0]] * 6)
    assert (problem.known.attitude == 0.035).all()
    assert (problem.known.position_bias, problem.known.attitude_bias) == (0.0, 0.035)


def without_origin(folder, name):
    (folder / name / "origin.csv").unlink()


def without_reference(folder, name):
    content = json.loads((folder / name).read_text())
    del content[0]["reference_lla"]
    (folder / name).write_text(json.dumps(content))


def nothing(folder, name):
    """As it is."""


BAD = {
    "a COLMAP model without a place": ("lonlat", "colmap text", without_origin, "does not say where it lies"),
    "the same, flat": ("flat", "colmap binary", without_origin, "x,y,z of its origin"),
    "a flat model on the Earth": (
        "lonlat",
        "colmap flat",
        nothing,
        "'longitude,latitude,height' are expected",
    ),
    "OpenSfM without reference": ("lonlat", "opensfm", without_reference, "reference_lla"),
    "a placed model in a flat world": ("flat", "opensfm", nothing, r"give \[world\] origin = \[20, 70, 50\]"),
    "no model": ("lonlat", "none", nothing, "poses: .*: no such file"),
    "an empty folder": ("lonlat", "empty", nothing, "no COLMAP model"),
    "quaternions": ("flat", "quaternions", nothing, "as positions and as attitudes"),
    "other names": ("lonlat", "names", nothing, "no row is of a frame"),
    "nothing left to add": ("lonlat", "both", nothing, "poses would add nothing"),
}


@pytest.mark.parametrize("case", BAD)
def test_models_that_cannot_be_used_are_reported(tmp_path, case):
    world, form, spoil, words = BAD[case]
    keys = ""
    if form in FORMS:
        name = write_model(tmp_path, form, [f"f{k}.npy" for k in range(6)], PLACE)
        spoil(tmp_path, name)
    elif form == "colmap flat":
        name = write_model(tmp_path, "colmap text", [f"f{k}.npy" for k in range(6)], None)
    elif form == "names":
        name = write_model(tmp_path, "opensfm", [f"IMG_{k}.jpg" for k in range(6)], PLACE)
    else:
        name = {"none": "nope", "empty": "folder", "quaternions": "attitudes.csv", "both": "sparse"}[form]
        (tmp_path / "folder").mkdir()
        keys = 'positions = "positions.csv"\nattitudes = "attitudes.csv"\n' if form == "both" else ""
    with pytest.raises(FormatError, match=words) as raised:
        load_sequence(sequence(world, f'poses = "{name}"\n{keys}').write(tmp_path))
    assert str(tmp_path) in str(raised.value)
