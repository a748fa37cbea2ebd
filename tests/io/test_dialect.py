"""Tables as spreadsheets and programs write them: read as what they say, or refused with what to do."""

import numpy as np
import pytest

from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import natural_key, parse_table, read_table
from jaxpoint.io.survey_files import read_landmarks
from jaxpoint.io.track_files import read_tracks

NAMES = ("cam_0", "cam_1", "cam_2", "cam_3")
CASES = {
    "UPPER.CSV": NAMES,
    "camnum.csv": ("0", "1", "2", "3"),
    "caps.csv": NAMES,
    "crlf_bom.csv": NAMES,
    "decimal_comma.csv": NAMES,
    "pandas_index.csv": NAMES,
    "quoted.csv": NAMES,
    "semicolon.csv": NAMES,
    "space_after_comma.csv": NAMES,
    "superscript.csv": ("cam_1", "cam_2", "cam_3", "²"),
    "tab.csv": NAMES,
    "trailing.csv": NAMES,
    "trailing_rows.csv": NAMES,
    "unicode names.csv": ("Kamera süd 1", "Kamera süd 2", "Kamera süd 10", "كاميرا"),
    "utf16.csv": NAMES,
    "uv.csv": NAMES,
    "latin1.csv": "is not UTF-8 text .byte 0xfc in line 2.; save it as UTF-8",
    "nosize.csv": "add columns width,height .* or give --image-size",
    "ns.csv": "more than 15 digits, as a clock's count has; count 0, 1, 2, .*time_ns",
    "us.csv": "more than 15 digits, as a clock's count has; count 0, 1, 2, .*time_us",
    "time_ns.csv": r"column 'time' rises by 3.33e\+07 from frame to frame.*name it time_ns",
    "twolights.csv": "line 421: camera 'cam_0' has a second line for frame 0; a file holds one light",
}


@pytest.mark.parametrize("name", CASES)
def test_tables_of_all_kinds(data_folder, name):
    folder = data_folder.parent / "cases" / "11-csv"
    wanted = CASES[name]
    if isinstance(wanted, str):
        with pytest.raises(FileFormatError, match=wanted):
            read_tracks(folder / name)
        return
    plain, tracks = read_tracks(folder / "plain.csv"), read_tracks(folder / name)
    assert tracks.names == wanted
    order = [2, 3, 1, 0] if name == "superscript.csv" else [0, 1, 2, 3]
    if name not in ("superscript.csv", "unicode names.csv"):
        np.testing.assert_array_equal(tracks.pixels, plain.pixels)
    assert sorted(tracks.visible.sum(axis=0)) == sorted(plain.visible.sum(axis=0)[order])


@pytest.mark.parametrize(
    "text",
    [
        "name;x_m;y_m;z_m\ndoor;1,25;-2;3\n",
        "NAME\tX_m\tY_M\tZ_m\t\t\ndoor\t1,25\t-2\t3\t\t\n\t\t\t\t\t\n",
        "name|x_m|y_m|z_m\rdoor|1.25|-2|3\r",
        ',name,x_m,y_m,z_m\n0,"door",1.25,-2,3\n',
        'sep_of_no_use,name,x_m,y_m,z_m,\n"a, ""b""",door,1.25,-2,+3.0e0,,\n',
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_every_table_is_read_by_the_same_reader(tmp_path, text, encoding):
    (tmp_path / "landmarks.csv").write_bytes(text.encode(encoding))
    known = read_landmarks(tmp_path / "landmarks.csv")
    assert known.names == ("door",)
    assert known.points.tolist() == [[1.25, -2.0, 3.0]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a;b\n1,5;2\n1.5;2\n", "line 3: column 'a' is 1.5, other lines have decimal commas; write all alike"),
        ("a,b\n1,5,2,5\n", "4 values under 2 columns; it has commas too many; numbers with decimal commas need"),
        ('a,b\n"1,5",2\n', "'1,5', which is not a number; write it as 1234.5"),
        ("a,b\n1_000,2\n", "'1_000', which is not a number"),
        ("a;b\n1.234,5;2\n", "not a number"),
        ("a,b\n٣,2\n", "'٣', which is not a number"),
        ("a,b,\n1,2,3\n", "3 values under 2 columns"),
        ("a,,b\n1,x,2\n", "column 2 holds 'x' but has no name"),
        (",a,b\n7,1,2\n3,1,2\n", "column 1 holds '7' but has no name"),
        ("A,a,b\n1,2,3\n", "column 'a' twice"),
        ('a,b\n1,"2\n' + "3,4\n" * 40_000, "a quotation mark is not closed"),
        ("a,b\n99999999999999999999,2\n", "more than 15 digits"),
    ],
)
def test_what_cannot_be_read_says_what_to_do(text, message):
    def read() -> None:
        for row in parse_table("t.csv", text, ("a", "b")):
            row.integer("a") if "999" in text else row.number("a")

    with pytest.raises(FileFormatError, match=message):
        read()


def test_binary_files_are_no_tables(tmp_path):
    (tmp_path / "a.csv").write_bytes("a,b\n1,2\n".encode("utf-16-le"))
    with pytest.raises(FileFormatError, match="holds zero bytes"):
        read_table(tmp_path / "a.csv", ("a",))


def test_names_sort_naturally_in_every_script():
    assert sorted(["cam10", "cam2", "cam²", "²", "cam٣"], key=natural_key) == ["cam2", "cam٣", "cam10", "cam²", "²"]
