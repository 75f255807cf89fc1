"""Real curves, grounds and reliefs, where the data are found; and that no default asks whether they are."""

import numpy as np
import pytest

from sightline.errors import FormatError
from sightline.simulate import measured
from sightline.simulate.instruments import INSTRUMENT_CASES, instrument_case
from sightline.simulate.scenarios import line_of_sight_case
from sightline.simulate.sequence import sequence_case
from sightline.simulate.sequence_options import CASE_OPTIONS as SEQUENCES
from sightline.simulate.stereo import stereo_case
from sightline.simulate.stereo_options import CASE_OPTIONS as STEREO
from sightline.simulate.strip_options import CASES

REAL = ("real", "other-family")
STRIP, FRAMES = {"lines": 64, "columns": 64}, {"frames": 2, "shape": (40, 48), "bands": 8}
DRAWN = {
    **{case: (line_of_sight_case, STRIP) for case in CASES if case not in REAL},
    **{case: (instrument_case, STRIP) for case in INSTRUMENT_CASES},
    **{case: (sequence_case, FRAMES) for case in SEQUENCES},
    **{case: (stereo_case, {"shots": 2, "points": 9}) for case in STEREO},
}


@pytest.mark.parametrize("case", DRAWN)
def test_a_scene_that_names_no_real_data_does_not_look_for_them(case, monkeypatch):
    def looked_for():
        pytest.fail(f"{case} looks for real data, so that the same seed may give another scene elsewhere")

    monkeypatch.setattr(measured, "data_folder", looked_for)
    draw, size = DRAWN[case]
    scenario = draw(case, 1, **size)
    assert scenario.case == case


def test_real_data_are_looked_for_only_in_the_folder_that_is_given(monkeypatch, tmp_path):
    assert (
        measured.data_folder() is None
    )  # though there may be some beside this copy, which the tests know of
    for case in REAL:
        with pytest.raises(FormatError, match="no folder of real data is given; set SIGHTLINE_DATA"):
            line_of_sight_case(case, **STRIP)
    monkeypatch.setenv("SIGHTLINE_DATA", str(tmp_path))
    assert measured.data_folder() == tmp_path
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "file").touch()
    assert measured.data_file("set/file") == tmp_path / "set" / "file"
    with pytest.raises(FormatError, match=f"real data not found: {tmp_path / 'elsewhere'}"):
        measured.data_file("set/file", tmp_path / "elsewhere")


def test_the_hirise_curve_has_its_length_step_and_span(real_data):
    t, curves = measured.hirise_curve(real_data("hirise_jitter_psp008469").parent)
    assert t.size == 2048
    assert np.diff(t).mean() == pytest.approx(3.574e-3, rel=1e-3)
    # SOURCE.md of the set: 21 px along samples, 37 px along lines
    assert np.ptp(curves[:, 0]) == pytest.approx(21.0, abs=0.6)
    assert np.ptp(curves[:, 1]) == pytest.approx(37.0, abs=0.6)


def test_the_attitudes_of_a_line_scan_model_are_small_beyond_a_cubic(real_data):
    path = real_data("linescan_isds") / "ctx_isd.json"
    t, angles = measured.isd_attitude_curve(path)
    assert t[0] == 0.0 and t[-1] == pytest.approx(0.75, abs=0.02)
    rms = np.sqrt(np.mean(angles**2, axis=0))
    assert np.all(rms < 0.6e-6) and rms.max() > 0.15e-6  # SOURCE.md: 0.2-0.5 urad


def test_the_c_kernel_gives_the_motion_its_source_names(real_data):
    pytest.importorskip("spiceypy")
    t, angles = measured.mro_ck_curve(real_data("hirise_jitter_psp008469").parent)
    assert t[-1] == pytest.approx(7.3, abs=0.1)
    rms = np.sqrt(np.mean(angles**2, axis=0))
    # SOURCE.md: 1-3 urad after a polynomial of degree 5; images tell two axes, the third is 0.01 urad
    assert np.all((rms[:2] > 1e-6) & (rms[:2] < 3.5e-6)) and rms[2] < 1e-7


def test_the_landsat_bands_are_four_and_run_along_the_longer_side(real_data):
    bands = measured.landsat_bands(real_data("landsat7_everest").parent)
    assert bands.shape == (4, 800, 655) and bands.dtype == np.uint8


def test_the_srtm_relief_lies_north_up_about_its_centre(real_data):
    relief = measured.srtm_relief((0.0, 5000.0), (3000.0, 8000.0), real_data("srtm_n44e005").parent)
    rows, columns = relief.heights.shape
    assert relief.west + 0.5 * (columns - 1) * relief.posting[0] == pytest.approx(0.0)
    assert relief.north - 0.5 * (rows - 1) * relief.posting[1] == pytest.approx(5000.0)
    # the summit of Mont Ventoux, 44.1741 N 5.2786 E by any map: 0.0059 degrees south of the cut's middle
    row, column = np.unravel_index(relief.heights.argmax(), relief.heights.shape)
    assert relief.north - row * relief.posting[1] == pytest.approx(5000.0 - 656.0, abs=200.0)
    assert relief.west + column * relief.posting[0] == pytest.approx(-110.0, abs=200.0)
