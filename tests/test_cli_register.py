"""`sightline register`: what it writes and says, and what it refuses."""

from __future__ import annotations

import json
import math
import shutil

import numpy as np
import pytest

from sightline.cli.main import run
from sightline.products import register_bands
from sightline.products.register_bands import RegisteredImage
from sightline.report import register_page
from sightline.stages import Stages


@pytest.fixture(scope="module")
def registered(recovery, tmp_path_factory):
    """The rendered strip of `recovery`, registered: folder and summary."""
    import contextlib
    import io

    out, said = tmp_path_factory.mktemp("registered") / "out", io.StringIO()
    words = ["register", str(recovery.scene / "acquisition.toml"), "--motion", str(recovery.folder)]
    with contextlib.redirect_stdout(said):
        assert run([*words, "--out", str(out), "--json"]) == 0
    return out, json.loads(said.getvalue())


def words(recovery, tmp_path, *more):
    toml = recovery.scene / "acquisition.toml"
    return ["register", str(toml), "--motion", str(recovery.folder), "--out", str(tmp_path / "out"), *more]


def test_images_summary_and_page_are_written_and_nothing_else(registered):
    out, summary = registered
    expected = ["B0.tif", "B1.tif", "B2.tif", "PAN.tif", "report.html", "summary.json"]
    assert sorted(entry.name for entry in out.iterdir()) == expected
    assert json.loads((out / "summary.json").read_text()) == summary
    assert summary["onto"] == "PAN" and summary["files"] == ["PAN.tif", "B1.tif", "B0.tif", "B2.tif"]


def test_bands_fit_as_well_as_they_can_be_matched(registered):
    _, summary = registered
    assert len(summary["pairs"]) == 6
    for pair in summary["pairs"]:
        before, after, noise = (
            sum(x * x for x in pair[when][key]) ** 0.5
            for when, key in (("before", "rms_px"), ("after", "rms_px"), ("after", "noise_px"))
        )
        assert after < 0.2 * before
        # a hundred windows scatter by 7 %; the motion of so short and narrow a strip is known to 0.02 px
        assert after < 1.25 * (noise**2 + 2 * 0.02**2) ** 0.5, pair


def test_the_page_opens_without_asking_anybody(registered, open_page):
    out, _ = registered
    page, problems = open_page(out / "report.html")
    assert not problems
    assert page.locator("#pairs tbody tr").count() == 6
    assert page.locator("#pictures img").count() == 2
    assert page.locator("#misfit svg.drawn").count() == 1


def test_onto_type_and_stack(recovery, tmp_path, capsys):
    import rasterio

    assert run(words(recovery, tmp_path, "--onto", "B0", "--type", "float32", "--stack")) == 0
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 7 and said[0].startswith("PAN - B1") and "registered.tif" in said[-1]
    with rasterio.open(tmp_path / "out" / "registered.tif") as file:
        assert file.descriptions == ("PAN", "B1", "B0", "B2") and set(file.dtypes) == {"float32"}


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--onto", "NIR"], "no band is called 'NIR'"),
        (["--type", "float64"], "float64"),
        (["--motion", "nowhere"], "motion.csv is missing"),
    ],
)
def test_wrong_words_are_refused_and_nothing_is_written(recovery, tmp_path, capsys, more, message):
    assert run(words(recovery, tmp_path, *more)) == 2
    said = capsys.readouterr().err
    assert message in said and "Traceback" not in said
    assert not (tmp_path / "out").exists()


def test_without_motion_it_says_what_is_missing(recovery, tmp_path, capsys):
    assert run(["register", str(recovery.scene / "acquisition.toml"), "--out", str(tmp_path / "out")]) == 2
    assert "--motion" in capsys.readouterr().err


def test_the_motion_of_another_strip_is_refused(recovery, tmp_path, capsys):
    scene = shutil.copytree(recovery.scene, tmp_path / "scene")
    toml = scene / "acquisition.toml"
    toml.write_text(toml.read_text() + "\n[matching]\npasses = 3\n")
    assert run(["register", str(toml), "--motion", str(recovery.folder), "--out", str(tmp_path / "out")]) == 2
    assert "does not belong to" in capsys.readouterr().err


