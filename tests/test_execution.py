"""Executors give the same results, in order, and say clearly what is wrong."""

from __future__ import annotations

import os
from functools import partial

import numpy as np
import pytest

from sightline.errors import InputError, SightlineError
from sightline.execution import (
    available_processors,
    executor_from_name,
    in_threads,
    one_blas_thread,
    process,
    serial,
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


def test_a_worker_that_dies_is_reported_with_advice():
    with process(1) as executor, pytest.raises(SightlineError, match="fewer workers"):
        list(executor.map(ends_the_process, range(2)))


def test_executors_are_found_by_name():
    assert executor_from_name("serial").workers == 1
    assert executor_from_name("process", 3).workers == 3
    assert executor_from_name("process").workers == available_processors()


@pytest.mark.parametrize(
    ("name", "workers", "message"),
    [
        ("threads", None, "unknown executor 'threads'; allowed are serial, process and dask:ADDRESS"),
        ("dask", None, "unknown executor 'dask'"),
        ("process", 0, "`workers` must be 1 or more, got 0"),
        ("serial", 4, "use `process`"),
        ("dask:tcp://127.0.0.1:9", 4, "leave it out"),
    ],
)
def test_a_wrong_executor_is_refused_with_what_is_allowed(name, workers, message):
    with pytest.raises(InputError, match=message):
        executor_from_name(name, workers)


def test_dask_gives_the_same_results():
    distributed = pytest.importorskip("distributed")
    expected = [result.tobytes() for result in serial().map(smoothed_noise, range(7))]
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
        ) as cluster,
        executor_from_name(f"dask:{cluster.scheduler_address}") as executor,
    ):
        assert executor.workers == 2
        assert [result.tobytes() for result in executor.map(smoothed_noise, range(7))] == expected
