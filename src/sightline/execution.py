"""Where work runs: in this process, in several, or on a dask cluster; and on how many threads.

All give bitwise the same results: they come in the order of the items or by their number, every caller
reduces them in that order, work is cut into items by its size, never by the number of workers, and linear
algebra runs on one thread (`one_blas_thread`).

Items of an `Executor` are whole runs of a command, or what a script has of its own. Inside a run work is
shared by threads (`in_threads`): its arrays are large and its steps short, so that sending them to other
processes takes longer than the steps do.

This file does not cut work into items: each caller knows its own.
"""

from __future__ import annotations

import os
import re
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from contextvars import copy_context
from dataclasses import dataclass
from functools import cache, partial, wraps
from math import ceil, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, Protocol, Self, TypeVar, cast

from sightline.errors import InputError, SightlineError

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from types import FrameType

Item = TypeVar("Item")
Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")

# Items submitted and not yet consumed, per worker: enough to keep all busy, few enough to bound memory.
_IN_FLIGHT_PER_WORKER = 3
#: How often an item is begun at most whose worker ends without an answer: of many that are stopped at random
#: all get through, and one that takes its worker's memory does not come back forever.
TRIES = 10
#: s that a worker has to tidy up in when it is asked to end, and between looks at a cluster.
_TIDIES, _LOOKS = 60.0, 1.0
#: s within which a scheduler answers.
_CONNECTS = 10.0

#: glibc's number of the option that bounds its heaps (``malloc.h``).
M_ARENA_MAX = -8
#: What libraries of linear algebra read when they are loaded; more particular than OMP_NUM_THREADS.
BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")

# Of a number of threads or workers that is read at all: Python refuses thousands of them.
_DIGITS = 9
#: Workers that may be asked for.
_MOST_WORKERS = 10_000
# What the system says of this process.
_PROC = Path("/proc/self")


@dataclass(frozen=True)
class Workers:
    """What ``--workers`` says.

    Attributes
    ----------
    kind : str
        ``"here"``, ``"process"`` or ``"dask"``.
    count : int or None
        Threads or processes; None: not said.
    address : str
        Of a dask scheduler, or ``"local"``; "" of the others.
    """

    kind: str
    count: int | None = None
    address: str = ""

    @classmethod
    def read(cls, text: str) -> Workers:
        """What a word stands for: ``N``, ``process``, ``process:N``, ``dask:ADDRESS``, ``dask:local``.

        Raises
        ------
        InputError
            If it is none of these.
        """
        kind, colon, rest = text.strip().partition(":")
        if not colon and (kind == "serial" or re.fullmatch(r"[+-]?\d+", kind)):
            return cls("here", 1 if kind == "serial" else _count(kind, text))
        if kind == "process" and (rest or not colon):
            return cls("process", _count(rest, text) if rest else None)
        if kind == "dask" and rest:
            return cls("dask", None, rest)
        said = {
            "dask": "lacks the address of a scheduler",
            "process": "lacks a number of processes",
        }.get(kind, "is not known")
        raise InputError(f"`workers` = {text!r} {said}; {_ALLOWED}")


_ALLOWED = "allowed are N, process:N, dask:ADDRESS (as dask:tcp://10.0.0.5:8786) and dask:local, N from 1 on"


def _count(word: str, text: str) -> int:
    """A number of workers."""
    digits = word.lstrip("+").lstrip("0") or "0"
    number = int(digits) if digits.isascii() and digits.isdigit() and len(digits) <= _DIGITS else 0
    if not 1 <= number <= _MOST_WORKERS:
        raise InputError(
            f"`workers` = {text!r}: {word} is no whole number from 1 to {_MOST_WORKERS}; {_ALLOWED}"
        )
    return number