def test_frames_are_refused(recovery, tmp_path, capsys):
    scene = tmp_path / "frames"
    assert run(["simulate", "line-of-sight", "--case", "frames", "--frames", "3", "--out", str(scene)]) == 0
    toml = scene / "acquisition.toml"
    assert run(["register", str(toml), "--motion", str(recovery.folder), "--out", str(tmp_path / "out")]) == 2
    assert "[[band]]" in capsys.readouterr().err


def test_a_band_that_matches_nothing_is_named_by_recover_and_marked_by_register(recovery, tmp_path, capsys):
    scene, folder, out = shutil.copytree(recovery.scene, tmp_path / "scene"), tmp_path / "r", tmp_path / "out"
    toml = scene / "acquisition.toml"
    before, after = toml.read_text().split('name = "B1"')
    swapped = before + 'name = "B1"' + after.replace("look_ahead = -", "look_ahead = ", 1)
    toml.write_text(swapped + "\n[matching]\npasses = 1\n")
    assert run(["recover", str(toml), "--out", str(folder)]) == 0
    warnings = [line for line in capsys.readouterr().err.splitlines() if "matches nothing" in line]
    assert len(warnings) == 1 and "B1 matches nothing" in warnings[0] and "change the sign" in warnings[0]

    assert run(["register", str(toml), "--motion", str(folder), "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert "nan" not in said.out + said.err
    assert "B1                placed by the recovered motion alone" in said.out
    assert "PAN - B1          how far apart is not known" in said.out
    summary = json.loads((out / "summary.json").read_text())
    assert {band["name"]: band["placed_by"] for band in summary["bands"]} == {
        "PAN": "matches", "B1": "motion", "B0": "matches", "B2": "matches",
    }  # fmt: skip
    page = (out / "report.html").read_text()
    assert "Too few windows match to say how well these fit: PAN – B1, B1 – B0, B1 – B2." in page
    assert "Placed by the recovered motion alone, their own place never measured: B1." in page


def test_a_band_in_none_of_the_pairs_is_laid_by_the_motion_of_the_others(recovery, tmp_path, capsys):
    scene, folder, out = shutil.copytree(recovery.scene, tmp_path / "scene"), tmp_path / "r", tmp_path / "out"
    toml = scene / "acquisition.toml"
    pairs = '[["PAN", "B1"], ["PAN", "B0"], ["B1", "B0"]]'
    toml.write_text(f"{toml.read_text()}\n[matching]\npasses = 1\npairs = {pairs}\n")
    assert run(["recover", str(toml), "--out", str(folder)]) == 0
    said = capsys.readouterr().err
    assert "B2 is in none of the `pairs` that are to be matched" in said and "matches nothing" not in said
    assert run(["register", str(toml), "--motion", str(folder), "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert "B2                placed by the recovered motion alone" in said.out
    assert "B2 is placed by its camera and the recovered motion alone: no window of it was" in said.err
    summary = json.loads((out / "summary.json").read_text())
    of_band = [pair["after"] for pair in summary["pairs"] if "B2" in pair["images"]]
    # it lies where its look angle says, known to a pixel each way: four sigmas of two images
    assert all(np.abs(fit["mean_px"]).max() < 4.0 * np.sqrt(2.0) for fit in of_band)
    # and it moves as the others say: its own rotation and scale are left, where no motion, or the opposite,
    # would leave as much as before or twice that
    before = [pair["before"] for pair in summary["pairs"] if "B2" in pair["images"]]
    for was, now in zip(before, of_band, strict=True):
        left = [np.sqrt(np.square(fit["rms_px"]) - np.square(fit["mean_px"])) for fit in (was, now)]
        assert np.hypot(*left[1]) < 0.7 * np.hypot(*left[0])


def stopped_at(stage: str, words: list[str], monkeypatch) -> None:
    """A run that is interrupted before it keeps this stage."""
    put = Stages.put

    def some(stages, name, value):
        if name == stage:
            raise KeyboardInterrupt
        put(stages, name, value)

    with monkeypatch.context() as patch:
        patch.setattr(Stages, "put", some)
        assert run(words) == 130


def test_a_run_that_was_stopped_time_and_again_goes_on_to_the_same_bits(
    registered, recovery, tmp_path, capsys, monkeypatch
):
    read = []

    def counted(image, lines, columns, of=RegisteredImage.read):
        read.append(lines)
        return of(image, lines, columns)

    # five blocks of lines: where maps are sampled hangs on the block, so the whole run has the same
    lines, columns = registered[1]["shape"]
    monkeypatch.setattr(register_bands, "BLOCK_PIXELS", -(-lines // 5) * columns)
    assert run([*words(recovery, tmp_path)[:-1], str(tmp_path / "whole"), "--json"]) == 0
    whole = json.loads(capsys.readouterr().out)
    monkeypatch.setattr(RegisteredImage, "read", counted)
    command = words(recovery, tmp_path, "--workers", "1")
    out, moved = tmp_path / "out", len(whole["bands"]) - 1
    stopped_at("after-2", command, monkeypatch)
    assert "finished stages wait in" in capsys.readouterr().err
    stopped_at("before-3", [*command, "--resume"], monkeypatch)
    stopped_at("fit-after-0-2", command, monkeypatch)
    assert "goes on from the finished stages" in capsys.readouterr().err
    # a block that was under way when the run was stopped is read again, and no other one
    assert len(read) == moved * (5 + 1 + 5 + 1)
    assert run([*command, "--resume"]) == 0
    assert len(read) == moved * 12
    assert not (out / ".partial").exists()
    for name in whole["files"]:
        assert (out / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    summary = json.loads((out / "summary.json").read_text())
    assert {key for key in whole if summary[key] != whole[key]} <= {"wall_seconds", "peak_memory_bytes"}


def test_a_run_of_other_options_is_refused_where_it_is_to_go_on(recovery, tmp_path, capsys, monkeypatch):
    command = words(recovery, tmp_path)
    stopped_at("before-0", command, monkeypatch)
    capsys.readouterr()
    assert run([*command, "--onto", "B1", "--resume"]) == 2
    said = capsys.readouterr().err
    assert said.count("error:") == 1 and "after-0.stage.npz: it is of other images, options" in said
    # without the word it is named and done again
    stopped_at("after-0", [*command, "--onto", "B1"], monkeypatch)
    assert "after-0.stage.npz is passed over" in capsys.readouterr().err


def test_onto_the_folder_of_its_own_images_is_refused_before_anything_is_resampled(
    recovery, tmp_path, capsys, monkeypatch
):
    scene = tmp_path / "scene"
    shutil.copytree(recovery.scene, scene)
    before = {path.name: path.read_bytes() for path in scene.iterdir()}
    monkeypatch.setattr(RegisteredImage, "read", None)
    toml, motion = str(scene / "acquisition.toml"), str(recovery.folder)
    assert run(["register", toml, "--motion", motion, "--out", str(scene), "--overwrite"]) == 2
    said = capsys.readouterr().err
    assert "was read for the result and would be replaced" in said and "finished stages" not in said
    assert {path.name: path.read_bytes() for path in scene.iterdir()} == before


def test_a_pair_that_matched_only_after_registration_is_said_to_fit(registered):
    summary = json.loads(json.dumps(registered[1]))
    first = summary["pairs"][0]
    first["before"]["rms_px"] = [math.nan, math.nan]
    said = " ".join(register_page.sentences(summary))
    name = " – ".join(first["images"])
    assert f"Too few windows matched then to say it of {name}." in said and "how well these fit" not in said
    first["after"]["rms_px"] = [math.nan, math.nan]
    said = " ".join(register_page.sentences(summary))
    assert f"Too few windows match to say how well these fit: {name}." in said


def test_a_band_that_is_named_after_a_hue_is_drawn_in_it():
    hues = ("red", "green", "blue")
    assert register_page._in_own_hues([0, 1, 2], ["PAN", "Blue", "green"], hues) == [0, 2, 1]
    assert register_page._in_own_hues([4, 2, 3], ["a", "b", "c"], hues) == [4, 2, 3]
    assert register_page._in_own_hues([1, 3], ["green", "red"], ("red", "cyan")) == [3, 1]
