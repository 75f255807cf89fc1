from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats import ccsds, ccsds_attitude, instants

EPOCH = "2026-01-01T00:00:00Z"

AEM = """CCSDS_AEM_VERS = 1.0
CREATION_DATE = 2026-01-01T00:00:00
ORIGINATOR = TEST

META_START
COMMENT made for a test
OBJECT_NAME = EXAMPLE
OBJECT_ID = 2026-001A
REF_FRAME_A = ITRF2014
REF_FRAME_B = SC_BODY_1
ATTITUDE_DIR = A2B
TIME_SYSTEM = UTC
START_TIME = 2026-01-01T00:00:01
STOP_TIME = 2026-01-01T00:00:02.5
ATTITUDE_TYPE = QUATERNION
QUATERNION_TYPE = LAST
META_STOP

DATA_START
2026-01-01T00:00:01 0.56748 0.03146 0.45689 0.68427
2026-001T00:00:02.5 0.42319 -0.45697 0.23784 0.74533
DATA_STOP
"""

OEM = """CCSDS_OEM_VERS = 2.0
CREATION_DATE = 2026-01-01T00:00:00
ORIGINATOR = TEST
META_START
OBJECT_NAME = EXAMPLE
OBJECT_ID = 2026-001A
CENTER_NAME = EARTH
REF_FRAME = ITRF
TIME_SYSTEM = UTC
START_TIME = 2026-01-01T00:00:00
STOP_TIME = 2026-01-01T00:00:02
META_STOP
2026-01-01T00:00:00.0 7000.0 0.0 1.0 0.0 7.0 0.5
2026-01-01T00:00:01.0 7000.0 7.0 1.5 0.0 7.0 0.5
COVARIANCE_START
EPOCH = 2026-01-01T00:00:00
4e-6
0 9e-6
0 0 16e-6
0 0 0 1e-12
0 0 0 0 1e-12
0 0 0 0 0 1e-12
COVARIANCE_STOP
META_START
OBJECT_NAME = EXAMPLE
OBJECT_ID = 2026-001A
CENTER_NAME = EARTH
REF_FRAME = ITRF
TIME_SYSTEM = UTC
START_TIME = 2026-01-01T00:00:01
STOP_TIME = 2026-01-01T00:00:02
META_STOP
2026-01-01T00:00:01.0 7000.0 7.0 1.5 0.0 7.0 0.5
2026-01-01T00:00:02.0 7000.0 14.0 2.0 0.0 7.0 0.5
"""


def file(tmp_path, text):
    path = tmp_path / "message.kvn"
    path.write_text(text)
    return path


def matrix_of_the_standard(q1, q2, q3, qc):
    """CCSDS 504.0-B: components in frame B from components in frame A, for a quaternion from A to B."""
    return np.array(
        [
            [q1**2 - q2**2 - q3**2 + qc**2, 2 * (q1 * q2 + q3 * qc), 2 * (q1 * q3 - q2 * qc)],
            [2 * (q1 * q2 - q3 * qc), -(q1**2) + q2**2 - q3**2 + qc**2, 2 * (q2 * q3 + q1 * qc)],
            [2 * (q1 * q3 + q2 * qc), 2 * (q2 * q3 - q1 * qc), -(q1**2) - q2**2 + q3**2 + qc**2],
        ]
    )


def test_an_aem_turns_vectors_as_the_standard_says(tmp_path):
    attitude = ccsds_attitude.read_aem(file(tmp_path, AEM), EPOCH)
    np.testing.assert_array_equal(attitude.t, [1.0, 2.5])
    earth_from_body = Rotation.from_quat(attitude.quat_xyzw[0]).as_matrix()
    np.testing.assert_allclose(
        earth_from_body.T, matrix_of_the_standard(0.56748, 0.03146, 0.45689, 0.68427), atol=2e-5
    )


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (
            "REF_FRAME_A = ITRF2014\nREF_FRAME_B = SC_BODY_1",
            "REF_FRAME_A = SC_BODY_1\nREF_FRAME_B = ITRF2014",
        ),
        ("ATTITUDE_DIR = A2B", "ATTITUDE_DIR = B2A"),
    ],
)
def test_an_aem_the_other_way_round_is_the_inverse(tmp_path, old, new):
    forward = ccsds_attitude.read_aem(file(tmp_path, AEM), EPOCH)
    backward = ccsds_attitude.read_aem(file(tmp_path, AEM.replace(old, new)), EPOCH)
    there, back = Rotation.from_quat(forward.quat_xyzw), Rotation.from_quat(backward.quat_xyzw)
    assert (there * back).magnitude().max() < 1e-12


