from __future__ import annotations

import tomllib

import numpy as np
import pytest

from sightline.errors import FormatError, InputError
from sightline.io.scene.models import FAMILIES
from sightline.io.scene.recipe import describe_recipe, read_recipe, recipe_toml
from sightline.simulate.instruments import DetectorOptions

CASES = [(family.kind, case) for family in FAMILIES for case in family.cases]


def said(*given, kind="stereo", file=None, **flags) -> str:
    with pytest.raises((FormatError, InputError)) as caught:
        read_recipe(kind, file, given, flags)
    return str(caught.value)


@pytest.fixture
def scene(tmp_path):
    def write(text):
        path = tmp_path / "mine.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.mark.parametrize(("kind", "case"), CASES)
def test_a_recipe_reads_back_as_it_was(scene, kind, case):
    recipe = read_recipe(kind, None, (), {"case": case, "seed": 2**63 - 1})
    again = read_recipe(kind, scene(recipe_toml(recipe)))
    assert again.options == recipe.options == recipe.family.options(**recipe.family.cases[case])
    assert (again.case, again.seed, again.files) == (case, 2**63 - 1, recipe.files)
    assert recipe_toml(again) == recipe_toml(recipe)


def test_numbers_that_no_short_decimal_has_read_back_to_the_same_bits(scene):
    value = float(np.nextafter(1.0 / 3.0, 1.0))
    recipe = read_recipe("stereo", None, [f"sigma_px={value!r}", "angles=[[1e-5, -2e-6, 0], [0, 0, 1e-9]]"])
    again = read_recipe("stereo", scene(recipe_toml(recipe)))
    assert again.options.sigma_px == value
    assert again.options.angles == ((1e-5, -2e-6, 0.0), (0.0, 0.0, 1e-9))


def test_flags_and_settings_win_over_the_file(scene):
    file = scene('kind = "stereo"\nseed = 4\nshots = 7\npoints = 50\nwindow = 9.0\n')
    recipe = read_recipe("stereo", file, ["points=60"], {"shots": 9, "seed": None})
    options = recipe.options
    assert (options.shots, options.points, options.window, recipe.seed) == (9, 60, 9.0, 4)
    assert read_recipe("stereo", file, (), {"seed": 5}).seed == 5


@pytest.mark.parametrize(
    ("kind", "given", "flag", "key"),
    [
        ("stereo", "shots=8", {"shots": 8}, "shots"),
        ("line-of-sight", "lines=1e3", {"lines": 500}, "lines"),
        ("frames", "shape=100,100", {"columns": 500}, "shape"),
    ],
)
def test_a_key_given_by_a_flag_and_a_setting_is_refused(kind, given, flag, key):
    assert (
        said(given, kind=kind, **flag)
        == f"--{next(iter(flag))} and --set {key} are both given; keep one of them"
    )


def test_lists_of_lists_need_no_more_than_lists(scene):
    assert read_recipe("line-of-sight", None, ["blank=[[100, 5],[.5e3,6],]"]).options.blank == (
        (100, 5),
        (500, 6),
    )
    for wrong in ("blank=[[100, 5]", "blank=[100,50", "lags=0,.15]"):
        assert said(wrong, kind="line-of-sight").startswith(f"--set {wrong}: a bracket is not closed, or not")
    assert read_recipe("stereo", None, ["dem_file=old[1.tif", "relief=dem"]).options.dem_file == "old[1.tif"
    message = said("cloud_banks=100,50", kind="line-of-sight")
    assert "cloud_banks[1] = 100 is not allowed: a list is, as cloud_banks = [[1, 2], [3, 4]]" in message


@pytest.mark.parametrize("key", ["blank", "cloud_banks"])
def test_stretches_beyond_the_strip_are_refused_where_they_are_asked_for(scene, key):
    assert "the strip has lines 0 to 299" in said(f"{key}=[[300, 5]]", kind="line-of-sight", lines=300)
    assert read_recipe("line-of-sight", None, [f"{key}=[[299, 5]]"], {"lines": 300}).options.lines == 300
    # a scene of less lines than its case was made for is made again from its file
    less = read_recipe("line-of-sight", None, (), {"lines": 300, "case": "clouds"})
    assert read_recipe("line-of-sight", scene(recipe_toml(less))).options == less.options


def test_what_a_file_leaves_out_is_that_of_its_case(scene):
    recipe = read_recipe("stereo", scene('case = "D_paper_T6_K128"\nwindow = 50\n'))
    assert (recipe.options.shots, recipe.options.points, recipe.options.window) == (128, 200, 50.0)


