"""Attitude messages, built after the standard's tables (504.0-B): no samples of other makers are at hand.

Expected attitudes come from the standard's own matrices (elementary turns of axes), not from quaternions.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.io.formats import ccsds
from sightline.io.formats.ccsds_attitude import read_aem, read_apm

EPOCH = "2026-01-01T00:00:00Z"


def aem(rows: str, *, version: str = "1.0", **meta: str) -> str:
    given = {
        "OBJECT_NAME": "EXAMPLE", "OBJECT_ID": "2026-001A", "REF_FRAME_A": "EME2000",
        "REF_FRAME_B": "SC_BODY_1",
        "TIME_SYSTEM": "UTC", "START_TIME": "2026-01-01T00:00:00", "STOP_TIME": "2026-01-01T00:10:00",
        "ATTITUDE_TYPE": "QUATERNION", **meta,
    }  # fmt: skip
    words = "\n".join(f"{key} = {value}" for key, value in given.items())
    return (
        f"CCSDS_AEM_VERS = {version}\nCREATION_DATE = 2026-01-01T00:00:00\nORIGINATOR = TEST\n\nMETA_START\n"
        f"{words}\nMETA_STOP\n\nDATA_START\n{rows}\nDATA_STOP\n"
    )


def apm(data: str, version: str) -> str:
    return (
        f"CCSDS_APM_VERS = {version}\nCREATION_DATE = 2026-01-01T00:00:00\nORIGINATOR = TEST\nMETA_START\n"
        "OBJECT_NAME = EXAMPLE\nOBJECT_ID = 2026-001A\nCENTER_NAME = EARTH\nTIME_SYSTEM = UTC\nMETA_STOP\n"
        f"{data}\n"
    )


def write(tmp_path, text):
    path = tmp_path / "message"
    path.write_text(text)
    return path


def turn(axis: int, degrees: float) -> np.ndarray:
    """Components along axes that are turned about one of them."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[i, i] = out[j, j] = c
    out[i, j], out[j, i] = s, -s
    return out


def body_from_axes(sequence: str, angles) -> np.ndarray:
    """The standard's product: the first turn of the sequence acts first."""
    first, second, third = (turn(int(axis) - 1, angle) for axis, angle in zip(sequence, angles, strict=True))
    return third @ second @ first


ANGLES = (11.0, -23.0, 47.0)


@pytest.mark.parametrize("sequence", ["123", "312", "321", "231", "313", "121", "232"])
@pytest.mark.parametrize(
    ("kind", "more"),
    [("EULER_ANGLE", ""), ("EULER_ANGLE/RATE", " 0.1 0.2 0.3"), ("EULER_ANGLE/DERIVATIVE", " 0 0 0"),
     ("EULER_ANGLE/ANGVEL", " 0 0 0")],
)  # fmt: skip
def test_euler_angles_of_every_sequence(tmp_path, sequence, kind, more):
    version = "1.0" if kind in ("EULER_ANGLE", "EULER_ANGLE/RATE") else "2.0"
    words = sequence if version == "1.0" else sequence.translate(str.maketrans("123", "XYZ"))
    row = f"2026-01-01T00:00:01 {' '.join(map(str, ANGLES))}{more}"
    given = read_aem(
        write(tmp_path, aem(row, version=version, ATTITUDE_TYPE=kind, EULER_ROT_SEQ=words)), EPOCH
    )
    found = Rotation.from_quat(given.quat_xyzw[0]).as_matrix()
    np.testing.assert_allclose(found.T, body_from_axes(sequence, ANGLES), atol=1e-14)
    assert given.axes == "EME2000" and given.t.tolist() == [1.0]
    if version == "1.0":
        text = aem(row, ATTITUDE_TYPE=kind, EULER_ROT_SEQ=words, ATTITUDE_DIR="B2A")
        back = Rotation.from_quat(read_aem(write(tmp_path, text), EPOCH).quat_xyzw[0]).as_matrix()
        np.testing.assert_allclose(back, body_from_axes(sequence, ANGLES), atol=1e-14)


