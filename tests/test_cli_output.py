"""The output folder: nothing half-written under a final name, nothing of the user's lost."""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from sightline.cli.output import output_folder, stages_folder
from sightline.errors import FormatError, InputError
from sightline.inputs import apart, note, will_write
from sightline.kinds import open as kinds_known
from sightline.kinds.kind import earlier
from sightline.output import folder as output
from sightline.output import publish


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


def content(folder):
    """Every file below a folder, what a link says of where it leads; folders as None."""
    return {
        path.relative_to(folder).as_posix(): os.readlink(path)
        if path.is_symlink()
        else path.read_text()
        if path.is_file()
        else None
        for path in sorted(folder.rglob("*"))
    }


def write(folder, files):
    """A result of these texts, by their names."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


RESULT = {"motion.csv": "t\n", "maps/a.tif": "a", "maps/deep/b.tif": "b", "summary.json": "{}"}
PUBLISHED = RESULT | {"maps": None, "maps/deep": None}


def test_files_appear_under_their_names_only_when_the_block_ends_well(tmp_path):
    folder = tmp_path / "deep" / "result"
    with output_folder(folder) as staging:
        write(staging, RESULT)
        assert not set(names(folder)) & {"maps", "motion.csv", "summary.json"}
    assert content(folder) == PUBLISHED


def test_a_failed_run_leaves_nothing_behind_not_even_the_folders_above(tmp_path):
    with pytest.raises(RuntimeError), output_folder(tmp_path / "deep" / "result") as staging:
        write(staging, RESULT)
        raise RuntimeError
    assert not names(tmp_path)


def test_a_failed_run_leaves_an_earlier_result_as_it_was(tmp_path):
    write(tmp_path, {"motion.csv": "earlier"})
    with pytest.raises(RuntimeError), output_folder(tmp_path, overwrite=True) as staging:
        write(staging, RESULT)
        raise RuntimeError
    assert content(tmp_path) == {"motion.csv": "earlier"}


def test_a_folder_that_holds_something_is_refused_without_overwrite(tmp_path):
    write(tmp_path, {"mine.txt": "keep"})
    with pytest.raises(InputError, match=r"holds mine\.txt.*add --overwrite"), output_folder(tmp_path):
        pass
    with output_folder(tmp_path, overwrite=True) as staging:
        write(staging, {"motion.csv": "new"})
    assert content(tmp_path) == {"mine.txt": "keep", "motion.csv": "new"}


# ---- nothing that is not ours is touched, and no link is followed


def _link(path, to):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.symlink_to(to, target_is_directory=True)


@pytest.mark.parametrize("resume", [None, False, True], ids=["recover", "georeference", "--resume"])
@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize(
    "lay",
    [
        lambda out, data: _link(out / ".partial", data),
        lambda out, data: _link(out / ".partial" / "stages", data),
        lambda out, data: _link(out / ".partial" / "stages" / "follow.stage.npz", data / "a.txt"),
        lambda out, data: _link(out / ".partial" / "stages" / "follow.stage.npz.tmp", data / "a.txt"),
        lambda out, data: _link(out / ".partial-abcd1234", data),
        lambda out, data: _link(out / ".partial-abcd1234" / "new", data),
        lambda out, data: write(out, {".partial/mine.txt": "x"}),
        lambda out, data: write(out, {".partial/stages/mine.txt": "x"}),
        lambda out, data: write(out, {".partial": "a file"}),
        lambda out, data: write(out, {".partial-abcd1234/mine.txt": "x"}),
        lambda out, data: (out / ".partial").mkdir() or os.mkfifo(out / ".partial" / "stages"),
    ],
    ids=[
        "partial is a link", "stages is a link", "a stage is a link", "a draft is a link",
        "staging is a link", "a link within staging", "a file in partial", "a file among stages",
        "partial is a file",
        "somebody's staging", "a pipe",
    ],
)  # fmt: skip
def test_what_was_not_made_by_us_is_neither_followed_nor_emptied(tmp_path, lay, overwrite, resume):
    data, out = tmp_path / "data", tmp_path / "out"
    write(data, {"a.txt": "precious"})
    out.mkdir()
    lay(out, data)
    kept = {name: text for name, text in content(out).items()}
    try:
        with output_folder(out, overwrite=overwrite, resume=resume) as staging:
            write(staging, {"motion.csv": "new"})
    except InputError as error:
        assert ".partial" in str(error)
        kept_now = content(out)
    else:
        assert overwrite
        kept_now = content(out)
        assert kept_now.pop("motion.csv") == "new"
    assert content(data) == {"a.txt": "precious"}
    assert kept_now == kept


def test_a_command_without_stages_leaves_those_of_another_alone(tmp_path):
    write(tmp_path, {".partial/stages/follow.stage.npz": "x"})
    with output_folder(tmp_path) as staging:
        write(staging, {"motion.csv": "new"})
    assert (tmp_path / ".partial/stages/follow.stage.npz").exists()


def test_finished_stages_outlive_a_run_that_failed_and_end_with_one_that_did_not(tmp_path):
    folder = tmp_path / "out"
    with pytest.raises(RuntimeError), output_folder(folder, resume=False) as staging:
        write(stages_folder(folder), {"follow.stage.npz": "1", "poses.stage.npz.tmp": "half"})
        write(staging, {"poses.csv": "half"})
        raise RuntimeError
    assert names(folder) == [".partial"]
    with output_folder(folder, resume=False) as staging:
        assert "follow.stage.npz" in names(stages_folder(folder))
        write(staging, {"poses.csv": "whole"})
    assert content(folder) == {"poses.csv": "whole"}


def test_overwriting_anew_forgets_finished_stages(tmp_path):
    write(stages_folder(tmp_path), {"follow.stage.npz": "1"})
    with output_folder(tmp_path, overwrite=True, resume=False) as staging:
        assert not stages_folder(tmp_path).exists()
        write(staging, {"poses.csv": "whole"})
    assert content(tmp_path) == {"poses.csv": "whole"}


def test_stages_of_inputs_that_changed_are_not_gone_on_from(tmp_path):
    file, folder = tmp_path / "PAN.tif", tmp_path / "out"
    file.write_text("first")
    with pytest.raises(InputError, match="changed while it was read"), output_folder(folder, resume=False):
        note(file)
        write(stages_folder(folder), {"follow.stage.npz": "of both"})
        file.write_text("second")
    assert names(tmp_path) == ["PAN.tif"]


def test_other_files_of_a_folder_that_is_written_anew_stay(tmp_path):
    write(tmp_path, {"bands/0-old.tif": "old", "bands/mine/notes.txt": "mine", "bands/1.tif": "old"})
    listed = ["bands/0-old.tif", "bands/1.tif", "../data", "/etc/hosts"]
    with output_folder(tmp_path, overwrite=True, earlier=lambda _: listed) as staging:
        write(staging, {"bands/1.tif": "new"})
    assert content(tmp_path) == {
        "bands": None, "bands/mine": None, "bands/mine/notes.txt": "mine", "bands/1.tif": "new",
    }  # fmt: skip


def test_a_link_with_the_name_of_a_result_is_replaced_not_followed(tmp_path):
    data, out = tmp_path / "data", tmp_path / "out"
    write(data, {"a.txt": "precious", "deep/old.tif": "precious"})
    before = content(data)
    _link(out / "maps", data)
    (out / "motion.csv").symlink_to(data / "a.txt")
    with output_folder(out, overwrite=True, earlier=lambda _: ["maps/deep/old.tif"]) as staging:
        write(staging, RESULT)
    assert content(out) == PUBLISHED and content(data) == before


def test_a_linked_output_folder_is_written_where_it_leads(tmp_path):
    (tmp_path / "disk").mkdir()
    _link(tmp_path / "out", tmp_path / "disk")
    with output_folder(tmp_path / "out") as staging:
        write(staging, RESULT)
    assert content(tmp_path / "disk") == PUBLISHED


def test_a_folder_that_holds_something_is_not_replaced_by_a_file(tmp_path):
    write(tmp_path, {"motion.csv/mine.txt": "keep", "summary.json": "earlier"})
    with (
        pytest.raises(InputError, match=r"motion\.csv: is a folder that holds something"),
        output_folder(tmp_path, overwrite=True) as staging,
    ):
        write(staging, RESULT)
    assert (tmp_path / "motion.csv/mine.txt").read_text() == "keep"
    assert (tmp_path / "summary.json").read_text() == "earlier"


@pytest.mark.parametrize("when", ["before", "once the input says so"])
def test_a_folder_in_the_way_of_a_file_that_will_be_written_is_refused_before_the_work(tmp_path, when):
    write(tmp_path, {"motion.csv/mine.txt": "keep", "summary.json": "earlier"})
    with (
        pytest.raises(InputError, match=r"motion\.csv: is a folder that holds something"),
        output_folder(tmp_path, overwrite=True, writes=["motion.csv"] if when == "before" else ()),
    ):
        will_write(["motion.csv"])
        raise AssertionError("the work went on")
    assert content(tmp_path) == {"motion.csv": None, "motion.csv/mine.txt": "keep", "summary.json": "earlier"}


def test_an_empty_folder_and_a_link_to_a_folder_are_in_no_ones_way(tmp_path):
    write(tmp_path, {"elsewhere/mine.txt": "keep"})
    (tmp_path / "out/motion.csv").mkdir(parents=True)
    _link(tmp_path / "out/summary.json", tmp_path / "elsewhere")
    with output_folder(tmp_path / "out", overwrite=True, writes=list(RESULT)) as staging:
        write(staging, RESULT)
    assert content(tmp_path / "out") == PUBLISHED
    assert (tmp_path / "elsewhere/mine.txt").read_text() == "keep"


def test_only_the_named_files_of_an_earlier_run_go_and_no_input(tmp_path):
    write(tmp_path, {"attitude.aem": "x", "hidden.csv": "x", "mine.txt": "x"})
    listed = ["attitude.aem", "hidden.csv", "report.html"]
    with output_folder(tmp_path, overwrite=True, earlier=lambda _: listed) as staging:
        note(tmp_path / "attitude.aem")
        write(staging, {"motion.csv": "new"})
    assert names(tmp_path) == ["attitude.aem", "mine.txt", "motion.csv"]


MINE = ["bands/mine.txt", "bands/other.tif", "mine.tif", "attitude_mine.csv", "colmap/mine.txt", "notes.txt"]


@pytest.mark.parametrize(
    ("summary", "goes"),
    [
        ({"result": "StereoOrientation", "angles": {"A": 0, "B/2": 0}},
         ["attitude_A.aem", "cameras_corrected.csv", "points.csv", "matches_used.csv", "colmap/images.txt"]),
        ({"result": "SequencePoses", "cube": {"files": ["bands/0-red.tif", "notes.txt", "../a.tif"]}},
         ["geo.txt", "footprints.geojson", "bands/0-red.tif", "colmap/cameras.txt"]),
        ({"result": "Registration", "files": ["B1.tif", "notes.txt", "../a.tif"]}, ["B1.tif"]),
        ({"result": "LineOfSight"}, ["motion.csv", "attitude.aem"]),
        ({"result": "SequencePoses", "cube": {"files": 3}}, []),
        ({"result": ["SequencePoses"], "cube": None}, []),
    ],
)  # fmt: skip
def test_of_an_earlier_result_all_goes_that_its_kind_makes_and_nothing_else(tmp_path, summary, goes):
    write(tmp_path, dict.fromkeys([*goes, *MINE], "x"))
    assert kinds_known.KINDS
    write(tmp_path, {"summary.json": json.dumps({"version": "0", **summary})})
    with output_folder(tmp_path, overwrite=True, earlier=earlier) as staging:
        write(staging, {"summary.json": "new"})
    files = {name for name, text in content(tmp_path).items() if text is not None}
    assert files == {"summary.json", *MINE}


@pytest.mark.parametrize("there", ["fifo", "text", "list", "of another program", "nothing"])
def test_a_folder_without_a_summary_of_ours_keeps_files_with_names_of_results(tmp_path, there):
    write(tmp_path, {"points.csv": "mine", "motion.csv": "mine"})
    if there == "fifo":
        os.mkfifo(tmp_path / "summary.json")
    elif there != "nothing":
        said = {"text": "{", "list": "[1]", "of another program": '{"result": "StereoOrientation"}'}
        write(tmp_path, {"summary.json": said[there]})
    with output_folder(tmp_path, overwrite=True, earlier=earlier) as staging:
        write(staging, {"orientation.csv": "new"})
    assert (tmp_path / "points.csv").read_text() == (tmp_path / "motion.csv").read_text() == "mine"


def test_a_result_never_replaces_what_it_was_made_of(tmp_path):
    write(tmp_path, {"PAN.tif": "raw", "summary.json": "earlier"})
    with (
        pytest.raises(InputError, match=r"PAN\.tif: was read for the result and would be replaced"),
        output_folder(tmp_path, overwrite=True) as staging,
    ):
        note(tmp_path / "nowhere" / ".." / "PAN.tif")
        write(staging, {"PAN.tif": "registered", "summary.json": "new"})
    assert content(tmp_path) == {"PAN.tif": "raw", "summary.json": "earlier"}


def test_reading_what_is_sure_to_be_replaced_is_refused_at_once(tmp_path):
    write(tmp_path, {"summary.json": "earlier"})
    with (
        pytest.raises(InputError, match=r"summary\.json: was read for the result and would be replaced"),
        output_folder(tmp_path, overwrite=True, writes=["summary.json"]),
    ):
        note(tmp_path / "." / "summary.json")
        raise AssertionError("the work went on")
    assert content(tmp_path) == {"summary.json": "earlier"}


def test_names_that_only_the_input_tells_are_refused_before_the_work_too(tmp_path):
    write(tmp_path, {"PAN.tif": "raw"})
    with (
        pytest.raises(InputError, match=r"PAN\.tif: was read for the result and would be replaced"),
        output_folder(tmp_path, overwrite=True),
    ):
        note(tmp_path / "PAN.tif")
        will_write(["B0.tif"])
        will_write(["PAN.tif"])
        raise AssertionError("the work went on")
    assert content(tmp_path) == {"PAN.tif": "raw"}


def test_what_a_job_will_write_is_not_beside_the_folder_of_its_batch(tmp_path):
    write(tmp_path, {"PAN.tif": "raw"})
    with apart(tmp_path / "job"), output_folder(tmp_path / "job") as staging:
        note(tmp_path / "PAN.tif")
        will_write(["PAN.tif"])
        write(staging, {"PAN.tif": "registered"})
    assert content(tmp_path) == {"PAN.tif": "raw", "job": None, "job/PAN.tif": "registered"}


# ---- folders that cannot be written


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("a file", "is a file"),
        ("a file/deeper", "cannot write into the output folder"),
        ("nowhere", "is a link to a folder that does not exist"),
        ("x" * 300, "cannot write into the output folder"),
    ],
)
def test_a_folder_that_cannot_be_is_refused_before_the_block(tmp_path, place, words):
    (tmp_path / "a file").write_text("x")
    _link(tmp_path / "nowhere", tmp_path / "gone")
    with pytest.raises(InputError, match=words), output_folder(tmp_path / place):
        raise AssertionError("the block was begun")
    assert names(tmp_path) == ["a file", "nowhere"]


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="not applicable: root may write anywhere"
)
def test_a_folder_one_may_not_write_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="cannot write"), output_folder(tmp_path / "result"):
        pass


@pytest.fixture
def mounted(tmp_path):
    """Function that mounts a small file system in memory and gives its folder, or mounts one anew."""
    places = []

    def mount(options, place=None):
        again = place is not None
        place = place or tmp_path / f"disk-{len(places)}"
        place.mkdir(exist_ok=True)
        words = ["mount", "-o", f"remount,{options}", place] if again else None
        words = words or ["mount", "-t", "tmpfs", "-o", options, "tmpfs", place]
        done = subprocess.run(words, capture_output=True, text=True)
        if done.returncode != 0:
            pytest.skip(f"not applicable: this user may not mount a file system ({done.stderr.strip()})")
        if not again:
            places.append(place)
        return place

    if shutil.which("mount") is None:
        pytest.skip("not applicable: no command `mount`")
    yield mount
    for place in places:
        subprocess.run(["umount", place], check=True)


def test_a_read_only_disk_is_refused_before_the_block(mounted):
    place = mounted("size=1m")
    (place / "made before").mkdir()
    mounted("ro", place)
    for folder in (place / "out", place / "made before"):
        with pytest.raises(InputError, match=r"cannot write into the output folder.*Read-only"):
            with output_folder(folder):
                raise AssertionError("the block was begun")


def test_a_disk_that_is_full_from_the_beginning_is_refused_before_the_block(mounted):
    place = mounted("size=64k")
    with pytest.raises(OSError), (place / "filler").open("wb", buffering=0) as stream:
        while True:
            stream.write(bytes(4096))
    with pytest.raises(InputError, match=rf"no room on the disk.*{place}.*are free there"):
        with output_folder(place / "out"):
            raise AssertionError("the block was begun")
    assert names(place) == ["filler"]


def test_a_disk_that_runs_full_names_the_file_and_loses_nothing(mounted):
    place = mounted("size=256k")
    write(place, {"out/motion.csv": "earlier"})
    with pytest.raises(InputError, match=r"out/covariance\.npz: cannot be written \(No space left"):
        with output_folder(place / "out", overwrite=True) as staging:
            (staging / "motion.csv").write_text("new")
            with (staging / "covariance.npz").open("wb", buffering=0) as stream:
                try:
                    while True:
                        stream.write(bytes(4096))
                except OSError as error:
                    raise OSError(error.errno, error.strerror, str(staging / "covariance.npz")) from error
    assert content(place / "out") == {"motion.csv": "earlier"}


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "out: cannot be written .No space left"),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), "out: cannot be written .Disk quota exceeded"),
        (OSError("20 requested and 3 written"), "out: cannot be written .20 requested and 3 written"),
    ],
)
def test_what_the_system_says_without_a_file_is_said_of_the_folder(tmp_path, error, words):
    with pytest.raises(InputError, match=words), output_folder(tmp_path / "out"):
        raise error
    assert not names(tmp_path)


def test_what_the_system_says_of_other_files_is_not_taken_for_the_output(tmp_path):
    refused = FileNotFoundError(errno.ENOENT, "No such file", str(tmp_path / "input.csv"))
    with pytest.raises(FileNotFoundError), output_folder(tmp_path / "out"):
        raise refused


def test_a_limit_of_the_size_of_files_is_said_and_the_file_by_its_final_name(tmp_path, monkeypatch):
    import resource

    monkeypatch.setattr(resource, "getrlimit", lambda _: (40_000, 40_000))
    words = (
        r"out/PAN\.tif: cannot be written \(File too large\).*no file may be larger than 40.* kB .`ulimit -f`"
    )
    with pytest.raises(InputError, match=words), output_folder(tmp_path / "out") as staging:
        raise OSError(errno.EFBIG, "File too large", str(staging / ".PAN.tif.draft.tif"))
    assert not (tmp_path / "out").exists()


def test_a_run_that_could_keep_no_stage_leaves_none_and_speaks_of_none(tmp_path):
    said = []
    with pytest.raises(RuntimeError), output_folder(tmp_path / "out", resume=False, note=said.append):
        stages_folder(tmp_path / "out").mkdir(parents=True)
        raise RuntimeError
    assert not said and not (tmp_path / "out").exists()


def test_a_date_that_is_none_is_refused_before_the_block(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with pytest.raises(InputError, match="SOURCE_DATE_EPOCH is 'yesterday'"), output_folder(tmp_path / "out"):
        raise AssertionError("the block was begun")


def assert_reported_as_complete(out, work, owner, name, signalled, monkeypatch, capsys):
    """`work` is the command, and `signalled` stands for what `owner` calls `name` while it ends."""
    from sightline.cli import main

    monkeypatch.setattr(main, "app", work)
    monkeypatch.setattr(owner, name, signalled)
    assert main.run(["recover"]) == 130
    said = capsys.readouterr().err
    assert said == f"sightline: error: interrupted; the result is complete: {out}\n"
    monkeypatch.undo()


def test_a_signal_in_the_last_step_of_publishing_is_reported_as_a_complete_result(
    tmp_path, monkeypatch, capsys
):
    def work(words, **options):
        with output_folder(tmp_path / "out", resume=False) as staging:
            stages = stages_folder(tmp_path / "out")
            stages.mkdir(parents=True)
            (stages / "pass-1.stage.npz").touch()
            write(staging, RESULT)

    unlink = Path.unlink

    def signalled(path, missing_ok=False):
        unlink(path, missing_ok)
        if path.name == publish.JOURNAL:
            raise KeyboardInterrupt

    assert_reported_as_complete(tmp_path / "out", work, Path, "unlink", signalled, monkeypatch, capsys)
    assert content(tmp_path / "out") == PUBLISHED  # no finished stages are left either


def test_a_signal_after_the_result_has_its_names_is_reported_as_that(tmp_path, monkeypatch, capsys):
    def late(words, **options):
        with output_folder(tmp_path / "out", resume=False) as staging:
            write(staging, RESULT)

    def signalled(staging):
        raise KeyboardInterrupt

    assert_reported_as_complete(tmp_path / "out", late, output, "_remove", signalled, monkeypatch, capsys)
    assert content(tmp_path / "out").items() >= PUBLISHED.items()
    with output_folder(tmp_path / "out", overwrite=True):
        pass
    assert content(tmp_path / "out") == PUBLISHED


# ---- inputs


@pytest.mark.parametrize("how", ["written anew", "exchanged", "cut", "removed", "appeared"])
def test_an_input_that_changes_under_way_is_one_clear_error(tmp_path, how):
    file, out = tmp_path / "PAN.tif", tmp_path / "out"
    if how != "appeared":
        file.write_text("first")
    with pytest.raises(InputError, match=r"PAN\.tif: changed while it was read"):
        with output_folder(out) as staging:
            note(file)
            write(staging, RESULT)
            if how == "exchanged":  # by another of the same size and time
                other = tmp_path / "other"
                other.write_text("other")
                times = file.stat()
                os.utime(other, ns=(times.st_atime_ns, times.st_mtime_ns))
                os.replace(other, file)
            elif how == "removed":
                file.unlink()
            else:
                file.write_text("second" if how != "cut" else "")
    assert not out.exists()


def test_an_error_that_an_exchanged_input_brings_is_explained_by_it(tmp_path):
    file = tmp_path / "PAN.tif"
    file.write_text("first")
    with (
        pytest.raises(InputError, match="changed while it was read") as raised,
        output_folder(tmp_path / "o"),
    ):
        note(file)
        file.write_text("half")
        raise FormatError("the file is truncated")
    assert isinstance(raised.value.__cause__, FormatError)


def test_an_input_that_a_backup_touches_or_a_network_numbers_anew_is_the_same(tmp_path, monkeypatch):
    from sightline import inputs

    file = tmp_path / "PAN.tif"
    file.write_text("first")
    seen = inputs.Inputs(tmp_path / "out")
    seen.add(file)
    os.link(file, tmp_path / "backup")  # changes its ctime
    assert seen.changed() is None
    stamp = inputs._Stamp.of(file)
    assert stamp.same(inputs._Stamp(stamp.size, stamp.mtime_ns, stamp.inode + 1, stamp.ctime_ns))


# ---- killed at any step

EARLIER = {"motion.csv": "earlier", "maps/a.tif": "earlier", "maps/mine.txt": "mine", "stale.csv": "earlier"}
STALE = ["stale.csv"]


def killed(folder, step, overwrite):
    """Steps on the disk of a run in a process of its own, which was killed at a `step` unless it is 0."""
    steps = 0
    heard, tell = os.pipe()
    child = os.fork()
    if child == 0:

        def counted(function):
            def once_more(*arguments, **options):
                nonlocal steps
                steps += 1
                if steps == step:
                    os.kill(os.getpid(), signal.SIGKILL)
                return function(*arguments, **options)

            return once_more

        for name in ("rename", "replace", "mkdir", "rmdir", "unlink", "open"):
            setattr(os, name, counted(getattr(os, name)))
        with output_folder(folder, overwrite=overwrite, earlier=lambda _: STALE) as staging:
            write(staging, RESULT)
        os.write(tell, str(steps).encode())
        os._exit(0)
    os.close(tell)
    with os.fdopen(heard) as pipe:
        said = pipe.read()
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == (-signal.SIGKILL if step else 0)
    return int(said or 0)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="not applicable: this system has no fork")
@pytest.mark.parametrize("overwrite", [False, True], ids=["new", "overwritten"])
def test_a_run_killed_at_any_step_is_undone_by_the_next(tmp_path, overwrite, capsys):
    def laid(place):
        write(place, EARLIER if overwrite else {})
        place.mkdir(exist_ok=True)
        return place

    steps = killed(laid(tmp_path / "whole"), 0, overwrite)
    undisturbed = content(tmp_path / "whole")
    assert undisturbed == PUBLISHED | ({"maps/mine.txt": "mine"} if overwrite else {})
    moments = {"before": 0, "after": 0}
    for step in range(1, steps + 1):
        # what the next run finds is what was there, or the whole of the new result
        place = laid(tmp_path / f"before-{step}")
        before = content(place)
        killed(place, step, overwrite)
        other = shutil.copytree(place, tmp_path / f"again-{step}", symlinks=True)
        with pytest.raises(RuntimeError), output_folder(place, overwrite=True):
            raise RuntimeError
        found = content(place)
        assert found in (before, undisturbed), step
        moments["before" if found == before else "after"] += 1
        # and the same command again ends as if nothing had been
        if found == undisturbed and not overwrite:
            with pytest.raises(InputError, match="not empty"), output_folder(other):
                pass
        else:
            with output_folder(other, overwrite=overwrite, earlier=lambda _: STALE) as staging:
                write(staging, RESULT)
        assert content(other) == undisturbed, step
    assert min(moments.values()) > 5
    assert "is taken over" in capsys.readouterr().err


def _as_killed_when_all_was_moved(folder):
    """Leaves what a run killed just before its last step leaves; gives its folder."""
    staged = []

    def last_step(move, *places):
        step(move, *places)
        if move.name == "summary.json":
            raise SystemExit

    with pytest.MonkeyPatch.context() as patch:
        step = publish._apply
        patch.setattr(publish, "_apply", last_step)
        patch.setattr(publish, "roll_back", lambda *_: None)
        with pytest.raises(SystemExit), output_folder(folder, overwrite=True) as staging:
            write(staging, RESULT)
            staged.append(staging.parent)
    return staged[0]


def test_a_file_that_was_changed_after_the_kill_is_not_touched(tmp_path):
    write(tmp_path, {"motion.csv": "earlier"})
    staging = _as_killed_when_all_was_moved(tmp_path)
    (tmp_path / "motion.csv").write_text("mine since")
    with pytest.raises(InputError, match=r"motion\.csv: was changed after a run was killed") as refused:
        with output_folder(tmp_path, overwrite=True):
            pass
    assert str(staging) in str(refused.value)
    assert (tmp_path / "motion.csv").read_text() == "mine since"
    assert (staging / "old" / "motion.csv").read_text() == "earlier"


@pytest.mark.parametrize("name", ["../data/a.txt", "/data/a.txt", "maps/../../data/a.txt", ""])
def test_a_journal_that_leads_elsewhere_is_not_followed(tmp_path, name):
    write(tmp_path / "data", {"a.txt": "precious"})
    staging = _as_killed_when_all_was_moved(tmp_path / "out")
    size = (tmp_path / "data" / "a.txt").stat()
    move = {"kind": "file", "name": name, "size": size.st_size, "mtime_ns": size.st_mtime_ns}
    (staging / "journal.json").write_text(json.dumps([move]))
    with pytest.raises(InputError, match=r"journal\.json: cannot be read"):
        with output_folder(tmp_path / "out", overwrite=True):
            pass
    assert content(tmp_path / "data") == {"a.txt": "precious"}


def test_undoing_goes_through_no_link(tmp_path):
    staging = _as_killed_when_all_was_moved(tmp_path / "out")
    shutil.copytree(tmp_path / "out" / "maps", tmp_path / "data")
    shutil.rmtree(tmp_path / "out" / "maps")
    _link(tmp_path / "out" / "maps", tmp_path / "data")
    before = content(tmp_path / "data")
    with pytest.raises(InputError, match="was changed after a run was killed"):
        with output_folder(tmp_path / "out", overwrite=True):
            pass
    assert content(tmp_path / "data") == before and staging.exists()


@pytest.mark.parametrize("linked", ["old", "new", "old/maps", "new/maps"])
def test_undoing_takes_nothing_from_behind_a_link_in_what_was_left(tmp_path, linked):
    write(tmp_path / "out", EARLIER)
    staging = _as_killed_when_all_was_moved(tmp_path / "out")
    place, data = staging / linked, tmp_path / "data"
    shutil.copytree(place, data) if place.is_dir() else data.mkdir()
    write(data, {"motion.csv": "precious", "maps/1.tif": "precious", "1.tif": "precious"})
    shutil.rmtree(place, ignore_errors=True)
    _link(place, data)
    before, there = content(data), content(tmp_path / "out")
    with pytest.raises(InputError, match=r"is no folder|was changed after a run was killed"):
        with output_folder(tmp_path / "out", overwrite=True):
            pass
    assert content(data) == before and content(tmp_path / "out") == there


def test_a_move_that_fails_half_way_puts_everything_back(tmp_path, monkeypatch):
    write(tmp_path, EARLIER)
    before, rename = content(tmp_path), os.rename

    def refused(source, target):
        if Path(target).name == "summary.json" and "new" in Path(source).parts:
            raise OSError(errno.EIO, "Input/output error", str(target))
        rename(source, target)

    monkeypatch.setattr(os, "rename", refused)
    with pytest.raises(InputError, match=r"summary\.json: cannot be written .Input/output error"):
        with output_folder(tmp_path, overwrite=True) as staging:
            write(staging, RESULT)
    assert content(tmp_path) == before


def test_files_that_may_not_grow_are_one_clear_error(tmp_path):
    """As a full disk or a quota is, for any user: no file of this process may be larger than 64 KiB."""
    program = textwrap.dedent("""
        import resource, sys
        resource.setrlimit(resource.RLIMIT_FSIZE, (65536, 65536))
        from sightline.cli.main import run
        sys.exit(run(sys.argv[1:]))
    """)
    words = ["simulate", "line-of-sight", "--lines", "400", "--columns", "200", "--out", tmp_path / "scene"]
    done = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True)
    assert done.returncode == 2, done.stderr
    assert f"{tmp_path / 'scene' / 'PAN.tif'}: cannot be written" in done.stderr
    assert not names(tmp_path)
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY


def test_a_folder_whose_name_is_no_text_is_refused_before_the_work(tmp_path):
    with pytest.raises(InputError, match="is no UTF-8 text"), output_folder(tmp_path / "\udcff"):
        pytest.fail("the work has begun")
    assert list(tmp_path.iterdir()) == []
