"""``simulate line-of-sight --acquisition``: strips through the cameras of products, and what is refused."""

from __future__ import annotations

import filecmp
import json
import tomllib

import numpy as np
import pytest
import rasterio
from tests.maker_files import ground
from tests.product_files import WorldViewScene, attitude, orbit

from sightline.cli.main import run
from sightline.io.acquisition.load import load_acquisition

#: Known exactly, so that what is rendered follows from the keys.
EXACT = "offset_sigma_px = 0\nrotation_sigma = 0\nscale_sigma = 0\n"
HEIGHT = 120.0
STILL = "--set motion=none --set coherence=1 --set snr=1e5 --lines 80 --columns 48 --seed 3".split()


@pytest.fixture
def acquisition(tmp_path):
    """ACQUISITION.toml of a product without its images, two bands; keys of each may be added."""
    folder = tmp_path / "given"
    folder.mkdir()
    WorldViewScene().xml(folder)

    def write(first="", second=""):
        path = folder / "acquisition.toml"
        path.write_text(
            '[acquisition]\nname = "mine"\n[platform]\nkind = "camera-model"\nmodel = "scene.XML"\n'
            f'[[band]]\nname = "A"\nimage = "A.npy"\n{first}[[band]]\nname = "B"\nimage = "B.tif"\n{second}'
            f"[surface]\nheight = {HEIGHT}\n"
        )
        return path

    return write


def simulated(path, out, *words) -> int:
    return run(["simulate", "line-of-sight", "--acquisition", str(path), "--out", str(out), *words])


def pixels(path):
    with rasterio.open(path) as image:
        return image.read(1).astype(float)


def looking_behind(lines, pixel):
    """Keys of a band that sees so many lines later what `pixel` sees, by the design of the product."""
    scene = WorldViewScene()
    origin, look = scene.ray(*pixel)
    seen = ground(origin[np.newaxis], look[np.newaxis], HEIGHT)[0]
    later = (pixel[0] + lines) / scene.rate
    x, y, z = attitude(later)[0].inv().apply(seen - orbit(later)[0][0])
    nominal = np.array([scene.origin[0], scene.origin[1] - pixel[1] * scene.pitch]) / scene.distance
    # columns run towards -y
    aside = (nominal[1] - y / z) * scene.distance / scene.pitch
    return f"look_ahead = {np.arctan(x / z - nominal[0])}\noffset_px = [0.0, {aside}]\n"


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_a_strip_through_a_product_is_that_of_its_cameras(tmp_path, acquisition, capsys):
    part = EXACT + "first_pixel = [30, 10]\n"
    behind = looking_behind(20, (70.0, 34.0)) + 'mask = "mask.tif"\n'
    out = tmp_path / "strip"
    assert simulated(acquisition(part, part + behind), out, *STILL) == 0
    capsys.readouterr()
    files = {"A.tif", "B.tif", "acquisition.toml", "scene.toml", "truth.csv", "truth-bands.csv"}
    assert {file.name for file in out.iterdir()} == files

    first, second = pixels(out / "A.tif"), pixels(out / "B.tif")
    assert first.shape == second.shape == (80, 48)
    # Over 60 lines and 48 columns the ground turns and stretches between the looks by hundredths of a pixel,
    # which change a pixel by as many hundredths of what neighbours differ by
    ahead, apart = first[:-20], second[20:] - first[:-20]
    assert apart.std() < 0.05 * np.diff(ahead, axis=0).std()

    # what recover reads: the pixels of the product that the images are, by the design of the product
    written = load_acquisition(out / "acquisition.toml")
    rays = written.bands[0].camera.rays(np.array([[0.0, 0.0], [60.0, 40.0]]))
    for k, (line, column) in enumerate(((30, 10), (90, 50))):
        origin, direction = WorldViewScene().ray(line, column)
        # aberration turns by up to 26 urad; a pixel is 10
        assert np.abs(rays.origins[k] - origin).max() < 0.1
        assert np.linalg.norm(rays.directions[k] - direction / np.linalg.norm(direction)) < 4e-5
    assert not written.still and "mask" not in (out / "acquisition.toml").read_text()
    truth = np.loadtxt(out / "truth.csv", delimiter=",", skiprows=1)
    assert truth.shape == (80, 4) and not truth[:, 1:].any()
    assert np.diff(truth[:, 0]) == pytest.approx(1.0 / WorldViewScene().rate)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_the_file_beside_it_makes_it_again(tmp_path, acquisition, capsys):
    small = "--lines 32 --columns 20 --seed 5 --set gains=1,.8".split()
    first, second = tmp_path / "deep" / "first", tmp_path / "second"
    assert simulated(acquisition("", "look_ahead = -1e-4\n"), first, *small, "--json") == 0
    assert json.loads(capsys.readouterr().out)["case"] == "acquisition"
    assert run(["simulate", "line-of-sight", "--scene", str(first / "scene.toml"), "--out", str(second)]) == 0
    # paths in acquisition.toml are as seen from its own folder
    same = sorted(path.name for path in first.iterdir() if path.name != "acquisition.toml")
    assert filecmp.cmpfiles(first, second, same, shallow=False) == (same, [], [])
    bands = [tomllib.loads((folder / "acquisition.toml").read_text())["band"] for folder in (first, second)]
    assert bands[0] == bands[1] and bands[0][1]["look_ahead"] == -1e-4
    assert bands[0][0]["first_pixel"] == [0, 0]