@pytest.mark.parametrize(
    ("kind", "more", "version"),
    [("QUATERNION", "", "1.0"), ("QUATERNION", "", "2.0"), ("QUATERNION/DERIVATIVE", " 0 0 0 0", "1.0"),
     ("QUATERNION/RATE", " 1 2 3", "1.0"), ("QUATERNION/ANGVEL", " 1 2 3", "2.0")],
)  # fmt: skip
def test_quaternions_with_whatever_follows_them(tmp_path, kind, more, version):
    q = np.array([0.1, -0.2, 0.3, np.sqrt(1 - 0.14)])
    orders = {"LAST": q} if version == "2.0" else {"LAST": q, "FIRST": q[[3, 0, 1, 2]]}
    for order, cells in orders.items():
        meta = {} if version == "2.0" else {"QUATERNION_TYPE": order, "ATTITUDE_DIR": "A2B"}
        text = aem(
            f"2026-01-01T00:00:01 {' '.join(map(str, cells))}{more}",
            version=version,
            ATTITUDE_TYPE=kind,
            **meta,
        )
        np.testing.assert_allclose(read_aem(write(tmp_path, text), EPOCH).quat_xyzw, [q], atol=1e-15)


def test_the_segment_of_the_images_is_taken_and_neighbours_are_joined(tmp_path):
    rows = [f"2026-01-01T00:00:{s:02d} 0 0 0 1" for s in range(8)]

    def segment(part: slice) -> str:
        whole = aem("\n".join(rows[part]), START_TIME=rows[part][0][:19], STOP_TIME=rows[part][-1][:19])
        return whole[whole.index("META_START") :]

    head = aem("")[: aem("").index("META_START")]
    path = write(tmp_path, head + segment(slice(0, 4)) + segment(slice(4, 8)))
    assert read_aem(path, EPOCH, span=(0.5, 2.5)).t.tolist() == [0.0, 1.0, 2.0, 3.0]
    both = read_aem(path, EPOCH, span=(2.0, 5.0))
    assert both.t.tolist() == list(range(8)) and both.segments == 2
    path = write(tmp_path, head + segment(slice(0, 3)) + segment(slice(6, 8)))
    with pytest.raises(FormatError, match="between segments 4 s are without data"):
        read_aem(path, EPOCH, span=(1.0, 7.0))
    path = write(tmp_path, head + segment(slice(0, 5)) + segment(slice(3, 8)))
    with pytest.raises(FormatError, match="segments overlap"):
        read_aem(path, EPOCH)


def test_useable_times_bound_what_is_joined(tmp_path):
    rows = "\n".join(f"2026-01-01T00:00:{s:02d} 0 0 0 1" for s in range(10))
    text = aem(rows, USEABLE_START_TIME="2026-01-01T00:00:02", USEABLE_STOP_TIME="2026-01-01T00:00:07")
    assert read_aem(write(tmp_path, text), EPOCH).useable == (2.0, 7.0)


Q = Rotation.from_euler("ZYX", [30.0, -20.0, 10.0], degrees=True)
RATE = np.array([1e-3, -2e-3, 5e-4])  # rad/s about body axes
DOT = (
    0.5
    * np.array(  # dq/dt = q (omega, 0) / 2, written out
        [
            Q.as_quat()[3] * RATE[0] + Q.as_quat()[1] * RATE[2] - Q.as_quat()[2] * RATE[1],
            Q.as_quat()[3] * RATE[1] + Q.as_quat()[2] * RATE[0] - Q.as_quat()[0] * RATE[2],
            Q.as_quat()[3] * RATE[2] + Q.as_quat()[0] * RATE[1] - Q.as_quat()[1] * RATE[0],
            -Q.as_quat()[:3] @ RATE,
        ]
    )
)


def keywords(**values: object) -> str:
    return "\n".join(f"{key} = {value}" for key, value in values.items())


def quaternion_words(q, dot=None) -> str:
    said = dict(zip(("Q1", "Q2", "Q3", "QC"), q, strict=True))
    if dot is not None:
        said |= dict(zip(("Q1_DOT", "Q2_DOT", "Q3_DOT", "QC_DOT"), dot, strict=True))
    return keywords(**said)


EARLIER = {"Q_FRAME_A": "EME2000", "Q_FRAME_B": "SC_BODY_1", "Q_DIR": "A2B"}
LATER = {"REF_FRAME_A": "EME2000", "REF_FRAME_B": "SC_BODY_1"}
AT = "EPOCH = 2026-01-01T00:00:10\n"
SPEED = {f"ANGVEL_{axis}": f"{v} [deg/s]" for axis, v in zip("XYZ", np.degrees(RATE), strict=True)}


