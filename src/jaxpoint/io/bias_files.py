"""A bias of pointing as a TOML file, angles in degrees.

`format`, `version`, `lines` (the first is turned), `model` with its numbers, `spread` and `within` (Student's t to the
left and up), `between` (covariance of people's offsets), and `fitted`, which says on what.
"""

from __future__ import annotations

import tomllib
from dataclasses import asdict
from typing import Any, Literal

import msgspec
import numpy as np
import tomli_w

from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import StrPath, check_finite, read_text, replacing
from jaxpoint.pointing.bias.bias import Bias, Fitted
from jaxpoint.pointing.bias.models import AbstractBiasModel, Blend, Constant, ConstantElevation, Personal, Polynomial
from jaxpoint.pointing.bias.spread import FREEDOMS, Spread

FORMAT = "jaxpoint-bias"
VERSION = 1
_DEG2 = np.rad2deg(1.0) ** 2

Pair = tuple[float, float]


class _ConstantElevation(msgspec.Struct, tag="constant-elevation", tag_field="kind", forbid_unknown_fields=True):
    elevation_deg: float

    def model(self) -> AbstractBiasModel:
        return ConstantElevation(np.deg2rad(self.elevation_deg))


class _Constant(msgspec.Struct, tag="constant", tag_field="kind", forbid_unknown_fields=True):
    azimuth_deg: float
    elevation_deg: float

    def model(self) -> AbstractBiasModel:
        return Constant(np.deg2rad([self.azimuth_deg, self.elevation_deg]))


class _Polynomial(msgspec.Struct, tag="polynomial", tag_field="kind", forbid_unknown_fields=True):
    azimuth_deg: list[float]  # of the powers 0, 1, ... of the line's elevation in rad
    elevation_deg: list[float]

    def model(self) -> AbstractBiasModel:
        if len(self.azimuth_deg) != len(self.elevation_deg) or not self.azimuth_deg:
            raise ValueError("azimuth_deg and elevation_deg must have as many numbers, at least one")
        return Polynomial(np.deg2rad([self.azimuth_deg, self.elevation_deg]))


class _Blend(msgspec.Struct, tag="blend", tag_field="kind", forbid_unknown_fields=True):
    azimuth_deg: float
    elevation_deg: float
    azimuth_weights: list[float]  # of the lines after the first
    elevation_weights: list[float]

    def model(self) -> AbstractBiasModel:
        weights = self.azimuth_weights, self.elevation_weights
        if len(weights[0]) != len(weights[1]):
            raise ValueError("azimuth_weights and elevation_weights must have as many numbers")
        used = np.any(np.array(weights) != 0, axis=0)
        return Blend(np.deg2rad([self.azimuth_deg, self.elevation_deg]), np.array(weights), used)


_Shared = _ConstantElevation | _Constant | _Polynomial | _Blend


class _Personal(msgspec.Struct, tag="personal", tag_field="kind", forbid_unknown_fields=True):
    azimuth_deg: float
    elevation_deg: float
    shared: _Shared

    def model(self) -> AbstractBiasModel:
        return Personal(self.shared.model(), np.deg2rad([self.azimuth_deg, self.elevation_deg]))


class _Spread(msgspec.Struct, forbid_unknown_fields=True):
    scale_deg2: tuple[Pair, Pair]
    freedom: int

    def spread(self) -> Spread:
        if self.freedom not in FREEDOMS:
            raise ValueError(f"freedom is {self.freedom}; it must be one of {', '.join(map(str, FREEDOMS))}")
        return Spread(_positive(self.scale_deg2, "scale_deg2"), np.array(self.freedom))


class _Between(msgspec.Struct, forbid_unknown_fields=True):
    covariance_deg2: tuple[Pair, Pair]


class _Fitted(msgspec.Struct, forbid_unknown_fields=True):
    source: str
    people: int
    gestures: int
    targets: int
    loss_deg: float | None = None
    median_deg: float | None = None