def test_what_cannot_be_rendered_is_refused(tmp_path, acquisition, capsys):
    def said(path, *words):
        assert simulated(path, tmp_path / "out", *words) in (1, 2)
        assert not (tmp_path / "out").exists()
        return capsys.readouterr().err

    path = acquisition()
    assert "--case nominal and --acquisition are both given" in said(path, "--case", "nominal")
    assert "no such file" in said(tmp_path / "none.toml")
    assert "`gains` must be one of each of the 2 bands" in said(path, "--set", "gains=1,1,1")
    np.save(path.parent / "A.npy", np.random.default_rng(1).integers(100, 900, (40, 48)).astype(np.uint16))
    beyond = said(acquisition("first_pixel = [300, 0]\n", "look_ahead = -1e-4\n"))
    assert "A.npy (40 x 48) that begins at first_pixel [300, 0] ends beyond them" in beyond
    (path.parent / "A.npy").unlink()
    apart = said(acquisition("", "look_ahead = -1e-4\n"), "--lines", "8")
    assert "`lines` must be from 16" in apart or "--lines" in apart
    apart = said(acquisition("", "look_ahead = -5e-4\n"), "--lines", "32")
    assert f"{path}, its first 32 lines and 200 columns: A shares no ground" in apart
    quality = said(acquisition('pieces = 2\nshape = "pieces"\n'), "--columns", "48")
    assert "pieces of band A is of 200 columns, 48 would be rendered" in quality
    assert run(["simulate", "line-of-sight", "--case", "acquisition", "--out", str(tmp_path / "out")]) == 2
    assert "give --acquisition FILE" in capsys.readouterr().err