def test_a_scalar_that_stands_first_is_put_last(tmp_path):
    text = AEM.replace("LAST", "FIRST").replace(
        "0.56748 0.03146 0.45689 0.68427", "0.68427 0.56748 0.03146 0.45689"
    )
    text = text.replace("0.42319 -0.45697 0.23784 0.74533", "0.74533 0.42319 -0.45697 0.23784")
    np.testing.assert_allclose(
        ccsds_attitude.read_aem(file(tmp_path, text), EPOCH).quat_xyzw,
        ccsds_attitude.read_aem(file(tmp_path, AEM), EPOCH).quat_xyzw,
        atol=1e-12,
    )


def test_a_written_aem_is_read_back_to_a_nanosecond_and_to_rounding(tmp_path):
    t = 12.5 + np.arange(2000) / 2000.0 + 1e-9 * np.arange(2000)
    quat = Rotation.from_rotvec(np.random.default_rng(0).normal(size=(2000, 3))).as_quat()
    ccsds.write_aem(tmp_path / "a.aem", t, quat, EPOCH, object_name="EXAMPLE")
    again = ccsds_attitude.read_aem(tmp_path / "a.aem", EPOCH)
    np.testing.assert_allclose(again.t, t, atol=0.6e-9)
    np.testing.assert_allclose(again.quat_xyzw, quat, atol=1e-15)
    assert "START_TIME = 2026-01-01T00:00:12.500000000" in (tmp_path / "a.aem").read_text()


def test_instants_agree_with_the_calendar():
    # by another path: the standard library's arithmetic
    for text, seconds in (("2026-01-02T03:04:05.25Z", 97445.25), ("2025-365T23:59:59", -1.0)):
        assert instants.seconds_from_epoch(text, EPOCH, "") == seconds
    later = datetime(2026, 1, 1, tzinfo=UTC) + timedelta(seconds=4000.5)
    assert instants.utc_text(4000.5, EPOCH) == later.strftime("%Y-%m-%dT%H:%M:%S.500000000")
    assert instants.utc_text(-0.25, "2026-01-01T00:00:00.125Z") == "2025-12-31T23:59:59.875000000"


def test_an_oem_becomes_metres_and_its_segments_one_table(tmp_path):
    orbit = ccsds.read_oem(file(tmp_path, OEM), EPOCH)
    np.testing.assert_array_equal(orbit.t, [0.0, 1.0, 2.0])
    np.testing.assert_allclose(orbit.position[2], [7e6, 14e3, 2e3])
    np.testing.assert_allclose(orbit.velocity[0], [0.0, 7e3, 500.0])


