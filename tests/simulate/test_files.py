"""The folder of a simulated strip: readable by anyone, silent about the truth."""

import tomllib

import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning

from sightline.io.acquisition.load import load_acquisition
from sightline.io.acquisition.schema import LevelFlight
from sightline.motion.strip.hyper import KnownContent
from sightline.simulate import files
from sightline.simulate.files import write_frames, write_strip
from sightline.simulate.frames import frames_case
from sightline.simulate.scenarios import line_of_sight_case

pytestmark = pytest.mark.filterwarnings(
    f"ignore::{NotGeoreferencedWarning.__module__}.NotGeoreferencedWarning"
)


@pytest.fixture(scope="module")
def hard(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hard")
    scenario = line_of_sight_case("hard", 1, lines=150, columns=80)
    write_strip(scenario, folder, star_tracker=True, gyro=True)
    return scenario, folder


def test_the_acquisition_file_is_toml_and_names_files_that_are_there(hard):
    scenario, folder = hard
    content = tomllib.loads((folder / "acquisition.toml").read_text())
    known = {name: content["platform"].pop(name) for name in files.ATTITUDE_KNOWN}
    assert all(value > files.ATTITUDE_KNOWN[name] for name, value in known.items())
    assert content["platform"] == {"kind": "level-flight", "altitude": 680e3, "ground_speed": 6800.0}
    assert content["instrument"] == {"ifov": 5e-6, "columns": 80, "line_period": 5e-4}
    assert [band["name"] for band in content["band"]] == ["PAN", "B1", "B0", "B2"]
    for band, truth in zip(content["band"], scenario.bands, strict=True):
        assert (folder / band["image"]).is_file()
        assert band["look_ahead"] == truth.look_ahead
    assert (folder / content["surface"]["dem"]).is_file()
    assert [sensor["kind"] for sensor in content["attitude_sensor"]] == ["star-tracker", "gyro"]


def test_the_acquisition_file_holds_no_truth(hard):
    _, folder = hard
    content = tomllib.loads((folder / "acquisition.toml").read_text())
    for band in content["band"]:
        assert band["offset_px"] == [0.0, 0.0] and band["rotation"] == 0.0
        assert band["offset_sigma_px"] == 1.0 and band["rotation_sigma"] == 3e-4


def test_images_read_back_as_rendered(hard):
    scenario, folder = hard
    with rasterio.open(folder / "B0.tif") as source:
        assert source.dtypes == ("uint16",)
        np.testing.assert_array_equal(source.read(1), scenario.image(2))


def test_tables_read_back_to_the_last_digit(hard):
    scenario, folder = hard
    truth = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(truth, scenario.truth)
    assert (folder / "truth.csv").read_text().startswith("t,roll,pitch,yaw\n")
    header = (folder / "gyro.csv").read_text().splitlines()[0]
    assert header == "t_start,t_end,roll,pitch,yaw,sigma"


def test_the_relief_is_written_north_up_in_local_metres(hard):
    scenario, folder = hard
    relief = scenario.scene.relief
    with rasterio.open(folder / "dem.tif") as source:
        assert source.crs is None
        # centre of the first post, by the raster's own affine
        assert source.xy(0, 0) == pytest.approx((relief.west, relief.north))
        assert source.transform.e < 0.0
        np.testing.assert_array_equal(source.read(1), relief.heights)


def test_without_a_dem_the_file_says_how_rough_the_ground_is(tmp_path):
    scenario = line_of_sight_case("relief", 1, lines=40, columns=40)
    written = write_strip(scenario, tmp_path, dem=False)
    content = tomllib.loads((tmp_path / "acquisition.toml").read_text())
    assert "dem.tif" not in written
    assert content["surface"] == {"height": pytest.approx(0.0, abs=1e-3), "height_sigma": 300.0}


def test_frames_are_written_with_the_times_given_and_the_true_ones_apart(tmp_path):
    scenario = frames_case(2, frames=3, shape=(40, 60), time_sigma=0.3)
    write_frames(scenario, tmp_path, estimate_camera=True)
    content = tomllib.loads((tmp_path / "acquisition.toml").read_text())
    assert [frame["time"] for frame in content["frame"]] == [0.0, 6.0, 12.0]
    assert content["frame"][0]["time_sigma"] == 0.3
    assert content["camera"]["distortion"] == "estimate"
    assert content["camera"]["focal_length_px"] == pytest.approx(3636.0)
    times = np.loadtxt(tmp_path / "truth-frames.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(times[:, 1], scenario.times)
    assert np.loadtxt(tmp_path / "truth.csv", delimiter=",", skiprows=1).shape == (3, 4)


def test_a_scene_that_turns_further_than_is_taken_for_granted_says_how_well_its_attitude_is_known(tmp_path):
    # some px at the edge of 60 columns of 5 urad: hundredths of a radian of yaw, and of its rate
    scenario = line_of_sight_case("nominal", 0, lines=500, columns=60)
    write_strip(scenario, tmp_path)
    known = load_acquisition(tmp_path / "acquisition.toml").known_motion
    t, yaw = scenario.truth[:, 0], scenario.truth[:, 3]
    even, mean = (abs(float(v)) for v in np.polyfit(t - t.mean(), yaw, 1))
    assert even > 1e-3 and even <= known.rate_sigma <= 2.0 * even
    assert max(mean, 1e-2) <= known.attitude_sigma <= max(2.0 * mean, 1e-2)


def test_what_is_not_said_of_the_attitude_is_what_the_schema_takes_for_granted():
    assert tuple(files.ATTITUDE_KNOWN.values()) == KnownContent().usual()
    schema = LevelFlight(kind="level-flight", altitude=1.0, ground_speed=1.0)
    assert (schema.attitude_sigma, schema.rate_sigma) == (None, None)
