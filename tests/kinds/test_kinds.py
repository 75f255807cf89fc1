"""Results as objects: what each shows of itself, and its folder written, opened and written again."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.io.stereo_files import scene
from tests.test_cli_layout import TEXT as INSTRUMENT
from tests.test_cli_tdi import COLUMNS
from tests.test_cli_tdi import TEXT as TDI

import sightline
from sightline.applications.detector_noise import detector_noise, plain_image_noise
from sightline.applications.frame_cube import assemble_cube
from sightline.applications.stereo_prediction import predict
from sightline.cli.main import run
from sightline.cli.score import score_folder
from sightline.geometry.spin import Spin
from sightline.geometry.surface import Infinity
from sightline.io.results.recovered import read_recovered
from sightline.kinds.kind import FILES, NAMED
from sightline.kinds.open import KINDS
from sightline.products.cube_plan import CubePlan
from sightline.products.cube_store import MemoryStore
from sightline.result import Result, makes_result, one_line

#: What "the same bits" leaves out.
TIMES = {"wall_seconds", "peak_memory_bytes", "solve_seconds"}
NAMES = (
    "recover", "register", "layout", "orient", "predict", "tdi", "georeference", "noise", "score", "cube",
    "picture", "match", "bands",
)  # fmt: skip
#: Of which no command writes a folder of their own.
WITHOUT_COMMAND = ("score", "cube", "picture")


@dataclass(frozen=True)
class Case:
    """A result by a call, and the folder that the command wrote of the same."""

    made: sightline.Result
    folder: Path
    main: str
    units: dict[str, str]
    dims: tuple[str, ...]
    options: dict[str, object] = field(default_factory=dict)


def quiet(*words: object) -> None:
    """Run a command that must succeed."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        assert run([str(word) for word in words]) == 0


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A short flight, its problem, and the poses found by call."""
    folder = tmp_path_factory.mktemp("flight")
    quiet("simulate", "frames", "--seed", "1", "--frames", "12", "--out", folder / "given")
    toml = folder / "given" / "sequence.toml"
    toml.write_text(toml.read_text() + "\n[cube]\nbands = 2\ngsd = 0.5\n")
    problem = sightline.load_sequence(toml)
    return folder, problem, sightline.georeference_sequence(problem)


@pytest.fixture(scope="module")
def case(recovery, flight, tmp_path_factory) -> Callable[[str], Case]:
    """Every case by its name, made when it is first asked for."""
    patch = pytest.MonkeyPatch()
    patch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    made: dict[str, Case] = {}

    def of(name: str) -> Case:
        if name not in made:
            made[name] = globals()[f"{name}_case"](recovery, flight, tmp_path_factory.mktemp(name))
        return made[name]

    yield of
    patch.undo()


def recover_case(recovery, flight, folder) -> Case:
    shutil.copytree(recovery.folder, folder / "out")
    text = (folder / "out" / "attitude.aem").read_text()
    dated = re.sub(r"CREATION_DATE = .*", "CREATION_DATE = 2023-11-14T22:13:20", text)
    (folder / "out" / "attitude.aem").write_text(dated)
    units = {"t": "s", "roll": "rad", "sigma_yaw": "rad", "sigma_absolute_pitch": "rad", "observed": "1"}
    return Case(recovery.result, folder / "out", "motion", units, ("t",))


def register_case(recovery, flight, folder) -> Case:
    toml = recovery.scene / "acquisition.toml"
    quiet("register", toml, "--motion", recovery.folder, "--out", folder / "out")
    acquired = sightline.load_acquisition(toml)
    found = read_recovered(recovery.folder, acquired)
    result = sightline.register_bands(
        acquired.bands, acquired.surface, found.motion, found.statics, relief=found.relief
    )
    return Case(result, folder / "out", "pairs", {"before_along": "px", "kept": "1"}, ("pair",))


def layout_case(recovery, flight, folder) -> Case:
    (folder / "instrument.toml").write_text(INSTRUMENT)
    quiet("layout", folder / "instrument.toml", "--passband", 40, 150, "--out", folder / "out", "--count", 3)
    plane = sightline.load_instrument(folder / "instrument.toml")
    result = sightline.choose_layout(plane, (40.0, 150.0), count=3)
    return Case(result, folder / "out", "layouts", {"worst_frequency": "Hz", "sigma_px": "px"}, ("rank",))


def orient_case(recovery, flight, folder) -> Case:
    path = scene(shots=6, points=20).write(folder / "given")
    quiet("orient", path, "--out", folder / "out")
    result = sightline.orient(sightline.load_stereo(path))
    return Case(result, folder / "out", "orientation", {"roll": "rad", "sigma_yaw": "rad"}, ("camera",))


def predict_case(recovery, flight, folder) -> Case:
    path = scene(shots=6, points=20).write(folder / "given")
    quiet("orient", path, "--predict", "--out", folder / "out")
    result = predict(sightline.load_stereo(path))
    return Case(result, folder / "out", "orientation", {"roll": "rad", "sigma_yaw": "rad"}, ("camera",))


def tdi_case(recovery, flight, folder) -> Case:
    (folder / "tdi.toml").write_text(TDI)
    (folder / "columns.csv").write_text(COLUMNS)
    quiet("tdi", folder / "tdi.toml", "--no-pictures", "--out", folder / "out")
    result = sightline.choose_tdi(sightline.load_tdi(folder / "tdi.toml"))
    units = {"signal": "electrons", "stages": "1", "mtf_x": "1"}
    return Case(result, folder / "out", "choice", units, ("column", "signal"), {"pictures": False})


def georeference_case(recovery, flight, folder) -> Case:
    given, _, result = flight
    quiet("georeference", given / "given" / "sequence.toml", "--out", folder / "out")
    units = {"t": "s", "x": "m", "qw": "1", "sigma_z": "m", "sigma_roll": "rad"}
    return Case(result, folder / "out", "poses", units, ("frame",))


def noise_case(recovery, flight, folder) -> Case:
    raw = np.random.default_rng(1).poisson(400.0, (600, 128)).astype(np.uint16)
    np.save(folder / "raw.npy", raw)
    quiet("noise", folder / "raw.npy", "--dark-level", 0, "--out", folder / "out")
    image = plain_image_noise("raw.npy", sightline.ArrayImage(raw), None, 0.0)
    result = detector_noise([image], stages=1)
    return Case(result, folder / "out", "columns", {"gain": "1", "offset": "DN"}, ("column",))


def match_case(recovery, flight, folder) -> Case:
    _write_bands(folder / "scene.tif")
    quiet(
        "match", folder / "scene.tif", folder / "scene.tif", "--band", 1, "--band", 2, "--out", folder / "out"
    )
    images = [sightline.load_raster(folder / "scene.tif", band) for band in (1, 2)]
    units = {"d_line": "px", "sigma_column": "px", "score": "1"}
    return Case(sightline.match_rasters(*images), folder / "out", "matches", units, ("line", "column"))


def bands_case(recovery, flight, folder) -> Case:
    _write_bands(folder / "scene.tif")
    quiet("match", folder / "scene.tif", "--bands", "all", "--out", folder / "out")
    images = [sightline.load_raster(folder / "scene.tif", band) for band in (1, 2, 3)]
    result = sightline.match_bands(images, ["red", "green", "band 3"], pairs="all")
    return Case(result, folder / "out", "pairs", {"d_line": "px", "kept": "1"}, ("pair",))


def _write_bands(path: Path) -> None:
    """Three bands of one texture, each moved by a pixel more, with a place on the map."""
    import rasterio

    texture = np.random.default_rng(4).normal(size=(210, 250))
    texture = (texture[1:] + texture[:-1])[:, 1:] + (texture[1:] + texture[:-1])[:, :-1]
    with rasterio.open(
        path, "w", driver="GTiff", height=200, width=240, count=3, dtype="float32", crs="EPSG:32645",
        transform=rasterio.Affine(30.0, 0.0, 478000.0, 0.0, -30.0, 3108140.0),
    ) as target:  # fmt: skip
        for k, name in enumerate(("red", "green", None)):
            target.write(texture[k : k + 200, :240].astype(np.float32), k + 1)
            if name:
                target.set_band_description(k + 1, name)


def score_case(recovery, flight, folder) -> Case:
    result, truth = recovery.result, np.loadtxt(recovery.scene / "truth.csv", delimiter=",", skiprows=1)
    score = sightline.score_motion(
        result.motion.t, result.motion.angles, result.sigma, truth[:, 0], truth[:, 1:4], ifov=result.ifov,
        half_field_px=recovery.acquisition.half_field_px, hidden=result.hidden,
        hidden_names=result.hidden_names, absolute_sigma=result.absolute_sigma,
    )  # fmt: skip
    return Case(score, score.write(folder / "out"), "axes", {"rms": "1", "nees": "1"}, ("axis",))


def cube_case(recovery, flight, folder) -> Case:
    _, problem, found = flight
    cube = assemble_cube(problem, found, CubePlan(bands=2, gsd=0.5), MemoryStore())
    return Case(
        cube, cube.write(folder / "out"), "bands", {"wavelength_nm": "nm", "coverage": "1"}, ("name",)
    )


def picture_case(recovery, flight, folder) -> Case:
    axis, turn = np.array([1.0, 0.0, 0.0]), -0.08
    trajectory = Spin(Rotation.identity(), axis, turn).trajectory((-1.0, 3.0), np.zeros((2, 3)), (-1.0, 3.0))
    pointing = sightline.FixedMount(Rotation.identity())
    rng, frames = np.random.default_rng(2), []
    for exposure, strip in np.ndindex(4, 2):
        detector = sightline.AreaDetector("camera", (48, 90), 400.0, (20.0 * strip, 44.5))
        image = sightline.ArrayImage((100.0 + rng.normal(size=detector.shape)).astype(np.float32))
        camera = sightline.FrameCamera(detector, trajectory, pointing, 0.4 * exposure)
        frames.append(sightline.Frame(f"{exposure}-{strip}", image, camera, 0.0, exposure, strip))
    picture = sightline.frame_mosaic(
        frames, [frame.camera for frame in frames], Infinity(), names=("a", "b"), masked=False
    )
    return Case(picture, picture.write(folder / "out"), "strips", {"share_seen": "1"}, ("strip",))


def content(folder: Path) -> dict[str, bytes]:
    """Every file below a folder by its name."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def less_times(value: object) -> object:
    """A summary without what differs from run to run."""
    if isinstance(value, dict):
        return {key: less_times(item) for key, item in value.items() if key not in TIMES}
    return value


