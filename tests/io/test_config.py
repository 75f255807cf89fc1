from __future__ import annotations

import json

import pytest

from sightline.errors import FormatError
from sightline.io.acquisition.load import load_acquisition, read_acquisition
from sightline.io.acquisition.schema import AcquisitionFile
from sightline.io.config import json_schema, validate
from sightline.io.stereo.schema import StereoFile
from sightline.io.tdi.schema import TdiFile


def message(folder) -> str:
    with pytest.raises(FormatError) as caught:
        read_acquisition(folder.write())
    return str(caught.value)


def test_an_unknown_key_is_named_with_the_nearest_one_and_those_allowed(folder):
    said = message(folder.replace("offset_sigma_px", "offset_sgima_px"))
    assert "acquisition.toml: unknown key 'band[1].offset_sgima_px'; did you mean offset_sigma_px?" in said
    assert "[[band]] number 1 takes: " in said and "look_ahead" in said


def test_an_unknown_key_without_a_near_one_lists_those_allowed(folder):
    said = message(folder.replace("altitude", "colour = 3\naltitude"))
    allowed = "attitude_sigma, rate_sigma, kind, altitude, ground_speed"
    assert f"unknown key 'platform.colour'; [platform] takes: {allowed}" in said


def test_a_key_of_another_kind_names_that_kind(folder):
    said = message(folder.replace('"level-flight"', '"spin"'))
    assert "'platform.altitude'; it belongs to kind = \"level-flight\"; [platform] takes: kind, pos" in said


def test_a_number_in_place_of_a_list_is_answered_with_how_a_list_is_written(folder):
    said = message(folder.replace("offset_sigma_px = 0.0", "offset_px = 0.0"))
    assert "band[1].offset_px = 0.0 is not allowed: two numbers [forward, toward larger columns] are" in said


@pytest.mark.parametrize(
    ("mask", "allowed"), [("7", "text in quotation marks is"), ('""', "text that is not empty")]
)
def test_what_is_no_text_is_answered_with_how_text_is_written(folder, mask, allowed):
    said = message(folder.replace("offset_sigma_px = 0.0", f"mask = {mask}"))
    assert "band[1].mask = " in said and f" is not allowed: {allowed}" in said


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[world]\norigin = []", "three numbers [longitude (deg), latitude (deg), height (m)] are"),
        ("[matching]\nwindow = [1, 2, 3]", "two numbers [lines, columns] are"),
        ('[matching]\npairs = ["PAN"]', 'two words in quotation marks, ["a", "b"], are'),
        ('[files]\nallow = "x"', 'a list is, its values in brackets, as ["x"]'),
        ("[files]\nallow = true", 'a list is, its values in brackets, as ["a", "b"]'),
        ("[known_motion]\ntones = 3", "a list is, its values in brackets, as [1.0, 2.0]"),
    ],
)
def test_what_is_no_list_or_one_of_another_length_is_answered_with_what_the_list_holds(folder, text, words):
    said = message(folder.add(f"{text}\n"))
    assert f"is not allowed: {words}" in said and "also missing" not in said


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("instrument", 3, "a table is, [instrument] with its keys below"),
        ("band", 3, "tables are, each headed [[band]]"),
        ("band", [3], "a table is, [[band]] with its keys below"),
    ],
)
def test_what_is_no_table_is_answered_with_one(tmp_path, key, value, words):
    platform = {"kind": "level-flight", "altitude": 7e5, "ground_speed": 7e3}
    with pytest.raises(FormatError) as caught:
        validate(AcquisitionFile, {"platform": platform, key: value}, tmp_path / "x.toml")
    assert f"is not allowed: {words}" in str(caught.value)


@pytest.mark.parametrize("value", ["1979-05-27", "07:32:00", "true"])
def test_values_are_repeated_as_the_file_has_them(folder, value):
    said = message(folder.replace('name = "strip"', f"name = {value}"))
    assert f"acquisition.name = {value} is not allowed: text in quotation marks is" in said


@pytest.mark.parametrize(
    ("key", "owners"),
    [
        ("positions", 'kind = "ephemeris" or "spin"'),
        ("epoch", "[acquisition]"),
        ("ifov", "[instrument] or [[band]]"),
        ("radii", "[surface]"),
    ],
)
def test_a_key_of_other_kinds_or_tables_names_all_of_them(folder, key, owners):
    said = message(folder.replace("altitude = 700e3", f'altitude = 700e3\n{key} = "x"'))
    assert f"'platform.{key}'; it belongs to {owners}; [platform] takes" in said


