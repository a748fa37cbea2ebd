"""Whether this machine can run jaxpoint: versions, devices, float64, cameras, optional packages."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

DEVELOPERS = ("dev", "docs")  # extras that only developers of jaxpoint need
CAMERA_FOLDER = Path("/sys/class/video4linux")  # where Linux lists cameras; other systems have no such list


@dataclass(frozen=True)
class EnvironmentCheck:
    """One thing that was looked at."""

    name: str
    state: str  # a version, a list, or what is wrong
    good: bool = True
    remedy: str = ""  # a command or an advice; empty where nothing is wrong


def examine() -> list[EnvironmentCheck]:
    """Everything that decides whether jaxpoint runs here; what is wrong carries its remedy."""
    import platform

    return [
        EnvironmentCheck("python", platform.python_version()),
        *_packages(),
        *_jax(),
        _cameras(),
        *_extras(),
    ]


def _requirements() -> list[tuple[str, str]]:
    """Each required package's name, and the extra that asks for it ("" for the core)."""
    found = []
    for line in requires("jaxpoint") or []:
        name = re.match(r"[\w.-]+", line)
        extra = re.search(r"extra\s*==\s*['\"]([\w-]+)['\"]", line)
        if name:
            found.append((name[0], extra[1] if extra else ""))
    return found


def _installed_version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _packages() -> list[EnvironmentCheck]:
    names = ["jaxpoint", *(name for name, extra in _requirements() if not extra)]
    return [
        EnvironmentCheck(name, _installed_version(name) or "missing", _installed_version(name) is not None,
                "" if _installed_version(name) else f"pip install {name}")
        for name in names
    ]  # fmt: skip


def _jax() -> list[EnvironmentCheck]:
    """Devices, and whether float64 is really computed in 64 bits."""
    try:
        import jax
        import jax.numpy as jnp

        devices = ", ".join(f"{device.platform} ({device.device_kind})" for device in jax.devices())
        with jax.enable_x64(True):
            third = jnp.asarray(1.0) / 3.0
            exact = third.dtype == jnp.float64 and abs(float(third) * 3.0 - 1.0) < 1e-15
    except (ImportError, RuntimeError) as error:
        return [EnvironmentCheck("devices", f"jax does not run: {error}", False, "pip install --upgrade jax jaxlib")]
    double = (
        EnvironmentCheck("float64", "works")
        if exact
        else EnvironmentCheck("float64", "is cut to float32", False, "unset JAX_ENABLE_X64 and JAX_DEFAULT_DTYPE_BITS")
    )
    return [EnvironmentCheck("devices", devices), double]


def _cameras() -> EnvironmentCheck:
    if not CAMERA_FOLDER.is_dir():
        return EnvironmentCheck("cameras", "none listed by this system")
    names = sorted(f"{entry.name} ({(entry / 'name').read_text().strip()})" for entry in CAMERA_FOLDER.iterdir())
    return EnvironmentCheck("cameras", ", ".join(names) or "none connected")


def _extras() -> list[EnvironmentCheck]:
    """Optional packages of users by the extra that brings them; a missing one is not wrong, but says how to get it."""
    extras: dict[str, list[str]] = {}
    for package, extra in _requirements():
        if extra and extra not in DEVELOPERS:
            extras.setdefault(extra, []).append(package)
    findings = []
    for extra, packages in extras.items():
        missing = [package for package in packages if _installed_version(package) is None]
        have = ", ".join(f"{package} {_installed_version(package)}" for package in packages if package not in missing)
        findings.append(
            EnvironmentCheck(
                f"extra '{extra}'", f"{', '.join(missing)} not installed", True, f'pip install "jaxpoint[{extra}]"'
            )
            if missing
            else EnvironmentCheck(f"extra '{extra}'", have)
        )
    return findings