@pytest.mark.parametrize("name", NAMES)
def test_a_result_writes_the_files_of_its_command_bit_for_bit(case, name, tmp_path):
    if name in WITHOUT_COMMAND:
        return
    one = case(name)
    assert one.made.write(tmp_path / "out", **one.options) == tmp_path / "out"
    mine, theirs = content(tmp_path / "out"), content(one.folder)
    assert list(mine) == list(theirs)
    for file in set(mine) - {"summary.json", "report.html"}:
        assert mine[file] == theirs[file], file
    summaries = [json.loads(files["summary.json"]) for files in (mine, theirs)]
    if name == "noise":  # arrays come from no file
        summaries[1]["inputs"] = {}
    assert less_times(summaries[0]) == less_times(summaries[1])


@pytest.mark.parametrize("name", NAMES)
def test_a_folder_that_is_opened_is_written_with_the_same_bits(case, name, tmp_path):
    one = case(name)
    opened = sightline.open_result(one.folder)
    assert type(opened) is type(one.made)
    opened.write(tmp_path / "out")
    assert content(tmp_path / "out") == content(one.folder)
    again = sightline.open_result(tmp_path / "out")
    again.write(tmp_path / "more")
    assert content(tmp_path / "more") == content(one.folder)


@pytest.mark.parametrize("name", NAMES)
def test_a_result_shows_itself_on_one_line_and_as_a_small_table(case, name):
    one = case(name)
    for result in (one.made, sightline.open_result(one.folder)):
        said = repr(result)
        assert said.startswith(f"<{type(one.made).__name__}: ") and "\n" not in said and len(said) < 400
        table = result._repr_html_()
        assert table.startswith("<table>") and table.count("<tr>") >= 2 and len(table) < 4000
        assert "<b>five</b>" not in table  # a name of the file, which is text
    assert repr(one.made) == repr(sightline.open_result(one.folder)) or name in ("register", "picture")