def test_a_level_flight_is_cut_to_a_shorter_detector(tmp_path, capsys):
    toml = tmp_path / "level.toml"
    toml.write_text(
        '[platform]\nkind = "level-flight"\naltitude = 600e3\nground_speed = 7000.0\n[instrument]\n'
        'ifov = 5e-6\nline_period = 4e-4\ncolumns = 400\n[[band]]\nname = "A"\nimage = "A.tif"\n'
        '[[band]]\nname = "B"\nimage = "B.tif"\nlook_ahead = -2e-4\n'
        '[[band]]\nname = "C"\nimage = "C.tif"\nlook_ahead = -3e-4\n'
        "ifov = 20e-6\nline_period = 16e-4\ncolumns = 100\n"  # four times the pixel: the same time, and field
    )
    out = tmp_path / "out"
    assert simulated(toml, out, "--lines", "128", "--columns", "48") == 0
    written = load_acquisition(out / "acquisition.toml")
    assert [image.shape for image in written.images] == [(128, 48), (128, 48), (32, 12)]
    assert written.bands[0].camera.detector.tangents[0, 0] == pytest.approx(-23.5 * 5e-6)
    # some px at the edge of 48 columns are hundredths of a radian of yaw: more than is taken for granted
    t, _, _, yaw = np.loadtxt(out / "truth.csv", delimiter=",", skiprows=1).T
    even, mean = (abs(float(v)) for v in np.polyfit(t - t.mean(), yaw, 1))
    known = written.known_motion
    assert even > 1e-3 and even <= known.rate_sigma <= 2.0 * even
    assert max(mean, 1e-2) <= (known.attitude_sigma or 1e-2) <= max(2.0 * mean, 1e-2)
    # what the file says itself stays
    toml.write_text(toml.read_text().replace("[instrument]", "rate_sigma = 4e-3\n[instrument]"))
    assert simulated(toml, tmp_path / "said", "--lines", "128", "--columns", "48") == 0
    assert load_acquisition(tmp_path / "said" / "acquisition.toml").known_motion.rate_sigma == 4e-3


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_the_truth_reaches_to_the_exposures_of_all_bands(tmp_path, capsys):
    """A panchromatic band, and a colour .159 s later: what `recover` will say reaches as far."""
    for name, shape in {"PA": (256, 128), "B0": (64, 32)}.items():
        np.save(tmp_path / f"raw_{name}.npy", np.arange(np.prod(shape)).reshape(shape).astype(np.uint16))
    images = [str(tmp_path / f"raw_{name}.npy") for name in ("PA", "B0")]
    assert run(["init", *images, "--preset", "pleiades", "--out", str(tmp_path / "acq")]) == 0
    file = tmp_path / "acq" / "acquisition.toml"
    assert simulated(file, tmp_path / "sim", "--lines", "256", "--columns", "128") == 0
    truth = np.loadtxt(tmp_path / "sim" / "truth.csv", delimiter=",", skiprows=1)
    t, period = truth[:, 0], 0.1034e-3
    assert t[0] == 0.0 and np.diff(t) == pytest.approx(period)
    last = 0.1591 + 63 * 4 * period
    assert last <= t[-1] < last + period


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_stages_of_tdi_blur_what_moves_within_them(tmp_path, capsys):
    """An image of stages is the mean of the images that its stages take, not what their mean looks at."""
    count, ifov, period = 12, 5e-6, 1.0 / 2400.0
    late = (np.arange(count) - (count - 1) / 2.0).tolist()
    # a pixel further back, a line period later
    keys = {
        f"S{k}": f"look_ahead = {-ifov * px}\nfirst_line_time = {period * px}\n" for k, px in enumerate(late)
    }
    path = tmp_path / "level.toml"
    path.write_text(
        '[platform]\nkind = "level-flight"\naltitude = 600e3\nground_speed = 7200.0\n'
        f"[instrument]\nifov = {ifov}\nline_period = {period}\ncolumns = 32\n"
        + "".join(
            f'[[band]]\nname = "{name}"\nimage = "{name}.tif"\n{EXACT}{more}'
            for name, more in {"A": f"stages = {count}\n", **keys}.items()
        )
    )
    out = tmp_path / "out"
    words = "--set contrast=.4 --set coherence=1 --set snr=1e5 --lines 160 --columns 32 --seed 3".split()
    assert simulated(path, out, *words) == 0
    capsys.readouterr()
    mean = np.mean([pixels(out / f"{name}.tif") for name in keys], axis=0)
    # numbers are rounded; what the mean of the stages looks at departs by 15
    assert (pixels(out / "A.tif") - mean).std() < 1.2 * np.sqrt((1.0 + 1.0 / count) / 12.0)
