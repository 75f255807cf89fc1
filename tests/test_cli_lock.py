"""One run at a time in a folder: who holds it is said, what nobody holds any more is taken over."""

from __future__ import annotations

import errno
import json
import os
import signal
import socket
import subprocess
import sys
import textwrap
import time

import pytest

from sightline.cli.main import run
from sightline.cli.output import output_folder
from sightline.errors import InputError
from sightline.output import lock
from sightline.output.lock import LOCK, take

#: Holds a folder until it is asked to end, and says when it does.
HOLDER = textwrap.dedent("""
    import sys
    from pathlib import Path
    from sightline.cli.output import output_folder
    with output_folder(Path(sys.argv[1])) as folder:
        print("held", flush=True)
        sys.stdin.read()
        (folder / "motion.csv").write_text("t")
""")


@pytest.fixture
def holder(tmp_path):
    """A process that writes into ``tmp_path / "out"``, and has begun."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, tmp_path / "out"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_a_second_run_into_a_folder_ends_with_2_and_says_who_has_it(tmp_path, holder, capsys):
    out = tmp_path / "out"
    words = ["simulate", "line-of-sight", "--lines", "64", "--columns", "64", "--out", str(out)]
    for more in ([], ["--overwrite"]):
        assert run([*words, *more]) == 2
        said = capsys.readouterr().err
        assert "is being written by another run" in said and str(out) in said
        assert f"process {holder.pid} on {socket.gethostname()}, begun 2" in said
    holder.communicate("")
    assert holder.returncode == 0
    assert [entry.name for entry in out.iterdir()] == ["motion.csv"]


def test_what_a_killed_run_left_is_taken_over_and_that_is_said(tmp_path, holder, capsys):
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert (tmp_path / "out" / LOCK).exists()
    with output_folder(tmp_path / "out") as folder:
        (folder / "motion.csv").write_text("t")
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1 and f"process {holder.pid}" in said and "is taken over" in said
    assert [entry.name for entry in (tmp_path / "out").iterdir()] == ["motion.csv"]


@pytest.mark.parametrize(
    ("left", "said"),
    [
        (
            json.dumps({"pid": 1, "host": "elsewhere", "begun": "2020", "command": "x"}),
            "process 1 on elsewhere",
        ),
        (json.dumps({"pid": os.getpid(), "host": socket.gethostname()}), f"process {os.getpid()}"),
        ("", "does not give its name"),
        ("[" * 3000, "does not give its name"),
        ("\0\xff not json", "does not give its name"),
        (json.dumps({"pid": "\x1b[31m\n", "host": ["a"]}), "process ?[31m? on"),
    ],
    # named, as the number of a process would make the name of the test another in every worker
    ids=["elsewhere", "this process", "empty", "deep", "no json", "hostile"],
)
def test_a_lock_that_nobody_holds_is_taken_over(tmp_path, capsys, left, said):
    (tmp_path / LOCK).write_text(left, encoding="latin-1")
    with output_folder(tmp_path):
        pass
    printed = capsys.readouterr().err
    assert said in printed and "is taken over" in printed and len(printed.splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["link", "second name", "folder", "pipe"])
def test_what_has_the_name_of_a_lock_and_is_none_is_not_touched(tmp_path, kind):
    data, out = tmp_path / "data.txt", tmp_path / "out"
    data.write_text("precious")
    out.mkdir()
    place = out / LOCK
    {
        "link": lambda: place.symlink_to(data),
        "second name": lambda: os.link(data, place),
        "folder": lambda: place.mkdir(),
        "pipe": lambda: os.mkfifo(place),
    }[kind]()
    with (
        pytest.raises(InputError, match=f"{LOCK}: is a link, a folder or something else"),
        output_folder(out),
    ):
        pass
    assert data.read_text() == "precious" and os.path.lexists(place)


def test_of_two_that_begin_at_the_same_moment_one_writes(tmp_path):
    program = textwrap.dedent("""
        import sys, time
        from pathlib import Path
        from sightline.cli.output import output_folder
        from sightline.errors import InputError
        for turn in range(40):
            while time.time() < float(sys.argv[2]) + 0.02 * turn:
                pass
            try:
                with output_folder(Path(sys.argv[1]) / str(turn)) as folder:
                    (folder / "who").write_text(sys.argv[3])
                    time.sleep(0.01)
                print(turn)
            except InputError as error:
                assert "written by another" in str(error) or "holds who" in str(error), error
    """)
    start = time.time() + 1.5
    both = [
        subprocess.Popen(
            [sys.executable, "-c", program, tmp_path, str(start), name], stdout=subprocess.PIPE, text=True
        )
        for name in ("a", "b")
    ]
    won = [set(process.communicate()[0].split()) for process in both]
    assert all(process.returncode == 0 for process in both)
    assert not won[0] & won[1] and won[0] | won[1] == {str(turn) for turn in range(40)}
    for turn in range(40):
        assert [entry.name for entry in (tmp_path / str(turn)).iterdir()] == ["who"]
        assert (tmp_path / str(turn) / "who").read_text() == ("a" if str(turn) in won[0] else "b")


# ---- file systems that know no locks


@pytest.fixture
def without_locks(monkeypatch):
    fcntl = pytest.importorskip("fcntl", reason="not applicable: this system has no fcntl")

    def unknown(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", unknown)
    monkeypatch.setattr(lock, "_SETTLES", 0.0)


def test_without_locks_of_the_system_a_living_owner_is_respected(tmp_path, without_locks):
    with output_folder(tmp_path / "out"):
        with pytest.raises(InputError, match=f"process {os.getpid()}"), output_folder(tmp_path / "out"):
            pass
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("owner", ["dead", "elsewhere", "nameless"])
def test_without_locks_of_the_system_one_that_is_gone_is_not(tmp_path, without_locks, owner, capsys):
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    host = "another.host" if owner == "elsewhere" else socket.gethostname()
    said = {"pid": os.getpid() if owner == "elsewhere" else gone.pid, "host": host}
    (tmp_path / LOCK).write_text("" if owner == "nameless" else json.dumps(said))
    os.utime(tmp_path / LOCK, (0, 0))
    with output_folder(tmp_path):
        pass
    assert "is taken over" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_without_locks_of_the_system_one_that_is_being_made_is_respected(tmp_path, without_locks):
    (tmp_path / LOCK).write_text("")
    with pytest.raises(InputError, match="does not give its name"), output_folder(tmp_path):
        pass
    assert (tmp_path / LOCK).exists()


def test_of_two_that_take_over_at_once_the_last_to_write_has_it(tmp_path, without_locks, monkeypatch):
    (tmp_path / LOCK).write_text(json.dumps({"pid": 1, "host": "another.host"}))
    other = json.dumps({"pid": 7, "host": "third.host", "token": "x"})
    monkeypatch.setattr(lock.time, "sleep", lambda _: (tmp_path / LOCK).write_text(other))
    with pytest.raises(InputError, match=r"process 7 on third\.host"):
        take(tmp_path)
    assert (tmp_path / LOCK).read_text() == other
