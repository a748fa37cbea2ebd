"""Rotations as 3 x 3 matrices, with values and derivatives that are safe at 0 and near pi.

Rotation vectors are axis times angle in radians. See Solà, Deray, Atchuthan, "A micro Lie theory for state estimation
in robotics" (2018), for the formulas.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxpoint.geometry.arrays import AnyArray, as_float, stack_last

# Below this squared angle the power series take over; with the terms below they are exact to the last bit there,
# and so are their derivatives, in which the closed forms cancel.
_SMALL = 0.25
_SINC = [(-1) ** k / math.factorial(2 * k + 1) for k in range(9)]
_COSC = [(-1) ** k / math.factorial(2 * k + 2) for k in range(9)]
_SINC3 = [(-1) ** k / math.factorial(2 * k + 3) for k in range(9)]
# (1 - x/2 cot(x/2)) / x^2 by the Bernoulli numbers.
_COTC = [1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000, 1 / 74724249600]
_ATANC = [(-1) ** k / (2 * k + 1) for k in range(28)]


def skew(vector: Float[AnyArray, "3"]) -> Float[Array, "3 3"]:
    """The matrix whose product with u is the cross product `vector` x u."""
    x, y, z = as_float(vector)
    zero = jnp.zeros_like(x)
    return jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)


def rotate(rotation: Float[AnyArray, "3 3"], points: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """`rotation` times every point. Written out: it fuses, and no accelerator rounds its products."""
    r, p = as_float(rotation), as_float(points)
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    return stack_last(*(r[i, 0] * x + r[i, 1] * y + r[i, 2] * z for i in range(3)))


def exp(rotvec: Float[AnyArray, "3"]) -> Float[Array, "3 3"]:
    """Rotation matrix of a rotation vector (rad), by Rodrigues' formula."""
    rotvec = as_float(rotvec)
    angle2 = rotvec @ rotvec
    k = skew(rotvec)
    return _eye(k) + _sinc(angle2) * k + _cosc(angle2) * (k @ k)


def log(rotation: Float[AnyArray, "3 3"]) -> Float[Array, "3"]:
    """Rotation vector (rad, length at most pi) of a rotation matrix; at pi either sign of the axis may come out."""
    w, x, y, z = _quaternion(as_float(rotation))
    sign = jnp.where(w < 0, -1.0, 1.0).astype(w.dtype)
    w, vector = sign * w, sign * jnp.stack([x, y, z])
    sine2 = vector @ vector
    # Half the angle is atan2(|vector|, w): a series in (|vector| / w)^2 where that is small.
    tangent2 = sine2 / jnp.where(w > 0.5, w, 1.0) ** 2
    small = (w > 0.5) & (tangent2 < 0.2)
    sine = jnp.sqrt(jnp.where(small, 1.0, sine2))
    near = _polynomial(jnp.where(small, tangent2, 0.0), _ATANC) / jnp.where(small, w, 1.0)
    far = jnp.arctan2(sine, jnp.where(small, 1.0, w)) / sine
    return 2 * jnp.where(small, near, far) * vector


def left_jacobian(rotvec: Float[AnyArray, "3"]) -> Float[Array, "3 3"]:
    """J with exp(rotvec + d) = exp(J d) exp(rotvec) to first order in d."""
    rotvec = as_float(rotvec)
    angle2 = rotvec @ rotvec
    k = skew(rotvec)
    return _eye(k) + _cosc(angle2) * k + _sinc3(angle2) * (k @ k)


def left_jacobian_inverse(rotvec: Float[AnyArray, "3"]) -> Float[Array, "3 3"]:
    """The inverse of `left_jacobian`; it exists for angles below 2 pi."""
    rotvec = as_float(rotvec)
    k = skew(rotvec)
    return _eye(k) - 0.5 * k + _cotc(rotvec @ rotvec) * (k @ k)


@jax.custom_jvp
def nearest_rotation(matrix: Float[AnyArray, "3 3"]) -> Float[Array, "3 3"]:
    """The rotation (determinant +1) with the smallest Frobenius distance to `matrix`.

    Differentiable wherever it is unique, also where singular values coincide, as those of a rotation do.
    """
    u, _, vt = jnp.linalg.svd(as_float(matrix))
    sign = jnp.sign(jnp.linalg.det(u @ vt))
    return jnp.concatenate([u[:, :2], sign * u[:, 2:]], axis=1) @ vt


@nearest_rotation.defjvp
def _nearest_rotation_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    # matrix = rotation @ stretch, and rotation^T d(rotation) = skew(w) with (tr(stretch) I - stretch) w = vee(...).
    (matrix,), (change,) = primals, tangents
    rotation = nearest_rotation(matrix)
    stretch = rotation.T @ matrix
    turned = rotation.T @ change
    odd = turned - turned.T
    vee = jnp.stack([odd[2, 1], odd[0, 2], odd[1, 0]])
    system = jnp.trace(stretch) * _eye(stretch) - (stretch + stretch.T) / 2
    return rotation, rotation @ skew(jnp.linalg.solve(system, vee))


def _quaternion(rotation: Float[Array, "3 3"]) -> Float[Array, "4"]:
    """Unit quaternion (w, x, y, z), from whichever component is largest (Shepperd 1978)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    candidates = jnp.stack(
        [
            jnp.stack([1 + a + e + i, h - f, c - g, d - b]),
            jnp.stack([h - f, 1 + a - e - i, b + d, c + g]),
            jnp.stack([c - g, b + d, 1 - a + e - i, f + h]),
            jnp.stack([d - b, c + g, f + h, 1 - a - e + i]),
        ]
    )
    largest = candidates[jnp.argmax(jnp.diagonal(candidates))]
    return largest / jnp.sqrt(largest @ largest)


def _eye(like: Array) -> Float[Array, "3 3"]:
    return jnp.eye(3, dtype=like.dtype)


def _polynomial(x: Array, coefficients: Sequence[float]) -> Array:
    total = jnp.zeros_like(x)
    for coefficient in reversed(coefficients):
        total = total * x + coefficient
    return total


def _switch(angle2: Array, series: Sequence[float], closed: Callable[[Array], Array]) -> Array:
    """The series for small angles and the closed form for large, each fed only what it can bear."""
    small = angle2 < _SMALL
    near = _polynomial(jnp.where(small, angle2, 0.0), series)
    return jnp.where(small, near, closed(jnp.sqrt(jnp.where(small, 1.0, angle2))))


def _sinc(angle2: Array) -> Array:
    return _switch(angle2, _SINC, lambda x: jnp.sin(x) / x)


def _cosc(angle2: Array) -> Array:
    return _switch(angle2, _COSC, lambda x: (1 - jnp.cos(x)) / x**2)


def _sinc3(angle2: Array) -> Array:
    return _switch(angle2, _SINC3, lambda x: (x - jnp.sin(x)) / x**3)


def _cotc(angle2: Array) -> Array:
    return _switch(angle2, _COTC, lambda x: (1 - x / 2 * jnp.cos(x / 2) / jnp.sin(x / 2)) / x**2)
