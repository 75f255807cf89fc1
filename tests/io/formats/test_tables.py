from __future__ import annotations

import tracemalloc
from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest

from sightline.errors import FormatError, InputError
from sightline.io.formats import tables


def csv(tmp_path, text):
    path = tmp_path / "table.csv"
    path.write_text(text)
    return path


def message(read, path) -> str:
    with pytest.raises(FormatError) as caught:
        read(path)
    return str(caught.value)


def test_positions_come_back_bit_for_bit(tmp_path):
    t = 1e4 + np.arange(5) / 3.0
    xyz = np.random.default_rng(0).normal(size=(5, 3)) * 7e6
    tables.write_positions(tmp_path / "p.csv", t, xyz)
    assert (tmp_path / "p.csv").read_text().startswith("t,x,y,z\n")
    again_t, again = tables.read_positions(tmp_path / "p.csv")
    np.testing.assert_array_equal(again_t, t)
    np.testing.assert_array_equal(again, xyz)
    assert not list(tmp_path.glob(".*"))


def test_attitudes_come_back_to_rounding(tmp_path):
    q = np.random.default_rng(1).normal(size=(4, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    tables.write_attitudes(tmp_path / "a.csv", np.arange(4.0), q)
    np.testing.assert_allclose(tables.read_attitudes(tmp_path / "a.csv")[1], q, atol=4e-16)


def test_a_motion_comes_back_with_its_sigmas(tmp_path):
    rng = np.random.default_rng(2)
    absolute = np.full((3, 3), np.inf)
    given = tables.MotionTable(
        np.array([0.0, 0.1, 0.2]), 1e-5 * rng.normal(size=(3, 3)), np.full((3, 3), 1e-7), absolute,
        np.array([True, False, True]),
    )  # fmt: skip
    tables.write_motion(tmp_path / "motion.csv", given)
    header = (tmp_path / "motion.csv").read_text().splitlines()[0]
    assert header == (
        "t,roll,pitch,yaw,sigma_roll,sigma_pitch,sigma_yaw,"
        "sigma_absolute_roll,sigma_absolute_pitch,sigma_absolute_yaw,observed,line"
    )
    again = tables.read_motion(tmp_path / "motion.csv")
    np.testing.assert_array_equal(again.t, given.t)
    np.testing.assert_allclose(again.angles, given.angles, rtol=1e-11)
    np.testing.assert_array_equal(again.sigma, given.sigma)
    assert np.isinf(again.sigma_absolute).all()
    np.testing.assert_array_equal(again.observed, given.observed)


def test_a_truth_table_is_a_motion_without_sigma(tmp_path):
    motion = tables.read_motion(csv(tmp_path, "t,roll,pitch,yaw\n0,1e-6,2e-6,3e-6\n1,0,0,0\n"))
    assert motion.sigma is None
    np.testing.assert_array_equal(motion.angles[0], [1e-6, 2e-6, 3e-6])


def test_a_motion_without_sigma_is_not_written_as_a_result(tmp_path):
    with pytest.raises(InputError, match="without sigma"):
        tables.write_motion(tmp_path / "m.csv", tables.MotionTable(np.zeros(1), np.zeros((1, 3))))


def test_columns_may_stand_in_any_order_and_comments_are_skipped(tmp_path):
    t, xyz = tables.read_positions(csv(tmp_path, "# made by hand\nz,t,x,y\n\n3,0,1,2\n6,1,4,5\n"))
    np.testing.assert_array_equal(xyz, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(t, [0, 1])


def test_a_spectrum_says_where_it_was_observed(tmp_path):
    tables.write_spectrum(
        tmp_path / "s.csv",
        np.array([1.0, 2.0]),
        np.full((2, 3), 1e-14),
        np.full((2, 3), 1e-16),
        np.array([[1, 0, 1], [1, 1, 0]], bool),
    )
    rows = (tmp_path / "s.csv").read_text().splitlines()
    assert rows[0].startswith("frequency,psd_roll,psd_pitch,psd_yaw,error_roll,")
    assert rows[1] == "1,1e-14,1e-14,1e-14,1e-16,1e-16,1e-16,1,0,1"


def test_a_missing_column_is_named_with_the_header_expected(tmp_path):
    said = message(tables.read_positions, csv(tmp_path, "t,lat,lon,h\n0,1,2,3\n"))
    assert "column 'x' is missing: the header is 't,lat,lon,h'; expected 't,x,y,z'" in said


def test_a_column_that_is_there_twice_is_refused(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("column,stages,stages\n0,4,32\n")
    for reads in (tables.read_columns, tables.read_long_columns):
        with pytest.raises(FormatError, match="column 'stages' is there 2 times: the header is"):
            reads(path, ("column", "stages"))
    # one that nobody asks for may be there as often as it likes
    path.write_text("column,note,note\n0,4,32\n")
    assert tables.read_columns(path, ("column",))["column"].tolist() == [0.0]


def test_a_word_in_place_of_a_number_names_line_and_column(tmp_path):
    said = message(tables.read_positions, csv(tmp_path, "t,x,y,z\n0,1,2,3\n1,4,five,6\n"))
    assert "table.csv: line 3, column 'y': 'five' is not a number" in said


def test_nan_names_line_and_column(tmp_path):
    said = message(tables.read_positions, csv(tmp_path, "t,x,y,z\n0,1,2,3\n1,4,nan,6\n2,4,nan,6\n"))
    assert "line 3, column 'y' is nan (2 such in all)" in said


def test_a_row_that_is_too_short_is_named(tmp_path):
    said = message(tables.read_positions, csv(tmp_path, "t,x,y,z\n0,1,2\n"))
    assert "line 2 has 3 values, the header has 4" in said


def test_duplicate_times_are_refused(tmp_path):
    said = message(tables.read_positions, csv(tmp_path, "t,x,y,z\n0,1,2,3\n1,1,2,3\n1,1,2,3\n"))
    assert "duplicate times: 't' is 1 in row 2 and 1 in row 3; times must increase; remove one" in said


def test_unordered_times_are_refused(tmp_path):
    said = message(tables.read_attitudes, csv(tmp_path, "t,qx,qy,qz,qw\n1,0,0,0,1\n0.5,0,0,0,1\n"))
    assert "unordered times: 't' is 1 in row 1 and 0.5 in row 2; times must increase; sort the rows" in said


def test_a_quaternion_that_is_not_of_length_one_is_refused(tmp_path):
    said = message(tables.read_attitudes, csv(tmp_path, "t,qx,qy,qz,qw\n0,0.1,0.2,0.3,0.4\n"))
    assert "row 1 holds a quaternion of length 0.547723; attitudes are unit quaternions qx,qy,qz,qw" in said


def test_a_gyro_increment_that_ends_before_it_starts_is_refused(tmp_path):
    said = message(tables.read_gyro, csv(tmp_path, "t_start,t_end,roll,pitch,yaw,sigma\n1,0,0,0,0,1e-6\n"))
    assert "row 1 ends at t_end = 0, not after t_start = 1" in said and "swapped" in said


def test_a_sigma_of_zero_is_refused(tmp_path):
    said = message(tables.read_star_tracker, csv(tmp_path, "t,roll,pitch,yaw,sigma\n0,0,0,0,0\n"))
    assert "row 1: sigma = 0; a 1-sigma error must be positive" in said


@pytest.mark.parametrize("fill", ["-1e300", "9.97e36", "-3.4028e38"])
def test_a_number_that_stands_for_none_is_named(tmp_path, fill):
    rows = f"t,roll,pitch,yaw,sigma\n0,0,0,0,1e-6\n1,0,{fill},0,1e-6\n"
    for read in (tables.read_star_tracker, partial(tables.read_long_columns, columns=tables.STAR_TRACKER)):
        said = message(read, csv(tmp_path, rows))
        assert f"line 3, column 'pitch' is {fill} (1 such in all); no quantity is as large" in said


@pytest.mark.parametrize("sigma", ["1e20", "1e-300"])
def test_a_sigma_that_no_instrument_has_is_refused_in_every_table(tmp_path, sigma):
    for read, text, unit in (
        (tables.read_star_tracker, f"t,roll,pitch,yaw,sigma\n0,0,0,0,{sigma}\n", "1e-13 to 6.3 rad are"),
        (tables.read_gyro, f"t_start,t_end,roll,pitch,yaw,sigma\n0,1,0,0,0,{sigma}\n", "1e-13 to 6.3 rad"),
        (
            tables.read_control_points,
            f"x,y,z,sigma,image,line,column\n0,0,0,{sigma},a,1,1\n",
            "1e-7 to 1e7 m are",
        ),
        (
            tables.read_control_points,
            f"x,y,z,sigma,image,line,column,sigma_line,sigma_column,sigma_ground\n0,0,0,1,a,1,1,1,{sigma},1\n",
            "1e-7 to 1e7 px are",
        ),
    ):
        said = message(read, csv(tmp_path, text))
        assert f"= {float(sigma):.6g} is not allowed: {unit}" in said


def test_directions_must_run_over_all_columns_and_look_forward(tmp_path):
    said = message(tables.read_directions, csv(tmp_path, "column,x,y,z\n0,0,0,1\n2,0,0,1\n"))
    assert "row 2 has column = 2; columns must run 0, 1, 2" in said
    said = message(tables.read_directions, csv(tmp_path, "column,x,y,z\n0,0,0,-1\n1,0,0,-1\n"))
    assert "camera z points to the scene" in said


def test_an_empty_file_and_a_missing_one_are_named(tmp_path):
    assert "the file is empty" in message(tables.read_positions, csv(tmp_path, "\n"))
    assert "no rows below the header" in message(tables.read_positions, csv(tmp_path, "t,x,y,z\n"))
    assert "no such file" in message(tables.read_positions, tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("0,1,1,1\n", "two frequencies or more"),
        ("1,1,1,1\n1,1,1,1\n", "f must increase"),
        ("0,1,1,1\n5,1,-1,1\n", "row 2 holds a negative density"),
        ("0,1,0,1\n5,1,0,1\n", "pitch is 0 at every frequency"),
    ],
)
def test_a_table_that_is_no_spectrum_is_refused(tmp_path, rows, words):
    assert words in message(tables.read_psd, csv(tmp_path, "f,roll,pitch,yaw\n" + rows))


def test_a_spectrum_is_read_by_axis(tmp_path):
    f, density = tables.read_psd(csv(tmp_path, "f,roll,pitch,yaw\n0,1,2,3\n50,4,5,6\n"))
    assert f.tolist() == [0.0, 50.0]
    assert density.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]


def test_names_of_any_text_come_back_from_a_table(tmp_path):
    names = ["a, b", 'say "hello"', "two\nlines", "a\r\n\n# b", "#c", "=1+1", "plain"]
    tables.write_columns(tmp_path / "n.csv", {"t": np.arange(7.0), "a, name": np.array(names)})
    read = tables.read_columns(tmp_path / "n.csv", ("t", "a, name"), text=("a, name",))
    assert read["a, name"] == names and read["t"].tolist() == list(range(7))
    assert tables.line_of_row(tmp_path / "n.csv", 3) == 6  # the name before it has a line more


def test_a_quote_that_is_never_closed_is_named_by_its_line(tmp_path):
    path = csv(tmp_path, 't,x,y,z\n0,1,2,3\n1,"1,2,3\n2,1,2,3\n')
    assert f"{path}: line 3 has 2 values, the header has 4" in message(tables.read_positions, path)
    path = csv(tmp_path, 't,x,y,z\n0,1,2,"' + "3" * 200_000)
    assert str(path) in message(tables.read_positions, path)


def test_a_quote_within_a_cell_is_part_of_it(tmp_path):
    path = csv(tmp_path, 'name,x\nlens of 2" ,1\n')
    assert tables.read_columns(path, ("name", "x"), text=("name",))["name"] == ['lens of 2"']


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t,x,y,z\n0,5,1,5,2,5,3,5\n", "line 2 has 8 values, the header has 4; are there decimal commas"),
        ("t,x,y,z\n0,1,2\n", "line 2 has 3 values, the header has 4; correct that line"),
        ('t,x,y,z\n0,"1,5",2,3\n', "'1,5' is not a number; numbers are written with a decimal point: 1.5"),
        ("t,x,y,z\n31/12/2026 12:00:00,1,2,3\n", "is not a number; seconds from the epoch (t = 0)"),
        ("t,x,y,z\n0,1_000,2,3\n", "'1_000' is not a number; digits are written without underscores: 1000"),
    ],
)
def test_decimal_commas_underscores_and_dates_are_recognised(tmp_path, text, words):
    assert words in message(tables.read_positions, csv(tmp_path, text))


