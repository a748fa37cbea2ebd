"""The database of objects: what is read, what is refused, what is appended, and the commands that do it."""

import json
import tomllib

import numpy as np
import pytest

from jaxpoint.cli import main
from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.calibration import write_calibration_json
from jaxpoint.io.object_files import check_shape, read_objects
from jaxpoint.io.objects_adding import append_object
from jaxpoint.pointing.objects import Thing
from jaxpoint.pointing.shapes import Box, Rectangle, Sphere, register, shapes
from jaxpoint.simulate.rooms import random_room

CORNERS = Rectangle.fields[0].columns
HEAD = f"name,unit,kind,tags,{','.join(CORNERS)}"
POSTER = np.array([[1.0, 0, 2], [2, 0, 2], [1, 0, 1], [2, 0, 1]])
# The first row of table 1 of the thesis, in centimetres; its fourth corner, cut off in print, by the other three.
THESIS = np.array([[-101.79, 43.3246, 164.205], [-101.79, 4.98713, 164.205], [-101.79, 43.3246, 150.0]])


def csv(tmp_path, *rows, head=HEAD):
    path = tmp_path / "objects.csv"
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def row(name="poster", corners=POSTER, unit="m"):
    return f"{name},{unit},picture,paper wall,{','.join(map(str, np.ravel(corners)))}"


TOML = """unit = "cm"
[room]
low = [0, 0, 0]
high = [600, 500, 270]
[[rectangle]]
name = "poster"
tags = ["paper"]
corners = [[100, 0, 200], [200, 0, 200], [100, 0, 100], [200, 0, 100]]
[[box]]
name = "printer"
center = [300, 200, 100]
size = [40, 30, 20]
yaw_deg = 30
[[sphere]]
name = "lamp"
kind = "light"
center = [300, 200, 200]
radius = 15
"""


def test_what_is_read(tmp_path):
    (thing,) = read_objects(csv(tmp_path, row())).things
    assert (thing.name, thing.kind, thing.tags) == ("poster", "picture", ("paper", "wall"))
    np.testing.assert_array_equal(thing.shape.corners, POSTER)
    cells = np.vstack([THESIS, THESIS[1] + THESIS[2] - THESIS[0]]).ravel()
    head = ",".join(["name", *(f"{corner}_cm" for corner in CORNERS)])
    (thing,) = read_objects(csv(tmp_path, "Printer 1," + ",".join(map(str, cells)), head=head)).things
    np.testing.assert_allclose(thing.shape.corners[0], [-1.0179, 0.433246, 1.64205])
    (tmp_path / "objects.toml").write_text(TOML)
    found = read_objects(tmp_path / "objects.toml")
    poster, printer, lamp = found.things
    np.testing.assert_allclose(poster.shape.corners, POSTER)
    np.testing.assert_allclose([*printer.shape.size, printer.shape.yaw], [0.4, 0.3, 0.2, np.pi / 6])
    assert (lamp.shape.radius, lamp.kind) == (0.15, "light")
    np.testing.assert_allclose(found.room.high, [6, 5, 2.7])
    assert found.objects.names == ("poster", "printer", "lamp")


