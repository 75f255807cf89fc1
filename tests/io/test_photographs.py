"""Times, places and angles in EXIF and XMP: what cameras get wrong is reported, and left out."""

import warnings

import numpy as np
import pytest
import rasterio

from sightline.errors import FormatError
from sightline.io.formats.exif import read_exif
from sightline.io.sequence.load import load_sequence

SHAPE = (24, 32)
#: A gimbal that looks straight down, the top of the image to the given heading.
GIMBAL = """<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" drone-dji:GimbalYawDegree="{}"
 drone-dji:GimbalPitchDegree="{}" drone-dji:GimbalRollDegree="0.0"/></rdf:RDF></x:xmpmeta>"""
TOML = """frames = "photos"
[camera]
focal_length_px = 40.0
"""


def tags(second=0, latitude=46.84, longitude=91.99, east="W", **more):
    """EXIF as the raster library shows it."""

    def degrees(value):
        whole, minutes = divmod(value * 60.0, 60.0)
        return f"({whole:.0f}) ({int(minutes)}) ({60.0 * (minutes % 1.0):.6f})"

    given = {
        "EXIF_DateTimeOriginal": f"2026:05:01 10:00:{second:02d}",
        "EXIF_GPSLatitude": degrees(latitude),
        "EXIF_GPSLatitudeRef": "N",
        "EXIF_GPSLongitude": degrees(longitude),
        "EXIF_GPSLongitudeRef": east,
        "EXIF_GPSAltitude": "(140)",
    }
    given |= more
    return {name: value for name, value in given.items() if value is not None}


def photographs(folder, every, xmp=None):
    """A folder of photographs and the SEQUENCE.toml that names it."""
    (folder / "photos").mkdir()
    for k, given in enumerate(every):
        photograph(folder / "photos" / f"p{k}.tif", given, k, None if xmp is None else xmp[k])
    (folder / "sequence.toml").write_text(TOML)
    return folder / "sequence.toml"


def photograph(path, given, seed=0, xmp=None):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # no georeference
        profile = {"driver": "GTiff", "dtype": "uint8", "count": 1, "height": 24, "width": 32}
        target = rasterio.open(path, "w", **profile)
    with target:
        target.write(np.random.default_rng(seed).integers(0, 255, SHAPE).astype(np.uint8), 1)
        target.update_tags(**given)
        if xmp is not None:
            target.update_tags(ns="xml:XMP", **{"xml:XMP": xmp})


@pytest.mark.parametrize(
    ("digits", "expected"),
    [
        ("25", "10:00:07.25Z"),
        ("005", "10:00:07.005Z"),
        ("-25", "10:00:06.75Z"),
        ("", "10:00:07Z"),
        ("x", "10:00:07Z"),
    ],
)
def test_digits_beyond_the_second(tmp_path, digits, expected):
    photograph(tmp_path / "p.tif", tags(7, EXIF_SubSecTime=digits or None))
    assert read_exif(tmp_path / "p.tif").time == f"2026-05-01T{expected}"


def test_heights_below_the_sea_and_places_without_references(tmp_path):
    photograph(tmp_path / "p.tif", tags(EXIF_GPSAltitudeRef="0x01", east=None))
    read = read_exif(tmp_path / "p.tif")
    assert read.height == -140.0 and read.unreferenced and read.longitude_deg == pytest.approx(91.99)


def test_a_series_in_order_of_its_times(tmp_path):
    north = [tags(9 - k, latitude=46.84 + 1e-4 * (9 - k)) for k in range(10)]
    problem = load_sequence(photographs(tmp_path, north))
    assert problem.frames == tuple(f"p{k}.tif" for k in range(9, -1, -1))
    np.testing.assert_array_equal(problem.t, np.arange(10.0))
    assert problem.epoch == "2026-05-01T10:00:00Z"
    steps = np.linalg.norm(np.diff(problem.images.position, axis=0), axis=1)
    np.testing.assert_allclose(steps, 11.12, rtol=0.01)
    assumed, heights, attitudes, ground = problem.warnings
    assert assumed == "10 positions have no sigma: 5 m per axis is assumed; set position_sigma"
    assert attitudes == "no attitudes: taken as straight down, nose along the track"
    assert "10 heights of EXIF (above sea level, by its standard)" in heights and "no geoid" in heights
    assert "gives no height of the ground" in ground