def test_settings_need_no_quotation_marks_and_no_brackets():
    given = ["filter=pan", "missing=3,7-9", "water=2-4", "distortion=-.1,2e-2", "wavelengths_nm=500,600"]
    recipe = read_recipe("frames", None, [*given, "blurred=5", "dem=true", "image_format=png"])
    options = recipe.options
    assert (options.filter, options.missing, options.water) == ("pan", (3, 7, 8, 9), ((2, 4),))
    assert (options.distortion, options.wavelengths_nm) == ((-0.1, 0.02), (500.0, 600.0))
    assert options.blurred == (5,)
    assert recipe.files == {"dem": True, "image_format": "png", "truth_bands": 5}
    bands = ["names=A,B", "lags=0,.15", "gains=1,1", "gammas=1,1"]
    assert read_recipe("line-of-sight", None, bands).options.names == ("A", "B")
    # nor do numbers in brackets need what TOML asks of them
    bands[1] = "lags=[0, .15]"
    assert read_recipe("line-of-sight", None, bands).options.lags == (0.0, 0.15)


def test_the_size_of_frames_is_given_by_its_two_numbers(scene):
    assert read_recipe("frames", None, (), {"lines": 128}).options.shape == (128, 640)
    assert read_recipe("frames", None, (), {"columns": 90, "case": "small"}).options.shape == (160, 90)
    file = scene("shape = [70, 80]\n")
    assert read_recipe("frames", file, (), {"columns": 90}).options.shape == (70, 90)
    assert "'lines'; it belongs to shape = [lines, columns]" in said("lines=3", kind="frames")


def test_detectors_are_tables(scene):
    file = scene(
        'case = "staggered"\n[[detectors]]\nname = "A"\nbehind = 0\n[[detectors]]\nname = "B"\nbehind = 9.5\n'
    )
    recipe = read_recipe("line-of-sight", file)
    assert recipe.options.detectors == (DetectorOptions("A", 0.0), DetectorOptions("B", 9.5))
    assert len(tomllib.loads(recipe_toml(recipe))["detectors"]) == 2
    wrong = scene('case = "staggered"\n[[detectors]]\nname = "A"\nbehind = 0\ngian = 1.0\n')
    assert "mine.toml: unknown key 'detectors[1].gian'; did you mean gain?" in said(
        file=wrong, kind="line-of-sight"
    )


def test_a_path_in_a_file_is_relative_to_it_and_is_written_whole(scene, tmp_path, monkeypatch):
    recipe = read_recipe("stereo", scene('relief = "dem"\ndem_file = "hills.tif"\n'))
    assert recipe.options.dem_file == str(tmp_path / "hills.tif")
    monkeypatch.chdir(tmp_path)
    recipe = read_recipe("stereo", None, ["relief=dem", "dem_file=hills.tif"])
    assert recipe.options.dem_file == "hills.tif"
    assert tomllib.loads(recipe_toml(recipe))["dem_file"] == str(tmp_path / "hills.tif")


def test_rendered_frames_have_ground_far_around_unless_it_is_given():
    assert read_recipe("stereo", None, ["images=true"]).options.ground_size == 60e3
    assert read_recipe("stereo", None, ["images=true", "ground_size=2e4"]).options.ground_size == 2e4
    assert read_recipe("stereo", None).options.ground_size == 0.0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("sigma_px", "--set sigma_px: give a key and its value, as --set snr=40"),
        ("=3", "--set =3: give a key"),
        ("seed=3", "--set seed=3: seed is given by --seed"),
        ("case=A_drift", "case is given by --case"),
        ("kind=stereo", "kind is given by the word after `sightline simulate`"),
        ("sigma_pix=3", "--set: unknown key 'sigma_pix'; did you mean sigma_px?"),
        ("flight_lines=3", "'flight_lines'; it belongs to `simulate frames`, case lvf"),
        ("sigma_px=-1", "--set: sigma_px = -1 is not allowed: 1e-6 to 100 px are"),
        ("sigma_px=nan", "sigma_px = nan is not allowed"),
        ("sigma_px=small", "sigma_px = 'small' is not allowed: 1e-6 to 100 px are"),
        ("shots=2.5", "shots = 2.5 is not allowed: a whole number is"),
        ("fov=90", "fov = 90 is not allowed: 1e-7 to 2.0943 rad are; are these degrees?"),
        ("relief=hilly", "relief = 'hilly' is not known; allowed: 'none', 'smooth'"),
        (
            "track_shots=[[[[[",
            "--set track_shots=[[[[[: a bracket is not closed, or not opened",
        ),
        ("track_shots=4,2", "`track_shots` must be (fewest, most)"),
        ("unpaired=perhaps", "unpaired = 'perhaps' is not allowed"),
    ],
)
def test_a_wrong_setting_is_answered_with_what_is_allowed(given, words):
    assert words in said(given)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('kind = "frames"\n', "kind = 'frames': a scene for `sightline simulate frames`"),
        ('kind = "flights"\n', "kind = 'flights' is not known; allowed: 'stereo'"),
        ('case = "Z"\n', "unknown case: got 'Z'; allowed are A_paper_T6_K64"),
        ("shots = [3]\n", "shots = [3] is not allowed: a whole number is"),
        ("track_shots = 3\n", "track_shots = 3 is not allowed: two numbers in brackets are"),
        ('relief = "white"\ndem_sigma = 1.0\n', 'relief "white" has no DEM'),
        ("[camera]\nshape = [3, 3]\n", "looks like a file for"),
        ("shots = \n", "not valid TOML"),
    ],
)
def test_a_wrong_file_is_named_with_what_is_allowed(scene, text, words):
    message = said(file=scene(text))
    assert "mine.toml: " in message and words in message


