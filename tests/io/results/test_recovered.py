"""Result folders read back: whose they are, what is in them."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from sightline.errors import FormatError, InputError
from sightline.io.acquisition.load import load_acquisition
from sightline.io.results.recovered import read_recovered


@pytest.fixture
def folder(recovery, tmp_path):
    """A copy of a result, to be spoiled."""
    return shutil.copytree(recovery.folder, tmp_path / "result")


@pytest.fixture(scope="module")
def acquisition(recovery):
    return load_acquisition(recovery.scene / "acquisition.toml")


def edit(folder, **changes):
    path = folder / "summary.json"
    summary = json.loads(path.read_text())
    for key, value in changes.items():
        if value is None:
            del summary[key]
        else:
            summary[key] = value
    path.write_text(json.dumps(summary))


def test_motion_and_statics_are_those_recovered(recovery, folder, acquisition):
    found = read_recovered(folder, acquisition)
    np.testing.assert_allclose(
        found.motion.at(recovery.result.motion.t), recovery.result.motion.angles, rtol=1e-8
    )
    assert found.statics == {s.name: pytest.approx(s.value) for s in recovery.result.statics}


def test_beyond_the_first_band_the_grid_of_the_estimate_goes_on(recovery, folder, acquisition):
    motion = read_recovered(folder, acquisition).motion
    assert motion.span[0] < recovery.result.motion.t[0] and motion.span[1] > recovery.result.motion.t[-1]
    early = motion.t[0]
    np.testing.assert_allclose(motion.at(early)[0], recovery.result.band.angles[0], rtol=1e-8)
    (folder / "covariance.npz").unlink()
    alone = read_recovered(folder, acquisition).motion
    assert alone.span == pytest.approx((recovery.result.motion.t[0], recovery.result.motion.t[-1]))


def test_a_changed_input_is_refused_by_name(recovery, folder, tmp_path):
    scene = shutil.copytree(recovery.scene, tmp_path / "scene")
    toml = scene / "acquisition.toml"
    toml.write_text(toml.read_text().replace("offset_sigma_px = 1.0", "offset_sigma_px = 2.0", 1))
    with pytest.raises(InputError, match=r"acquisition.toml was changed since; .*run it again"):
        read_recovered(folder, load_acquisition(toml))


def test_an_input_that_was_no_part_of_it_is_refused(folder, acquisition):
    summary = json.loads((folder / "summary.json").read_text())
    del summary["inputs"]["B0.tif"]
    edit(folder, inputs=summary["inputs"])
    with pytest.raises(InputError, match=r"B0.tif was no part of it"):
        read_recovered(folder, acquisition)


def cut(path, rows):
    """The first rows of a table."""
    path.write_text("".join(path.read_text().splitlines(keepends=True)[: rows + 1]))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: edit(f, inputs=None), r"`inputs`, .* is missing"),
        (lambda f: edit(f, statics=[{"name": "B1 offset along"}]), "`statics` must be a list"),
        (lambda f: edit(f, statics=[{"name": "B1 rotation", "value": float("nan")}]), "`statics` must be"),
        (lambda f: (f / "summary.json").unlink(), "`inputs`"),
        (lambda f: (f / "motion.csv").unlink(), r"motion.csv is missing"),
        (lambda f: cut(f / "motion.csv", 40), r"motion.csv: has 40 rows where `recover` wrote \d+"),
        (lambda f: (f / "covariance.npz").write_bytes(b"PK nothing"), r"covariance.npz: cannot be read"),
    ],
)
def test_what_is_missing_or_damaged_is_named(folder, acquisition, spoil, message):
    spoil(folder)
    with pytest.raises(FormatError, match=message):
        read_recovered(folder, acquisition)


def test_a_result_without_statics_has_none(folder, acquisition):
    edit(folder, statics=None)
    assert read_recovered(folder, acquisition).statics == {}