class _File(msgspec.Struct, forbid_unknown_fields=True):
    format: Literal["jaxpoint-bias"]
    version: Literal[1]
    lines: list[str]
    model: _Shared | _Personal
    spread: _Spread
    between: _Between
    within: _Spread
    fitted: _Fitted

    def bias(self) -> Bias:
        if len(set(self.lines)) != len(self.lines) or not self.lines:
            raise ValueError(f"lines are {self.lines}; there must be one or more, all different")
        inner = self.model.shared if isinstance(self.model, _Personal) else self.model
        needed = 1 + len(inner.azimuth_weights) if isinstance(inner, _Blend) else 1
        if len(self.lines) != needed:
            raise ValueError(f"the model reads {needed} lines, but {len(self.lines)} are named")
        return Bias(
            tuple(self.lines),
            self.model.model(),
            self.spread.spread(),
            _positive(self.between.covariance_deg2, "covariance_deg2"),
            self.within.spread(),
            Fitted(**msgspec.structs.asdict(self.fitted)),
        )


def read_bias(path: StrPath) -> Bias:
    """A bias from a TOML file. JAX's 64 bits must be on.

    Raises:
        FileFormatError: no such file, no TOML, an unknown or missing key, or numbers that cannot be.
    """
    try:
        raw = tomllib.loads(read_text(path))
        check_finite(raw)
        return msgspec.convert(raw, _File).bias()
    except (tomllib.TOMLDecodeError, msgspec.ValidationError, ValueError) as error:
        raise FileFormatError(f"{path} is not a bias of pointing: {error}; `jaxpoint bias fit` writes one.") from None


def write_bias(path: StrPath, bias: Bias) -> None:
    """Write a bias; the file is replaced whole or not at all.

    Raises:
        OSError: the folder is missing or not writable.
    """
    tables = {
        "format": FORMAT,
        "version": VERSION,
        "lines": list(bias.lines),
        "model": _model(bias.model),
        "spread": _spread(bias.spread),
        "between": {"covariance_deg2": _round(bias.between * _DEG2)},
        "within": _spread(bias.within),
        "fitted": {
            key: round(value, 6) if isinstance(value, float) else value
            for key, value in asdict(bias.fitted).items()
            if value is not None
        },
    }
    with replacing(path) as file:
        file.write(tomli_w.dumps(tables).encode())


def _model(model: AbstractBiasModel) -> dict[str, Any]:
    match model:
        case ConstantElevation():
            return {"kind": "constant-elevation", "elevation_deg": _degrees(model.elevation)}
        case Constant():
            return {"kind": "constant"} | _offset(model.offset)
        case Polynomial():
            azimuth, elevation = _degrees(model.coefficients)
            return {"kind": "polynomial", "azimuth_deg": azimuth, "elevation_deg": elevation}
        case Blend():
            azimuth, elevation = _round(np.where(model.used[None], model.weights, 0.0))
            weights = {"azimuth_weights": azimuth, "elevation_weights": elevation}
            return {"kind": "blend"} | _offset(model.offset) | weights
        case Personal():
            return {"kind": "personal"} | _offset(model.offset) | {"shared": _model(model.shared)}
    raise TypeError(f"A {type(model).__name__} has no place in a file.")


def _offset(offset: Any) -> dict[str, float]:
    azimuth, elevation = _degrees(offset)
    return {"azimuth_deg": azimuth, "elevation_deg": elevation}


def _spread(spread: Spread) -> dict[str, Any]:
    return {"scale_deg2": _round(spread.scale * _DEG2), "freedom": int(spread.freedom)}


def _degrees(radians: Any) -> Any:
    return _round(np.rad2deg(np.asarray(radians)))


def _round(values: Any) -> Any:
    return np.asarray(values).round(6).tolist()


def _positive(matrix: tuple[Pair, Pair], name: str) -> np.ndarray:
    values = np.array(matrix)
    if not np.allclose(values, values.T) or np.linalg.eigvalsh(values).min() <= 0:
        raise ValueError(f"{name} is {values.tolist()}, which is no covariance: symmetric and positive")
    return values / _DEG2