def test_an_earlier_result_is_known_without_the_files_of_the_other_kinds():
    assert {name: type(kind).__module__ for name, kind in NAMED.items()} == {
        name: f"sightline.kinds.{file}" for name, file in FILES.items()
    }
    assert {type(kind) for kind in NAMED.values()} == {type(kind) for kind in KINDS}


def test_no_kind_shows_itself_otherwise_and_no_fact_makes_a_long_line():
    for name, kind in NAMED.items():
        own = [vars(one) for one in next(t for t in kind.types if t.__name__ == name).__mro__]
        for method in ("__repr__", "summary", "to_dict"):
            first = next(members[method] for members in own if method in members)
            assert first is getattr(Result, method), f"{name}.{method}"
    said = one_line("LineOfSight", {f"fact {k}": "two\nlines \x1b[31m" + 1000 * "x" for k in range(20)})
    assert len(said) < 400 and said.isprintable()


@pytest.mark.parametrize("name", NAMES)
def test_the_summary_is_that_of_the_file(case, name):
    one = case(name)
    listed = json.loads((one.folder / "summary.json").read_text())
    again = sightline.open_result(one.folder)
    assert again.to_dict() == listed and listed["result"] == type(one.made).__name__
    mine = json.loads(json.dumps(one.made.to_dict(), allow_nan=False))
    if name == "noise":
        listed["inputs"] = {}
    assert less_times(mine) == less_times(listed)
    said = again.summary()
    assert type(said) is str and [line.split()[0] for line in said.splitlines()] == list(listed)
    assert all(len(line) <= 100 + 2 + max(map(len, listed)) for line in said.splitlines())