@pytest.mark.parametrize(
    ("version", "data"),
    [
        ("1.0", AT + keywords(**EARLIER) + "\n" + quaternion_words(Q.as_quat(), DOT)),
        (
            "1.0",
            AT + keywords(**{**EARLIER, "Q_DIR": "B2A"}) + "\n"
            + quaternion_words(Q.as_quat() * [-1, -1, -1, 1], DOT * [-1, -1, -1, 1]),
        ),
        ("2.0", AT + f"QUAT_START\n{keywords(**LATER)}\n{quaternion_words(Q.as_quat(), DOT)}\nQUAT_STOP"),
        (
            "2.0",
            AT + f"QUAT_START\n{keywords(**LATER)}\n{quaternion_words(Q.as_quat())}\nQUAT_STOP\n"
            + "ANGVEL_START\n"
            + keywords(**LATER, ANGVEL_FRAME="SC_BODY_1", **SPEED) + "\nANGVEL_STOP",
        ),
    ],
)  # fmt: skip
def test_one_attitude_turns_evenly_at_its_rate(tmp_path, version, data):
    given = read_apm(write(tmp_path, apm(data, version)), EPOCH, span=(5.0, 30.0))
    assert given.t[0] == 5.0 and given.t[-1] == 30.0 and given.axes == "EME2000"
    assert given.words.startswith(
        "one attitude, of 10.000 s from the epoch, turning evenly at 0.002291 rad/s"
    )
    for t, q in zip(given.t, given.quat_xyzw, strict=True):
        size = np.linalg.norm(RATE) * (t - 10.0)
        half = np.append(np.sin(size / 2) * RATE / np.linalg.norm(RATE), np.cos(size / 2))
        expected = Q * Rotation.from_quat(half)
        assert (expected.inv() * Rotation.from_quat(q)).magnitude() < 1e-12


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_one_attitude_of_euler_angles(tmp_path, version):
    if version == "1.0":
        words = keywords(
            EULER_FRAME_A="GCRF", EULER_FRAME_B="SC_BODY_1", EULER_DIR="A2B", EULER_ROT_SEQ="313"
        )
        data = AT + words + "\nZ_ANGLE = 11 [deg]\nX_ANGLE = -23 [deg]\nZ_ANGLE = 47 [deg]"
    else:
        words = keywords(
            REF_FRAME_A="GCRF", REF_FRAME_B="SC_BODY", EULER_ROT_SEQ="ZXZ", ANGLE_1=11, ANGLE_2=-23
        )
        data = AT + f"EULER_START\n{words}\nANGLE_3 = 47\nEULER_STOP"
    given = read_apm(write(tmp_path, apm(data, version)), EPOCH)
    found = Rotation.from_quat(given.quat_xyzw[0]).as_matrix()
    np.testing.assert_allclose(found.T, body_from_axes("313", ANGLES), atol=1e-14)
    assert "still in GCRF" in given.words


@pytest.mark.parametrize(("version", "frame"), [("1.0", "B"), ("1.0", "A"), ("2.0", "")])
def test_one_attitude_of_euler_angles_turns_at_their_rates(tmp_path, version, frame):
    """Rates in a frame are the angular velocity's components there; derivatives are of the angles."""
    rates = np.array([0.2, -0.1, 0.05])  # deg/s
    if version == "1.0":
        words = keywords(
            EULER_FRAME_A="GCRF", EULER_FRAME_B="SC_BODY_1", EULER_DIR="A2B", EULER_ROT_SEQ="312",
            RATE_FRAME=f"EULER_FRAME_{frame}",
            **{f"{axis}_ANGLE": f"{angle} [deg]" for axis, angle in zip("ZXY", ANGLES, strict=True)},
            **{f"{axis}_RATE": f"{rate} [deg/s]" for axis, rate in zip("XYZ", rates, strict=True)},
        )  # fmt: skip
        data = AT + words
    else:
        words = keywords(
            REF_FRAME_A="GCRF", REF_FRAME_B="SC_BODY", EULER_ROT_SEQ="ZXY",
            **{f"ANGLE_{k}": angle for k, angle in enumerate(ANGLES, 1)},
            **{f"ANGLE_{k}_DOT": rate for k, rate in enumerate(rates, 1)},
        )  # fmt: skip
        data = AT + f"EULER_START\n{words}\nEULER_STOP"
    given = read_apm(write(tmp_path, apm(data, version)), EPOCH, span=(9.0, 11.0))
    start, later = (body_from_axes("312", np.array(ANGLES) + t * rates) for t in (0.0, 1e-4))
    omega = np.radians(rates)
    if frame == "A":
        omega = start @ omega
    if version == "2.0":  # dM/dt = -[omega x] M
        cross = -(later - start) / 1e-4 @ start.T
        omega = np.array([cross[2, 1], cross[0, 2], cross[1, 0]])
    expected = start.T @ Rotation.from_rotvec(omega).as_matrix()
    # 1e-4 s of turns by 3e-3 rad/s: 1e-9 of the rate
    np.testing.assert_allclose(Rotation.from_quat(given.quat_xyzw[-1]).as_matrix(), expected, atol=1e-8)