@pytest.mark.parametrize(
    ("rows", "head", "message"),
    [
        ([row()], HEAD.replace(",unit,", ",colour,"), "says no unit"),
        ([row(unit="inch")], HEAD, "line 2: the unit is 'inch'; use m, cm or mm"),
        ([row(), row()], HEAD, "2 objects named 'poster'"),
        ([row(), row("far", 300 + POSTER)], HEAD, "lie up to 301 m apart"),
        ([row(corners=POSTER[[0, 1, 3, 2]])], HEAD, "twisted: its top and bottom are 180 degrees apart"),
        ([row(corners=POSTER[[0, 0, 2, 2]])], HEAD, "'poster' has a side of 0 mm"),
        ([row(corners=0.0009994 * POSTER)], HEAD, r"'poster' has a side of 0\.999 mm.*correct the unit"),
        ([row(corners=np.outer([0, 1, 2, 3], [1.0, 0, 0]))], HEAD, "'poster' has all corners on one line"),
        ([row(corners=1e300 * POSTER)], HEAD, r"a size of 1e\+300 m"),
        ([row("Nothing")], HEAD, "is the answer where no object is meant; give it another name"),
        ([row().replace("2.0", "two", 1)], HEAD, "which is not a number"),
    ],
)
def test_a_bad_table_is_refused(tmp_path, rows, head, message):
    with pytest.raises(FileFormatError, match=message):
        read_objects(csv(tmp_path, *rows, head=head))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('unit = "cm"', "", "says no unit"),
        ('unit = "cm"', 'unit = "ft"', "the unit is 'ft'"),
        ("[100, 0, 200], ", "", "has 3 corners"),
        ("radius = 15", "radius = -1", "'lamp' has a radius of -10 mm"),
        ("radius = 15", "radius = nan", r"sphere\[0\]\.radius is nan"),
        ("yaw_deg = 30", "yaw_deg = inf", r"box\[0\]\.yaw_deg is inf"),
        ("radius = 15", "radius = 15\ncolour = 3", r"unknown field `colour`.*\[\[sphere\]\] \(name, center, radius\)"),
        ("[[sphere]]", "[[cone]]", r"unknown field `cone`; it must hold unit"),
        ('name = "lamp"', 'name = ""', "named '': that is empty"),
        ('name = "lamp"', 'name = " poster"', "named ' poster': that is empty, or has a line break or spaces"),
        ('name = "lamp"', 'name = "nothing"', "is the answer where no object is meant"),
        ("high = [600", "high = [-600", "low x is not below its high x"),
        ("high = [600, 500", "high = [600, nan", r"room\.high\[1\] is nan"),
        ("high = [600", "high = [30000", "The room of .* is 300 m long"),
        ("yaw_deg = 30", "yaw_deg = ", "is not TOML"),
    ],
)
def test_a_bad_toml_is_refused(tmp_path, old, new, message):
    (tmp_path / "objects.toml").write_text(TOML.replace(old, new, 1))
    with pytest.raises(FileFormatError, match=message):
        read_objects(tmp_path / "objects.toml")


MIXED = """name,shape,center_x_cm,center_y_cm,center_z_cm,size_x_cm,size_y_cm,size_z_cm,yaw_deg,radius_cm,tags
printer,box,300,200,100,40,30,20,30,,paper
crate,Box,100,200,20,40,30,20,,,
lamp,sphere,300,200,200,,,,,15,
"""


def mixed(tmp_path, old="", new=""):
    path = tmp_path / "mixed.csv"
    path.write_text(MIXED.replace(old, new, 1) if old else MIXED)
    return path


def test_a_table_with_a_column_shape_holds_every_shape(tmp_path):
    printer, crate, lamp = read_objects(mixed(tmp_path)).things
    np.testing.assert_allclose(printer.shape.numbers, [3, 2, 1, 0.4, 0.3, 0.2, np.pi / 6])
    assert (type(crate.shape), crate.shape.yaw, printer.tags) == (Box, 0.0, ("paper",))
    np.testing.assert_allclose(lamp.shape.numbers, [3, 2, 2, 0.15])
    head = HEAD.replace("name,", "name,shape,") + ",center_x,center_y,center_z,radius"
    rows = [row().replace("poster,", "poster,rectangle,") + 4 * ",", "ball,sphere,m,,," + 12 * "," + "1,2,1,0.5"]
    poster, ball = read_objects(csv(tmp_path, *rows, head=head)).things
    np.testing.assert_array_equal(poster.shape.corners, POSTER)
    np.testing.assert_array_equal(ball.shape.numbers, [1, 2, 1, 0.5])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("lamp,sphere", "lamp,cone", "line 4: the shape is 'cone'; use rectangle, box or sphere"),
        ("lamp,sphere", "lamp,", "line 4: column 'shape' is empty"),
        ("lamp,sphere", "lamp,rectangle", "has no column 'lt_x_cm'"),
        ("lamp,sphere", "lamp,box", "line 4: a box has no 'radius_cm', but it is 15; empty that cell, or correct the"),
        ("20,30,,paper", "20,left,,paper", "line 2: column 'yaw_deg' is 'left', which is not a number"),
        (",15,", ",,", "line 4: column 'radius_cm' is empty"),
        (",15,", ",0.05,", r"line 4: 'lamp' has a radius of 0\.5 mm"),
        ("40,30,20,30", "40,0,20,30", "line 2: 'printer' has a side of 0 mm"),
        ("name,shape", "name,form", "has the columns of a box, but no column 'shape'; add it"),
    ],
)
def test_a_bad_table_of_shapes_is_refused(tmp_path, old, new, message):
    with pytest.raises(FileFormatError, match=message):
        read_objects(mixed(tmp_path, old, new))


