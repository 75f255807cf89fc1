"""``sightline georeference``: the files, the words, and what a user may get wrong."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from sightline.cli.main import main, run
from sightline.errors import InputError
from sightline.io.formats.colmap import read_colmap_model
from sightline.io.formats.opensfm import read_opensfm
from sightline.io.results.poses import read_pose_covariance, read_pose_table, read_pose_truth
from sightline.version import VERSION

FILES = (
    "bands colmap covariance.npz frames_used.csv opk.csv poses.csv reconstruction.json report.html "
    "summary.json ypr.csv"
).split()
LOST = 11


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """Twenty-four frames, one of which cannot be read."""
    out = tmp_path_factory.mktemp("georeference") / "flight"
    words = ["--case", "small", "--frames", "24", "--set", "truth_bands=0", "--set", f"unreadable={LOST}"]
    assert run(["simulate", "frames", *words, "--seed", "3", "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def done(flight):
    out = flight.parent / "located"
    assert run(["georeference", str(flight / "sequence.toml"), "--out", str(out)]) == 0
    return out


def rows_of(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_the_files_are_the_contract(done):
    assert set(FILES) <= {entry.name for entry in done.iterdir()}
    header = (done / "poses.csv").read_text().splitlines()[0]
    assert header == (
        "frame,t,x,y,z,qx,qy,qz,qw,sigma_x,sigma_y,sigma_z,sigma_roll,sigma_pitch,sigma_yaw,source"
    )
    table, covariance = read_pose_table(done / "poses.csv"), read_pose_covariance(done / "covariance.npz")
    assert table.frames == covariance.frames
    assert np.sqrt(np.einsum("mii->mi", covariance.covariance)) == pytest.approx(
        table.sigma, rel=1e-6
    )  # its digits


def test_every_frame_has_a_pose_that_its_sigma_covers(flight, done):
    table, truth = read_pose_table(done / "poses.csv"), read_pose_truth(flight / "poses-truth.csv")
    assert table.frames == truth.frames
    off = np.concatenate(
        [table.position - truth.position, (truth.world_from_body.inv() * table.world_from_body).as_rotvec()],
        axis=1,
    )
    # the datum is one draw of six numbers for all frames: 4.5 sigma are passed once in 25 000 flights
    assert (np.abs(off) < 4.5 * table.sigma).all()
    assert table.source[LOST] == "interpolated" and set(table.source) == {
        "solved", "estimated", "interpolated",
    }  # fmt: skip
    # most of the sigma is the tables' biases, which all frames have in common
    assert (table.sigma[LOST] >= 0.999 * table.sigma[[LOST - 1, LOST + 1]].min(axis=0)).all()


def test_the_table_of_frames_says_why(done):
    rows = rows_of(done / "frames_used.csv")
    assert rows[LOST]["sightings"] == "0" and "cannot be read" in rows[LOST]["reason"]
    chosen = [row for row in rows if row["subset"] == "1"]
    assert all(row["reason"] for row in chosen)
    assert all(not row["reason"] for row in rows if row["source"] == "estimated")
    assert all(0.0 < float(row["residual_px"]) < 0.2 for row in rows if row["source"] != "interpolated")


def test_the_summary_has_the_numbers_of_the_tables(done):
    summary = json.loads((done / "summary.json").read_text())
    table = read_pose_table(done / "poses.csv")
    assert summary["frames"] == 24 and sum(summary["sources"].values()) == 24
    assert summary["sources"]["interpolated"] == 1 == len(summary["not_estimated"])
    assert summary["sigmas"]["sigma_x"]["median"] == pytest.approx(np.median(table.sigma[:, 0]))
    assert set(summary["datum"]) == {"x", "y", "z", "roll", "pitch", "yaw"}
    assert set(summary["inputs"]) >= {"sequence.toml", "frames", "positions.csv", "attitudes.csv"}


def test_other_programs_get_the_same_poses(done):
    table = read_pose_table(done / "poses.csv")
    for model in (read_colmap_model(done / "colmap"), read_opensfm(done / "reconstruction.json")[0]):
        order = np.argsort(model.names)  # names count the frames
        assert len(model.names) == 24
        assert model.position[order] == pytest.approx(table.position, abs=1e-6)
        assert len(model.points) > 50


def test_words_on_the_terminal(flight, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(["georeference", str(flight / "sequence.toml"), "--out", str(out), "--stride", "6"]) == 0
    said = capsys.readouterr()
    assert re.search(r"24 frames: \d+ solved, \d+ estimated, 1 interpolated", said.out)
    assert "1 of 24 frames is interpolated" in said.err or "1 of 24 frames cannot be used" in said.err
    assert str(out / "poses.csv") in said.out
    chosen = [int(row["frame"]) for row in rows_of(out / "frames_used.csv") if row["subset"] == "1"]
    assert set(np.diff(chosen)) <= {6, 7}  # one more where the frame that cannot be read lies between


def test_a_result_is_not_overwritten_unasked(flight, done, capsys):
    before = (done / "poses.csv").read_bytes()
    assert run(["georeference", str(flight / "sequence.toml"), "--out", str(done)]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert (done / "poses.csv").read_bytes() == before


def test_a_wrong_file_is_one_clear_error(tmp_path, capsys):
    path = tmp_path / "sequence.toml"
    path.write_text('frames = "nowhere.csv"\n[camera]\nfocal_length_px = 100.0\n')
    assert run(["georeference", str(path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "nowhere.csv" in said and "Traceback" not in said
    assert not (tmp_path / "out").exists()


@pytest.fixture
def signals_as_before():
    """What a signal does is the whole process' affair."""
    # tests that run in the background are started with some of them ignored
    plain = {
        signal.SIGINT: signal.default_int_handler,
        signal.SIGTERM: signal.SIG_DFL,
        signal.SIGHUP: signal.SIG_DFL,
    }
    before = {number: signal.signal(number, heed) for number, heed in plain.items()}
    yield
    for number, heed in before.items():
        signal.signal(number, heed)