@pytest.mark.parametrize(("key", "example"), [("stages", "[8, 16, 32]"), ("integration_ratio", "[0.5, 1.0]")])
@pytest.mark.parametrize("value", [17, "x", True, None])
def test_a_grid_that_is_neither_list_nor_range_is_answered_with_both(tmp_path, key, example, value):
    grid = {"stages": [4], "integration_ratio": [1.0]} | {key: value}
    given = {"grid": grid, "columns": {"count": 4}, "signals": {"list": [10.0]}, "noise": {"read": 3.0}}
    with pytest.raises(FormatError) as caught:
        validate(TdiFile, given, tmp_path / "tdi.toml")
    assert f"is not allowed: a list is, as {example}, or a range {{ from, to, step }}" in str(caught.value)


def test_an_unknown_table_is_named_with_the_nearest_one(folder):
    assert "unknown key 'surfaces'; did you mean surface?" in message(
        folder.add("[surfaces]\nheight = 0.0\n")
    )


def test_a_value_out_of_range_is_named_with_what_is_allowed(folder):
    said = message(folder.replace("ifov = 5e-6", "ifov = -5e-6"))
    assert "instrument.ifov = -5e-06 is not allowed: 1e-10 to 0.5 are; a tangent" in said


def test_a_value_that_is_not_a_number_is_refused(folder):
    assert "platform.altitude = nan is not allowed" in message(folder.replace("700e3", "nan"))


def test_a_value_of_the_wrong_type_is_refused(folder):
    said = message(folder.replace("look_ahead = 2e-4", 'look_ahead = "2e-4 rad"'))
    assert "band[2].look_ahead = '2e-4 rad' is not allowed: a number without quotation marks is" in said


def test_a_missing_key_is_named(folder):
    assert "key 'platform.altitude' is missing" in message(folder.replace("altitude = 700e3\n", ""))


def test_an_unknown_platform_names_those_there_are(folder):
    said = message(folder.replace("level-flight", "levelflight"))
    assert "platform.kind = 'levelflight' is not known; did you mean level-flight?" in said
    assert "ephemeris, " in said and "camera-model" in said


def test_the_error_of_a_platform_without_a_kind_asks_for_one(folder):
    said = message(folder.replace('kind = "level-flight"\n', ""))
    assert "key 'platform.kind' is missing; allowed: camera-model, ephemeris, level-flight, spin" in said


def test_one_band_alone_is_described_but_holds_no_motion(folder):
    folder.text = folder.text[: folder.text.rindex("[[band]]")]
    assert "one image cannot show motion: 1 [[band]] given (PAN)" in load_acquisition(folder.write()).still
    folder.text = folder.text[: folder.text.rindex("[[band]]")]
    assert "0 [[band]] given; motion is seen between two or more images" in message(folder)


def test_two_bands_of_one_name_are_refused(folder):
    assert "two bands are called 'PAN'" in message(folder.replace('name = "XS"', 'name = "PAN"'))


def test_text_that_is_not_toml_names_the_line(folder):
    assert (
        "not valid TOML" in (said := message(folder.replace("[platform]", "[platform"))) and "line 6" in said
    )


def test_a_missing_toml_file_is_one_message(tmp_path):
    with pytest.raises(FormatError, match=r"none\.toml: no such file"):
        read_acquisition(tmp_path / "none.toml")


def test_a_geoid_datum_without_a_geoid_is_refused(folder):
    said = message(folder.add('[surface]\ndem = "d.tif"\ndatum = "geoid"\n'))
    assert 'datum = "geoid" needs geoid = ' in said


def test_estimate_and_a_sigma_exclude_each_other(folder):
    said = message(folder.add('[camera]\nfocal_length_px = "estimate"\nfocal_length_sigma_px = 3.0\n'))
    assert 'focal_length_px = "estimate" takes no focal_length_sigma_px' in said


def test_a_wrong_word_in_place_of_estimate_is_refused(folder):
    said = message(folder.add('[camera]\nfocal_length_px = "guess"\n'))
    assert "camera.focal_length_px = 'guess' is not allowed" in said


def test_an_epoch_may_be_written_as_a_toml_date_time(folder):
    folder.replace('"2026-01-01T00:00:00Z"', "2026-01-01T00:00:00Z")
    assert load_acquisition(folder.write()).epoch == "2026-01-01T00:00:00+00:00"


@pytest.mark.parametrize("epoch", ["yesterday", "2026-13-01T00:00:00Z", "2026-01-01T00:00:00+02:00", ""])
def test_an_epoch_that_is_no_utc_instant_is_refused_when_the_file_is_read(folder, epoch):
    said = message(folder.replace('"2026-01-01T00:00:00Z"', f'"{epoch}"'))
    assert f"acquisition.epoch: {epoch!r} is not a UTC instant; write it like 2026-01-31T12:00:00" in said