def test_shapes_are_appended_to_a_table_that_has_their_columns(tmp_path):
    path = mixed(tmp_path)
    for name, shape in (("case", Box(np.ones(3), np.ones(3), 0.5)), ("ball", Sphere(POSTER[0], 0.2))):
        append_object(path, Thing(name, shape))
    *_, case, ball = read_objects(path).things
    np.testing.assert_allclose(case.shape.numbers, [1, 1, 1, 1, 1, 1, 0.5], atol=1e-5)
    np.testing.assert_allclose(ball.shape.numbers, [1, 0, 2, 0.2])
    before = path.read_text()
    for thing, column in ((Thing("new", Rectangle(POSTER)), "lt_x_cm"), (Thing("new", ball.shape, "toy"), "kind")):
        with pytest.raises(UsageError, match=f"has no column '{column}'; add it to every line first, or "):
            append_object(path, thing)
    with pytest.raises(UsageError, match=r"has no column 'shape'; add it .*, or keep the sphere in a \.toml"):
        append_object(csv(tmp_path, row()), Thing("new", ball.shape))
    assert path.read_text() == before


def test_a_shape_needs_a_name_of_its_own():
    class Other(Sphere):
        name = "room"

    for name, message in (("room", "'room', which cannot stand in files"), ("box", "There is a shape 'box' already")):
        Other.name = name
        with pytest.raises(ValueError, match=message):
            register(Other)
    assert list(shapes()) == ["rectangle", "box", "sphere"]


def test_non_finite_shapes_are_refused():
    for shape in (
        Rectangle(np.where(POSTER == 2, np.nan, POSTER)),
        Box(POSTER[0], np.array([1, np.inf, 1])),
        Sphere(POSTER[0], np.nan),
    ):
        with pytest.raises(FileFormatError, match=r"a size of (nan|inf) m"):
            check_shape(shape, "it")


def test_an_empty_table_and_an_ending_in_capitals(tmp_path):
    (tmp_path / "objects.csv").write_text("")
    with pytest.raises(FileFormatError, match="is empty; its first line must be name,unit,lt_x"):
        read_objects(tmp_path / "objects.csv")
    (tmp_path / "OBJECTS.TOML").write_text(TOML)
    assert len(read_objects(tmp_path / "OBJECTS.TOML").things) == 3


def test_an_extent_that_is_no_rooms_is_warned_of(tmp_path):
    for scale, told in ((10.0, "span 40.00 m"), (0.1, "span 0.40 m")):
        things = row(corners=scale * POSTER), row("other", scale * (POSTER + np.eye(3)[0] * 3))
        (note,) = read_objects(csv(tmp_path, *things)).warnings
        assert f"{told}, where 1 to 30 m are usual; check the unit" in note


def test_a_bent_rectangle_is_warned_of(tmp_path):
    bent = POSTER.copy()
    bent[3, 1] = 0.3  # four corners: the plane passes each at a quarter of it
    (note,) = read_objects(csv(tmp_path, row(corners=bent))).warnings
    assert "'poster' lie 7.3 cm off a common plane" in note
    bent[3, 1] = 0.15
    assert read_objects(csv(tmp_path, row(corners=bent))).warnings == ()


