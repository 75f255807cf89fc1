"""Finished stages: found again as they were, passed over where they are damaged or of other inputs."""

from __future__ import annotations

import errno
import re
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.stages import Stages, pack, unpack


@dataclass(frozen=True, eq=False)
class Inner:
    value: np.ndarray
    name: str


@dataclass(frozen=True, eq=False)
class Result:
    numbers: np.ndarray
    turn: Rotation
    words: tuple[str, ...]
    inner: Inner | None
    count: int
    nothing: Inner | None = None


def result() -> Result:
    rng = np.random.default_rng(1)
    turn = Rotation.from_rotvec(rng.normal(size=(4, 3)))
    return Result(rng.normal(size=(3, 2)), turn, ("", "blurred"), Inner(np.array([True, False]), "x"), 7)


@dataclass(frozen=True)
class Other:
    size: float
    word: Literal["low", "high"] = "low"


@dataclass(frozen=True, eq=False)
class Nested:
    """All that a stage may hold besides."""

    parts: tuple[Inner | Other, ...]
    pair: tuple[Other, Inner]
    numbers: tuple[float, float]
    places: tuple[int, ...]
    arrays: tuple[np.ndarray, ...]
    sparse: csr_array
    either: Inner | Other | None = None


def same(a: Result, b: Result) -> bool:
    return (
        np.array_equal(a.numbers, b.numbers)
        and np.array_equal(a.turn.as_quat(), b.turn.as_quat())
        and (a.words, a.count, a.nothing) == (b.words, b.count, b.nothing)
        and np.array_equal(a.inner.value, b.inner.value)
    )


def test_a_result_is_the_same_when_it_is_found(tmp_path):
    first, second, nowhere = Stages(tmp_path / "kept"), Stages(tmp_path / "kept"), Stages()
    for stages in (first, second, nowhere):
        stages.depend([1, "a"])
    made = [stages.stage("one", Result, result) for stages in (first, second, nowhere)]
    assert (first.computed, first.found) == (["one"], []) and (second.computed, second.found) == ([], ["one"])
    assert same(made[0], made[1]) and same(made[0], made[2])
    assert not made[1].numbers.flags.writeable
    second.remove()
    assert not (tmp_path / "kept").exists()


def test_tuples_of_whatever_parts_and_sparse_arrays_are_found_as_they_were(tmp_path):
    sparse = csr_array(np.array([[0.0, 1.5], [0.0, -2.0]]))
    made = Nested(
        (Other(2.0, "high"), Inner(np.arange(3), "x")), (Other(1.0), Inner(np.zeros(0), "y")), (0.1, -0.0),
        (),
        (np.eye(2), np.asfortranarray(np.arange(6.0).reshape(2, 3))), sparse, Other(3.0),
    )  # fmt: skip
    Stages(tmp_path).put("one", made)
    stages = Stages(tmp_path)
    found = stages.held("one", Nested, writeable=True)
    assert stages.found == ["one"] and stages.held("two", Nested) is None
    assert found.parts[0] == made.parts[0] and found.pair[0] == made.pair[0] and found.either == made.either
    assert np.array_equal(found.parts[1].value, np.arange(3)) and found.parts[1].name == "x"
    assert (found.numbers, found.places, found.pair[1].value.shape) == ((0.1, -0.0), (), (0,))
    assert [a.tolist() for a in found.arrays] == [a.tolist() for a in made.arrays]
    assert [a.flags.f_contiguous for a in found.arrays] == [False, True] and found.arrays[0].flags.writeable
    assert np.array_equal(found.sparse.indptr, sparse.indptr) and (found.sparse - sparse).nnz == 0


def test_large_arrays_are_found_as_they_were_and_numpy_reads_what_is_kept(tmp_path):
    large = np.arange(300_000.0).reshape(3, -1)
    Stages(tmp_path).put("one", Inner(large, "x"))
    (path,) = tmp_path.iterdir()
    with np.load(path) as file:
        np.testing.assert_array_equal(file["value"], large)
    found = Stages(tmp_path).held("one", Inner, writeable=True)
    np.testing.assert_array_equal(found.value, large)
    assert found.value.flags.writeable and found.value.flags.c_contiguous