def test_a_case_beside_a_file_of_another_is_refused(scene):
    file = scene('case = "A_drift"\n')
    assert "--case A_three_cameras: the scene of" in said(file=file, case="A_three_cameras")
    assert read_recipe("stereo", file, (), {"case": "A_drift"}).case == "A_drift"


def test_a_flag_of_another_case_is_refused_with_its_own():
    message = "--frames is not for case 'nominal'; it belongs to `simulate line-of-sight`, case frames"
    assert said(kind="line-of-sight", frames=4) == message


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["names=../a,B1,B0,B2"], "`names` must be letters, digits, - and _"),
        (["names=dem,B1,B0,B2"], "and not aux, con, dem"),
        (["names=PAN,pan,B0,B2"], "`names` must differ from each other"),
        (["gains=1,1"], "must have one entry per band"),
        (["coherence_with_first=.9,1,1,1"], "1 for the first"),
    ],
)
def test_bands_that_cannot_be_written_are_refused(given, words):
    assert words in said(*given, kind="line-of-sight")


def test_detectors_that_cannot_be_matched_are_refused(scene):
    one = '[[detectors]]\nname = "A"\nbehind = 0.0\n'
    file = scene(f'case = "staggered"\npairs = [["A", "C"]]\n{one}{one.replace("A", "B")}')
    assert "`pairs` must be of two of A, B, got A and C" in said(file=file, kind="line-of-sight")
    assert "`detectors` must hold one" in said("detectors=[]", kind="line-of-sight", case="staggered")


def test_a_recipe_is_described_by_what_differs_from_its_case():
    said = describe_recipe(read_recipe("stereo", None, ["sigma_px=.5"], {"shots": 5}))
    assert said["given"] == {"shots": 5, "sigma_px": 0.5} and said["missing"] == []
    assert (
        said["understood"][0]
        == "a scene for `sightline simulate stereo --scene`: case A_paper_T6_K64, seed 0"
    )
    assert "sigma_px = 0.5" in said["understood"]


CHOICE = "column,signal,stages,limit\n" + "".join(
    f"{k},400,{16 if k < 90 else 32},none\n" for k in range(200)
)


def test_stages_are_taken_from_a_choice(tmp_path, scene):
    path = tmp_path / "choice.csv"
    path.write_text(CHOICE)
    wanted = (16,) * 90 + (32,) * 110
    given = (f"stages={path}", "columns=200", "time_reference=first-stage")
    recipe = read_recipe("line-of-sight", None, given)
    assert recipe.options.column_stages(0).tolist() == list(wanted)
    text = 'kind = "line-of-sight"\ncolumns = 200\nstages = "choice.csv"\n'
    assert read_recipe(None, scene(text)).options.stages == wanted
    again = read_recipe(None, scene(recipe_toml(recipe)))
    assert again.options == recipe.options


def test_stretches_need_no_outer_brackets():
    for given in ("[1,2],[3,4]", "[1, 2] , [3, 4]", "[[1,2],[3,4]]", "[[1,2],[.3e1,4]]"):
        recipe = read_recipe("line-of-sight", None, [f"cloud_banks={given}"])
        assert recipe.options.cloud_banks == ((1, 2), (3, 4))


def test_what_is_neither_true_nor_false_is_answered_with_both():
    assert said("gyro=7", kind="line-of-sight") == "--set: gyro = 7 is not allowed: true or false is"
    assert said("gyro=none", kind="line-of-sight") == "--set: gyro = 'none' is not allowed: true or false is"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CHOICE.replace("\n3,400", "\n3,500"), "has stages for each of several signals"),
        (CHOICE.replace("\n3,400", "\n300,400"), "its 200 rows are of columns 0 to 300"),
        (CHOICE.replace("\n3,400,16", "\n3,400,2000"), "stages = 2000 at column 3"),
        ("column,stages\n0,16\n1,16\n", "is of 2 columns, the strip has 200; set columns = 2, or"),
    ],
)
def test_a_table_of_stages_of_another_strip_is_refused(tmp_path, text, message):
    (tmp_path / "choice.csv").write_text(text)
    told = said(f"stages={tmp_path / 'choice.csv'}", "columns=200", kind="line-of-sight")
    assert message in told
    assert "no such file" in said("stages=nowhere.csv", kind="line-of-sight")
