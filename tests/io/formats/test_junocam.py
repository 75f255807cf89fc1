"""JunoCam: framelets, metadata and the acquisition made of them."""

from __future__ import annotations

import json
from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.io.conftest import write_tif

from sightline.errors import EstimationError, FormatError
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats import junocam

METADATA = {
    "PRODUCT_ID": "JNCE_2022229_44C00030_V01",
    "START_TIME": "2022-08-17T13:25:44.834",
    "INTERFRAME_DELAY": "0.373 <s>",
    "SPACECRAFT_ALTITUDE": "118043.7 <km>",
    "SUB_SPACECRAFT_LATITUDE": "41.7481",
    "SUB_SPACECRAFT_LONGITUDE": "287.6978",
}
LATER = METADATA | {
    "PRODUCT_ID": "JNCE_2022229_44C00032_V01",
    "START_TIME": "2022-08-17T13:44:55.688",
    "SPACECRAFT_ALTITUDE": "85911.5 <km>",
    "SUB_SPACECRAFT_LATITUDE": "51.6238",
    "SUB_SPACECRAFT_LONGITUDE": "301.5612",
}


@pytest.fixture
def metadata(tmp_path):
    paths = []
    for number, content in enumerate((METADATA, LATER)):
        paths.append(tmp_path / f"{number}.json")
        paths[-1].write_text(json.dumps(content), encoding="utf-8")
    return paths


def test_the_square_root_table_is_the_published_one():
    table = junocam.companding_table()
    assert len(table) == 256 and table[0] == 0 and table[-1] == 2879
    # as printed in public processing code: steps change at 23, 63, 247, 1007, 1407
    assert [table[k] for k in (23, 24, 43, 44, 89, 90, 184, 185)] == [23, 25, 63, 67, 247, 255, 1007, 1023]
    assert set(np.diff(table)) == {1, 2, 4, 8, 16, 32}


def test_metadata_are_read_with_their_units(metadata):
    read = junocam.read_metadata(metadata[0])
    assert read.start == datetime(2022, 8, 17, 13, 25, 44, 834000, tzinfo=UTC)
    assert read.delay == 0.373 and read.altitude == 118043.7e3
    place = read.position()
    # west longitudes: 287.7 W is 72.3 E; planetographic latitude over a flattened body
    assert np.degrees(np.arctan2(place[1], place[0])) == pytest.approx(360.0 - 287.6978)
    equatorial, polar = junocam.RADII
    normal = equatorial / np.hypot(1.0, polar / equatorial * np.tan(np.radians(41.7481)))
    along = normal / np.cos(np.radians(41.7481)) + 118043.7e3
    assert np.hypot(place[0], place[1]) == pytest.approx(along * np.cos(np.radians(41.7481)), rel=1e-9)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda content: content.pop("START_TIME"),
        lambda content: content.update(SPACECRAFT_ALTITUDE="high"),
        lambda content: content.update(START_TIME="yesterday"),
        lambda content: content.update(INTERFRAME_DELAY=""),
        lambda content: content.update(PRODUCT_ID={}, START_TIME=["2022"]),
    ],
)
def test_spoilt_metadata_are_one_clear_error(metadata, spoil):
    content = dict(METADATA)
    spoil(content)
    metadata[0].write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(FormatError, match="not as in a JunoCam metadata file"):
        junocam.read_metadata(metadata[0])


def test_numbers_that_cannot_be_of_a_flight_past_jupiter_are_refused_by_name(metadata):
    for key, value in {
        "SUB_SPACECRAFT_LATITUDE": "97",
        "SPACECRAFT_ALTITUDE": "nan",
        "INTERFRAME_DELAY": "-1",
    }.items():
        metadata[0].write_text(json.dumps(METADATA | {key: value}), encoding="utf-8")
        with pytest.raises(FormatError, match=rf"{key} = \S+ is not from"):
            junocam.read_metadata(metadata[0])
    metadata[0].write_text("[]", encoding="utf-8")
    with pytest.raises(FormatError, match="INTERFRAME_DELAY: not as in a JunoCam metadata file"):
        junocam.read_metadata(metadata[0])