def test_a_part_of_another_class_is_none_of_the_result(tmp_path):
    @dataclass(frozen=True)
    class Held:
        inner: Other

    said: list[str] = []
    Stages(tmp_path).put("one", Result(np.zeros(1), Rotation.identity(), (), Inner(np.zeros(1), "x"), 1))
    assert Stages(tmp_path, said.append).held("one", Held) is None
    assert "inner is no Inner" in said[0]


@pytest.mark.parametrize("damage", ["cut", "flipped", "text", "empty", "newer", "locked", "method", "other"])
def test_damaged_and_foreign_files_are_passed_over_with_a_warning(tmp_path, damage):
    Stages(tmp_path).stage("one", Result, result)
    path = tmp_path / "one.stage.npz"
    data = bytearray(path.read_bytes())
    if damage == "cut":
        path.write_bytes(data[: len(data) // 2])
    elif damage == "flipped":
        # a bit within the numbers, which the sum of the archive's member tells
        at = data.index(result().numbers.tobytes()[:16])
        data[at] ^= 1
        path.write_bytes(data)
    elif damage in ("newer", "locked", "method"):
        # version, flags and method of compression that each entry of the archive's directory claims
        for at in (found.start() for found in re.finditer(b"PK\x01\x02", data)):
            data[at + {"newer": 6, "locked": 8, "method": 10}[damage]] = {
                "newer": 100,
                "locked": 1,
                "method": 99,
            }[damage]
        path.write_bytes(data)
    elif damage == "text":
        path.write_text("not an archive")
    elif damage == "empty":
        path.write_bytes(b"")
    else:
        np.savez(path, fingerprint=np.array("0"), numbers=np.zeros(3))
    said: list[str] = []
    stages = Stages(tmp_path, said.append)
    assert same(stages.stage("one", Result, result), result())
    assert stages.computed == ["one"] and len(said) == 1
    assert "one.stage.npz is passed over" in said[0] and "done again" in said[0]


def test_a_folder_that_cannot_be_written_stops_nothing(tmp_path):
    (tmp_path / "kept").write_text("a file")
    said: list[str] = []
    stages = Stages(tmp_path / "kept", said.append)
    for name in ("one", "two"):
        assert same(stages.stage(name, Result, result), result())
    assert len(said) == 1 and "stages are not kept" in said[0]


@pytest.mark.parametrize("name", ["one.stage.npz", "one.stage.npz.tmp"])
def test_links_among_stages_are_neither_read_nor_written_through(tmp_path, name):
    elsewhere = tmp_path / "elsewhere"
    Stages(elsewhere).stage("one", Result, result)
    before = (elsewhere / "one.stage.npz").read_bytes()
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / name).symlink_to(elsewhere / "one.stage.npz")
    said: list[str] = []
    stages = Stages(tmp_path / "kept", said.append)
    assert same(stages.stage("one", Result, result), result()) and stages.computed == ["one"]
    assert (elsewhere / "one.stage.npz").read_bytes() == before
    assert not (tmp_path / "kept" / "one.stage.npz").is_symlink()
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["one.stage.npz"]
    assert len(said) == (not name.endswith("tmp")) and all("is a link" in words for words in said)


def test_a_disk_without_room_for_a_stage_keeps_no_half_of_it(tmp_path, monkeypatch):
    def full(file, _):
        file.write(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("sightline.stages._save", full)
    said: list[str] = []
    assert same(Stages(tmp_path, said.append).stage("one", Result, result), result())
    assert not list(tmp_path.iterdir())
    assert len(said) == 1 and "No space left" in said[0]


def test_files_of_the_problem_count_by_name_size_and_time(tmp_path):
    file = tmp_path / "frame.tif"
    file.write_text("a")

    def run(*inputs: object) -> list[str]:
        stages = Stages(tmp_path / "kept")
        stages.depend([file, Inner(np.zeros(3), "x"), *inputs])
        stages.stage("one", Inner, lambda: Inner(np.ones(2), "y"))
        return stages.computed

    assert run() == ["one"] and run() == []
    file.write_text("bb")
    assert run() == ["one"] and run() == []
    assert run(0.1) == ["one"] and run(0.2) == ["one"]


def test_what_a_run_before_the_stopped_one_left_is_no_reason_to_refuse(tmp_path):
    def run(number: float, names: str, *, refuse: bool = False) -> list[str]:
        stages = Stages(tmp_path, refuse=refuse)
        stages.depend(number)
        for name in names:
            stages.stage(name, Inner, lambda: Inner(np.full(1, number), "x"))
        return stages.computed

    assert run(1.0, "abc") == ["a", "b", "c"]
    with pytest.raises(InputError, match="cannot go on from it"):
        run(2.0, "abc", refuse=True)
    assert run(2.0, "a") == ["a"]  # and was stopped
    assert run(2.0, "abc", refuse=True) == ["b", "c"]


@pytest.mark.parametrize("nested", [False, True])
def test_going_on_where_another_command_was_stopped_leaves_its_stages(tmp_path, nested):
    def run(folder, name: str, *, refuse: bool) -> None:
        stages = Stages(folder, refuse=refuse)
        if nested:
            stages.stage(f"{name}-all", Other, lambda: stages.once(name, Other, lambda: Other(1.0)))
        else:
            stages.once(name, Other, lambda: Other(1.0))

    run(tmp_path / "one", "poses", refuse=False)
    before = {path.name: path.read_bytes() for path in (tmp_path / "one").iterdir()}
    with pytest.raises(InputError, match=r"poses.*another command.*leave --resume out"):
        run(tmp_path / "one", "table", refuse=True)
    assert {path.name: path.read_bytes() for path in (tmp_path / "one").iterdir()} == before
    # its own are gone on from, whole or damaged
    run(tmp_path / "one", "poses", refuse=True)
    for path in (tmp_path / "one").iterdir():
        path.write_bytes(b"cut")
    run(tmp_path / "one", "poses", refuse=True)


def test_a_stage_within_a_stage_does_not_change_those_after_it(tmp_path):
    def outer(stages: Stages) -> Inner:
        stages.depend("within")
        return stages.stage("inner", Inner, lambda: Inner(np.ones(1), "x"))

    for expected in (["inner", "outer", "last"], []):
        stages = Stages(tmp_path)
        stages.stage("outer", Inner, lambda stages=stages: outer(stages))
        stages.stage("last", Inner, lambda: Inner(np.ones(1), "x"))
        assert stages.computed == expected


def test_seconds_of_an_earlier_start_come_with_what_is_taken_over(tmp_path, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("sightline.stages.time.process_time", lambda: now[0])

    def worked(seconds: float) -> Inner:
        now[0] += seconds
        return Inner(np.ones(1), "x")

    def outer(stages: Stages, stop: bool) -> Inner:
        for number in range(2):
            if stages.has(f"part-{number}"):
                stages.stage(f"part-{number}", Inner, lambda: worked(100.0))
            elif stop and number == 1:
                raise KeyboardInterrupt
            else:
                stages.keep(f"part-{number}", worked(2.0 + number))
        return Inner(np.ones(1), "x")

    with pytest.raises(KeyboardInterrupt):
        stopped = Stages(tmp_path)
        stopped.stage("outer", Inner, lambda: outer(stopped, True))
    # the seconds of the first start are in the whole's, with what the second took itself
    second = Stages(tmp_path)
    second.stage("outer", Inner, lambda: outer(second, False))
    assert second.found == ["part-0"] and second.taken_over == 2.0
    third = Stages(tmp_path)
    third.stage("outer", Inner, lambda: outer(third, False))
    assert third.found == ["outer"] and third.taken_over == 5.0


def test_packed_arrays_of_another_kind_are_refused():
    with pytest.raises(KeyError):
        unpack(Result, pack(Inner(np.zeros(1), "x")))
