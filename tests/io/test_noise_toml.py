"""A measured noise law as a TDI.toml."""

from __future__ import annotations

import tomllib
from dataclasses import asdict

import pytest

from sightline.errors import FormatError
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.io.noise_toml import write_noise_toml
from sightline.io.tdi import load_tdi

LAW = NoiseLaw(gain=2.28e-4, dark=16.3, output=70.73, column_fixed=1.26e-6)
GIVEN = {
    "columns": 256,
    "signals": (132.0, 2366.0),
    "full_well_sum": 151400.0,
    "notes": ["C = 3.7 +- 0.1", "b"],
}


def test_the_law_comes_back_from_the_file(tmp_path):
    write_noise_toml(tmp_path / "tdi.toml", LAW, **GIVEN)
    text = (tmp_path / "tdi.toml").read_text(encoding="utf-8")
    assert text.startswith("# C = 3.7 +- 0.1\n# b\n")
    read = tomllib.loads(text)
    # written to three or four digits: more are not known
    assert read["noise"] == pytest.approx(asdict(LAW), rel=1e-3)
    assert read["columns"] == {"count": 256}
    assert (read["signals"]["from"], read["signals"]["to"]) == (132.0, 2366.0)
    assert read["choice"]["full_well_sum"] == pytest.approx(151400.0, rel=1e-3)
    assert read["head"]["stages"] == 0


def test_the_choice_reads_what_was_written(tmp_path):
    write_noise_toml(tmp_path / "tdi.toml", LAW, **GIVEN)
    problem = load_tdi(tmp_path / "tdi.toml")
    assert asdict(problem.detector.noise) == pytest.approx(asdict(LAW), rel=1e-3)
    assert len(problem.columns) == 256 and problem.signals[[0, -1]] == pytest.approx([132.0, 2366.0])
    assert problem.detector.full_well_sum == pytest.approx(151400.0, rel=1e-3)


def test_a_place_that_cannot_be_written_is_said(tmp_path):
    with pytest.raises(FormatError, match="cannot be written"):
        write_noise_toml(tmp_path / "no" / "tdi.toml", LAW, **GIVEN)
