"""Where work runs: one process, its threads, several processes, or a dask cluster.

All give bitwise the same results: they come in the order of the items, every caller reduces them in that
order, work is cut into items by its size, never by the number of workers, and linear algebra runs on one
thread (`one_blas_thread`).

This file does not cut work into items: each caller knows its own.
"""

from __future__ import annotations

import os
import re
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache, wraps
from math import ceil, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, Protocol, Self, TypeVar

from sightline.errors import InputError, SightlineError

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor

Item = TypeVar("Item")
Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")

# Items submitted and not yet consumed, per worker: enough to keep all busy, few enough to bound memory.
_IN_FLIGHT_PER_WORKER = 3

#: What libraries of linear algebra read when they are loaded; more particular than OMP_NUM_THREADS.
BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")

# Of a number of threads that is read at all: Python refuses thousands of them.
_DIGITS = 9
# What the system says of this process.
_PROC = Path("/proc/self")


class Executor(Protocol):
    """Something that applies a function to many items and returns the results in order."""

    @property
    def workers(self) -> int:
        """How many items are worked on at the same time."""
        ...

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Results of ``function(item)``, in the order of the items.

        `function` and each item must be picklable unless the executor is serial: a function defined at the
        top of a module, or a `functools.partial` of one. The first failing item raises its exception.
        """
        ...

    def close(self) -> None:
        """Release processes and connections; the executor starts them anew if it is used again."""
        ...

    def __enter__(self) -> Self:
        """Use as ``with``: closed at the end of the block."""
        ...

    def __exit__(self, *exc: object) -> None:
        """Close."""
        ...


class _Closing:
    """``with`` for an executor."""

    def close(self) -> None:
        """Nothing to release."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class SerialExecutor(_Closing):
    """Everything in the calling process, one item after another."""

    @property
    def workers(self) -> int:
        """Always 1."""
        return 1

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Results in order, each computed when it is asked for."""
        return (function(item) for item in items)


class ProcessExecutor(_Closing):
    """Several fresh processes of this machine, started at the first `map` and kept until `close`.

    Processes are spawned, not forked, so that threads and compiled code of the parent are never copied
    half-way. A script that uses this at its top level therefore needs ``if __name__ == "__main__":``.
    """

    def __init__(self, workers: int) -> None:
        """Keep the number of processes; start none yet."""
        self._workers = _checked_workers(workers)
        self._pool: ProcessPoolExecutor | None = None

    @property
    def workers(self) -> int:
        """Number of processes."""
        return self._workers

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Results in order; at most a few items per process are under way or waiting to be consumed."""
        from concurrent.futures import ProcessPoolExecutor
        from concurrent.futures.process import BrokenProcessPool
        from multiprocessing import get_context

        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                self._workers, mp_context=get_context("spawn"), initializer=_limit_blas_of_this_process
            )
        try:
            yield from _in_order(self._pool.submit, function, items, self._workers)
        except BrokenProcessPool as error:
            self.close()
            raise SightlineError(
                f"a worker process ended without an answer: one of {self._workers} workers was stopped, most "
                "often because memory ran out; use fewer workers, or `serial`"
            ) from error

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None


class DaskExecutor(_Closing):
    """The workers of a running dask cluster, reached by the address of its scheduler."""

    def __init__(self, address: str) -> None:
        """Keep the address; connect at first use."""
        self._address = address
        self._connected: Any = None

    def _client(self) -> Any:
        if self._connected is None:
            try:
                from distributed import Client
            except ImportError as error:
                raise InputError(
                    "the executor `dask` needs the package `distributed`, which is not installed; run "
                    "`pip install dask distributed`, or use `process`"
                ) from error
            try:
                self._connected = Client(self._address)
            except (OSError, ValueError) as error:
                raise InputError(
                    f"no dask scheduler answered at {self._address!r}: {error}; give the address printed by "
                    "the scheduler, for example dask:tcp://10.0.0.5:8786"
                ) from error
        return self._connected

    @property
    def workers(self) -> int:
        """Threads of all workers of the cluster, as it is now."""
        return max(1, sum(self._client().nthreads().values()))

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Results in order; at most a few items per worker thread are under way or waiting to be consumed."""
        client = self._client()

        def submit(function: Callable[[Item], Result], item: Item) -> Any:
            return client.submit(function, item, pure=False)

        return _in_order(submit, function, items, self.workers)

    def close(self) -> None:
        """Leave the cluster; its workers stay."""
        if self._connected is not None:
            self._connected.close()
            self._connected = None


def serial() -> SerialExecutor:
    """Executor that does everything in the calling process."""
    return SerialExecutor()


def process(workers: int | None = None) -> ProcessExecutor:
    """Executor of several processes on this machine.

    Parameters
    ----------
    workers
        Number of processes; None takes the number of processors this process may use.
    """
    return ProcessExecutor(available_processors() if workers is None else workers)


def dask(address: str) -> DaskExecutor:
    """Executor on a running dask cluster, for example ``tcp://10.0.0.5:8786``."""
    return DaskExecutor(address)