class Executor(Protocol):
    """Something that applies a function to many items.

    A function and its items must be picklable unless the executor is serial: a function defined at the top of
    a module, or a `functools.partial` of one. A worker has one item at a time. An item whose worker ends
    without an answer (it was stopped, or memory ran out) is begun again on another one, ten times at most.
    """

    @property
    def workers(self) -> int:
        """How many items are worked on at the same time."""
        ...

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Results of ``function(item)``, in the order of the items.

        The first failing item raises its exception; SightlineError where workers end again and again.
        """
        ...

    def completed(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        *,
        lost: Callable[[Item, str], Result],
        begun: Callable[[int], None] = ...,
    ) -> Iterator[tuple[int, Result]]:
        """Number and result of each item, as they are done.

        Parameters
        ----------
        function : callable
        items : sequence
        lost : callable
            Gives the result of an item whose workers ended again and again, from it and the reason.
        begun : callable, optional
            Called with the number of an item that is given to a worker.

        Raises
        ------
        Exception
            That of the first item that raises one; SightlineError where all workers are gone, as when the
            scheduler of a cluster ends.
        """
        ...

    def close(self) -> None:
        """End or release the workers; they are started anew if the executor is used again."""
        ...

    def __enter__(self) -> Self:
        """Use as ``with``: closed at the end of the block."""
        ...

    def __exit__(self, *exc: object) -> None:
        """Close."""
        ...


class _LostError(Exception):
    """A worker ended without an answer; the message says how. Not seen outside this file."""

    def __init__(self, how: str, tries: int = 1) -> None:
        super().__init__(how)
        self.tries = tries


def _unsaid(number: int) -> None:
    """Items that nobody counts."""


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

    def completed(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        *,
        lost: Callable[[Item, str], Result],
        begun: Callable[[int], None] = _unsaid,
    ) -> Iterator[tuple[int, Result]]:
        """Results in order; nothing is lost but with the process itself."""
        for number, item in enumerate(items):
            begun(number)
            yield number, function(item)


class _Submitting(_Closing):
    """What executors with workers share: items submitted, and submitted again where a worker was lost."""

    @property
    def workers(self) -> int:
        """How many items are worked on at the same time."""
        raise NotImplementedError

    def _submit(self, function: Callable[[Item], Result], item: Item) -> Future[Result]:
        """The item given to a worker, whose end without an answer is a `_LostError`."""
        raise NotImplementedError

    def _look(self) -> None:
        """Raise where no answer will come any more."""

    def _answer(self, future: Future[Result]) -> Result:
        """An answer, once it is there."""
        while not wait([future], timeout=_LOOKS).done:
            self._look()
        return future.result()

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Results in order; at most a few items per worker are under way or waiting to be consumed."""
        waiting: deque[tuple[Future[Result], Item]] = deque()
        most = _IN_FLIGHT_PER_WORKER * self.workers

        def first() -> Result:
            future, item = waiting.popleft()
            tries = 0
            while True:
                try:
                    return self._answer(future)
                except _LostError as error:
                    tries += error.tries
                    if tries >= TRIES:
                        raise SightlineError(
                            f"{tries} times a worker ended without an answer: {error}; most often memory ran "
                            "out: use fewer workers, or `serial`"
                        ) from error
                    future = self._submit(function, item)

        try:
            for item in items:
                waiting.append((self._submit(function, item), item))
                if len(waiting) >= most:
                    yield first()
            while waiting:
                yield first()
        finally:
            for future, _ in waiting:
                future.cancel()

    def completed(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        *,
        lost: Callable[[Item, str], Result],
        begun: Callable[[int], None] = _unsaid,
    ) -> Iterator[tuple[int, Result]]:
        """Results as they come; no more items are under way than there are workers."""
        queue, tries = deque(range(len(items))), dict.fromkeys(range(len(items)), 0)
        running: dict[Future[Result], int] = {}
        try:
            while queue or running:
                while queue and len(running) < self.workers:
                    number = queue.popleft()
                    running[self._submit(function, items[number])] = number
                    begun(number)
                done = wait(running, timeout=_LOOKS, return_when=FIRST_COMPLETED).done
                self._look()
                for future in done:
                    number = running.pop(future)
                    try:
                        yield number, future.result()
                    except _LostError as error:
                        tries[number] += error.tries
                        if tries[number] < TRIES:
                            queue.append(number)
                        else:
                            yield number, lost(items[number], f"{tries[number]} times {error}")
        finally:
            for future in running:
                future.cancel()