@pytest.mark.parametrize(
    ("text", "read", "words"),
    [
        (
            OEM.replace("ITRF", "EMEE2000"),
            ccsds.read_oem,
            "REF_FRAME = EMEE2000 is not handled; is EME2000 meant?",
        ),
        (OEM.replace("ITRF", "RTN"), ccsds.read_oem, "REF_FRAME = RTN is not handled; it goes round with"),
        (
            OEM.replace("UTC", "TDB"),
            ccsds.read_oem,
            "TIME_SYSTEM = TDB is not handled; allowed: UTC, TAI, GPS, TT, UT1",
        ),
        (OEM.replace("UTC", "GPS", 1), ccsds.read_oem, "its segments differ in TIME_SYSTEM: GPS and UTC"),
        (OEM.replace("4e-6", "-4e-6"), ccsds.read_oem, "line 16: the covariance is not positive"),
        (OEM.replace("\n0 9e-6", "\n7e-6 9e-6"), ccsds.read_oem, "line 16: the covariance is not positive"),
        (OEM.replace("01.0 7000.0 7.0 1.5", "09.0 7000.0 7.0 1.5", 1), ccsds.read_oem, "epochs are mixed"),
        (
            OEM.replace("CENTER_NAME = EARTH", "CENTRE = EARTH", 1),
            ccsds.read_oem,
            "keyword CENTER_NAME is missing",
        ),
        (OEM.replace("META_STOP", "", 1), ccsds.read_oem, "is not KEYWORD = value"),
        (OEM.replace("= 2.0", "= 7.0", 1), ccsds.read_oem, "CCSDS_OEM_VERS = 7.0 is not known"),
        (OEM.replace("ORIGINATOR = TEST\n", ""), ccsds.read_oem, "ORIGINATOR is missing"),
        (
            OEM.replace("7.0 1.5", "x 1.5"),
            ccsds.read_oem,
            "line 14: '7000.0 x 1.5 0.0 7.0 0.5' are not numbers",
        ),
        (
            AEM.replace("SC_BODY_1", "EME2000"),
            ccsds_attitude.read_aem,
            "attitude from ITRF2014 to EME2000; one of both must be the body",
        ),
        (
            AEM.replace("= QUATERNION\n", "= SPIN\n"),
            ccsds_attitude.read_aem,
            "ATTITUDE_TYPE = SPIN is not handled: it does not say which axis of the body spins",
        ),
        (
            AEM.replace("= QUATERNION\n", "= EULER_ANGEL\n"),
            ccsds_attitude.read_aem,
            "ATTITUDE_TYPE = EULER_ANGEL is not handled; is EULER_ANGLE meant?",
        ),
        (
            AEM.replace("DATA_STOP\n", ""),
            ccsds_attitude.read_aem,
            "not between one DATA_START and one DATA_STOP",
        ),
        (
            AEM.replace("2026-01-01T00:00:01 0", "yesterday 0"),
            ccsds_attitude.read_aem,
            "'yesterday' is not a UTC instant",
        ),
        (AEM.replace("0.68427", "0.98427"), ccsds_attitude.read_aem, "row 1 holds a quaternion of length"),
        (
            AEM.replace("2026-001T00:00:02.5", "2026-001T00:00:00.5"),
            ccsds_attitude.read_aem,
            "unordered times",
        ),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(tmp_path, text, read, words):
    with pytest.raises(FormatError) as caught:
        read(file(tmp_path, text), EPOCH)
    assert "message.kvn" in str(caught.value) and words in str(caught.value)


def test_a_message_of_the_wrong_kind_is_said_to_be_so(tmp_path):
    with pytest.raises(FormatError, match="is a CCSDS AEM; OEM is needed here"):
        ccsds.is_ccsds(file(tmp_path, AEM), "OEM")


def test_the_covariance_nearest_to_the_images_gives_the_sigma(tmp_path):
    # variances of 4, 9 and 16 mm^2 km-wise: 2, 3, 4 m; their rms
    assert ccsds.read_oem(file(tmp_path, OEM), EPOCH).sigma == pytest.approx(np.sqrt((4 + 9 + 16) / 3))


def test_an_acquisition_may_name_an_oem_and_an_aem(folder):
    t = np.linspace(-1.0, 2.0, 7)
    position = np.column_stack([7.078e6 + 0 * t, 0 * t, 7000.0 * t])
    rows = [
        f"{instants.utc_text(k, EPOCH)} {p[0] / 1e3} {p[1] / 1e3} {p[2] / 1e3} 0 0 7.0"
        for k, p in zip(t, position, strict=True)
    ]
    head = OEM[: OEM.index("2026-01-01T00:00:00.0")]
    (folder.path / "orbit.oem").write_text(head + "\n".join(rows) + "\n")
    # over longitude 0: down is -x, forward (north) is +z, right is down x forward = +y
    body = Rotation.from_matrix(np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0.0]]))
    ccsds.write_aem(folder.path / "attitude.aem", t, np.tile(body.as_quat(), (7, 1)), EPOCH)
    folder.replace(
        'kind = "level-flight"\naltitude = 700e3\nground_speed = 7000.0',
        'kind = "ephemeris"\npositions = "orbit.oem"\nattitudes = "attitude.aem"',
    )
    acquisition = load_acquisition(folder.write())
    seen = acquisition.cameras[0].locate([[0.0, 59.5], [0.0, 0.0]], acquisition.surface)
    np.testing.assert_allclose(seen[0], [6378137.0, 0.0, 0.0], atol=1e-3)
    assert seen[1, 1] > 100.0  # column 0 is to the right: east is +y here
    folder.replace('epoch = "2026-01-01T00:00:00Z"\n', "")
    with pytest.raises(FormatError, match=r"orbit\.oem: its times are UTC and \[acquisition\] has no epoch"):
        load_acquisition(folder.write())


def test_segments_whose_rows_lie_apart_are_read_as_they_stand(tmp_path):
    """As in the standard's own example: rows are left out, and none lies within the useable span."""
    head, _, rest = OEM.partition("META_START")
    first = rest[: rest.index("META_STOP")]
    rows = "META_STOP\n2026-01-01T00:00:00.0 7000.0 0 1 0 7 0\n2026-01-01T00:10:00.0 7000.0 1 1 0 7 0\n"
    early = first.replace("00:00:02", "00:10:00") + "USEABLE_START_TIME = 2026-01-01T00:01:00\n"
    early += "USEABLE_STOP_TIME = 2026-01-01T00:09:00\n"
    late = early.replace("T00:", "T01:")
    text = f"{head}META_START{early}{rows}META_START{late}{rows.replace('T00:', 'T01:')}"
    orbit = ccsds.read_oem(file(tmp_path, text), EPOCH)
    np.testing.assert_array_equal(orbit.t, [0.0, 600.0, 3600.0, 4200.0])
    assert orbit.useable == (60.0, 4140.0) and orbit.segments == 2
    alone = ccsds.read_oem(file(tmp_path, text), EPOCH, span=(3700.0, 3800.0))
    assert alone.t.tolist() == [3600.0, 4200.0] and alone.segments == 1
    with pytest.raises(FormatError, match="between segments 3000 s are without data"):
        ccsds.read_oem(file(tmp_path, text), EPOCH, span=(500.0, 3700.0))
