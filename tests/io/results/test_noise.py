"""A detector's noise as the files that a choice of TDI settings reads."""

from __future__ import annotations

import json
import tomllib
from dataclasses import asdict, replace

import numpy as np
import pytest

from sightline.applications.detector_noise import DEAD, GAIN_UNKNOWN, DetectorNoise
from sightline.imaging.strip_noise import NoiseFigure
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.io.results.noise import NOISE_FILES, write_noise
from sightline.io.tdi.load import load_tdi

LAW = NoiseLaw(gain=2.28e-4, dark=16.3, output=70.73, column_fixed=1.26e-6)
FOUND = DetectorNoise(
    law=LAW,
    unit="e-",
    stages=64,
    electrons_per_dn=19.3,
    gain=np.array([1.0, 1.001, 0.998]),
    offset=np.array([1000.0, 1001.5, 999.0]),
    flags=np.array([GAIN_UNKNOWN | DEAD, 0, 0], dtype=np.uint8),
    signals=(132.0, 2366.0),
    full_well_sum=151400.0,
    figures=(
        NoiseFigure("read noise C", "DN rms", 3.7, 0.1, "=", "empty pixels"),
        NoiseFigure("  A of the sum", "1", 3.6e-6, None, "<=", "image"),
    ),
    images=(),
    warnings=("one thing",),
)


@pytest.fixture
def written(tmp_path):
    raw = tmp_path / "raw.img"
    raw.write_bytes(b"x")
    out = tmp_path / "out"
    out.mkdir()
    summary = write_noise(out, FOUND, [raw], wall_seconds=1.5)
    assert json.loads((out / "summary.json").read_text()) == summary
    return out, summary


def test_the_table_of_the_noise_comes_back(written):
    out, summary = written
    assert sorted(p.name for p in out.iterdir()) == sorted(NOISE_FILES)
    text = (out / "noise.toml").read_text(encoding="utf-8")
    assert "# read noise C" in text and "3.7 +- 0.1 DN rms" in text and "<= 3.6e-06" in text
    read = tomllib.loads(text)
    # written to four digits: more are not known
    assert list(read) == ["noise"] and read["noise"] == pytest.approx(asdict(LAW), rel=1e-3)
    assert summary["noise"] == asdict(LAW) and summary["warnings"] == ["one thing"]
    assert summary["figures"][1] == {
        "name": "A of the sum", "unit": "1", "value": 3.6e-6, "sigma": None, "relation": "<=", "how": "image",
    }  # fmt: skip


def test_the_choice_reads_what_was_written(written):
    problem = load_tdi(written[0] / "tdi.toml")
    assert asdict(problem.detector.noise) == pytest.approx(asdict(LAW), rel=1e-3)
    assert len(problem.columns) == 3 and problem.signals[[0, -1]] == pytest.approx([132.0, 2366.0])
    assert problem.detector.full_well_sum == pytest.approx(151400.0, rel=1e-3)


def test_columns_are_a_table_of_their_numbers(written):
    out, summary = written
    lines = (out / "columns.csv").read_text().splitlines()
    assert lines == ["column,gain,offset,flags", "0,1,1000,5", "1,1.001,1001.5,0", "2,0.998,999,0"]
    assert summary["columns"]["flagged"] == {
        "gain_unknown": 1, "offset_unknown": 0, "dead": 1, "outlying": 0,
    }  # fmt: skip


def test_a_name_of_an_image_cannot_add_a_key(tmp_path):
    from sightline.io.results.noise import noise_toml

    image = type("Image", (), {"name": "a\n[noise]\ngain = 9", "figures": ()})()
    text = noise_toml(replace(FOUND, images=(image,)))
    assert tomllib.loads(text)["noise"]["gain"] == pytest.approx(LAW.gain, rel=1e-3)


def test_in_dn_the_file_says_so_and_without_a_ceiling_there_is_no_well(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    write_noise(
        out, replace(FOUND, unit="DN", electrons_per_dn=None, full_well_sum=None), [], wall_seconds=0.0
    )
    assert "# in DN: signals and full wells" in (out / "noise.toml").read_text(encoding="utf-8")
    assert "full_well_sum" not in tomllib.loads((out / "tdi.toml").read_text(encoding="utf-8"))["choice"]
