"""Tables of pointings, and biases as files."""

from dataclasses import replace

import crowds
import jax
import numpy as np
import pytest

from jaxpoint.errors import FileFormatError
from jaxpoint.io.bias_files import read_bias, write_bias
from jaxpoint.io.pointing_files import read_pointings, write_pointings
from jaxpoint.pointing.bias.bias import Bias, Fitted
from jaxpoint.pointing.bias.models import Blend, Constant, ConstantElevation, Personal, Polynomial
from jaxpoint.pointing.bias.spread import Spread

HEADER = "person,gesture,line,origin_x_m,origin_y_m,origin_z_m,direction_x,direction_y,direction_z"
LINE = "anna,1,forearm,0,0,1.4,1,0,0.1"
MODELS = {
    "constant-elevation": ConstantElevation(0.1),
    "constant": Constant(np.array([0.1, -0.2])),
    "polynomial": Polynomial(np.array([[0.1, 0.2, 0.3], [-0.1, 0.0, 0.4]])),
    "blend": Blend(np.array([0.1, 0.2]), np.array([[0.3, 0.0], [-0.4, 0.0]]), np.array([True, False])),
    "personal": Personal(Constant(np.array([0.1, -0.2])), np.array([0.02, 0.03])),
}


def bias_of(model) -> Bias:
    matrix = np.array([[0.01, 0.002], [0.002, 0.02]])
    lines = ("forearm", "hand", "shoulder") if isinstance(model, Blend) else ("forearm",)
    return Bias(lines, model, Spread(matrix, np.array(4)), matrix, Spread(matrix / 2, np.array(2)),
                Fitted("drawn", 5, 60, 9, 1.5, None))  # fmt: skip


@pytest.mark.parametrize("known", [True, False])
def test_a_table_comes_back(tmp_path, known):
    people = crowds.crowd(people=3, gestures=4)
    people = people if known else replace(people, targets=None)
    write_pointings(tmp_path / "pointings.csv", people)
    found = read_pointings(tmp_path / "pointings.csv")
    assert (found.gestures, found.people, found.lines) == (people.gestures, people.people, people.lines)
    np.testing.assert_allclose(found.directions, people.directions, atol=1e-9)
    np.testing.assert_allclose(found.origins, people.origins, atol=1e-9)
    assert (found.targets is not None) == known


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([HEADER, LINE, LINE], "line 3: the line 'forearm' of this gesture is given twice"),
        ([HEADER, LINE, LINE.replace("forearm", "hand"), LINE.replace(",1,", ",2,", 1)], "has no line 'hand'"),
        ([HEADER, LINE.replace("1,0,0.1", "0,0,0")], "the direction has no length"),
        ([HEADER, LINE.replace("1.4", "1400")], "a coordinate is 1400 m"),
        ([HEADER, LINE.replace("1.4", "much")], "'much', which is not a number"),
        ([HEADER + ",target_x_m,target_y_m,target_z_m", LINE + ",0,0,1.4"], "the target lies 0 mm from"),
        ([HEADER + ",target_x_m", LINE + ",2"], "column 'target_y_m' is empty"),
    ],
)
def test_a_bad_table_is_refused(tmp_path, rows, message):
    (tmp_path / "bad.csv").write_text("\n".join(rows))
    with pytest.raises(FileFormatError, match=message):
        read_pointings(tmp_path / "bad.csv")


@pytest.mark.parametrize("kind", MODELS)
def test_a_bias_comes_back(tmp_path, kind):
    bias = bias_of(MODELS[kind])
    write_bias(tmp_path / "bias.toml", bias)
    found = read_bias(tmp_path / "bias.toml")
    assert jax.tree.structure(found) == jax.tree.structure(bias)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(bias)):
        np.testing.assert_allclose(a, b, atol=1e-7)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('format = "jaxpoint-bias"', 'format = "another"', "another"),
        ("version = 1", "version = 2", "version"),
        ("elevation_deg", "elevation", "elevation"),
        ("freedom = 4", "freedom = 5", "freedom is 5"),
        ('"forearm",', '"forearm", "hand",', "reads 1 lines, but 2 are named"),
        ("[between]", "[betwixt]", "betwixt"),
        ("32.828064", "-32.828064", "no covariance"),
        ("version", "[[", "is not a bias"),
    ],
)
def test_a_bad_bias_is_refused(tmp_path, old, new, message):
    path = tmp_path / "bias.toml"
    write_bias(path, bias_of(MODELS["constant"]))
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(FileFormatError, match=message):
        read_bias(path)
