"""What users import: names that exist, are documented, load on demand, and are all that README and docs use."""

import ast
import dataclasses
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxpoint
from jaxpoint.geometry.arrays import hash_or_hint
from jaxpoint.lazy import homes_in

ROOT = Path(jaxpoint.__file__).parent
PACKAGES = (
    *("body", "calibration", "camera", "config", "detection", "evidence", "geometry", "io"),
    *("pointing", "pointing.shapes", "report", "simulate"),
)
WANTED = {
    "Behaviour", "Bias", "Calibration", "CameraRig", "JaxpointError", "Objects", "PointingLine", "Tracks", "calibrate",
    "chain_of", "detect_led", "fit_bias", "intersect", "nearest", "posterior", "read_objects", "resect", "triangulate",
    "uncertainty_of", "write_report",
}  # fmt: skip


def module(package: str):
    return importlib.import_module(f"jaxpoint.{package}" if package else "jaxpoint")


@pytest.mark.parametrize("package", ["", *PACKAGES])
def test_every_public_name_exists_and_is_documented(package):
    public = module(package)
    assert len(public.__all__) == len(set(public.__all__))
    for name in public.__all__:
        value = getattr(public, name)
        if inspect.isclass(value) or inspect.isroutine(value):  # not `config.Count` and its like, types with a range
            assert value.__doc__, f"{public.__name__}.{name} has no docstring."
            assert value.__module__.startswith("jaxpoint."), f"{public.__name__}.{name} is somebody else's."


def test_both_halves_and_all_errors_are_public():
    assert set(jaxpoint.__all__) >= WANTED
    errors = importlib.import_module("jaxpoint.errors")
    own = {name for name, value in vars(errors).items() if isinstance(value, type)}
    assert set(jaxpoint.__all__) >= own
    assert set(dir(jaxpoint)) >= set(jaxpoint.__all__)


@pytest.mark.parametrize("package", ["", "pointing"])
def test_other_names_are_refused(package):
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        module(package).nothing  # noqa: B018


def test_functions_win_over_modules_of_their_name():
    """Whoever was imported first: `pointing.posterior` is a module too."""
    code = "import jaxpoint.pointing.posterior, jaxpoint; from jaxpoint.pointing import nearest, posterior; "
    code += "assert callable(nearest) and posterior is jaxpoint.posterior"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


def test_importing_the_package_imports_nothing_heavy():
    code = "import sys, jaxpoint; assert not {'jax', 'numpy', 'cv2', 'equinox'} & set(sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


def test_a_stub_says_where_a_name_lives():
    stub = "from .a.b import c as c, d as e\nfrom jax import numpy\nfrom . import f\n"
    assert homes_in(stub) == {"c": ("a.b", "c"), "e": ("a.b", "d")}


def test_the_api_pages_list_every_public_name():
    pages = (ROOT.parents[1] / "docs/api").glob("*.md")
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    listed = [name.rpartition(".")[::2] for name in re.findall(r"^::: jaxpoint\.(.+)$", text, re.MULTILINE)]
    assert len(listed) == len(set(listed))
    assert all(name in module(package).__all__ for package, name in listed)
    public = {name for package in ("", *PACKAGES) for name in module(package).__all__}
    assert {name for _, name in listed} == public


def documents() -> list[Path]:
    root = Path(__file__).parents[1]
    return [root / "README.md", *sorted((root / "docs").rglob("*.md"))]


@pytest.mark.parametrize("path", documents(), ids=lambda path: path.name)
def test_documents_import_public_names_alone(path):
    for block in re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.Import):
                assert not [alias.name for alias in node.names if alias.name.startswith("jaxpoint.")], path.name
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "jaxpoint":
                package = node.module.removeprefix("jaxpoint").removeprefix(".")
                assert package in ("", *PACKAGES), f"{path.name} imports from {node.module}; make the name public."
                names = {alias.name for alias in node.names}
                assert names <= set(module(package).__all__), f"{names} of {node.module} in {path.name}"


@pytest.mark.usefixtures("any_shape")
@pytest.mark.parametrize("name", ["Alignment", "Calibration", "Triangulation"])
def test_results_are_pytrees_or_say_why_not(name):
    result = getattr(jaxpoint, name)
    is_leaf = not issubclass(result, eqx.Module) and jax.tree.structure(_without_fields(result)).num_leaves == 1
    assert not is_leaf or "not a pytree" in result.__doc__.lower()


def _without_fields(result: type):
    """An instance whose fields are all None, which is nothing to a pytree."""
    return result(*[None] * len(dataclasses.fields(result)))


@pytest.mark.usefixtures("any_shape")
def test_an_alignment_goes_through_jax():
    similarity = jaxpoint.Similarity(np.float64(2.0), np.eye(3), np.zeros(3))
    aligned = jaxpoint.Alignment(similarity, "floor", ("a",), np.ones(1), (None,), 1.0, 1.0, True)
    assert jax.jit(lambda one: one.residual_mm * one.similarity.scale)(aligned) == 2.0
    doubled = jax.tree.map(lambda leaf: 2 * leaf, aligned)
    assert (doubled.method, doubled.rms_mm, doubled.leave_one_out_mm) == ("floor", 2.0, (None,))


@pytest.mark.parametrize("name", ["Bias", "Camera", "CameraRig", "Chain", "Plane", "Pose", "Ray", "Similarity"])
def test_a_class_with_methods_to_compile_says_how(name):
    assert (getattr(jaxpoint, name, None) or getattr(module("geometry"), name)).__hash__ is hash_or_hint


def test_methods_are_compiled_as_the_hint_says():
    pose, ray = jaxpoint.Pose.identity(), jaxpoint.Ray(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    with pytest.raises(TypeError, match=r"A Pose holds arrays.*`equinox\.filter_jit\(x\.method\)`, or"):
        jax.jit(pose.inverse)()
    np.testing.assert_array_equal(eqx.filter_jit(pose.inverse)().rotation, np.eye(3))
    np.testing.assert_array_equal(jax.jit(lambda one, far: one.at(far))(ray, 2.0), [2.0, 0.0, 0.0])
