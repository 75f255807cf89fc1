"""`batch`: names of folders, what is kept, what is told; one real run beside the commands themselves."""

from __future__ import annotations

import csv
import json
import os
import struct
from pathlib import Path

import pytest

import sightline
from sightline.applications.batch import Batch, JobOutcome, job_names
from sightline.cli import jobs
from sightline.cli.jobs import Job, run_job
from sightline.cli.main import run
from sightline.errors import InputError
from sightline.io.results.batch import write_batch


@pytest.fixture
def stereo(tmp_path, monkeypatch):
    """A pass of two cameras, oriented in a tenth of a second, in the folder of work."""
    monkeypatch.chdir(tmp_path)
    assert run("simulate stereo --shots 3 --points 20 --out pass".split()) == 0
    return tmp_path


def rows(folder: Path) -> dict[str, dict[str, str]]:
    with (folder / "results.csv").open(encoding="utf-8") as stream:
        return {row["name"]: row for row in csv.DictReader(stream)}


def test_a_result_is_called_as_its_file_or_where_files_are_alike_as_their_folder():
    given = ["a/acquisition.toml", "b/acquisition.toml", "c/strip 7.toml", "d/tdi.toml"]
    assert job_names([Path(one) for one in given]) == ["a", "b", "strip 7", "tdi"]


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("x/a/strip.toml", "y/a/strip.toml"),
        ("b/strip.toml", "a/b.toml"),
        ("x/a/Strip.toml", "y/A/strip.toml"),
    ],
)
def test_names_that_still_are_alike_are_refused_and_both_files_named(first, second):
    files = [Path(first), Path(second)]
    if second == "a/b.toml":  # two are called after their folders, the third after itself
        files.insert(1, Path("c/strip.toml"))
    with pytest.raises(InputError, match=f"{first} and {second} would both write into the folder"):
        job_names(files)


def test_a_file_that_is_given_twice_is_named():
    with pytest.raises(InputError, match=r"a/\.\./a/strip\.toml is given twice"):
        job_names([Path("a/strip.toml"), Path("b/strip.toml"), Path("a/../a/strip.toml")])


@pytest.mark.parametrize(
    "stem",
    ["..", ".", "...", ".batch", ".partial", "-x", "~root", "a:b", "summary.json", "results.csv",
     "report.html", "NUL", "con.x", "a\nb", "\u202egnp", "a\\b", "ends.", "x" * 250, "\udcff"],
)  # fmt: skip
def test_no_name_leads_out_of_the_folder_or_to_a_file_of_the_batch(stem):
    (name,) = job_names([Path(f"{stem}.toml")])
    assert name == Path(name).name and name not in ("", ".", "..") and len(name.encode()) <= 201
    assert not name.startswith((".", "-", "~")) and name.isprintable() and not set(name) & set('<>:"/\\|?*')
    assert name.casefold() not in ("summary.json", "report.html", "results.csv", "nul", "con.x")


def test_a_batch_of_many_kinds_lists_what_failed_and_its_folder_opens_as_a_result(stereo, capsys):
    Path("bad.toml").write_text("x = [")
    Path("instrument.toml").write_text("detectors = 3\n")
    Path("lists").mkdir()
    Path("lists/today.txt").write_text("# today\n../pass/stereo.toml\n\n../bad.toml\n")
    words = ["batch", "@lists/today.txt", "absent.toml", "instrument.toml", "--out", "out", "--workers", "1"]
    assert run(words) == 1
    said = capsys.readouterr()
    assert (
        "1 of 4 inputs done, 3 failed" in said.out
        and "absent: exit status 2: absent.toml: no such" in said.out
    )
    assert "progress: 4 of 4: instrument: failed with exit status 2" in said.err
    found = rows(Path("out"))
    assert [(name, row["state"], row["status"]) for name, row in found.items()] == [
        ("stereo", "done", "0"), ("bad", "failed", "2"), ("absent", "failed", "2"),
        ("instrument", "failed", "2"),
    ]  # fmt: skip
    assert found["stereo"]["command"] == "orient" and float(found["stereo"]["residual_rms_px"]) > 0.0
    assert (
        "not valid TOML" in found["bad"]["message"] and "takes ACQUISITION" in found["instrument"]["message"]
    )
    assert sorted(os.listdir()) == ["absent.toml", "bad.toml", "instrument.toml", "lists", "out", "pass"][1:]
    # the page links that of each, and every failure stands on it
    page = Path("out/report.html").read_text(encoding="utf-8")
    assert 'href="stereo/report.html"' in page and "absent.toml: no such file" in page
    opened = sightline.open_result("out")
    assert isinstance(opened, sightline.Batch) and [one.name for one in opened.failed] == list(found)[1:]
    summary = opened.to_dict()
    assert summary["done"] == 1 and summary["jobs"][0]["figures"]["points"] == 20
    # the same result as its own command writes
    assert run("orient pass/stereo.toml --out own".split()) == 0
    own = {path.name for path in Path("own").iterdir()}
    assert own == {path.name for path in Path("out/stereo").iterdir()}
    assert Path("own/orientation.csv").read_bytes() == Path("out/stereo/orientation.csv").read_bytes()
    pyarrow = pytest.importorskip("pyarrow.parquet")
    table = pyarrow.read_table("out/results.parquet")
    assert table.column_names == [*found["bad"], "geometry"] and table["status"].to_pylist() == [0, 2, 2, 2]


