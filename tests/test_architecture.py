"""The tree is the architecture: layers import from those below them alone, and importing the package does nothing."""

import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path

import pytest

import jaxpoint

ROOT = Path(jaxpoint.__file__).parent
LAYERS = (
    ("errors", "devices", "finite", "lazy"),
    ("compilation", "cores", "extras"),
    ("config",),
    ("geometry",),
    ("camera", "targets"),
    ("tracks",),
    ("epipolar", "motion", "triangulation"),
    ("repeats",),
    ("calibration",),
    ("evidence",),
    ("body",),
    ("pointing",),
    ("landmarks", "metrics"),
    ("validation",),
    ("io",),
    ("detection",),
    ("report", "simulate"),
    ("environment", "runs"),
    ("commands",),
    ("cli",),
)
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
USES_OPENCV = {"detection", "io", "report", "simulate"}


def modules() -> list[Path]:
    return sorted(path for path in ROOT.rglob("*.py") if path != ROOT / "__init__.py")


def layer(path: Path) -> str:
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def imported(path: Path) -> set[str]:
    """Dotted names of everything a file imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: write imports in full."
            names |= {node.module or ""} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_one_way(path):
    assert layer(path) in RANK, f"Give '{layer(path)}' its place in LAYERS."
    for name in imported(path):
        parts = name.split(".")
        if parts[0] == "jaxpoint" and len(parts) > 1 and parts[1] in RANK and parts[1] != layer(path):
            assert RANK[parts[1]] < RANK[layer(path)], f"{path.name} must not import {name}."


def test_the_picture_shows_the_layers():
    """And the table beside it names them all."""
    docs = ROOT.parents[1] / "docs"
    boxes = re.findall(r' y="(\d+)"[^>]*font-weight="600"[^>]*>(\w+)<', (docs / "layers.svg").read_text("utf-8"))
    rows: dict[int, set[str]] = {}
    for y, name in boxes:
        rows.setdefault(int(y), set()).add(name)
    assert [rows[y] for y in sorted(rows, reverse=True)] == [set(names) for names in LAYERS]
    table = (docs / "architecture.md").read_text("utf-8")
    assert not {name for name in RANK if not re.search(rf"`{name}(\.py|/)`", table)}


def test_no_two_files_and_no_two_classes_share_a_name():
    files = Counter(path.name for path in modules() if path.name != "__init__.py")
    assert [name for name, count in files.items() if count > 1] == []
    trees = (ast.parse(path.read_text("utf-8")) for path in modules())
    classes = Counter(node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef))
    public = {name: count for name, count in classes.items() if not name.startswith("_")}
    assert [name for name, count in public.items() if count > 1] == []


def test_opencv_stays_at_the_edge():
    users = {layer(path) for path in modules() if any(name.split(".")[0] == "cv2" for name in imported(path))}
    assert users <= USES_OPENCV
    assert users, "The guard looks for the wrong name."


def test_tests_of_the_library_import_no_experiment():
    experiments = {path.stem for path in (ROOT.parents[1] / "experiments").rglob("*.py")}
    tests = ROOT.parents[1] / "tests"
    for path in sorted(tests.rglob("*.py")):
        if path.relative_to(tests).parts[0] != "experiments":
            used = {name.split(".")[0] for name in imported(path)} & experiments
            assert not used, f"{path} imports {used}; what tests experiments belongs to tests/experiments."


def test_every_extra_is_used():
    """Extras for users, that is, whose packages are imported by their own names; `dev` and `docs` are for us."""
    project = tomllib.loads((ROOT.parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    used = {name.split(".")[0] for path in modules() for name in imported(path)}
    for extra, packages in project["optional-dependencies"].items():
        unused = {re.match(r"[\w-]+", package)[0] for package in packages} - used
        assert extra in ("dev", "docs") or not unused, f"Nothing imports {unused} of the extra '{extra}'."


def test_library_does_not_print():
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            is_print = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
            assert not is_print, f"{path}, line {node.lineno}: use a callback or logging."


def run_python(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize(
    "arguments",
    [["--help"], ["calibrate", "--help"], ["detect", "--help"], ["bias", "fit", "--help"], ["doctor", "--help"]],
)
def test_help_imports_nothing_heavy(arguments):
    code = f"""
import sys
from jaxpoint.cli import main
try:
    main({arguments})
except SystemExit as stop:
    assert stop.code == 0
heavy = [name for name in ("jax", "numpy", "cv2", "matplotlib", "equinox") if name in sys.modules]
assert not heavy, heavy
"""
    assert "jaxpoint" in run_python(code)


def test_import_flips_no_jax_flag():
    code = """
import pkgutil, importlib
import jax
before = dict(jax.config.values)
import jaxpoint
for module in pkgutil.walk_packages(jaxpoint.__path__, "jaxpoint."):
    importlib.import_module(module.name)
changed = {key for key, value in jax.config.values.items() if before.get(key) != value}
print(sorted(changed))
"""
    assert run_python(code).strip() == "[]"