@pytest.mark.parametrize("name", NAMES)
def test_tables_and_datasets_have_units(case, name):
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    one = case(name)
    opened = sightline.open_result(one.folder)
    for result in (one.made, opened):
        frame, dataset = result.to_pandas(), result.to_xarray()
        assert set(one.units.items()) <= set(frame.attrs["units"].items())
        assert tuple(dataset.sizes)[: len(one.dims)] == one.dims
        for column, unit in one.units.items():
            assert dataset[column].attrs["units"] == unit
        assert dataset.attrs["result"] == type(one.made).__name__
    mine, theirs = one.made.to_pandas(), opened.to_pandas()
    assert list(mine.columns) == list(theirs.columns) and len(mine) == len(theirs)
    for column in mine.columns:
        if name == "picture":  # its file is cut to what every strip saw
            continue
        if mine[column].dtype.kind == "f":  # files have nine digits
            np.testing.assert_allclose(mine[column], theirs[column], rtol=1e-8, atol=1e-15)
        else:
            assert list(mine[column]) == list(theirs[column]), column
    with pytest.raises(
        sightline.InputError, match=f"has no table 'absent'; there are: .*{one.main}|no table"
    ):
        opened.to_pandas("absent")


@pytest.mark.parametrize("name", NAMES)
def test_every_table_of_the_command_is_a_frame(case, name):
    pytest.importorskip("pandas")
    one = case(name)
    for path in one.folder.glob("*.csv"):
        frame = sightline.open_result(one.folder).to_pandas(path.stem)
        lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
        assert len(frame) == len(lines) - (path.stem != "covariance")
        assert set(frame.attrs["units"]) <= set(frame.columns)


@pytest.mark.parametrize("name", NAMES)
def test_a_result_is_drawn_with_words_at_its_axes(case, name):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    one = case(name)
    for result in (one.made, sightline.open_result(one.folder)):
        axes = np.ravel(result.plot())
        figure = axes[0].figure
        figure.canvas.draw()
        assert all(panel.get_ylabel() or panel.get_xticklabels() for panel in axes)
        assert any(panel.has_data() for panel in axes)
        plt.close(figure)
    with pytest.raises(sightline.InputError, match="`axes` must be"):
        one.made.plot(plt.subplots(1, 7)[1])
    plt.close("all")


@pytest.mark.parametrize("name", NAMES)
def test_a_page_is_one_file(case, name, tmp_path):
    one = case(name)
    opened = sightline.open_result(one.folder)
    # pictures of a target, which the page of a fresh choice has, are tried in tests of their own
    for number, result in enumerate((opened,) if name == "tdi" else (one.made, opened)):
        page = result.report(tmp_path / f"{number}.html").read_text()
        assert page.startswith("<!doctype html>") or page.lstrip().lower().startswith("<!doctype html")
        assert "http://" not in page.replace("http://www.w3.org", "")
    with pytest.raises(sightline.InputError, match="is a folder; give the name of a file"):
        one.made.report(tmp_path)
    with pytest.raises(sightline.InputError, match="there is no folder"):
        one.made.report(tmp_path / "absent" / "page.html")