class ProcessExecutor(_Submitting):
    """Several fresh processes of this machine, started when they are first needed and kept until `close`.

    Processes are spawned, not forked, so that threads and compiled code of the parent are never copied
    half-way. A script that uses this at its top level therefore needs ``if __name__ == "__main__":``. Each
    has its share of the processors for threads of its own.
    """

    def __init__(self, workers: int, threads: int | None = None) -> None:
        """Keep the numbers of processes, and of threads in each (None: its share); start none yet."""
        if workers < 1:
            raise InputError(f"`workers` must be 1 or more, got {workers}")
        self._workers = int(workers)
        self._threads = max(1, available_processors() // self._workers) if threads is None else threads
        self._hands: ThreadPoolExecutor | None = None
        self._free: deque[_Process] = deque()
        self._all: set[_Process] = set()
        self._closing = False

    @property
    def workers(self) -> int:
        """Number of processes."""
        return self._workers

    def _submit(self, function: Callable[[Item], Result], item: Item) -> Future[Result]:
        if self._hands is None:
            # a thread for each process, which hands it an item and waits for the answer
            self._hands = ThreadPoolExecutor(self._workers)
        return self._hands.submit(self._asked, function, item)

    def _asked(self, function: Callable[[Item], Result], item: Item) -> Result:
        """The answer of a process that is free; no more items are asked at once than there are."""
        if self._closing:
            raise _LostError("the run was ended")
        try:
            worker = self._free.popleft()
        except IndexError:
            worker = _Process(self._threads)
            self._all.add(worker)
        try:
            good, answer = worker.ask(function, item)
        except (EOFError, OSError) as error:
            self._all.discard(worker)
            raise _LostError(f"a worker process ended without an answer ({worker.ended()})") from error
        self._free.append(worker)
        if not good:
            raise answer
        return answer

    def close(self) -> None:
        """End the processes; one that has an item under way is asked to leave nothing half-done."""
        self._closing = True
        for worker in list(self._all):
            worker.end()
        if self._hands is not None:
            self._hands.shutdown(wait=True, cancel_futures=True)
            self._hands = None
        for worker in list(self._all):
            worker.end()
            worker.ended()
        self._free.clear()
        self._all.clear()
        self._closing = False


class _Process:
    """One process of a `ProcessExecutor`."""

    def __init__(self, threads: int) -> None:
        from multiprocessing import get_context

        context = get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, threads), daemon=True)
        self._process.start()
        theirs.close()  # so that its end is seen here

    def ask(self, function: Callable[[Item], Result], item: Item) -> tuple[bool, Any]:
        """Whether an item went well, and its result or exception; EOFError or OSError if the process ends."""
        self._connection.send((function, item))
        answer: tuple[bool, Any] = self._connection.recv()
        return answer

    def end(self) -> None:
        """Ask it to end."""
        with suppress(OSError, ValueError):
            self._process.terminate()

    def ended(self) -> str:
        """How it ended, in words, once it has."""
        self._process.join(_TIDIES)
        if self._process.exitcode is None:
            self._process.kill()
            self._process.join()
        code = self._process.exitcode or 0
        self._connection.close()
        if code >= 0:
            return f"exit status {code}"
        with suppress(ValueError):
            return f"stopped by {signal.Signals(-code).name}"
        return f"stopped by signal {-code}"


