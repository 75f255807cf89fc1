"""A result folder as the choice of TDI stages takes it, beside the same recovery in memory."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sightline.errors import FormatError, InputError
from sightline.io.acquisition.load import load_acquisition
from sightline.io.tdi.motion import read_motion_knowledge
from tdi.knowledge_in_memory import motion_knowledge


@pytest.fixture
def folder(recovery, tmp_path):
    """A copy of a result, to be spoiled."""
    return shutil.copytree(recovery.folder, tmp_path / "result")


@pytest.fixture(scope="module")
def acquisition(recovery):
    return load_acquisition(recovery.scene / "acquisition.toml")


def edit_hidden(folder, **changes):
    path = folder / "summary.json"
    summary = json.loads(path.read_text())
    for key, value in changes.items():
        if value is None:
            summary["hidden_directions"].pop(key)
        else:
            summary["hidden_directions"][key] = value
    path.write_text(json.dumps(summary))


def test_the_folder_says_what_the_recovery_does(recovery, folder, acquisition):
    result = recovery.result
    read, known = read_motion_knowledge(folder, acquisition), motion_knowledge(result)
    found = read.knowledge
    assert found.warnings == () and not found.exact
    # nine digits of the files
    assert_allclose(found.frequency, known.frequency, rtol=1e-8)
    assert_allclose(found.error_psd, known.error_psd, rtol=1e-7)
    assert_allclose(found.jitter, known.jitter, rtol=1e-7)
    assert_allclose(found.hidden_covariance, result.hidden_covariance, rtol=1e-12)
    inside = (found.motion.t >= result.motion.t[0]) & (found.motion.t <= result.motion.t[-1])
    size = np.abs(result.hidden).max()
    assert_allclose(found.hidden[inside], result.hidden, atol=1e-8 * size)
    assert len(found.hidden) == len(found.motion.t) > len(result.motion.t)
    assert read.statics_sigma == {s.name: pytest.approx(s.sigma) for s in result.statics}


def test_a_covariance_of_hidden_directions_is_one(recovery):
    covariance = recovery.result.hidden_covariance
    assert covariance.shape == (recovery.result.hidden.shape[2],) * 2
    assert_allclose(covariance, covariance.T, atol=1e-9 * np.abs(covariance).max())
    correlation = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert np.linalg.eigvalsh(correlation).min() > -1e-9


def test_a_result_that_does_not_say_how_much_is_hidden_warns(folder, acquisition):
    edit_hidden(folder, covariance=None)
    found = read_motion_knowledge(folder, acquisition).knowledge
    assert found.hidden is None
    assert "hidden directions (constant of roll" in found.warnings[0]
    assert "sigma_slip" in found.warnings[0]


@pytest.mark.parametrize("wrong", [[[1.0]], "big", [[None] * 6] * 6])
def test_a_covariance_of_another_form_is_refused(folder, acquisition, wrong):
    edit_hidden(folder, covariance=wrong)
    with pytest.raises(FormatError, match=r"`hidden_directions\.covariance` must be"):
        read_motion_knowledge(folder, acquisition)


def test_a_spectrum_that_is_none_is_refused(folder, acquisition):
    path = folder / "spectrum.csv"
    rows = path.read_text().splitlines()
    path.write_text("\n".join([rows[0], *rows[:0:-1]]))
    with pytest.raises(FormatError, match="rising frequencies"):
        read_motion_knowledge(folder, acquisition)
    path.unlink()
    with pytest.raises((FormatError, InputError), match=r"spectrum\.csv"):
        read_motion_knowledge(folder, acquisition)