def test_the_arc_is_the_orbit_that_is_known(metadata):
    """Juno in 2022: a period of six weeks, a perijove a few thousand km above the clouds, over the poles."""
    read = [junocam.read_metadata(path) for path in metadata]
    t = np.array([-1.0, 0.0, 1.0])
    turned = junocam.arc(read, 0, t)
    np.testing.assert_allclose(turned[1], read[0].position(), atol=1.0)
    np.testing.assert_allclose(junocam.arc(read, 1, t)[1], read[1].position(), atol=1.0)
    # velocity in axes that stand still
    place = turned[1]
    velocity = (turned[2] - turned[0]) / 2.0 + np.cross([0.0, 0.0, junocam.ROTATION], place)
    energy = 0.5 * velocity @ velocity - junocam.MU / np.linalg.norm(place)
    semi = -0.5 * junocam.MU / energy
    assert 2.0 * np.pi * np.sqrt(semi**3 / junocam.MU) / 86_400.0 == pytest.approx(43.0, abs=2.5)
    momentum = np.cross(place, velocity)
    closest = semi * (1.0 - np.sqrt(1.0 - momentum @ momentum / (junocam.MU * semi)))
    assert 71e6 < closest < 78e6
    assert 90.0 < np.degrees(np.arccos(momentum[2] / np.linalg.norm(momentum))) < 105.0


def test_the_sun_stands_near_the_equator_of_jupiter_and_moves_with_its_turn():
    at = datetime(2022, 8, 17, 13, 25, 44, tzinfo=UTC)
    toward = junocam.sun_direction(at)
    # 15 months after the equinox of May 2021, a quarter of 11.9 years / 4 x 3.1 degrees
    assert np.degrees(np.arcsin(toward[2])) == pytest.approx(2.0, abs=0.5)
    later = junocam.sun_direction(datetime(2022, 8, 17, 14, 25, 44, tzinfo=UTC))
    turned = np.degrees(np.arctan2(later[1], later[0]) - np.arctan2(toward[1], toward[0]))
    assert turned == pytest.approx(-870.536 / 24.0, abs=0.01)


def test_a_picture_of_another_size_is_refused(tmp_path):
    path = write_tif(tmp_path / "other.tif", np.zeros((384, 1000), np.uint8))
    with pytest.raises(FormatError, match="a raw JunoCam colour image has 1648 columns"):
        junocam.read_framelets(path)


def test_a_radiation_hit_is_marked_and_a_limb_is_not():
    framelet = np.zeros((128, 200), np.uint8)
    framelet[:, 60:] = 100
    framelet[40, 120] = 160
    hits, median = junocam.radiation_hits(framelet, 18.0)
    assert hits[39:42, 119:122].all() and hits.sum() == 9
    unusable = junocam.unusable(hits, median, 18.0)
    # sky, and so many pixels around it as the limb disturbs
    edge = 60 + junocam.AROUND
    assert unusable[:, : edge - 3].all() and not unusable[60:, edge + 3 : 110].any()
    assert unusable[40, 120]


def test_a_dark_image_is_refused(tmp_path):
    path = write_tif(
        tmp_path / "dark.tif", np.random.default_rng(0).integers(0, 3, (768, 1648)).astype(np.uint8)
    )
    with pytest.raises(FormatError, match="no lit disc"):
        junocam.write_junocam_acquisition(path, tmp_path / "out")


def test_metadata_of_another_image_are_refused(tmp_path, metadata):
    path = write_tif(tmp_path / "JNCE_other.tif", np.zeros((768, 1648), np.uint8))
    with pytest.raises(FormatError, match="of one other of the same orbit are needed"):
        junocam.write_junocam_acquisition(path, tmp_path / "out", metadata=metadata)


def test_a_real_image_becomes_an_acquisition(real_data, tmp_path):
    """The smallest of the three images; its metadata are not known, so that the ground is at infinity."""
    image = next(real_data("junocam_spin_scan").glob("*36C00061*.png"))
    toml = junocam.write_junocam_acquisition(image, tmp_path)
    acquisition = load_acquisition(toml)
    assert acquisition.chip.names == ("blue", "green", "red")
    assert len(acquisition.frames) == 3 * 12
    assert acquisition.spin is not None and acquisition.spin.rate < 0.0
    middle = acquisition.frames[3 * 6 + 2]
    assert not middle.image.mask((0, 128), (0, 1648)).all()