@pytest.mark.parametrize("unit", ["m", "cm", "mm"])
def test_what_is_appended_is_read_back_and_the_rest_stays(tmp_path, unit):
    scale = {"m": 1, "cm": 100, "mm": 1000}[unit]
    path = csv(tmp_path, row("first", scale * POSTER, unit))
    before = path.read_text()
    thing = Thing("second, new", Rectangle(POSTER + 1), "picture", ("a", "b"))
    append_object(path, thing)
    assert path.read_text().startswith(before)
    assert len(path.read_text().splitlines()) == 3
    found = read_objects(path).things[1]
    assert (found.name, found.kind, found.tags) == (thing.name, thing.kind, thing.tags)
    np.testing.assert_allclose(found.shape.corners, POSTER + 1, atol=1e-5)
    (tmp_path / "objects.toml").write_text(TOML)
    for shape in (Rectangle(POSTER), Box(POSTER[0], np.ones(3), 0.5), Sphere(POSTER[0], 0.2)):
        append_object(tmp_path / "objects.toml", Thing(type(shape).__name__, shape, "", ("tag",)))
    assert len(tomllib.loads((tmp_path / "objects.toml").read_text())["sphere"]) == 2
    *_, new_box, _, ball = read_objects(tmp_path / "objects.toml").things
    np.testing.assert_allclose(
        [*new_box.shape.center, new_box.shape.yaw, ball.shape.radius], [1, 0, 2, 0.5, 0.2], atol=1e-4
    )


def test_what_does_not_fit_leaves_the_file_alone(tmp_path):
    path = csv(tmp_path, row())
    before = path.read_bytes()
    for thing, error in (
        (Thing("poster", Rectangle(POSTER + 1)), FileFormatError),
        (Thing("flat", Rectangle(POSTER[[0, 0, 2, 2]])), FileFormatError),
        (Thing("far", Rectangle(POSTER + 500)), FileFormatError),
        (Thing("ball", Sphere(POSTER[0], 0.1)), UsageError),
    ):
        with pytest.raises(error):
            append_object(path, thing)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["", "  ", " poster ", "#1 window", "two\nlines", "a\x85b", "nothing"])
def test_what_is_no_name_is_not_appended(tmp_path, name):
    path = csv(tmp_path, row("other"))
    before = path.read_bytes()
    with pytest.raises(UsageError, match="give it another name"):
        append_object(path, Thing(name, Rectangle(POSTER + 1)))
    assert path.read_bytes() == before


def test_what_would_not_read_back_is_not_appended(tmp_path):
    """An inline array of TOML cannot grow; a quote that is left open swallows the next line; a CSV strips its cells."""
    inline = tmp_path / "inline.toml"
    inline.write_text(f'unit = "m"\nrectangle = [{{name = "old", corners = {POSTER.tolist()}}}]\n')
    table = csv(tmp_path, row("other"))
    for path, text, kind in (
        (inline, inline.read_text(), ""),
        (table, table.read_text(), " padded"),
        (table, f'{",".join(HEAD.split(",")[:2] + HEAD.split(",")[4:])},note\n'
         + ",".join(["other", "m", *map(str, POSTER.ravel()), '"open']), ""),
    ):  # fmt: skip
        path.write_text(text)
        with pytest.raises(FileFormatError, match=r"would not be read as it should with 'new' at its end"):
            append_object(path, Thing("new", Rectangle(POSTER + 1), kind))
        assert path.read_text() == text


def test_what_the_table_has_no_column_for_is_not_dropped(tmp_path):
    path = csv(tmp_path, row().replace(",picture,paper wall", ""), head=HEAD.replace(",kind,tags", ""))
    for thing, column in (
        (Thing("new", Rectangle(POSTER + 1), "picture"), "kind"),
        (Thing("new", Rectangle(POSTER + 1), "", ("paper",)), "tags"),
    ):
        with pytest.raises(UsageError, match=f"has no column '{column}'; add it"):
            append_object(path, thing)