def _serve(connection: Connection[Any, Any], threads: int) -> None:
    """What a process of a `ProcessExecutor` does: items one after the other, until nobody asks any more."""

    def stop(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # asked once: tidying up is not interrupted
        raise KeyboardInterrupt

    # Ctrl-C reaches every process of the terminal: who started this one decides, and asks by SIGTERM
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _limit_blas_of_this_process()
    one_heap()
    with suppress(EOFError, OSError, KeyboardInterrupt), threads_limited(threads):
        try:
            signal.signal(signal.SIGTERM, stop)
            while True:
                function, item = connection.recv()
                try:
                    answer = True, function(item)
                except Exception as error:
                    answer = False, error
                try:
                    connection.send(answer)
                except (TypeError, AttributeError, ValueError) as error:  # what cannot be pickled
                    connection.send((False, SightlineError(f"an answer cannot be sent: {error}")))
        finally:  # it leaves by itself now: asked to, it would end with a traceback
            signal.signal(signal.SIGTERM, signal.SIG_IGN)


@contextmanager
def signals_kept() -> Iterator[None]:
    """Signals do after it what they did before.

    A library that is imported inside may have taken SIGTERM for a dump of its stack: a command that is asked
    to end would then end without tidying up.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heeded = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        # what Python knows of it has not changed, what the system calls may have
        signal.signal(signal.SIGTERM, signal.SIG_DFL if heeded is None else heeded)


class DaskExecutor(_Submitting):
    """The workers of a dask cluster: of a running one, by the address of its scheduler, or of this machine.

    A worker has one item at a time, with as many threads as dask has given it.
    """

    def __init__(self, address: str) -> None:
        """Keep the address, or ``"local"`` for a cluster of this machine; connect at first use."""
        self._address = address
        self._connected: Any = None
        self._cluster: Any = None

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
                if self._address == "local":
                    self._cluster = _local_cluster()
                self._connected = Client(self._cluster or self._address, timeout=_CONNECTS)
            except (OSError, ValueError, ImportError) as error:
                raise InputError(
                    f"no dask scheduler answered at {self._address!r}: {error}; give the address printed by "
                    "the scheduler, for example dask:tcp://10.0.0.5:8786"
                ) from error
        return self._connected

    @property
    def workers(self) -> int:
        """Workers of the cluster, as it is now; 1 where it waits for the first."""
        return max(1, len(self._client().nthreads()))

    def _submit(self, function: Callable[[Item], Result], item: Item) -> Future[Result]:
        ours: Future[Result] = Future()
        theirs = self._client().submit(partial(_on_worker, function), item, pure=False)

        def told(done: Any) -> None:
            from distributed import KilledWorker

            if ours.cancelled():
                return
            try:
                if done.status not in ("finished", "error"):  # the scheduler is gone, or has another memory
                    raise _LostError(f"the cluster has {done.status or 'lost'} it")
                ours.set_result(done.result())
            except _LostError as error:
                ours.set_exception(error)
            except KilledWorker as error:
                how = "a worker of the cluster ended without an answer"
                ours.set_exception(_LostError(how, getattr(error, "allowed_failures", 0) + 1))
            except Exception as error:
                ours.set_exception(error)

        theirs.add_done_callback(told)
        return ours

    def _look(self) -> None:
        if self._connected is not None and self._connected.status != "running":
            raise SightlineError(
                f"the dask scheduler at {self._address!r} does not answer any more; what is finished is "
                "kept: start a scheduler and run the same command again with --resume"
            )

    def close(self) -> None:
        """Leave the cluster, whose workers stay; one that was started here ends."""
        connected, self._connected = self._connected, None
        cluster, self._cluster = self._cluster, None
        for one in (connected, cluster):
            if one is not None:
                with suppress(OSError, TimeoutError):
                    one.close()


def _local_cluster() -> Any:
    """A dask cluster of this machine: a worker for each processor.

    What dask does beside the work is left out: its profiler, and allocation that gives memory back at once
    (two fifths more CPU time of a recovery, measured: docs/batch.md).
    """
    import logging

    import dask.config
    from distributed import LocalCluster

    plain = {"distributed.worker.profile.enabled": False, "distributed.nanny.pre-spawn-environ": {}}
    with dask.config.set(plain):
        return LocalCluster(
            n_workers=available_processors(),
            threads_per_worker=1,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
        )


#: A worker of a cluster may have several threads, and an item has all of them.
_one_item = threading.Lock()


def _on_worker(function: Callable[[Item], Result], item: Item) -> Result:
    """An item on a worker of a dask cluster."""
    from distributed import get_worker

    with _one_item, threads_limited(get_worker().state.nthreads):
        return one_blas_thread(function)(item)


def _limit_blas_of_this_process() -> None:
    """One thread for the linear algebra of a fresh process, whether numpy is loaded yet or not."""
    from threadpoolctl import threadpool_limits

    for variable in ("OMP_NUM_THREADS", *BLAS_THREADS):
        os.environ[variable] = "1"
    threadpool_limits(limits=1, user_api="blas")


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
    """Executor on a running dask cluster (``tcp://10.0.0.5:8786``), or a ``local`` one of its own."""
    return DaskExecutor(address)


def executor_from_name(name: str) -> Executor:
    """Executor named as by ``--workers``.

    Parameters
    ----------
    name
        ``N`` or ``process:N``: so many processes (``1`` and ``serial``: this one; ``process``: one for every
        processor that this process may use); ``dask:ADDRESS``: the workers of the cluster whose scheduler has
        this address; ``dask:local``: a cluster of this machine.

    Raises
    ------
    InputError
        If the name is none of these.
    """
    asked = Workers.read(name)
    if asked.kind == "dask":
        return dask(asked.address)
    return serial() if asked == Workers("here", 1) else process(asked.count)


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


#: Most threads at a time, where a number was given; it holds for the whole process, innermost last.
_threads: list[int] = []


@contextmanager
def threads_limited(count: int | None) -> Iterator[None]:
    """So many threads for what this process does in the block; None: as before."""
    before = list(_threads)
    give_threads(count)
    try:
        yield
    finally:
        _threads[:] = before


def give_threads(count: int | None) -> None:
    """So many threads from now on, whatever processors there are; None changes nothing."""
    if count is not None:
        _threads.append(count)


def thread_count() -> int:
    """Threads that work is shared by: as many as were given, else as processors that may be used."""
    return _threads[-1] if _threads else available_processors()


@cache
def _of_c_library(name: str) -> Callable[..., int] | None:
    """A function of glibc; None where the C library has none of that name."""
    import ctypes

    try:
        return cast("Callable[..., int]", getattr(ctypes.CDLL(None), name))
    except (AttributeError, OSError, TypeError):
        return None


def one_heap() -> None:
    """Let all threads of this process take memory from one heap, before there are any.

    Each of those that threads have for themselves would keep what was freed in it: a tenth of a long run's
    memory. ``MALLOC_ARENA_MAX`` of the environment, or its newer name in ``GLIBC_TUNABLES``, comes first.
    """
    options = _of_c_library("mallopt")
    asked = "MALLOC_ARENA_MAX" in os.environ or ".arena_max=" in os.environ.get("GLIBC_TUNABLES", "")
    if options is not None and not asked:
        options(M_ARENA_MAX, 1)


def give_back_memory() -> None:
    """Hand memory that was freed back to the system, where the C library would keep it for what comes next.

    Arrays of some megabytes leave holes among small objects: a long run would hold them to its end.
    """
    trim = _of_c_library("malloc_trim")
    if trim is not None:
        trim(0)


def slices(count: int, at_once: int) -> list[slice]:
    """So many items in pieces of `at_once` and a last one: what is made of all at once grows with them."""
    return [slice(begin, min(begin + at_once, count)) for begin in range(0, count, at_once)]


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
        Most threads at a time; None takes `thread_count`.
    step
        Called with the number of items that are done, and of all.
    """
    jobs = list(items)
    count = min(thread_count() if threads is None else threads, len(jobs))
    if count <= 1:
        return [function(job) for job in stepped(jobs, step)]
    # where scratch files go, and what may be read, is the caller's
    around = copy_context()
    with ThreadPoolExecutor(count) as pool:
        found = []
        for result in pool.map(lambda job: around.copy().run(function, job), jobs):
            found.append(result)
            step(len(found), len(jobs))
        return found