@pytest.mark.parametrize(
    ("number", "status", "by", "words"),
    [
        (signal.SIGINT, 130, "interrupted", ["--resume"]),
        (signal.SIGTERM, 143, "ended by SIGTERM", []),
        (signal.SIGHUP, 129, "SIGHUP", ["--overwrite", "--resume"]),
    ],
)
def test_a_run_that_was_stopped_goes_on_by_the_same_command(
    flight, done, tmp_path, capsys, monkeypatch, signals_as_before, number, status, by, words
):
    from sightline.photogrammetry.flight import solver as sequence_solver

    file, out = str(flight / "sequence.toml"), tmp_path / "out"

    def stopped(*_, **__):
        os.kill(os.getpid(), number)
        time.sleep(60.0)

    with monkeypatch.context() as patch:
        patch.setattr(sequence_solver, "adjust_frames", stopped)
        with pytest.raises(SystemExit) as end:
            main(["georeference", file, "--out", str(out)])
    assert end.value.code == status
    said = [line for line in capsys.readouterr().err.splitlines() if "progress" not in line]
    assert len(said) == 1 and by in said[0] and "no result was written" in said[0]
    assert str(out / ".partial" / "stages") in said[0] and "--resume" in said[0]
    assert [entry.name for entry in out.iterdir()] == [".partial"]
    assert [entry.name for entry in (out / ".partial").iterdir()] == ["stages"]
    first = set((out / ".partial" / "stages").iterdir())
    assert {path.name for path in first} == {"follow.stage.npz", "subset.stage.npz"}

    def again(*_, **__):
        raise AssertionError("windows have been followed before")

    monkeypatch.setattr("sightline.applications.sequence_poses.follow_sequence", again)
    assert run(["georeference", file, "--out", str(out), *words]) == 0
    assert ("goes on from the finished stages" in capsys.readouterr().err) == (not words)
    assert (out / "poses.csv").read_bytes() == (done / "poses.csv").read_bytes()
    assert not (out / ".partial").exists()
    summary = json.loads((out / "summary.json").read_text())
    undisturbed = json.loads((done / "summary.json").read_text())
    measured = ("wall_seconds", "peak_memory_bytes")
    assert [{k: v for k, v in said.items() if k not in measured} for said in (summary, undisturbed)] == [
        {k: v for k, v in undisturbed.items() if k not in measured}
    ] * 2
    assert "of an earlier start" in (out / "report.html").read_text()


def test_finished_stages_that_are_a_link_are_refused_before_the_work(flight, tmp_path, capsys):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "follow.stage.npz").write_text("precious")
    out = tmp_path / "out"
    (out / ".partial").mkdir(parents=True)
    (out / ".partial" / "stages").symlink_to(tmp_path / "data", target_is_directory=True)
    for words in (["--overwrite"], ["--resume"], []):
        assert run(["georeference", str(flight / "sequence.toml"), "--out", str(out), *words]) == 2
        assert "stages is a link, not made by Sightline" in capsys.readouterr().err
    assert (tmp_path / "data" / "follow.stage.npz").read_text() == "precious"