class TestControlPointsAtOnePixel:
    """A point that stands twice would count twice."""

    ROWS = "x,y,z,sigma,image,line,column\n0,0,0,1,a,10,20\n5,0,0,1,b,10,20\n"

    def test_two_images_may_show_one_pixel(self, tmp_path):
        assert tables.read_control_points(csv(tmp_path, self.ROWS)).image == ["a", "b"]

    def test_a_row_that_stands_twice_is_refused(self, tmp_path):
        said = message(tables.read_control_points, csv(tmp_path, self.ROWS + "0,0,0,1,a,10,20\n"))
        assert said.startswith("row 3 of ") and "is at the pixel of row 1 of " in said
        assert "line 10, column 20 of 'a'" in said

    def test_two_at_nearly_one_pixel_are_refused_whatever_their_ground(self, tmp_path):
        said = message(tables.read_control_points, csv(tmp_path, self.ROWS + "9,9,9,1,b,10.0004,19.9996\n"))
        assert said.startswith("row 3 of ") and "is at the pixel of row 2 of " in said
        apart = self.ROWS + "9,9,9,1,b,10.002,20\n"
        assert len(tables.read_control_points(csv(tmp_path, apart)).image) == 3

    def test_a_table_of_one_pixel_is_refused_without_all_its_pairs(self, tmp_path):
        table = csv(tmp_path, self.ROWS + 3000 * "9,9,9,1,a,0,0\n")
        tracemalloc.start()
        try:
            said = message(tables.read_control_points, table)
            assert tracemalloc.get_traced_memory()[1] < 100e6  # all pairs are half a gigabyte
        finally:
            tracemalloc.stop()
        assert said.startswith("row 4 of ") and "is at the pixel of row 3 of " in said

    def test_one_that_is_listed_and_in_the_table_too_is_refused(self, tmp_path):
        @dataclass
        class Entry:
            x: float = 0.0
            y: float = 0.0
            z: float = 0.0
            sigma: float = 1.0
            image: str = "b"
            line: float = 10.0
            column: float = 20.0

        path = csv(tmp_path, self.ROWS)
        said = message(lambda table: tables.control_points([Entry()], table), path)
        assert said.startswith(f"row 2 of {path} is at the pixel of [[control_point]] 1")
        said = message(lambda listed: tables.control_points(listed, None), [Entry(), Entry()])
        assert said.startswith("[[control_point]] 2 is at the pixel of [[control_point]] 1")