def test_metadata_of_one_attitude_need_no_marks(tmp_path):
    """As in the examples of the standard."""
    text = apm(AT + keywords(**EARLIER) + "\n" + quaternion_words(Q.as_quat(), DOT), "1.0")
    path = write(tmp_path, text.replace("META_START\n", "").replace("META_STOP\n", ""))
    given = read_apm(path, EPOCH)
    assert (given.centre, given.time_scale) == ("EARTH", "UTC")
    np.testing.assert_allclose(given.quat_xyzw, [Q.as_quat()], atol=1e-15)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (AT + "SPIN_ALPHA = 1", "SPIN_ALPHA tells of a spin, not about which axis of the body"),
        (
            AT + keywords(**EARLIER) + "\n" + quaternion_words([0, 0, 0, 1]) + "\nSPIN_ANGLE_VEL = 1 [deg/s]",
            "SPIN_ANGLE_VEL tells of a spin, not about which axis of the body",
        ),
        (AT + keywords(USER_DEFINED_A=1), "holds neither a quaternion nor Euler angles"),
        (
            AT + "META_START\nOBJECT_NAME = OTHER\nMETA_STOP\n" + AT,
            "line 11: a second segment; an APM is of one",
        ),
        (AT + keywords(**EARLIER) + "\nQ1 = 0\nQ2 = 0\nQC = 1", "Q3 is missing"),
        (keywords(**EARLIER) + "\n" + quaternion_words([0, 0, 0, 1]), "EPOCH stands 0 times"),
        (AT + keywords(**EARLIER) + "\n" + quaternion_words([0, 0, 0, 2]), "quaternion of length"),
    ],
)
def test_one_attitude_that_is_none_is_refused(tmp_path, data, words):
    with pytest.raises(FormatError, match=words):
        read_apm(write(tmp_path, apm(data, "1.0")), EPOCH)


def test_one_attitude_of_another_hour_is_refused(tmp_path):
    text = apm(AT + keywords(**EARLIER) + "\n" + quaternion_words([0, 0, 0, 1]), "1.0")
    with pytest.raises(FormatError, match="one attitude is carried over 600 s at most"):
        read_apm(write(tmp_path, text), EPOCH, span=(3000.0, 3010.0))


