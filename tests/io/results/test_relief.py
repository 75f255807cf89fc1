"""``relief.csv``: what is written is read, and belongs to an image."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import FormatError
from sightline.io.results.relief import read_relief, write_relief
from sightline.motion.strip.relief import RowRelief

FOUND = RowRelief(
    1, np.array([0.5, 0.75, 1.0]), np.array([[1.0, -2.0], [3.5, 0.0], [4.0, 1.0]]), np.full((3, 2), 25.0)
)


def test_what_is_written_is_read(tmp_path):
    write_relief(tmp_path / "relief.csv", FOUND)
    assert (tmp_path / "relief.csv").read_text().startswith("t,height,slope,sigma_height,sigma_slope\n")
    again = read_relief(tmp_path, {"relief": {"image": "G"}}, ("B", "G"))
    assert again.image == 1
    for name in ("t", "heights", "sigma"):
        assert np.array_equal(getattr(again, name), getattr(FOUND, name))
    assert read_relief(tmp_path, {"relief": None}, ("B", "G")) is None


def test_heights_go_on_beyond_the_rows_and_tilt_across(tmp_path):
    # by hand: half way between the first two rows 2.25 and -1; before them as the first
    assert FOUND.at(np.array([0.625, 0.0]), np.array([0.5, -1.0])).tolist() == [2.25 - 0.5, 1.0 + 2.0]


@pytest.mark.parametrize("entry", [{"image": "R"}, {}, 3])
def test_relief_of_another_image_is_refused(tmp_path, entry):
    write_relief(tmp_path / "relief.csv", FOUND)
    with pytest.raises(FormatError, match=r"summary\.json"):
        read_relief(tmp_path, {"relief": entry}, ("B", "G"))


def test_relief_that_is_missing_asks_for_another_run(tmp_path):
    with pytest.raises(FormatError, match=r"relief.csv: is missing, .* run `sightline recover` again"):
        read_relief(tmp_path, {"relief": {"image": "G"}}, ("B", "G"))


def test_relief_with_rows_cut_off_is_refused(tmp_path):
    write_relief(tmp_path / "relief.csv", FOUND)
    rms = float(np.sqrt(np.mean(FOUND.heights[:, 0] ** 2)))
    entry = {"image": "G", "rms_height": rms}
    assert read_relief(tmp_path, {"relief": entry}, ("B", "G")) is not None
    rows = (tmp_path / "relief.csv").read_text().splitlines(keepends=True)
    (tmp_path / "relief.csv").write_text("".join(rows[:-1]))
    with pytest.raises(FormatError, match=r"heights are 2\.57\d+ m rms, where .* says 3\.12\d+ m: rows are"):
        read_relief(tmp_path, {"relief": entry}, ("B", "G"))