def test_an_earlier_result_is_replaced_with_the_maps_it_lists_and_no_file_of_the_user(
    flight, tmp_path, capsys
):
    out, words = tmp_path / "out", ["georeference", str(flight / "sequence.toml"), "--out"]
    (out / "bands").mkdir(parents=True)
    for name in ("99-old.tif", "mine.tif"):
        (out / "bands" / name).write_text(name)
    (out / "summary.json").write_text(
        json.dumps(
            {
                "version": "1",
                "result": "SequencePoses",
                "cube": {"files": ["bands/99-old.tif", "bands/gone.tif"]},
            }
        )
    )
    assert run([*words, str(out), "--overwrite"]) == 0
    assert not (out / "bands" / "99-old.tif").exists()
    assert (out / "bands" / "mine.tif").read_text() == "mine.tif"


@pytest.mark.parametrize("method", ["displacement", "slerp"])
def test_the_ways_of_the_document_stand_beside(flight, tmp_path, method, capsys):
    out = tmp_path / "out"
    words = ["--method", method, "--poses-only"]
    assert run(["georeference", str(flight / "sequence.toml"), "--out", str(out), *words]) == 0
    assert "no covariance" in capsys.readouterr().err
    table, truth = read_pose_table(out / "poses.csv"), read_pose_truth(flight / "poses-truth.csv")
    solved = np.array([word == "solved" for word in table.source])
    assert 2 <= solved.sum() < 24
    assert np.isfinite(table.sigma[solved]).all() and np.isinf(table.sigma[~solved]).all()
    off = (truth.world_from_body.inv() * table.world_from_body).as_rotvec()
    # biases of a degree per axis are common to all; slerp leaves a third of a degree more
    assert np.degrees(np.abs(off - off.mean(axis=0))).max() < 3.0


def test_a_score_for_people_has_the_numbers_of_the_json(flight, done, capsys):
    truth = str(flight / "poses-truth.csv")
    assert run(["score", str(done), truth]) == 0
    score = json.loads(capsys.readouterr().out)
    assert run(["score", str(done), truth, "--table"]) == 0
    lines = capsys.readouterr().out.splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("estimated ("))
    for k, name in enumerate(("x", "y", "z", "roll", "pitch", "yaw")):
        parameter, unit, *numbers = (
            lines[at + k].replace(f"estimated ({score['by_source']['estimated']['frames']})", "").split()
        )
        entry = score["by_source"]["estimated"][name]
        factor = 1.0 if k < 3 else np.degrees(1.0)
        assert (parameter, unit) == (name, "m" if k < 3 else "deg")
        printed = [float(number.rstrip("%")) for number in numbers]
        expected = [factor * entry["rms"], factor * entry["max"], factor * entry["sigma"]]
        # three figures, two digits, whole per cent
        assert printed[:3] == pytest.approx(expected, rel=5e-3)
        assert printed[3] == pytest.approx(entry["nees"], abs=5e-3)
        assert printed[4] == pytest.approx(100.0 * entry["coverage_95"], abs=0.5)
    assert any(line.startswith("interpolated (1)") for line in lines)


def test_maps_that_fail_leave_the_poses(flight, tmp_path, capsys, monkeypatch):
    def nothing_to_map(problem, found, plan, store, progress=None):
        (store.folder / "bands").mkdir()
        raise InputError("no frame that can be used looks at the ground: there is nothing to map")

    monkeypatch.setattr("sightline.io.results.cube_summary.assemble_cube", nothing_to_map)
    out = tmp_path / "out"
    assert run(["georeference", str(flight / "sequence.toml"), "--out", str(out)]) == 1
    said = capsys.readouterr().err
    assert "warning: no maps of the bands were made: no frame that can be used looks at the ground" in said
    summary = json.loads((out / "summary.json").read_text())
    assert summary["cube"] is None and any("no maps" in words for words in summary["warnings"])
    assert len(rows_of(out / "poses.csv")) == 24 and not (out / "bands").exists()
    assert "no maps of the bands were made" in (out / "report.html").read_text()


def test_the_package_is_a_command():
    done = subprocess.run(
        [sys.executable, "-m", "sightline", "version"], capture_output=True, text=True, check=True
    )
    assert done.stdout == f"{VERSION}\n"