def test_a_file_for_another_command_is_pointed_there(tmp_path):
    path = tmp_path / "x.toml"
    stereo = {"cameras": "c.csv", "matches": "m.csv", "camera": {}, "noise": {}}
    with pytest.raises(FormatError, match="looks like a file for `sightline orient`"):
        validate(AcquisitionFile, stereo, path)
    with pytest.raises(FormatError, match="looks like a file for `sightline recover`"):
        validate(StereoFile, {"acquisition": {}, "platform": {}, "instrument": {}, "band": []}, path)
    # one strange table among its own is a mistake in the file, not another file
    with pytest.raises(FormatError, match="unknown key 'cameras'"):
        validate(AcquisitionFile, {"cameras": "c.csv", "acquisition": {}, "platform": {}, "band": []}, path)


def test_the_json_schema_describes_every_table_and_can_be_printed():
    schema = json_schema("acquisition")
    assert {"platform", "band", "frame", "camera", "surface", "attitude_sensor"} <= set(schema["properties"])
    assert "look_ahead" in json.dumps(schema)


def test_a_schema_that_does_not_exist_lists_those_that_do():
    with pytest.raises(FormatError, match=r"no schema is called 'aquisition'; did you mean acquisition\?"):
        json_schema("aquisition")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "[camera]\nfocal_length_px = 1000.0\n",
            "[camera] focal_length_px describes frames, but [[band]] is given",
        ),
        (
            '[camera]\nmount = "nominal"\nbody_from_camera = [0, 0, 0, 1]\n',
            "mount and body_from_camera are both given",
        ),
        ('[world]\nframe = "earth-fixed"\n', 'kind = "level-flight" has axes of its own'),
        ('[surface]\nkind = "infinity"\ndem = "d.tif"\n', 'kind = "infinity" takes no dem'),
    ],
)
def test_what_would_be_ignored_is_refused(folder, text, words):
    assert words in message(folder.add(text))


def test_choices_of_matching_are_those_of_the_recovery(folder):
    from sightline.motion.strip.strip import RecoverOptions

    folder.add("[matching]\nwindow = [6, 80]\nstep = 3\nsearch_px = [20, 12]\n")
    options = RecoverOptions(**load_acquisition(folder.write()).matching)
    assert (options.window, options.step, options.search_px) == ((6, 80), 3, (20, 12))
    assert options.first_window == RecoverOptions().first_window


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('select = "best"', "'all', 'textured', 'spread' or 'listed'"),
        ("points = 50", 'points is for select = "spread"'),
        ('select = "listed"', "needs features = a CSV file"),
        ('similarity = "mutual"', "'whitened', 'radiometric' or 'gradient'"),
        ('weighting = "score"', "'predicted' or 'none'"),
    ],
)
def test_choices_of_matching_that_do_not_fit_are_refused(folder, text, words):
    assert words in message(folder.add(f"[matching]\n{text}\n"))


@pytest.mark.parametrize(
    ("written", "words"),
    [
        ("5,5", "'5,5' has a decimal comma: numbers are written with a decimal point, 5.5"),
        ("0,00042 # s", "'0,00042' has a decimal comma: numbers are written with a decimal point, 0.00042"),
        ("5e-4 ms", "5e-4 ms: numbers are written without units"),
        (".5 ms # s", "unless the name of the key says otherwise; .5 ms is 0.0005"),
        (
            "3 lines",
            "3 lines: numbers are written without units, in SI units and rad unless the name of the key "
            "says otherwise",
        ),
        ("5e-06\nline_period = 5e-06", "line_period stands twice in its table: keep one of the two"),
        ("5e-4\n[acquisition]", "[acquisition] stands twice: put all of its keys under one"),
        ('5e-4\nmask = "C:\\data\\m.tif"', r"write a path with / or \\, or in single quotes"),
        ('5e-4\nmask = "C:\\users\\m.tif"', r"write a path with / or \\, or in single quotes"),
        ("'", "correct it there"),
    ],
)
def test_usual_mistakes_in_toml_are_recognised(folder, written, words):
    said = message(folder.replace("line_period = 5e-4", f"line_period = {written}"))
    assert ("not valid TOML" in said and said.endswith(words)) or words in said


def test_a_missing_table_names_its_keys_as_they_are_written(tmp_path):
    given = {"columns": {"count": 4}, "grid": {"stages": [1], "integration_ratio": [1.0]}}
    with pytest.raises(FormatError) as caught:
        validate(TdiFile, given | {"noise": {}, "mtf": {}}, tmp_path)
    assert "key 'signals' is missing; add it: it may hold list, from, to, count, " in str(caught.value)