def executor_from_name(name: str, workers: int | None = None) -> Executor:
    """Executor named as on the command line.

    Parameters
    ----------
    name
        ``serial``, ``process`` or ``dask:ADDRESS`` (the address of a dask scheduler).
    workers
        Number of processes for ``process``; None takes every processor this process may use.

    Raises
    ------
    InputError
        If the name is none of these, or `workers` is given where it has no meaning.
    """
    if name == "process":
        return process(workers)
    if name == "serial":
        if workers not in (None, 1):
            raise InputError(f"`workers` = {workers} with the executor serial, which has one; use `process`")
        return serial()
    kind, _, address = name.partition(":")
    if kind == "dask" and address:
        if workers is not None:
            raise InputError(
                f"`workers` = {workers} with a dask cluster, which knows its own workers; leave it out"
            )
        return dask(address)
    raise InputError(f"unknown executor {name!r}; allowed are serial, process and dask:ADDRESS")


def one_blas_thread(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Decorator: the linear algebra inside `function` runs on one thread.

    Our matrices are banded and small: more threads wait for each other longer than they work (ten times the
    processor time, measured), and they change the order of additions, hence the last bits.
    """

    @wraps(function)
    def limited(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        import scipy.linalg  # noqa: F401  (a library that is loaded later would not be limited)
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


def machine_memory() -> float:
    """Bytes of memory that this process may use; inf where the system does not say.

    The least of the machine's and the limits of every control group it is in.
    """
    limits = _control_limits("memory", ("memory.max", "memory.limit_in_bytes"), float)
    with suppress(AttributeError, OSError, ValueError):  # not a POSIX system
        limits.append(float(os.sysconf("SC_PAGE_SIZE")) * float(os.sysconf("SC_PHYS_PAGES")))
    return min(limits, default=float("inf"))


def time_words(seconds: float) -> str:
    """A duration in the unit in which it is read: ``"3 min"``, ``"2.5 h"``."""
    for unit, size in (("years", 365.25 * 86400.0), ("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{_rounded(seconds / size, 2)} {unit}"
    return f"{seconds:.0f} s"


def size_words(size: float, digits: int = 2) -> str:
    """A number of bytes in the unit in which it is read: ``"40 MB"``, ``"0.6 GB"``."""
    for unit, many in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if size >= (0.1 * many if unit == "GB" else many):
            return f"{_rounded(size / many, digits)} {unit}"
    return f"{ceil(size / 1e3)} kB"


def _rounded(number: float, digits: int) -> str:
    """To some digits, or to a whole number where that has more."""
    return f"{number:,.0f}" if number >= 10**digits - 0.5 else f"{number:.{digits}g}"


class Progress(Protocol):
    """Shows what is being done."""

    def __call__(self, stage: str, done: int = 0, total: int | None = None) -> None:
        """Say a stage; where `total` is known, how much of it is done."""


#: Called with how much of a stage is done, and how much it is.
Step = Callable[[int, int], None]


def silent(stage: str, done: int = 0, total: int | None = None) -> None:
    """Progress that nobody asked for."""


def no_step(done: int, total: int) -> None:
    """Steps that nobody counts."""


def steps_of(progress: Progress, stage: str) -> Step:
    """Say a stage now; what it returns then counts its steps."""
    progress(stage)
    return lambda done, total: progress(stage, done, total)


def part_of(step: Step, number: int, count: int) -> Step:
    """Steps of one of so many parts alike, as steps of all of them."""
    return lambda done, total: step(number * total + done, count * total)


def stepped(items: Sequence[Item], step: Step) -> Iterator[Item]:
    """The items, each counted once it has been worked on."""
    for done, item in enumerate(items, 1):
        yield item
        step(done, len(items))


class CpuClock:
    """CPU seconds of this process by stage.

    Attributes
    ----------
    seconds : dict of str to float
        Of each stage noted so far.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.process_time()

    def note(self, stage: str) -> None:
        """Add the time since the last note to a stage."""
        now = time.process_time()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self._last = now


def available_processors() -> int:
    """Processors that this process may use, hence how many threads or processes it starts; at least 1.

    The least of those that the system lets it run on, the whole ones within the quota of every control group
    it is in (a container with 1.5 processors has 1), and ``OMP_NUM_THREADS``.
    """
    if hasattr(os, "sched_getaffinity"):
        counts = [len(os.sched_getaffinity(0))]
    else:
        counts = [os.cpu_count() or 1]
    counts += [int(quota) for quota in _control_limits("cpu", ("cpu.max", "cpu.cfs_quota_us"), _processors)]
    asked = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()  # "4,2": two nested levels
    if asked.isdecimal():
        most = int(asked[:_DIGITS]) if len(asked) <= _DIGITS else counts[0]  # more than there are, or zeros
        counts.append(most or counts[0])
    return max(1, min(counts))


def _processors(text: str) -> float:
    """Processors of ``QUOTA PERIOD``, both in microseconds; inf for a quota of -1, which is none."""
    quota, period = map(float, text.split())
    return quota / period if quota > 0.0 < period else float("inf")


def _control_limits(controller: str, names: tuple[str, str], parsed: Callable[[str], float]) -> list[float]:
    """Finite limits of one controller on this process: of its control group and of all those around it.

    `names` are those of the file with the limit in version 2 and in version 1 of control groups.
    """
    limits = []
    for folder in _control_groups(controller):
        for name in names:
            with suppress(OSError, ValueError):  # no such file, or "max": no limit
                text = (folder / name).read_text()
                if name == "cpu.cfs_quota_us":  # its period is in a file of its own
                    text += (folder / "cpu.cfs_period_us").read_text()
                limits.append(parsed(text))
    return [limit for limit in limits if isfinite(limit)]


@cache
def _control_groups(controller: str) -> list[Path]:
    """Folders of the control groups that limit this process, of both versions, from inside to outside."""
    top = Path("/sys/fs/cgroup")
    folders = []
    with suppress(OSError, ValueError, IndexError):  # not Linux
        # lines "number:controllers:group"; the number is 0 and the controllers are none in version 2
        groups = [line.split(":", 2)[1:] for line in (_PROC / "cgroup").read_text().splitlines()]
        own = {name: group for names, group in groups for name in names.split(",")}
        for line in (_PROC / "mountinfo").read_text().splitlines():
            place, _, kind = line.partition(" - ")
            root, mounted = (_unescaped(word) for word in place.split()[3:5])
            system, _, options = kind.split(maxsplit=2)
            name = {"cgroup2": "", "cgroup": controller}.get(system)
            if name is None or name not in own or (name and name not in options.split(",")):
                continue
            # what is mounted may be a part of the tree that our group lies in, as in a container
            group = Path("/", own[name])
            inside = group.relative_to(root) if group.is_relative_to(root) else Path()
            folders += [Path(mounted, part) for part in (inside, *inside.parents)]
    # where the tables do not show them: the usual places
    return list(dict.fromkeys([*folders, top / controller, top]))


def _unescaped(word: str) -> str:
    """A path of ``mountinfo``, whose blanks are written ``\\040``."""
    return re.sub(r"\\([0-7]{3})", lambda found: chr(int(found[1], 8)), word)


def in_threads(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    threads: int | None = None,
    step: Step = no_step,
) -> list[Result]:
    """Results of ``function(item)`` in the order of the items, computed on threads of this process.

    For work that releases the interpreter's lock (compiled loops, linear algebra, files). An item must not
    depend on another one: the results are then those of a plain loop.

    Parameters
    ----------
    function
        What to do with each item.
    items
        All of them are taken at once.
    threads
        Most threads at a time; None takes the number of processors this process may use.
    step
        Called with the number of items that are done, and of all.
    """
    jobs = list(items)
    count = min(available_processors() if threads is None else threads, len(jobs))
    if count <= 1:
        return [function(job) for job in stepped(jobs, step)]
    with ThreadPoolExecutor(count) as pool:
        found = []
        for result in pool.map(function, jobs):
            found.append(result)
            step(len(found), len(jobs))
        return found


def _limit_blas_of_this_process() -> None:
    """One thread for the linear algebra of a fresh process, whether numpy is loaded yet or not."""
    from threadpoolctl import threadpool_limits

    for variable in ("OMP_NUM_THREADS", *BLAS_THREADS):
        os.environ[variable] = "1"
    threadpool_limits(limits=1, user_api="blas")


def _checked_workers(workers: int) -> int:
    if workers < 1:
        raise InputError(f"`workers` must be 1 or more, got {workers}")
    return int(workers)


def _in_order(
    submit: Callable[..., Any],
    function: Callable[[Item], Result],
    items: Iterable[Item],
    workers: int,
) -> Iterator[Result]:
    """Results of submitted items in order, with a bounded number under way."""
    waiting: deque[Any] = deque()
    try:
        for item in items:
            waiting.append(submit(function, item))
            if len(waiting) >= _IN_FLIGHT_PER_WORKER * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()