def test_a_link_is_written_through(tmp_path):
    path = csv(tmp_path, row())
    link = tmp_path / "link.csv"
    link.symlink_to(path)
    append_object(link, Thing("new", Rectangle(POSTER + 1)))
    assert link.is_symlink()
    assert [thing.name for thing in read_objects(path).things] == ["poster", "new"]


def run(capsys, *words):
    code = main([str(word) for word in words])
    out, err = capsys.readouterr()
    return code, out, err


def test_the_commands_list_check_and_add(tmp_path, capsys):
    path = csv(tmp_path, row(), row("copy", POSTER + 0.001))
    code, out, _ = run(capsys, "objects", "list", path)
    assert code == 0
    assert out.splitlines()[1].split()[:3] == ["poster", "picture", "rectangle"]
    code, out, _ = run(capsys, "objects", "check", path, "--room-low", 0, 0, 0, "--room-high", 1.5, 5, 3, "--json")
    notes = json.loads(out)["warnings"]
    assert code == 0
    assert any("'poster' and 'copy' lie in one plane" in note for note in notes)
    assert any("'poster' reaches 0.50 m out of the room" in note for note in notes)
    code, out, _ = run(capsys, "objects", "add", path, "--name", "new", "--corners", *(POSTER + 1).ravel())
    assert code == 0
    assert "Added 'new'" in out
    assert [thing.name for thing in read_objects(path).things] == ["poster", "copy", "new"]
    bent = POSTER + np.outer([0, 0, 0, 1], [0, 0.7, 0])
    code, out, _ = run(capsys, "objects", "add", path, "--name", "bent", "--tags", "a b", "--corners", *bent.ravel())
    assert code == 0
    assert "'bent' lie 15.5 cm off a common plane" in out
    assert read_objects(path).things[-1].tags == ("a", "b")


def test_the_command_adds_every_shape(tmp_path, capsys):
    (tmp_path / "objects.toml").write_text(TOML)
    words = ("objects", "add", tmp_path / "objects.toml", "--name")
    code, out, err = run(capsys, *words, "ball", "--shape", "sphere", "--measures", "radius", 0.2, "center", 1, -2, 1)
    assert (code, "Added 'ball'" in out, "0.400 m, a sphere, measured." in out) == (0, True, True), err
    box = ("--shape", "box", "--measures", "center", 3, 2, 1, "size", 0.1, 0.2, 0.3)
    assert run(capsys, *words, "plain", *box)[0] == 0
    code, out, err = run(capsys, *words, "turned", *box, "yaw_deg", 45, "--json")
    assert code == 0, err
    assert json.loads(out)["size_m"] == [0.1, 0.2, 0.3]
    found = {thing.name: thing.shape.numbers for thing in read_objects(tmp_path / "objects.toml").things}
    np.testing.assert_allclose(found["ball"], [1, -2, 1, 0.2])
    np.testing.assert_allclose(found["plain"], [3, 2, 1, 0.1, 0.2, 0.3, 0.0])
    np.testing.assert_allclose(found["turned"], [3, 2, 1, 0.1, 0.2, 0.3, np.pi / 4])