def test_frames_of_one_second_are_spread_over_it(tmp_path):
    problem = load_sequence(photographs(tmp_path, [tags(second) for second in (0, 0, 0, 0, 1, 3, 3)]))
    np.testing.assert_allclose(problem.t, [0, 0.25, 0.5, 0.75, 1, 3, 3.5])
    assert "6 images share their EXIF second" in problem.warnings[0]


def test_no_fix_wrong_hemisphere_and_no_reference(tmp_path):
    every = [tags(k, latitude=46.84 + 1e-4 * k) for k in range(8)]
    every[2] = tags(2, latitude=0.0, longitude=0.0)
    every[5] = tags(5, latitude=46.8405, east=None)
    every[6] = tags(6, latitude=46.8406, EXIF_GPSLongitude=None)
    problem = load_sequence(photographs(tmp_path, every))
    bad = [2, 5, 6]
    assert np.isinf(problem.known.position[bad]).all()
    assert np.isfinite(np.delete(problem.known.position, bad, axis=0)).all()
    steps = np.linalg.norm(np.diff(problem.images.position, axis=0), axis=1)
    np.testing.assert_allclose(steps, 11.12, rtol=0.01)
    said = " / ".join(problem.warnings)
    assert "1 positions are 0, 0 (no GPS fix; the first of frame p2.tif)" in said
    assert "wrong hemisphere (frame p5.tif" in said and "is a reference W or S missing?" in said
    assert "1 photographs give longitude or latitude without E, W, N, S" in said
    assert "3 of 8 frames have no position" in said


@pytest.mark.parametrize(
    ("reference", "height", "ellipsoid"),
    [
        (None, 140.0, False),
        ("0x00", 140.0, False),
        ("0x01", -140.0, False),
        ("1", -140.0, False),
        ("0x31", -140.0, False),  # the letter "1"
        ("0x02", 140.0, True),
        ("0x03", -140.0, True),
        ("0x10", 140.0, False),  # no value of the standard
        ("?", 140.0, False),
    ],
)
def test_what_heights_are_counted_from(tmp_path, reference, height, ellipsoid):
    photograph(tmp_path / "p.tif", tags(EXIF_GPSAltitudeRef=reference))
    read = read_exif(tmp_path / "p.tif")
    assert (read.height, read.above_ellipsoid) == (height, ellipsoid)


def test_heights_above_the_ellipsoid_need_no_word(tmp_path):
    problem = load_sequence(photographs(tmp_path, [tags(k, EXIF_GPSAltitudeRef="0x02") for k in range(3)]))
    assert not any("geoid" in words for words in problem.warnings)


RTK = 'drone-dji:RtkStdLon="0.012" drone-dji:RtkStdLat="0.013" drone-dji:RtkStdHgt="0.03" drone-dji:GimbalYaw'


@pytest.mark.parametrize(
    ("keys", "rtk", "expected"),
    [
        ("", False, (5.0, 0.035)),
        ("position_sigma = 3.0\nattitude_sigma = 0.1\n", False, (3.0, 0.1)),
        ("position_bias_sigma = 0\nattitude_bias_sigma = 0.0\n", False, (0.0, 0.0)),
        ("position_bias_sigma = 9.0\n", False, (9.0, 0.035)),
        ("", True, (0.03, 0.035)),  # as rough as the receiver says that it is
    ],
)
def test_receivers_and_gimbals_are_off_by_the_same_in_every_photograph(tmp_path, keys, rtk, expected):
    xmp = GIMBAL.format(90.0, -90.0)
    if rtk:
        xmp = xmp.replace("drone-dji:GimbalYaw", RTK)
    path = photographs(tmp_path, [tags(k) for k in range(5)], [xmp] * 5)
    path.write_text(keys + TOML)
    known = load_sequence(path).known
    assert (known.position_bias, known.attitude_bias) == expected


def test_a_photograph_without_time_lies_between_its_neighbours(tmp_path):
    every = [tags(k) for k in range(5)]
    every[2] = {}
    problem = load_sequence(photographs(tmp_path, every))
    np.testing.assert_allclose(problem.t, np.arange(5.0))
    assert "1 images have no time in their EXIF" in problem.warnings[0]


