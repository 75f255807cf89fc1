"""What `recover` writes: the header and the units that a chain relies on, and files that agree."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sightline.cli.score import score_folder
from sightline.errors import FormatError, InputError, SpanError
from sightline.geometry.surface import Ellipsoid, Plane
from sightline.geometry.trajectory import Motion
from sightline.io.formats.tables import read_attitudes, read_columns, read_motion
from sightline.io.results.hidden import read_hidden, remove_hidden
from sightline.io.results.line_of_sight import _unused, on_another_body, summarize

HEADER = (
    "t,roll,pitch,yaw,sigma_roll,sigma_pitch,sigma_yaw,"
    "sigma_absolute_roll,sigma_absolute_pitch,sigma_absolute_yaw,observed,line"
)


def test_the_motion_has_one_row_per_line_of_the_first_band_under_the_agreed_header(recovery):
    rows = (recovery.folder / "motion.csv").read_text().splitlines()
    assert rows[0] == HEADER and len(rows) == 1 + 640
    motion = read_motion(recovery.folder / "motion.csv")
    np.testing.assert_allclose(motion.t, recovery.acquisition.cameras[0].times(np.arange(640.0)), atol=1e-12)
    assert motion.lines.tolist() == list(range(640))  # all bands are exposed together
    np.testing.assert_allclose(motion.angles, recovery.result.motion.angles, rtol=1e-8, atol=1e-15)
    # Nothing ties the hidden part: its sigma is infinite, written as such.
    assert np.isinf(motion.sigma_absolute).all()


def test_the_attitude_is_the_reference_turned_by_the_motion(recovery):
    t, quaternions = read_attitudes(recovery.folder / "attitude.csv")
    # Level flight north: x forward = north (world y), y right = east (world x), z down: a half turn about
    # (1, 1, 0) / sqrt 2, whose quaternion is that axis. Small angles multiply it by (angles / 2, 1).
    angles = read_motion(recovery.folder / "motion.csv").angles
    axis = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    half = angles / 2.0
    vector = axis + np.cross(axis, half)  # product of quaternions, scalar of the first zero
    scalar = -(half @ axis)
    expected = np.column_stack([vector, scalar])
    sign = np.sign((quaternions * expected).sum(axis=1, keepdims=True))
    # Second order: half the square of the largest angle, a few mrad of yaw.
    tolerance = float(np.abs(angles).max()) ** 2
    np.testing.assert_allclose(sign * quaternions, expected, atol=max(tolerance, 1e-12))
    assert len(t) == 640


def test_the_message_for_other_chains_holds_the_same_attitude(recovery):
    text = (recovery.folder / "attitude.aem").read_text()
    assert "REF_FRAME_A = LOCAL_ENU\n" in text and "QUATERNION_TYPE = LAST\n" in text
    rows = text.split("DATA_START")[1].split("DATA_STOP")[0].split("\n")
    cells = [row.split() for row in rows if row.strip()]
    t, quaternions = read_attitudes(recovery.folder / "attitude.csv")
    stamps = np.array([cell[0] for cell in cells], dtype="datetime64[ns]")
    seconds = (stamps - np.datetime64("2026-01-01T00:00:00", "ns")) / np.timedelta64(1, "s")
    np.testing.assert_allclose(seconds, t, atol=1e-9)
    # ten decimals in one file, twelve or more in the other
    np.testing.assert_allclose(np.array([cell[1:] for cell in cells], dtype=float), quaternions, atol=1e-10)


def test_the_spectrum_holds_the_power_of_the_motion(recovery):
    table = np.genfromtxt(recovery.folder / "spectrum.csv", delimiter=",", names=True)
    angles = recovery.result.motion.angles
    u = np.linspace(-1.0, 1.0, len(angles))
    for k, axis in enumerate(("roll", "pitch", "yaw")):
        power = float(table[f"psd_{axis}"].sum() * table["frequency"][1])
        rest = angles[:, k] - np.polynomial.Legendre.fit(u, angles[:, k], 2)(u)
        # One Hann-windowed periodogram weighs the middle of the strip: a tone of 47 Hz has 15 periods here.
        assert 0.6 < power / rest.var() < 1.6
        seen = table[f"observed_{axis}"] == 1
        assert seen[(table["frequency"] > 20.0) & (table["frequency"] < 300.0)].mean() > 0.9
        assert (table[f"error_{axis}"][seen] > 0.0).all()


def test_the_time_covariance_belongs_to_the_motion(recovery):
    with np.load(recovery.folder / "covariance.npz") as stored:
        t, angles, band = stored["t"], stored["angles"], stored["band"]
    assert angles.shape == (len(t), 3) and band.shape[1] == 3 * len(t)
    motion = recovery.result.motion
    inside = (t > motion.t[0]) & (t < motion.t[-1])
    np.testing.assert_allclose(
        motion.at(t[inside]), angles[inside], atol=1e-3 * float(np.abs(angles[:, 2]).max())
    )
    assert (band[0] > 0.0).all()


def test_the_hidden_directions_are_written_on_the_lines(recovery):
    summary = json.loads((recovery.folder / "summary.json").read_text())
    hidden, names = read_hidden(recovery.folder, summary, 640)
    assert names == recovery.result.hidden_names
    np.testing.assert_allclose(hidden, recovery.result.hidden, rtol=1e-8, atol=1e-12)


def test_what_was_left_out_is_named_and_given_beside_the_hidden_directions(recovery):
    # offsets and rotations of the bands are free in this scene: docs/theory/s1.md, section 7
    assert recovery.summary["hidden_directions"]["words"] == [
        "constant of roll", "constant of pitch", "constant of yaw",
        "drift of roll", "drift of pitch", "drift of yaw (with a parabola of roll)",
    ]  # fmt: skip
    columns = [f"left out {axis}" for axis in ("roll", "pitch", "yaw")]
    table = read_columns(recovery.folder / "hidden.csv", columns)
    left_out = np.column_stack([table[column] for column in columns])
    motion, result = read_motion(recovery.folder / "motion.csv"), recovery.result
    kept = remove_hidden(recovery.folder / "motion.csv", recovery.folder)
    # nine digits of a direction are 5e-9 of it, and yaw holds two of about its own size
    np.testing.assert_allclose(motion.angles - left_out, kept, atol=1e-8 * np.abs(motion.angles).max())
    in_px = np.sqrt((kept**2).mean(axis=0)) / result.scale
    np.testing.assert_allclose(in_px, list(recovery.summary["rms_motion_px"].values()), rtol=1e-6)


def test_the_same_is_taken_from_a_truth_of_ones_own_as_score_takes(recovery):
    folder, truth = recovery.folder, recovery.scene / "truth.csv"
    found, true = remove_hidden(folder / "motion.csv", folder), remove_hidden(truth, folder)
    error = (found - true) * [1.0 / 5e-6, 1.0 / 5e-6, 159.5]
    scored = score_folder(folder, truth)
    for k, axis in enumerate(("roll", "pitch", "yaw")):
        np.testing.assert_allclose(np.sqrt(np.mean(error[:, k] ** 2)), scored[axis]["rms"], rtol=1e-6)
    # the hidden part of the truth does not matter; a drift of yaw without its parabola of roll would
    t, hidden = recovery.result.motion.t, recovery.result.hidden
    table = read_motion(truth)
    at_lines = Motion(table.t, table.angles).at(t)
    moved = at_lines + hidden @ (1e-5 * np.arange(1.0, 7.0))
    np.testing.assert_allclose(remove_hidden(moved, folder), true, atol=1e-12)
    alone = at_lines + np.stack([0.0 * t, 0.0 * t, 1e-3 * t], axis=1)
    # -(V / 2H) rate t^2 of roll, over 0.16 s to either side of the middle; the fit takes a part of it
    parabola = 0.5 * 6800.0 / 680e3 * 1e-3 * 0.16**2
    assert np.abs(remove_hidden(alone, folder) - true)[:, 0].max() > 0.25 * parabola
    np.testing.assert_allclose(remove_hidden(Motion(table.t, table.angles), folder), true, rtol=1e-12)


def test_a_motion_that_does_not_fit_the_result_is_refused(recovery, tmp_path):
    t, angles = recovery.result.motion.t, recovery.result.motion.angles
    with pytest.raises(InputError, match="`motion` must be 640 rows of three finite angles"):
        remove_hidden(angles[:-1], recovery.folder)
    with pytest.raises(InputError, match="three finite angles"):
        remove_hidden(np.where(t[:, None] > t[5], np.nan, angles), recovery.folder)
    with pytest.raises(SpanError, match="give a truth that covers every line of the result"):
        remove_hidden(Motion(t[:-9], angles[:-9]), recovery.folder)
    with pytest.raises(FormatError, match=r"motion\.csv"):
        remove_hidden(angles, tmp_path)


def test_the_summary_says_what_the_contract_asks_for(recovery):
    summary = json.loads((recovery.folder / "summary.json").read_text())
    assert summary == json.loads(recovery.printed)
    for key in ("passbands", "tones", "rms_motion", "rms_motion_px", "median_sigma_px", "max_sigma_px"):
        assert set(summary[key]) == {"roll", "pitch", "yaw"}
    # 5 urad pixels, 320 columns
    np.testing.assert_allclose(summary["ifov"], 5e-6, rtol=1e-4)
    assert summary["half_field_px"] == 159.5 and summary["reference_image"] == "PAN"
    np.testing.assert_allclose(summary["half_field"], 159.5 * 5e-6, rtol=1e-3)
    for k, axis in enumerate(("roll", "pitch", "yaw")):
        px = summary["rms_motion"][axis] / [5e-6, 5e-6, 1.0 / 159.5][k]
        np.testing.assert_allclose(summary["rms_motion_px"][axis], px, rtol=0.01)
    assert summary["residual_rms_px"] < 0.1 < 0.5 < summary["residual_rms_before_px"]
    matches = summary["matches"]
    assert matches["tried"] == matches["kept"] + sum(matches["rejected"].values())
    assert {"lag", "tried", "kept", "rejected", "rms_before_px", "rms_after_px"} <= set(summary["pairs"][0])
    assert {"value", "sigma", "prior_sigma", "unit"} <= set(summary["statics"][0])
    assert summary["wall_seconds"] > 0.0 and summary["peak_memory_bytes"] > 1e7 and summary["version"]


def rms_of_pairs(summary: dict, name: str) -> float:
    """Root mean square over all pairs, from that of each."""
    squares = [pair["kept"] * pair[name] ** 2 for pair in summary["pairs"] if pair["kept"]]
    return float(np.sqrt(sum(squares) / summary["matches"]["kept"]))


def test_residuals_count_the_windows_kept_and_those_rejected_apart(recovery):
    result, first = recovery.result, recovery.result.records[0]
    both = zip(result.records, result.after_px, strict=True)
    kept = [np.where(record.star.present[..., None], px, np.nan) for record, px in both]
    none = summarize(replace(result, after_px=tuple(kept)), recovery.acquisition, wall_seconds=1.0)
    assert none["residual_rms_rejected_px"] is None
    # two windows that were found 3 and 4 px off, and therefore rejected
    (a, b), weight = np.argwhere(first.star.present)[:2], first.star.weight.copy()
    for place, size in ((tuple(a), 3.0), (tuple(b), 4.0)):
        weight[place], kept[0][place] = 0.0, size
    records = replace(first, star=replace(first.star, weight=weight)), *result.records[1:]
    changed = replace(result, records=records, after_px=tuple(kept))
    summary = summarize(changed, recovery.acquisition, wall_seconds=1.0)
    np.testing.assert_allclose(summary["residual_rms_rejected_px"], np.sqrt((9.0 + 16.0) / 2.0), rtol=1e-12)
    for key, name in (("residual_rms_px", "rms_after_px"), ("residual_rms_before_px", "rms_before_px")):
        np.testing.assert_allclose(summary[key], rms_of_pairs(summary, name), rtol=1e-12)
    assert summary["matches"]["kept"] == none["matches"]["kept"] - 2
    assert summary["matches"]["tried"] == none["matches"]["tried"]


def test_the_hashes_are_those_of_every_file_that_was_read(recovery):
    for name, written in recovery.summary["inputs"].items():
        content = (recovery.scene / name).read_bytes()
        assert hashlib.sha256(content).hexdigest() == written
    assert {"acquisition.toml", "PAN.tif", "B1.tif", "B0.tif", "B2.tif"} <= set(recovery.summary["inputs"])


def test_sigmas_that_a_spinning_camera_leaves_unused_are_named(recovery):
    frame = SimpleNamespace(time_sigma=0.1)
    spinning = replace(recovery.acquisition, frames=(frame,), spin=object(), height_sigma=20.0)
    (said,) = _unused(spinning)
    assert said.startswith("not used: [surface] height_sigma, time_sigma;")
    exact = replace(spinning, frames=(SimpleNamespace(time_sigma=0.0),), height_sigma=0.0)
    assert _unused(exact) == [] == _unused(recovery.acquisition)
    # of frames without a spin both are used
    assert _unused(replace(spinning, spin=None)) == []


def test_attitudes_over_another_body_go_into_no_message_in_earth_fixed_axes():
    assert on_another_body(Ellipsoid(71492e3, 66854e3))
    assert not on_another_body(Ellipsoid()) and not on_another_body(Plane())