def test_the_parquet_table_holds_outlines_as_geoparquet_asks(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    near = [[10.0, 1.0], [11.0, 1.0], [11.0, 2.5], [10.0, 1.0]]
    west = [[-180.0, 0.0], [-179.0, 0.0], [-180.0, 1.0], [-180.0, 0.0]]
    halves = [[[179.0, 0.0], [180.0, 0.0], [180.0, 1.0], [179.0, 0.0]], west]
    outcomes = (
        JobOutcome("near", "a.toml", "recover", outline=[near]),
        JobOutcome("cut", "b.toml", "recover", outline=halves),
        JobOutcome("none", "c.toml", "tdi"),
    )
    write_batch(tmp_path, Batch("many", outcomes), {}, wall_seconds=1.0)
    table = parquet.read_table(tmp_path / "results.parquet")
    geo = json.loads(table.schema.metadata[b"geo"])
    assert geo["primary_column"] == "geometry"
    assert geo["columns"]["geometry"] == {"encoding": "WKB", "geometry_types": ["MultiPolygon", "Polygon"]}
    one, two, nothing = table["geometry"].to_pylist()
    assert nothing is None
    # little endian, polygon (3), one ring of four points; multipolygon (6) of two such
    assert one[:13] == b"\x01\x03\0\0\0\x01\0\0\0\x04\0\0\0"
    assert struct.unpack("<8d", one[13:]) == (10.0, 1.0, 11.0, 1.0, 11.0, 2.5, 10.0, 1.0)
    assert two[:9] == b"\x01\x06\0\0\0\x02\0\0\0" and len(two) == 9 + 2 * len(one)


def test_what_is_done_is_kept_and_what_changed_is_done_anew(stereo, capsys):
    words = "batch pass/stereo.toml --out out --workers 1".split()
    assert run(words) == 0
    assert run(words) == 2
    assert "holds a batch: out; add --resume" in capsys.readouterr().err
    before = Path("out/stereo/orientation.csv").stat().st_mtime_ns

    def resumed(*more: str) -> bool:
        """Whether the one result was kept."""
        assert run([*words, "--resume", *more]) == 0
        now = Path("out/stereo/orientation.csv").stat().st_mtime_ns
        kept = rows(Path("out"))["stereo"]["kept"] == "1"
        nonlocal before
        assert kept == (now == before)
        before = now
        return kept

    assert resumed()
    os.utime("pass/matches.csv")
    assert not resumed()
    assert resumed("--overwrite")
    with Path("out/stereo/summary.json").open("a") as stream:
        stream.write("\n")
    assert not resumed()
    Path("out/.batch/stereo.json").write_text("{")  # as a full disk may leave it
    assert run([*words, "--resume"]) == 1 and "not empty" in rows(Path("out"))["stereo"]["message"]
    assert run([*words, "--overwrite"]) == 0
    # another file of that name is another input: its result is no earlier one of this
    os.rename("pass", "later")
    assert run("batch later/stereo.toml --out out --workers 1 --resume".split()) == 1
    assert "holds what was made of" in rows(Path("out"))["stereo"]["message"]
    # what stands in the place of a folder is not followed
    os.rename("out/stereo", "moved")
    os.symlink("../moved", "out/stereo")
    assert run("batch later/stereo.toml --out out --workers 1 --overwrite".split()) == 1
    assert "is a link" in rows(Path("out"))["stereo"]["message"]


def test_a_job_whose_worker_was_lost_after_it_had_written_is_done_and_not_kept(stereo):
    job = Job("one", "pass/stereo.toml", "out", str(stereo), "token", False, False, False)
    Path("out").mkdir()
    first = run_job(run, job)
    assert (first.state, first.command, first.kept) == ("done", "orient", False)
    again = run_job(run, job)  # as a cluster asks for that lost the answer
    assert again == first
    # one that was stopped in between has a folder of its own to go on in
    Path("out/.batch/one.json").write_text(json.dumps({"batch": "token", "file": str(stereo / job.file)}))
    third = run_job(run, job)
    assert third.state == "done" and third.figures == first.figures


def test_a_worker_that_is_asked_to_end_gives_its_job_up(stereo):
    with pytest.raises(KeyboardInterrupt):
        run_job(
            lambda words: 143,
            Job("one", "pass/stereo.toml", "out", str(stereo), "token", False, False, False),
        )


def test_a_worker_with_another_version_or_other_files_says_so(stereo, tmp_path):
    one = run_job(
        run, Job("one", "pass/stereo.toml", "out", str(stereo), "t", False, False, False, version="0.0.9")
    )
    assert one.status == 2 and "was begun by 0.0.9" in one.message and not Path("out").exists()
    one = run_job(run, Job("one", "pass/stereo.toml", "out", str(stereo / "gone"), "t", False, False, False))
    assert one.status == 2 and "all workers must see the same files" in one.message


def test_an_interrupted_batch_says_what_is_kept(stereo, capsys, monkeypatch):
    def stopped(job: Job) -> object:
        if job.name == "second":
            raise KeyboardInterrupt
        return run_job(run, job)

    Path("second.toml").write_bytes(Path("pass/stereo.toml").read_bytes())
    monkeypatch.setattr(jobs, "job_runner", lambda: stopped)
    assert run("batch pass/stereo.toml second.toml --out out --workers 1".split()) == 130
    assert (
        "interrupted; 1 of 2 inputs are done and kept; the same command with --resume"
        in capsys.readouterr().err
    )
    assert sorted(os.listdir("out")) == [".batch", "stereo"]


@pytest.mark.parametrize("workers", ["0", "-1", "dask:", "many", "process:0"])
@pytest.mark.parametrize("words", ["batch x.toml", "recover x.toml", "tdi x.toml"])
def test_wrong_workers_are_refused_before_anything_is_read(tmp_path, monkeypatch, capsys, words, workers):
    monkeypatch.chdir(tmp_path)
    assert run([*words.split(), "--out", "out", "--workers", workers]) == 2
    assert "allowed are N, process:N, dask:ADDRESS" in capsys.readouterr().err
    assert not os.listdir()


def test_a_list_without_files_and_one_that_is_not_there_are_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("empty.txt").write_text("# nothing\n")
    Path("itself.txt").write_text("a.toml\n@itself.txt\n")
    Path("odd.txt").write_text("a\0.toml\n")
    assert run("batch @itself.txt --out out".split()) == 2 and run("batch @odd.txt --out out".split()) == 2
    said = capsys.readouterr().err
    assert "line 2 is '@itself.txt': a list names no other list" in said and "line 1 holds a NUL" in said
    assert not Path("out").exists()
    assert run("batch @empty.txt --out out".split()) == 2
    assert run("batch @absent.txt --out out".split()) == 2
    said = capsys.readouterr().err
    assert "@empty.txt: names no file" in said and "absent.txt: no such file" in said


def plain(path: Path) -> object:
    """A file, less what a run says of itself."""
    if path.suffix == ".json":
        summary = json.loads(path.read_text())
        return {
            key: value for key, value in summary.items() if key not in ("wall_seconds", "peak_memory_bytes")
        }
    return [line for line in path.read_bytes().splitlines() if b"CREATION_DATE" not in line]


def test_processes_write_what_the_commands_themselves_write(stereo, capfd):
    few = "--case frames --frames 3 --set interval=4".split()
    assert run(["simulate", "line-of-sight", *few, "--out", "photographs"]) == 0
    photographs = "photographs/acquisition.toml"
    assert run(["recover", photographs, "--out", "recovered"]) == 0
    assert run(["batch", photographs, "pass/stereo.toml", "--out", "out", "--workers", "2"]) == 0
    assert run("orient pass/stereo.toml --out own".split()) == 0
    assert run("orient pass/stereo.toml --out elsewhere --workers process:1".split()) == 0
    said = capfd.readouterr().out  # a process of its own says what it has to say itself
    assert "elsewhere/orientation.csv" in said and "own/orientation.csv" in said
    (recovered,) = {"acquisition", "photographs"} & {path.name for path in Path("out").iterdir()}
    pairs = [
        (Path("recovered"), Path("out", recovered)), (Path("own"), Path("out/stereo")),
        (Path("own"), Path("elsewhere")),
    ]  # fmt: skip
    for own, other in pairs:
        names = {path.relative_to(own) for path in own.rglob("*") if path.is_file()}
        assert names == {path.relative_to(other) for path in other.rglob("*") if path.is_file()}
        unlike = {name for name in names if plain(own / name) != plain(other / name)}
        # `orient` keeps the time of its solution too
        unlike = {name.name for name in unlike} - {"report.html"}
        assert unlike <= ({"summary.json"} if own == Path("own") else set())
    workers = {row["worker"] for row in rows(Path("out")).values()}
    assert len(workers) == 2 and all(f":{os.getpid()}" not in worker for worker in workers)
