"""The output folder: nothing half-written under a final name, nothing of the user's lost."""

from __future__ import annotations

import os

import pytest

from sightline.cli.output import check_output_folder, output_folder, remove_earlier
from sightline.errors import InputError


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


def test_files_appear_under_their_names_only_when_the_block_ends_well(tmp_path):
    folder = tmp_path / "deep" / "result"
    with output_folder(folder) as staging:
        (staging / "motion.csv").write_text("t\n")
        (staging / "maps").mkdir()
        (staging / "maps" / "a.tif").write_text("x")
        assert names(folder) == [".partial"]
    assert names(folder) == ["maps", "motion.csv"]
    assert (folder / "maps" / "a.tif").read_text() == "x"


def test_a_failed_run_leaves_nothing_behind(tmp_path):
    folder = tmp_path / "result"
    with pytest.raises(RuntimeError), output_folder(folder) as staging:
        (staging / "motion.csv").write_text("t\n")
        raise RuntimeError
    assert not folder.exists()


def test_a_failed_run_leaves_an_earlier_result_as_it_was(tmp_path):
    (tmp_path / "motion.csv").write_text("earlier")
    with pytest.raises(RuntimeError), output_folder(tmp_path, overwrite=True) as staging:
        (staging / "motion.csv").write_text("half")
        raise RuntimeError
    assert names(tmp_path) == ["motion.csv"]
    assert (tmp_path / "motion.csv").read_text() == "earlier"


def test_a_folder_that_holds_something_is_refused_without_overwrite(tmp_path):
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match=r"holds mine\.txt.*add --overwrite"), output_folder(tmp_path):
        pass
    with pytest.raises(InputError, match="not empty"):
        check_output_folder(tmp_path)
    with output_folder(tmp_path, overwrite=True) as staging:
        (staging / "motion.csv").write_text("new")
    assert names(tmp_path) == ["mine.txt", "motion.csv"]


def test_what_a_killed_run_left_does_not_count_as_a_result(tmp_path):
    (tmp_path / ".partial").mkdir()
    (tmp_path / ".partial" / "motion.csv").write_text("half")
    with output_folder(tmp_path) as staging:
        (staging / "summary.json").write_text("{}")
    assert names(tmp_path) == ["summary.json"]


def test_a_folder_of_an_earlier_result_is_replaced_whole(tmp_path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "old.tif").write_text("old")
    with output_folder(tmp_path, overwrite=True) as staging:
        (staging / "maps").mkdir()
        (staging / "maps" / "new.tif").write_text("new")
    assert names(tmp_path / "maps") == ["new.tif"]


def test_only_the_named_files_of_an_earlier_run_go_and_no_input(tmp_path):
    for name in ("attitude.aem", "hidden.csv", "mine.txt"):
        (tmp_path / name).write_text("x")
    remove_earlier(tmp_path, ["attitude.aem", "hidden.csv", "report.html"], [tmp_path / "attitude.aem"])
    assert names(tmp_path) == ["attitude.aem", "mine.txt"]


def test_a_file_is_no_output_folder(tmp_path):
    (tmp_path / "result").write_text("a file")
    with pytest.raises(InputError, match="is a file"), output_folder(tmp_path / "result"):
        pass


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="not applicable: root may write anywhere"
)
def test_a_folder_one_may_not_write_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="cannot write"), output_folder(tmp_path / "result"):
        pass