def test_a_folder_that_holds_something_is_written_on_demand_only(case, tmp_path):
    one = case("tdi")
    (tmp_path / "notes.txt").write_text("keep")
    with pytest.raises(sightline.InputError, match="give overwrite=True to replace files") as refused:
        one.made.write(tmp_path)
    assert "--" not in str(refused.value)
    one.made.write(tmp_path, overwrite=True, pictures=False)
    assert (tmp_path / "notes.txt").read_text() == "keep"
    assert sightline.open_result(tmp_path).to_pandas().equals(sightline.open_result(one.folder).to_pandas())
    # what is not of the result stays behind
    sightline.open_result(tmp_path).write(tmp_path / "copy")
    assert not (tmp_path / "copy" / "notes.txt").exists()


def test_options_of_writing_are_those_of_the_command(case, tmp_path):
    one = case("register")
    one.made.write(tmp_path / "one", stack=True, pixels="float32")
    assert (tmp_path / "one" / "registered.tif").is_file()
    opened = sightline.open_result(tmp_path / "one")
    assert len(opened.after) == len(one.made.after)
    shape = opened.after[0].shape
    apart = [image.read((0, shape[0]), (0, shape[1])) for image in opened.after]
    assert not np.array_equal(apart[0], apart[1], equal_nan=True)
    for result, option in ((one.made, "frames"), (opened, "frames"), (case("tdi").made, "stack")):
        with pytest.raises(sightline.InputError, match=f"`{option}` is no option of writing"):
            result.write(tmp_path / "two", **{option: True})
    with pytest.raises(sightline.InputError, match="`stack` is for a result that was just made"):
        opened.write(tmp_path / "two", stack=True)
    assert not (tmp_path / "two").exists()
    case("georeference").made.write(tmp_path / "three", maps=False)
    assert not (tmp_path / "three" / "bands").exists()


def test_an_opened_motion_is_that_of_the_call_and_says_what_its_files_lack(recovery):
    opened, made = sightline.open_result(recovery.folder), recovery.result
    np.testing.assert_allclose(opened.motion.angles, made.motion.angles, rtol=1e-11, atol=1e-18)
    np.testing.assert_allclose(opened.sigma, made.sigma, rtol=1e-8)
    np.testing.assert_allclose(opened.hidden, made.hidden, rtol=1e-8, atol=1e-15)
    np.testing.assert_allclose(opened.differences[0].angles, made.differences[0].angles, rtol=1e-11)
    assert [s.name for s in opened.statics] == [s.name for s in made.statics]
    assert opened.hidden_names == made.hidden_names and np.array_equal(opened.observed, made.observed)
    np.testing.assert_array_equal(opened.band.band, made.band.band)
    with pytest.raises(
        AttributeError, match=f"`records` of this LineOfSight is not there: .*{recovery.folder}"
    ):
        opened.records  # noqa: B018
    with pytest.raises(AttributeError, match="has no attribute 'absent'"):
        made.absent  # noqa: B018


def test_a_large_file_is_referred_to_and_must_stay_as_it_is(case, tmp_path, monkeypatch):
    from sightline.kinds import kind

    monkeypatch.setattr(kind, "HELD", 1000)
    folder = shutil.copytree(case("register").folder, tmp_path / "one")
    opened = sightline.open_result(folder)
    assert {"PAN.tif", "report.html"} <= set(opened.origin.stamps)
    opened.write(tmp_path / "two")
    assert content(tmp_path / "two") == content(folder)
    with (folder / "PAN.tif").open("ab") as file:
        file.write(b"more")
    with pytest.raises(sightline.InputError, match=r"PAN\.tif: was changed since the result was opened"):
        opened.write(tmp_path / "three")
    (folder / "PAN.tif").unlink()
    with pytest.raises(sightline.InputError, match=r"PAN\.tif: is gone since"):
        opened.write(tmp_path / "three")
    assert not (tmp_path / "three").exists()


def test_what_is_held_outlives_the_folder(case, tmp_path):
    folder = shutil.copytree(case("orient").folder, tmp_path / "one")
    opened = sightline.open_result(folder)
    shutil.rmtree(folder)
    opened.write(tmp_path / "two")
    assert content(tmp_path / "two") == content(case("orient").folder)


