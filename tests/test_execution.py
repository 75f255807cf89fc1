"""Executors give the same results, in order, and say clearly what is wrong."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import threading
from contextvars import ContextVar
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from sightline import execution
from sightline.errors import InputError, SightlineError
from sightline.execution import (
    Workers,
    available_processors,
    executor_from_name,
    give_threads,
    in_threads,
    machine_memory,
    one_blas_thread,
    process,
    serial,
    size_words,
    thread_count,
    threads_limited,
    time_words,
)


def smoothed_noise(seed: int, length: int = 400) -> np.ndarray:
    """Something whose last bits depend on the order of its additions."""
    samples = np.random.default_rng(seed).standard_normal(length)
    return np.cumsum(samples) / np.sqrt(length)


def fails_at(item: int, bad: int) -> int:
    if item == bad:
        raise ValueError(f"item {item}")
    return item


def blas_threads(_: int = 0) -> set[int]:
    from threadpoolctl import threadpool_info

    np.linalg.inv(np.eye(2))
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def ends_the_process(item: int) -> int:
    os._exit(3)


def test_results_are_bitwise_the_same_whatever_the_executor_and_the_workers():
    expected = list(serial().map(smoothed_noise, range(13)))
    for workers in (1, 2):
        with process(workers) as executor:
            got = list(executor.map(smoothed_noise, range(13)))
            again = list(executor.map(partial(smoothed_noise, length=400), range(13)))
            begun: list[int] = []
            numbered = dict(executor.completed(smoothed_noise, range(13), lost=told, begun=begun.append))
        assert begun == list(range(13))
        assert all(numbered[k].tobytes() == expected[k].tobytes() for k in range(13))
        for ours, theirs, later in zip(expected, got, again, strict=True):
            assert ours.tobytes() == theirs.tobytes() == later.tobytes()


def test_linear_algebra_runs_on_one_thread_where_that_is_asked_for_and_in_worker_processes():
    before = blas_threads()
    assert one_blas_thread(blas_threads)() == {1}
    assert blas_threads() == before
    assert blas_threads.__name__ == one_blas_thread(blas_threads).__name__
    with process(1) as executor:
        assert list(executor.map(blas_threads, [0])) == [{1}]


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_give_the_results_of_a_plain_loop_in_order_and_raise_what_an_item_raises(threads):
    expected = [smoothed_noise(seed) for seed in range(13)]
    got = in_threads(smoothed_noise, iter(range(13)), threads)
    assert [one.tobytes() for one in got] == [one.tobytes() for one in expected]
    assert in_threads(smoothed_noise, [], threads) == []
    with pytest.raises(ValueError, match="item 3"):
        in_threads(partial(fails_at, bad=3), range(10), threads)


def test_threads_see_what_their_caller_has_set():
    # such as where scratch files go
    place = ContextVar("place", default="the system's")
    place.set("below --out")
    assert in_threads(lambda _: place.get(), range(4), 2) == ["below --out"] * 4


def test_the_first_failing_item_raises_its_own_exception():
    for executor in (serial(), process(2)):
        with executor:
            results = executor.map(partial(fails_at, bad=3), range(10))
            assert [next(results) for _ in range(3)] == [0, 1, 2]
            with pytest.raises(ValueError, match="item 3"):
                next(results)


def test_items_are_taken_as_they_are_needed():
    taken = []

    def items():
        for number in range(1000):
            taken.append(number)
            yield number

    with process(1) as executor:
        results = executor.map(partial(fails_at, bad=-1), items())
        assert next(results) == 0
        # A strip of any length must not wait in memory: three items per worker at most.
        assert len(taken) <= 3
        results.close()


def told(item: int, how: str) -> str:
    """What stands in the place of a result that is lost."""
    return how


def ends_its_first_process(item: int, folder: Path) -> int:
    """Of item 1 the first process ends by a signal."""
    if item == 1 and not list(folder.iterdir()):
        (folder / "tried").touch()
        os.kill(os.getpid(), 9)
    return item * item


def test_an_item_whose_worker_ends_is_done_by_another_and_one_that_ends_all_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(execution, "TRIES", 2)
    with process(1) as executor:
        work = partial(ends_its_first_process, folder=tmp_path)
        assert sorted(executor.completed(work, range(4), lost=told)) == [(0, 0), (1, 1), (2, 4), (3, 9)]
        assert [path.name for path in tmp_path.iterdir()] == ["tried"]
        with pytest.raises(SightlineError, match=r"2 times a worker ended .* use fewer workers"):
            list(executor.map(ends_the_process, range(2)))
    with process(1) as executor:
        ((number, how),) = executor.completed(ends_the_process, [5], lost=told)
        assert number == 0 and how == "2 times a worker process ended without an answer (exit status 3)"


def threads_there(_: int) -> int:
    return thread_count()


def test_a_worker_has_its_share_of_the_threads_and_a_number_that_is_given_holds(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    with execution.ProcessExecutor(1, threads=5) as executor:
        assert list(executor.map(threads_there, [0])) == [5]
    assert thread_count() == 1
    with threads_limited(None):
        give_threads(3)
        assert thread_count() == 3
        together = threading.Barrier(3)  # broken unless so many wait at once
        in_threads(lambda _: together.wait(timeout=30.0), range(3))
    assert thread_count() == 1


def test_executors_are_found_by_name():
    assert executor_from_name("serial").workers == executor_from_name("1").workers == 1
    assert executor_from_name("process:3").workers == executor_from_name("3").workers == 3
    assert executor_from_name("process").workers == available_processors()
    assert Workers.read("dask:tcp://10.0.0.5:8786") == Workers("dask", None, "tcp://10.0.0.5:8786")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("threads", "`workers` = 'threads' is not known; allowed are N, process:N, dask:ADDRESS"),
        ("dask", "'dask' lacks the address of a scheduler; allowed"),
        ("dask:", "'dask:' lacks the address of a scheduler; allowed"),
        ("process:", "lacks a number of processes"),
        ("0", "0 is no whole number from 1 to"),
        ("-2", "-2 is no whole number from 1 to"),
        ("process:0", "0 is no whole number from 1 to"),
        ("process:two", "two is no whole number"),
        ("9" * 5000, "is no whole number from 1 to"),
        ("1.5", "is not known"),
        ("", "is not known"),
    ],
)
def test_a_wrong_executor_is_refused_with_what_is_allowed(name, message):
    with pytest.raises(InputError, match=message):
        executor_from_name(name)


def test_a_scheduler_that_is_not_there_is_one_clear_error(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(execution, "_CONNECTS", 0.5)
    with (
        executor_from_name("dask:tcp://127.0.0.1:9") as executor,
        pytest.raises(InputError, match=r"no dask scheduler answered at 'tcp://127.0.0.1:9'"),
    ):
        list(executor.completed(smoothed_noise, range(2), lost=told))


class LostCluster:
    """A client whose scheduler is gone: what it has taken gets no answer."""

    status = "closed"

    def nthreads(self) -> dict[str, int]:
        return {"one": 1}

    def submit(self, *_: object, **__: object) -> LostCluster:
        return self

    def add_done_callback(self, _: object) -> None:
        pass

    def close(self) -> None:
        pass


def test_a_scheduler_that_ends_is_one_clear_error(monkeypatch):
    monkeypatch.setattr(execution, "_LOOKS", 0.01)
    with executor_from_name("dask:tcp://127.0.0.1:9") as executor:
        executor._connected = LostCluster()
        with pytest.raises(SightlineError, match=r"does not answer any more; .* --resume"):
            list(executor.completed(smoothed_noise, range(2), lost=told))
        with pytest.raises(SightlineError, match=r"does not answer any more; .* --resume"):
            list(executor.map(smoothed_noise, range(2)))


def test_dask_gives_the_same_results():
    distributed = pytest.importorskip("distributed")
    expected = [result.tobytes() for result in serial().map(smoothed_noise, range(7))]
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
        ) as cluster,
        executor_from_name(f"dask:{cluster.scheduler_address}") as executor,
    ):
        assert executor.workers == 1  # which has two threads for an item
        assert list(executor.map(threads_there, [0])) == [2]
        assert [result.tobytes() for result in executor.map(smoothed_noise, range(7))] == expected


class ControlGroups:
    """A system in files: what it says of this process, and the folders of its control groups."""

    def __init__(self, base: Path, patch: pytest.MonkeyPatch) -> None:
        self.base, self.tables = base / "a b", base / "proc"  # mount points may hold blanks
        self.tables.mkdir(parents=True)
        patch.setattr(execution, "_PROC", self.tables)
        patch.setattr(os, "sched_getaffinity", lambda _: set(range(16)), raising=False)
        patch.delenv("OMP_NUM_THREADS", raising=False)

    def say(self, groups: str, *mounts: tuple[str, str, str, str]) -> None:
        """Own groups, and mounts as (folder below the base, root, type, options)."""
        execution._control_groups.cache_clear()
        (self.tables / "cgroup").write_text(groups)
        lines = ["21 1 252:1 / / rw,relatime shared:1 - ext4 /dev/vda1 rw,errors=remount-ro"]
        for number, (folder, root, kind, options) in enumerate(mounts, 30):
            place = str(self.base / folder).replace(" ", "\\040")
            lines.append(
                f"{number} 21 0:{number} {root} {place} rw,nosuid shared:9 - {kind} {kind} {options}"
            )
        (self.tables / "mountinfo").write_text("\n".join(lines) + "\n")

    def limit(self, name: str, text: str) -> None:
        path = self.base / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n")


@pytest.fixture
def groups(tmp_path, monkeypatch):
    yield ControlGroups(tmp_path, monkeypatch)
    execution._control_groups.cache_clear()


def test_threads_and_memory_keep_within_every_control_group_of_version_2(groups):
    groups.say("0::/user/job/step\n", ("two", "/", "cgroup2", "rw,nsdelegate"))
    groups.limit("two/user/job/step/cpu.max", "max 100000")
    groups.limit("two/user/job/cpu.max", "350000 100000")
    groups.limit("two/user/cpu.max", "800000 100000")
    groups.limit("two/user/other/cpu.max", "100000 100000")
    groups.limit("two/user/job/step/memory.max", "max")
    groups.limit("two/user/memory.max", "1048576")
    assert available_processors() == 3
    assert machine_memory() == 2.0**20


def test_threads_and_memory_keep_within_every_control_group_of_version_1(groups):
    groups.say(
        "7:memory:/batch/job\n3:cpu,cpuacct:/batch/job\n1:name=systemd:/init\n0::/\n",
        ("cpu", "/", "cgroup", "rw,cpu,cpuacct"),
        ("memory", "/", "cgroup", "rw,memory"),
        ("systemd", "/", "cgroup", "rw,name=systemd"),
    )
    groups.limit("cpu/cpu.cfs_quota_us", "-1")
    groups.limit("cpu/cpu.cfs_period_us", "100000")
    groups.limit("cpu/batch/job/cpu.cfs_quota_us", "100000")
    groups.limit("cpu/batch/job/cpu.cfs_period_us", "50000")
    groups.limit("memory/memory.limit_in_bytes", "9223372036854771712")
    groups.limit("memory/batch/memory.limit_in_bytes", "2097152")
    assert available_processors() == 2
    assert machine_memory() == 2.0**21


@pytest.mark.parametrize("own", ["/docker/b5", "/", "/../elsewhere"])
def test_the_limit_of_a_container_is_found_where_its_group_is_mounted_as_the_whole_tree(groups, own):
    root = "/docker/b5" if own.startswith("/docker") else "/"
    groups.say(f"0::{own}\n", ("inside", root, "cgroup2", "rw"))
    groups.limit("inside/cpu.max", "400000 100000")
    groups.limit("inside/memory.max", "3145728")
    assert available_processors() == 4
    assert machine_memory() == 3.0 * 2.0**20


@pytest.mark.parametrize(
    ("quota", "processors"), [("50000 100000", 1), ("150000 100000", 1), ("-1 100000", 16), ("?", 16)]
)
def test_a_process_has_the_whole_processors_of_its_quota_and_one_at_least(groups, quota, processors):
    groups.say("0::/\n", ("two", "/", "cgroup2", "rw"))
    groups.limit("two/cpu.max", quota)
    assert available_processors() == processors


@pytest.mark.parametrize(
    ("asked", "processors"),
    [
        ("1", 1),
        ("3", 3),
        (" 5 ", 5),
        ("4,2", 4),
        ("64", 16),
        ("0", 16),
        ("-2", 16),
        ("all", 16),
        ("", 16),
        ("9" * 5000, 16),
        ("0" * 5000, 16),
        ("00003", 3),
    ],
)
def test_omp_num_threads_bounds_the_threads_and_a_word_without_a_number_does_not(
    groups, monkeypatch, asked, processors
):
    groups.say("0::/\n", ("two", "/", "cgroup2", "rw"))
    monkeypatch.setenv("OMP_NUM_THREADS", asked)
    assert available_processors() == processors == process().workers


def test_threads_are_as_many_as_the_processors_that_may_be_used(groups, monkeypatch):
    groups.say("0::/\n", ("two", "/", "cgroup2", "rw"))
    for asked in (1, 2, 3):
        monkeypatch.setenv("OMP_NUM_THREADS", str(asked))
        together = threading.Barrier(asked)  # broken unless so many wait at once

        def work(_: int, together=together, names=(names := set())) -> None:
            names.add(threading.get_ident())
            together.wait(timeout=30.0)

        in_threads(work, range(2 * asked))
        assert len(names) == asked


def test_a_system_that_says_nothing_of_itself_limits_nothing(groups):
    execution._control_groups.cache_clear()
    assert execution._control_groups("cpu") == [Path("/sys/fs/cgroup/cpu"), Path("/sys/fs/cgroup")]


def test_a_command_takes_one_thread_for_linear_algebra():
    ask = "import os, sys; sys.argv[1:] = ['version']\nfrom sightline.cli.main import main\n"
    ask += "assert 'numpy' not in sys.modules\ntry:\n    main()\nexcept SystemExit:\n    pass\n"
    ask += "import numpy, threadpoolctl\nnumpy.linalg.inv(numpy.eye(2))\n"
    ask += "print({lib['num_threads'] for lib in threadpoolctl.threadpool_info()})"
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    ran = subprocess.run(
        [sys.executable, "-c", ask], env=environment, capture_output=True, text=True, check=True
    )
    assert ran.stdout.splitlines()[-1] == "{1}"


def test_a_library_does_not_take_the_signal_to_end():
    """pycolmap, where it is installed, answers SIGTERM with a dump of its stack; faulthandler does alike."""
    words = (
        "import faulthandler, os, signal, sys\n"
        "from sightline.execution import signals_kept\n"
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit(7))\n"
        "with signals_kept():\n"
        "    faulthandler.register(signal.SIGTERM, chain=False)\n"
        "os.kill(os.getpid(), signal.SIGTERM)\n"
    )
    assert subprocess.run([sys.executable, "-c", words], capture_output=True).returncode == 7


def test_durations_and_sizes_are_in_the_unit_in_which_they_are_read():
    times = (0.3, 59.2, 119.0, 120.0, 5400.0, 7200.0, 9000.0, 10 * 86400.0, 1e9)
    assert [time_words(t) for t in times] == [
        "0 s", "59 s", "119 s", "2 min", "90 min", "2 h", "2.5 h", "10 days", "32 years"
    ]  # fmt: skip
    sizes = (0, 1200, 2.5e6, 99e6, 0.12e9, 5.44e9, 123e9, 1.3e12)
    assert [size_words(n) for n in sizes] == [
        "0 kB", "2 kB", "2.5 MB", "99 MB", "0.12 GB", "5.4 GB", "123 GB", "1.3 TB"
    ]  # fmt: skip
    # where two sizes are compared, digits that tell them apart
    assert [size_words(n, 3) for n in (1.234e9, 1.244e9, 2.0**70)] == [
        "1.23 GB",
        "1.24 GB",
        "1,180,591,621 TB",
    ]


tells_of_heaps = pytest.mark.skipif(
    sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "malloc_stats"),
    reason="glibc alone tells of its heaps",
)

HEAPS = """
import ctypes, threading
from sightline.execution import one_heap