def test_messages_in_xml_are_those_in_kvn(tmp_path):
    ndm_io = pytest.importorskip("ccsds_ndm.ndm_io")
    from ccsds_ndm.mapping import NDMFileFormats

    t, quat = np.arange(4.0), Rotation.random(4, rng=np.random.default_rng(1)).as_quat()
    place = np.array([[7e6, 1e3, 2.0]] * 4) + t[:, None]
    ccsds.write_aem(tmp_path / "a.aem", t, quat, EPOCH)
    ccsds.write_oem(tmp_path / "o.oem", t, place, place * 1e-3, EPOCH)
    for name in ("a.aem", "o.oem"):
        tree = ndm_io.NdmIo().from_path(tmp_path / name)
        (tmp_path / f"{name}.xml").write_text(ndm_io.NdmIo().to_string(tree, NDMFileFormats.XML))
    found = read_aem(tmp_path / "a.aem.xml", EPOCH)
    np.testing.assert_allclose(found.quat_xyzw, quat, atol=1e-15)
    np.testing.assert_allclose(found.t, t, atol=1e-9)
    orbit = ccsds.read_oem(tmp_path / "o.oem.xml", EPOCH)
    np.testing.assert_allclose(orbit.position, place, rtol=1e-15)
    assert orbit.axes == "ITRF"
    text = (tmp_path / "o.oem.xml").read_text()
    secret = tmp_path / "secret.txt"
    secret.write_text("2026-01-01")
    for spoilt in (
        text.replace("<oem", f'<!DOCTYPE oem [<!ENTITY x SYSTEM "{secret.as_uri()}">]>\n<oem', 1),
        text.replace("<oem", "<!DOCTYPE oem>\n<oem", 1),
    ):
        (tmp_path / "spoilt.xml").write_text(spoilt)
        with pytest.raises(FormatError, match="XML with a document type or entities is not read"):
            ccsds.read_oem(tmp_path / "spoilt.xml", EPOCH)
    (tmp_path / "spoilt.xml").write_text(text.replace("<X>", "<Y>", 1))
    with pytest.raises(FormatError, match="is no OEM in XML"):
        ccsds.read_oem(tmp_path / "spoilt.xml", EPOCH)


def aem_xml(kind: str, states: str, meta: str = "", version: str = "2.0") -> str:
    """An attitude message in XML, after the schema: two states, `{t}` their instants."""
    states = "".join(
        f"<attitudeState>{states.format(t=f'2026-01-01T00:00:0{k}')}</attitudeState>" for k in (0, 1)
    )
    direction = "<ATTITUDE_DIR>A2B</ATTITUDE_DIR>" if version == "1.0" else ""
    return (
        f'<?xml version="1.0"?><!-- <oem --><aem id="CCSDS_AEM_VERS" version="{version}"><header>'
        "<COMMENT>none</COMMENT><CREATION_DATE>2026-01-01T00:00:00</CREATION_DATE><ORIGINATOR>T</ORIGINATOR>"
        "</header><body><segment><metadata><OBJECT_NAME>E</OBJECT_NAME><OBJECT_ID>2026-001A</OBJECT_ID>"
        f"<REF_FRAME_A>EME2000</REF_FRAME_A><REF_FRAME_B>SC_BODY_1</REF_FRAME_B>{direction}"
        "<TIME_SYSTEM>UTC</TIME_SYSTEM><START_TIME>2026-01-01T00:00:00</START_TIME>"
        f"<STOP_TIME>2026-01-01T00:00:01</STOP_TIME><ATTITUDE_TYPE>{kind}</ATTITUDE_TYPE>{meta}</metadata>"
        f"<data><COMMENT>none</COMMENT>{states}</data></segment></body></aem>"
    )


XML_QUATERNION = "<quaternion><Q1>0</Q1><Q2>0.6</Q2><Q3>0</Q3><QC>0.8</QC></quaternion>"
#: Kind, states, more metadata, version.
XML_STATES = [
    ("QUATERNION", f"<quaternionEphemeris><EPOCH>{{t}}</EPOCH>{XML_QUATERNION}</quaternionEphemeris>", "",
     "2.0"),
    ("QUATERNION", f"<quaternionState><EPOCH>{{t}}</EPOCH>{XML_QUATERNION}</quaternionState>",
     "<QUATERNION_TYPE>FIRST</QUATERNION_TYPE>", "1.0"),
    ("QUATERNION/ANGVEL", f"<quaternionAngVel><EPOCH>{{t}}</EPOCH>{XML_QUATERNION}<angVel>"
     '<ANGVEL_X units="deg/s">1</ANGVEL_X><ANGVEL_Y units="deg/s">2</ANGVEL_Y><ANGVEL_Z>3</ANGVEL_Z></angVel>'
     "</quaternionAngVel>", "<ANGVEL_FRAME>SC_BODY_1</ANGVEL_FRAME>", "2.0"),
    ("EULER_ANGLE", "<eulerAngle><EPOCH>{t}</EPOCH><rotationAngles>"
     + "".join(f'<rotation{k} angle="{a}_ANGLE" units="deg">{v}</rotation{k}>'
               for k, a, v in ((1, "Y", 73.739795291688), (2, "X", 0), (3, "Z", 0)))
     + "</rotationAngles></eulerAngle>", "<EULER_ROT_SEQ>213</EULER_ROT_SEQ>", "1.0"),
]  # fmt: skip