BALL = ["add", "--name", "x", "--shape", "sphere"]


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["add", "--name", "x"], 2, "either --corners"),
        (
            ["add", "--name", "x", "--shape", "cone", "--measures", "a"],
            2,
            "no shape 'cone'; choose among rectangle, box",
        ),
        ([*BALL, "--corners", *12 * ["1"]], 2, "is not described by points; give --measures center X Y Z radius VALUE"),
        ([*BALL, "--measures", "1", "2"], 2, "--measures begins with '1'; a sphere takes center X Y Z radius VALUE"),
        ([*BALL, "--measures", "radius", "big"], 2, "--measures has 'big', which is no finite number"),
        ([*BALL, "--measures", "radius", "nan"], 2, "--measures has 'nan', which is no finite number"),
        ([*BALL, "--measures", "radius", "1", "radius", "1"], 2, "--measures has 'radius' twice"),
        ([*BALL, "--measures", "radius", "1"], 2, "has 0 numbers for 'center' where 3 are needed"),
        ([*BALL, "--measures", "center", "1", "0", "0", "radius", "0"], 7, "'x' has a radius of 0 mm"),
        ([*BALL, "--measures", "center", "1", "0", "0", "radius", "1"], 2, "has no column 'shape'"),
        (["add", "--name", "x", "--corners", "1", "2"], 2, "has 2 numbers"),
        (["add", "--name", "x", "--views", "clicks.csv"], 2, "needs the cameras"),
        (["add", "--name", "poster", "--corners", *map(str, POSTER.ravel())], 7, "named 'poster'"),
        (
            ["add", "--name", "x", "--corners", "0", "nan", *map(str, POSTER.ravel()[2:])],
            2,
            "'corners[1]' cannot be used",
        ),
        (["add", "--name", "x", "--out", "new.csv"], 2, "leave out --out"),
        (["list", "--out", "new.csv"], 2, "only prints, and nothing would come to 'new.csv'"),
        (["check", "--out", "new.csv"], 2, "only prints, and nothing would come to 'new.csv'"),
        (
            ["check", "--room-low", "nan", "0", "0", "--room-high", "1", "1", "1"],
            2,
            "'room_low[0]' cannot be used",
        ),
        (
            ["check", "--room-low", "0", "0", "0", "--room-high", "1", "1", "inf"],
            2,
            "'room_high[2]' cannot be used",
        ),
        (["check", "--room-low", "0", "0", "0"], 2, "both --room-low and --room-high"),
        (["check", "--room-low", "0", "0", "9", "--room-high", "1", "1", "1"], 2, "exchange them"),
    ],
)
def test_wrong_use_is_told(tmp_path, capsys, words, code, message):
    path = csv(tmp_path, row())
    before = path.read_bytes()
    found, _, err = run(capsys, "objects", words[0], path, *words[1:])
    assert (found, message in err) == (code, True), err
    assert path.read_bytes() == before


def test_corners_that_were_clicked(tmp_path, capsys):
    room = random_room(1, cameras=4, frames=60)
    places = room.points[0] + 0.3 * np.array([[0, 0, 1.0], [1, 0, 1], [0, 0, 0], [1, 0, 0]])
    pixels = np.asarray(room.rig.project(places))
    write_calibration_json(tmp_path / "calibration.json", room.rig)
    lines = ["camera,corner,x,y"]
    for camera in (0, 2, 3):
        for corner, (x, y) in zip(("lt", "rt", "lb", "rb"), pixels[:, camera]):
            lines.append(f"{room.rig.names[camera]},{corner},{x},{y}")
    clicks = tmp_path / "clicks.csv"
    clicks.write_text("\n".join(lines))
    path = csv(tmp_path, row("other", places + 1))
    words = [
        "objects",
        "add",
        path,
        "--name",
        "clicked",
        "--views",
        clicks,
        "--calibration",
        tmp_path / "calibration.json",
    ]
    code, out, err = run(capsys, *words, "--json")
    assert code == 0, err
    assert 0 < json.loads(out)["corner_sigma_m"] < 0.1
    np.testing.assert_allclose(read_objects(path).things[1].shape.corners, places, atol=1e-4)
    clicks.write_text("\n".join(lines[:6]))
    before = path.read_bytes()
    code, _, err = run(capsys, *words[:4], "again", *words[5:])
    assert (code, "in 1 images; click it in two or more" in err) == (7, True)
    clicks.write_text("\n".join([*lines[:-1], lines[-1].rsplit(",", 1)[0] + ",-300"]))
    code, _, err = run(capsys, *words[:4], "again", *words[5:])
    assert (code, "miss each other" in err) == (7, True)
    assert path.read_bytes() == before