def test_a_result_put_together_by_hand_cannot_be_written(recovery, tmp_path):
    from dataclasses import replace

    by_hand = replace(recovery.result, origin=None)
    assert repr(by_hand) == repr(recovery.result)
    with pytest.raises(sightline.InputError, match="how this LineOfSight was made is not known"):
        by_hand.write(tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda folder: (folder / "summary.json").unlink(), r"no result \(summary.json is missing\)"),
        (lambda folder: shutil.rmtree(folder), "there is no such folder"),
        (lambda folder: (folder / "summary.json").write_text("{}"), "`result` does not say which"),
        (lambda folder: (folder / "summary.json").write_text('{"result": "Other"}'), "is of 'Other'"),
        (lambda folder: (folder / "summary.json").write_text('{"result": ["TdiResult"]}'), "`result` is of"),
        (lambda folder: (folder / "summary.json").write_text("[1]"), "an object with named values"),
        (lambda folder: (folder / "summary.json").write_text("{"), "summary.json"),
        (
            lambda folder: (folder / "summary.json").write_text('{"result": "Registration", "files": 3}'),
            "its list of files cannot be read",
        ),
        (lambda folder: (folder / "table.bin").write_bytes(b"no table"), "table.bin"),
        (lambda folder: (folder / "table.bin").unlink(), "table.bin"),
    ],
)
def test_a_folder_that_is_no_result_is_refused_in_one_line(case, tmp_path, spoil, said):
    folder = shutil.copytree(case("tdi").folder, tmp_path / "one")
    spoil(folder)
    with pytest.raises(sightline.FormatError, match=said):
        sightline.open_result(folder)


def test_a_missing_library_is_named_with_the_way_to_get_it(case, monkeypatch):
    import sys

    for library, use in (("pandas", "to_pandas"), ("xarray", "to_xarray"), ("matplotlib", "plot")):
        monkeypatch.setitem(sys.modules, library, None)
        with pytest.raises(sightline.InputError, match=f"run `pip install {library}`"):
            getattr(case("tdi").made, use)()


def test_calls_log_their_stages_and_their_steps(tmp_path, caplog):
    path = scene(shots=4, points=16).write(tmp_path / "given")
    problem = sightline.load_stereo(path)
    with caplog.at_level(logging.INFO, "sightline"):
        sightline.orient(problem)
    assert [record.name for record in caplog.records] == ["sightline", "sightline"]
    assert caplog.messages[0] == "orient: begun" and caplog.messages[1].startswith("orient: done in ")
    seen = []

    @makes_result
    def call(progress=None):
        progress("one", 0, 2)
        progress("one", 1, 2)
        progress("two")
        return sightline.Result()

    caplog.clear()
    with caplog.at_level(logging.DEBUG, "sightline"):
        assert call(lambda *step: seen.append(step)).origin.call == "call"
    assert seen == [("one", 0, 2), ("one", 1, 2), ("two",)]
    assert [record.levelname for record in caplog.records] == [
        "INFO",
        "INFO",
        "DEBUG",
        "DEBUG",
        "INFO",
        "INFO",
    ]
    assert caplog.messages[3] == "call: one: 1 of 2"
    stages = []
    call(lambda stage: stages.append(stage))  # one that takes no steps gets none
    assert stages == ["one", "two"]
    assert any(
        isinstance(handler, logging.NullHandler) for handler in logging.getLogger("sightline").handlers
    )


def test_what_is_loaded_has_a_short_repr(recovery, flight, case):
    loaded = {
        "load_acquisition": sightline.load_acquisition(recovery.scene / "acquisition.toml"),
        "load_sequence": flight[1],
        "load_tdi": sightline.load_tdi(case("tdi").folder.parent / "tdi.toml"),
        "load_instrument": sightline.load_instrument(case("layout").folder.parent / "instrument.toml"),
        "load_stereo": sightline.load_stereo(case("orient").folder.parent / "given" / "stereo.toml"),
        "load_raster": sightline.load_raster(recovery.scene / "PAN.tif"),
    }
    assert set(loaded) == {name for name in dir(sightline) if name.startswith("load_")}
    for one in loaded.values():
        said = repr(one)
        assert said.startswith(f"<{type(one).__name__}: ") and "\n" not in said and len(said) < 400


def test_a_score_is_what_the_command_prints(case, recovery):
    printed = score_folder(recovery.folder, recovery.scene / "truth.csv")
    mine = case("score").made.to_dict()
    assert {key: mine[key] for key in ("lines", "hidden_directions_removed")} == {
        key: printed[key] for key in ("lines", "hidden_directions_removed")
    }
    assert mine["roll"]["rms"] == pytest.approx(printed["roll"]["rms"], rel=1e-6)