@pytest.mark.parametrize("space", ["", 'xmlns="urn:ccsds:schema:ndmxml" ', "ndm"])
@pytest.mark.parametrize(("kind", "states", "meta", "version"), XML_STATES)
def test_attitudes_in_xml_of_any_kind_and_namespace(tmp_path, kind, states, meta, version, space):
    text = aem_xml(kind, states, meta, version)
    if space == "ndm":
        text = text.replace("<aem", "<ndm><aem").replace("</aem>", "</aem></ndm>")
    else:
        text = text.replace("<aem ", f"<aem {space}")
    found = read_aem(write(tmp_path, text), EPOCH)
    np.testing.assert_allclose(found.t, [0.0, 1.0])
    # from the stars (A) to the body (B): world_from_body is the quaternion itself, 2 atan(.6 / .8) about y
    np.testing.assert_allclose(found.quat_xyzw, [[0.0, 0.6, 0.0, 0.8]] * 2, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("</aem>", "", "is no AEM in XML .*was it cut"),
        ("<QC>0.8</QC>", "", "without a quaternion|holds 4 values"),
        ("<Q2>0.6</Q2>", "<Q2>0.6</Q2><Q2>0.6</Q2>", "holds Q2 2 times; once is needed"),
        ("<Q2>0.6</Q2>", "<Q2></Q2>", "Q2 holds '', no number"),
        ('units="deg/s">2', 'units="rad/s">2', "ANGVEL_Y is in 'rad/s'; CCSDS messages give it in deg"),
        ("</aem>", "</aem><aem/>", "is no AEM in XML"),
        ("aem", "oem", "<oem> holds 0 messages <aem>"),
    ],
)
def test_xml_that_holds_no_attitudes_is_refused(tmp_path, old, new, words):
    text = aem_xml(*XML_STATES[2])
    with pytest.raises(FormatError, match=words):
        read_aem(write(tmp_path, text.replace(old, new)), EPOCH)


def test_written_orbits_and_attitudes_are_what_another_reader_finds(tmp_path):
    ndm_io = pytest.importorskip("ccsds_ndm.ndm_io")
    t = np.array([0.0, 0.25, 1.5])
    place = np.array([[7e6, -1234567.891, 0.125], [7e6, 0.0, 1.0], [6.9e6, 1e6, 2e6]])
    speed = np.array([[0.1, 7512.3456789, -1.0]] * 3)
    ccsds.write_oem(
        tmp_path / "o.oem", t, place, speed, EPOCH, object_name="PROBE", frame="IAU_MARS", centre="MARS"
    )
    (segment,) = ndm_io.NdmIo().from_path(tmp_path / "o.oem").body.segment
    assert (segment.metadata.center_name, segment.metadata.ref_frame) == ("MARS", "IAU_MARS")
    assert segment.metadata.start_time == "2026-01-01T00:00:00.000000000"
    for row, p, v in zip(segment.data.state_vector, place, speed, strict=True):
        # written to the nanometre and the femtometre per second
        np.testing.assert_allclose(
            [float(row.x.value), float(row.y.value), float(row.z.value)], p / 1e3, atol=1e-12
        )
        found = [float(row.x_dot.value), float(row.y_dot.value), float(row.z_dot.value)]
        np.testing.assert_allclose(found, v / 1e3, atol=1e-15)
    quat = Rotation.random(3, rng=np.random.default_rng(2)).as_quat()
    ccsds.write_aem(tmp_path / "a.aem", t, quat, EPOCH, frame="IAU_MARS", centre="MARS")
    (segment,) = ndm_io.NdmIo().from_path(tmp_path / "a.aem").body.segment
    assert (segment.metadata.center_name, segment.metadata.ref_frame_a) == ("MARS", "IAU_MARS")
    for state, q in zip(segment.data.attitude_state, quat, strict=True):
        found = state.quaternion_state.quaternion
        np.testing.assert_allclose(
            [float(found.q1), float(found.q2), float(found.q3), float(found.qc)], q, atol=1e-15
        )