def test_a_gimbal_tells_the_attitude_unless_it_looks_at_the_sky(tmp_path):
    xmp = [GIMBAL.format(90.0, -90.0)] * 4 + [GIMBAL.format(90.0, 45.0)]
    problem = load_sequence(photographs(tmp_path, [tags(k) for k in range(5)], xmp))
    assert np.isfinite(problem.known.attitude[:4]).all() and np.isinf(problem.known.attitude[4]).all()
    assert any("1 attitudes look away from the ground (first: p4.tif)" in words for words in problem.warnings)
    up = problem.images.position[0] / np.linalg.norm(problem.images.position[0])
    axis = problem.images.world_from_body[0].apply(problem.mount.as_matrix()[:, 2])
    assert axis @ up == pytest.approx(
        -1.0, abs=1e-4
    )  # geocentric and geodetic verticals are .2 degrees apart


@pytest.mark.parametrize(
    ("every", "words"),
    [
        ([{}, {}], "no image has a time in its EXIF"),
        ([tags(k, latitude=0.0, longitude=0.0) for k in range(3)], "no frame has a position"),
        ([tags(k, EXIF_GPSAltitude=None) for k in range(3)], "3 positions have no height; give altitude"),
        ([tags(k, EXIF_GPSLatitude=None) for k in range(3)], "no frame has a position"),
    ],
)
def test_nothing_to_start_from_is_reported(tmp_path, every, words):
    with pytest.raises(FormatError, match=words):
        load_sequence(photographs(tmp_path, every))


def test_an_empty_folder_is_reported(tmp_path):
    with pytest.raises(FormatError, match="holds no images"):
        load_sequence(photographs(tmp_path, []))


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        ({"EXIF_DateTimeOriginal": "2026:13:01 10:00:02"}, "EXIF time"),
        ({"EXIF_DateTimeOriginal": "yesterday"}, "the EXIF time 'yesterday' is not of the form"),
        ({"EXIF_GPSLatitude": "(146) (50) (33.4)"}, "the EXIF place"),
        (GIMBAL.format(10.0, -90.0)[:-30], "its XMP cannot be read"),
        (GIMBAL.format(10.0, -90.0).encode()[:-40] + b"\xa2" + b"</x:xmpmeta>", "its XMP cannot be read"),
    ],
)
def test_a_photograph_with_broken_tags_is_left_out_and_named_and_the_flight_goes_on(tmp_path, spoilt, said):
    every = [tags(k, 46.84 + 1e-4 * k) for k in range(5)]
    toml = photographs(tmp_path, every, [GIMBAL.format(10.0, -90.0)] * 5)
    if isinstance(spoilt, dict):
        photograph(tmp_path / "photos" / "p2.tif", every[2] | spoilt, 2)
    else:
        text = spoilt if isinstance(spoilt, str) else spoilt.decode("latin-1")
        photograph(tmp_path / "photos" / "p2.tif", every[2], 2, text)
        if isinstance(spoilt, bytes):
            path = tmp_path / "photos" / "p2.tif"
            held = path.read_bytes()
            assert "\u00a2".encode() in held
            path.write_bytes(held.replace("\u00a2".encode(), b"\xa2 "))
    problem = load_sequence(toml)
    at = problem.frames.index("p2.tif")
    assert [bool(reason) for reason in problem.excluded] == [k == at for k in range(5)]
    assert problem.excluded[at].startswith(said)
    assert any("p2.tif" in words and said in words for words in problem.warnings)


@pytest.mark.parametrize("stamp", [None, "0000:00:00 00:00:00", "    :  :     :  :  "])
def test_a_camera_without_a_clock_breaks_no_photograph(tmp_path, stamp):
    every = [tags(k, 46.84 + 1e-4 * k) for k in range(4)]
    every[1]["EXIF_DateTimeOriginal"] = stamp
    problem = load_sequence(photographs(tmp_path, [{k: v for k, v in e.items() if v} for e in every]))
    assert not any(problem.excluded)
    assert problem.t[1] == pytest.approx(1.0)


def test_words_of_the_artist_may_be_in_any_code(tmp_path):
    photograph(tmp_path / "p.tif", tags(7, EXIF_Artist="J?rgen", EXIF_Copyright="J?rgen"))
    held = (tmp_path / "p.tif").read_bytes()
    (tmp_path / "p.tif").write_bytes(held.replace(b"J?rgen", b"J\xfcrgen"))
    assert read_exif(tmp_path / "p.tif").time == "2026-05-01T10:00:07Z"


def test_where_all_photographs_are_broken_the_first_is_named(tmp_path):
    toml = photographs(tmp_path, [tags(k, EXIF_DateTimeOriginal="yesterday") for k in range(3)])
    with pytest.raises(
        FormatError, match=r"no image has a time in its EXIF \(p0\.tif: the EXIF time 'yesterday'"
    ):
        load_sequence(toml)