def rendered(latitude, gain, *, exposures=11, turned=0.0, beside=50.0):
    """Framelets (exposures, strips, lines, columns) of an even Jupiter, with what was put in.

    Rays by the published numbers, cut with the ellipsoid in closed form, brightness by Lambert's law, levels
    by the square-root table. The Sun stands so many degrees beside the camera, towards smaller columns.
    """
    equatorial, polar = junocam.RADII
    axes = np.array([equatorial, equatorial, polar])
    place = 1.9e8 * np.array([np.cos(latitude), 0.0, np.sin(latitude)])
    down = -place / np.linalg.norm(place)
    side = Rotation.from_rotvec(turned * down).apply(np.cross(down, [0.0, 1.0, 0.0]))
    side -= (side @ down) * down
    side /= np.linalg.norm(side)
    sun = np.cos(np.radians(beside)) * -down + np.sin(np.radians(beside)) * side
    middle = Rotation.from_matrix(np.stack([-side, np.cross(down, -side), down], axis=1))
    middle = middle * Rotation.from_euler("y", 0.06)
    start = middle * Rotation.from_rotvec([-junocam.TURN * (exposures // 2), 0.0, 0.0])
    table = junocam.companding_table()
    framelets = np.zeros((exposures, 3, 128, 800), np.uint8)
    line, column = np.meshgrid(np.arange(128.0), np.arange(800.0), indexing="ij")
    noise = np.random.default_rng(3)
    for strip, (_, axis) in enumerate(junocam.STRIPS):
        seen = np.stack([column - junocam.COLUMN, line - (axis + junocam.COMMON_LINE)]) / junocam.FOCAL
        flat = seen.copy()
        for _ in range(30):
            square = (flat**2).sum(axis=0)
            flat = seen / (1.0 + junocam.DISTORTION[0] * square + junocam.DISTORTION[1] * square**2)
        look = np.stack([*flat, np.ones_like(line)], axis=-1)
        for k in range(exposures):
            ray = (start * Rotation.from_rotvec([junocam.TURN * k, 0.0, 0.0])).apply(look.reshape(-1, 3))
            u, o = ray / axes, place / axes
            a, b, c = (u**2).sum(axis=1), u @ o, o @ o - 1.0
            inside = b**2 - a * c
            hit = place + ((-b - np.sqrt(np.maximum(inside, 0.0))) / a)[:, None] * ray
            normal = hit / axes**2
            lit = (normal @ sun) / np.linalg.norm(normal, axis=1)
            linear = np.where(inside > 0.0, gain * 2000.0 * np.maximum(lit, 0.0), 0.0)
            level = np.searchsorted(table, linear).astype(float) + noise.normal(0.0, 0.7, linear.shape)
            framelets[k, strip] = np.clip(np.round(level), 0, 255).reshape(line.shape)
    return framelets, start, np.tile(place, (exposures, 1)), sun


@pytest.mark.parametrize("latitude", [0.73, 1.5])
def test_a_limb_gives_the_attitude_as_well_as_it_says(latitude):
    framelets, truth, place, sun = rendered(latitude, 1.0)
    fit = junocam.limb_attitude(framelets, 0.374, place, sun)
    error = (fit.world_from_body * truth.inv()).as_rotvec()
    down = -place[0] / np.linalg.norm(place[0])
    across = np.linalg.norm(error - (error @ down) * down)
    # the limb is cut at a level that Lambert's law reaches a little inside of it
    assert across < 3.0 * max(junocam.ATTITUDE_SIGMA, fit.sigma)
    assert abs(error @ down) < 3.0 * fit.sigma_turn
    # above the pole the outline is a circle, which tells nothing of the turn
    assert (fit.sigma_turn > 0.3) if latitude > 1.4 else (fit.sigma_turn < 0.1)


@pytest.mark.parametrize(("gain", "said"), [(20.0, "terminator"), (400.0, "beside what is overexposed")])
def test_an_overexposed_image_is_refused_for_its_terminator(gain, said):
    """A crescent whose limb is overexposed: what is left of steep edges is where its night begins."""
    framelets, _, place, sun = rendered(0.73, gain, beside=110.0)
    assert (framelets == 255).mean() > 0.1
    with pytest.raises(EstimationError, match=said):
        junocam.limb_attitude(framelets, 0.374, place, sun)
    # what is overexposed, and around it, is not matched
    hits, median = junocam.radiation_hits(framelets[5, 2], 18.0)
    assert junocam.unusable(hits, median, 18.0)[framelets[5, 2] >= 254].all()
