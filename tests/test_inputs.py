"""Every file that a result is made of is watched from before it is read."""

from __future__ import annotations

import os

import numpy as np
import pytest

from sightline.cli.main import run
from sightline.errors import FormatError
from sightline.inputs import noted
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats.images import open_image
from sightline.io.layout.load import load_instrument
from sightline.io.results.recovered import read_recovered
from sightline.io.sequence.load import read_sequence
from sightline.io.stereo.load import read_stereo
from sightline.io.tdi.load import load_tdi, tdi_inputs


def real(paths):
    return {os.path.realpath(path) for path in paths}


def test_of_a_strip_and_of_what_was_recovered_of_it(recovery, tmp_path):
    with noted(tmp_path) as seen:
        acquired = load_acquisition(recovery.scene / "acquisition.toml")
        assert real(acquired.inputs) <= seen.places()
        assert len(acquired.inputs) > 3
        read_recovered(recovery.folder, acquired)
    names = ("motion.csv", "summary.json", "covariance.npz")
    assert real(recovery.folder / name for name in names) <= seen.places()


def test_of_the_table_of_settings_with_a_recovered_motion(recovery, tmp_path):
    columns = f'acquisition = "{recovery.scene / "acquisition.toml"}"\nband = "PAN"'
    (tmp_path / "tdi.toml").write_text(
        "[grid]\nstages = { from = 3, to = 16 }\nintegration_ratio = [1.0]\n"
        "[head]\nstages = 2\nintegration_ratio = 0.5\n[noise]\ngain = 9e-6\nread = 12.0\n"
        f"[columns]\n{columns}\n[signals]\nlist = [10.0, 100.0]\n[mtf]\naperture_x = 0.9\naperture_y = 0.9\n"
        "diffusion_sigma_px = 0.2\noptics_mtf = 0.35\n"
    )
    with noted(tmp_path / "out") as seen:
        load_tdi(tmp_path / "tdi.toml", recovery.folder)
    assert real(tdi_inputs(tmp_path / "tdi.toml", recovery.folder)) <= seen.places()


def test_of_a_flight_every_frame_too(tmp_path):
    flight = tmp_path / "flight"
    words = [
        "--case",
        "small",
        "--frames",
        "5",
        "--set",
        "truth_bands=0",
        "--set",
        "dem=true",
        "--out",
        str(flight),
    ]
    assert run(["simulate", "frames", *words]) == 0
    with noted(tmp_path / "out") as seen:
        sequence = read_sequence(flight / "sequence.toml")
    assert len(sequence.files) == 5
    assert real((*sequence.inputs, *sequence.files)) <= seen.places()


@pytest.mark.parametrize("more", ["control_points=3", "images=true"], ids=["points", "pictures"])
def test_of_a_pass_of_spacecraft(tmp_path, more):
    words = f"--shots 3 --points 20 --set columns=128 --set {more}".split()
    assert run(["simulate", "stereo", *words, "--out", str(tmp_path / "pass")]) == 0
    with noted(tmp_path / "out") as seen:
        stereo = read_stereo(tmp_path / "pass" / "stereo.toml")
    assert len(stereo.inputs) > 2 and real(stereo.inputs) <= seen.places()


def test_of_an_instrument(tmp_path):
    with noted(tmp_path) as seen, pytest.raises(FormatError):
        load_instrument(tmp_path.parent / "instrument.toml")
    assert real([tmp_path.parent / "instrument.toml"]) <= seen.places()


def test_what_the_run_makes_itself_is_no_input(tmp_path):
    np.save(tmp_path / "own.npy", np.zeros((2, 3)))
    with noted(tmp_path) as seen:
        open_image(tmp_path / "own.npy")
    assert not seen.places()


@pytest.mark.parametrize("left", [0, 200])
def test_an_image_cut_while_it_is_read_ends_in_an_error_and_not_the_process(tmp_path, left):
    path = tmp_path / "a.npy"
    np.save(path, np.ones((64, 1024), dtype=np.float32))
    image = open_image(path)
    assert image.read((60, 64), (0, 1024)).sum() == 4096.0
    os.truncate(path, left)
    for look in (image.read, image.mask):
        with pytest.raises(FormatError, match=rf"a\.npy: was cut to {left} bytes while it was read"):
            look((60, 64), (0, 1024))


def test_an_image_exchanged_by_a_longer_one_is_read_to_its_end(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.ones((4, 8), dtype=np.float32))
    image = open_image(path)
    np.save(tmp_path / "b.npy", np.zeros((40, 8), dtype=np.float32))
    os.replace(tmp_path / "b.npy", path)
    assert image.read((0, 4), (0, 8)).sum() == 32.0