one_heap()
full = threading.Barrier(4)

def some():
    kept = [ctypes.create_string_buffer(5000) for _ in range(100)]
    full.wait()

threads = [threading.Thread(target=some) for _ in range(4)]
[thread.start() for thread in threads], [thread.join() for thread in threads]
ctypes.CDLL(None).malloc_stats()
"""


@tells_of_heaps
@pytest.mark.parametrize(
    ("asked", "one"),
    [
        ({}, True),
        ({"MALLOC_ARENA_MAX": "4"}, False),
        ({"GLIBC_TUNABLES": "glibc.malloc.arena_max=4"}, False),
        ({"GLIBC_TUNABLES": "glibc.malloc.check=0"}, True),
    ],
)
def test_threads_share_one_heap_unless_the_environment_asks_for_more(asked, one):
    own = ("MALLOC_ARENA_MAX", "GLIBC_TUNABLES")
    plain = {name: value for name, value in os.environ.items() if name not in own}
    done = subprocess.run(
        [sys.executable, "-c", HEAPS], env=plain | asked, capture_output=True, text=True, check=True
    )
    assert (done.stderr.count("Arena ") == 1) == one


WORKER = """
import ctypes, threading
from sightline.execution import process

def heaps(_):
    full = threading.Barrier(4)

    def some():
        kept = [ctypes.create_string_buffer(5000) for _ in range(100)]
        full.wait()

    threads = [threading.Thread(target=some) for _ in range(4)]
    [thread.start() for thread in threads], [thread.join() for thread in threads]
    ctypes.CDLL(None).malloc_stats()

if __name__ == "__main__":
    list(process(1).map(heaps, [0]))
"""


@tells_of_heaps
def test_threads_of_a_process_of_its_own_share_one_heap_too(tmp_path):
    own = ("MALLOC_ARENA_MAX", "GLIBC_TUNABLES")
    plain = {name: value for name, value in os.environ.items() if name not in own}
    (tmp_path / "worker.py").write_text(WORKER)
    words = [sys.executable, str(tmp_path / "worker.py")]
    done = subprocess.run(words, env=plain, capture_output=True, text=True, check=True)
    assert done.stderr.count("Arena ") == 1
