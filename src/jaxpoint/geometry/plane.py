"""Planes, rectangles on walls and tables, and where rays meet them."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxpoint.geometry.arrays import AnyArray, as_float, hash_or_hint
from jaxpoint.geometry.linalg import null_vector
from jaxpoint.geometry.line import Ray, normalise


class Plane(eqx.Module):
    """All points x with normal . x = offset."""

    normal: Float[Array, "3"] = eqx.field(converter=as_float)  # unit length
    offset: Float[Array, ""] = eqx.field(converter=as_float)  # m

    __hash__ = hash_or_hint

    @staticmethod
    def through(points: Float[AnyArray, "3 3"]) -> Plane:
        """The plane of three points, its normal by the right hand; zero where they are collinear."""
        a, b, c = as_float(points)
        normal = normalise(jnp.cross(b - a, c - a))
        return Plane(normal, normal @ a)

    def distance(self, points: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch"]:
        """Signed distance of points, m; positive on the side that the normal points to."""
        p = as_float(points)
        return sum(self.normal[i] * p[..., i] for i in range(3)) - self.offset

    def project(self, points: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch 3"]:
        """The feet of the perpendiculars from points."""
        points = as_float(points)
        distance = self.distance(points)
        return points - jnp.stack([distance * self.normal[i] for i in range(3)], axis=-1)


class Rect(eqx.Module):
    """A rectangle (or parallelogram) in space: a screen, a picture, a table."""

    corner: Float[Array, "3"] = eqx.field(converter=as_float)  # left-top, m
    right: Float[Array, "3"] = eqx.field(converter=as_float)  # from left-top to right-top, m
    down: Float[Array, "3"] = eqx.field(converter=as_float)  # from left-top to left-bottom, m

    @staticmethod
    def from_corners(corners: Float[AnyArray, "4 3"]) -> tuple[Rect, Float[Array, ""]]:
        """The rectangle nearest to measured corners, and how far (m, rms) these are from a common plane.

        Corners in the order of the thesis's table 1: left-top, right-top, left-bottom, right-bottom.
        """
        corners = as_float(corners)
        plane, residual = fit_plane(corners)
        left_top, right_top, left_bottom, right_bottom = plane.project(corners)
        right = (right_top - left_top + right_bottom - left_bottom) / 2
        down = (left_bottom - left_top + right_bottom - right_top) / 2
        center = (left_top + right_top + left_bottom + right_bottom) / 4
        return Rect(center - right / 2 - down / 2, right, down), residual

    @property
    def center(self) -> Float[Array, "3"]:
        """The middle, m."""
        return self.corner + self.right / 2 + self.down / 2

    @property
    def corners(self) -> Float[Array, "4 3"]:
        """Left-top, right-top, left-bottom, right-bottom, m."""
        a, u, v = self.corner, self.right, self.down
        return jnp.stack([a, a + u, a + v, a + u + v])

    @property
    def plane(self) -> Plane:
        """Its plane; the normal points to the viewer who sees left-top at the left and top."""
        normal = normalise(jnp.cross(self.down, self.right))
        return Plane(normal, normal @ self.corner)


def fit_plane(
    points: Float[AnyArray, "n 3"], weights: Float[AnyArray, " n"] | None = None
) -> tuple[Plane, Float[Array, ""]]:
    """The plane with the least sum of (weighted) squared distances, and the rms distance, m.

    At least three points that are not collinear; the sign of the normal is arbitrary. A weight of 0 hides a point.
    """
    points = as_float(points)
    w = jnp.ones_like(points[:, 0]) if weights is None else as_float(weights)
    center = jnp.sum(w[:, None] * points, axis=0) / jnp.sum(w)
    centred = points - center[None, :]
    normal = null_vector(jnp.sqrt(w)[:, None] * centred)
    # At a perfect fit the square root has no derivative; its argument is then replaced before, not after.
    squared = jnp.sum(w * (centred @ normal) ** 2) / jnp.sum(w)
    positive = squared > 0
    residual = jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)
    return Plane(normal, normal @ center), residual


def intersect(ray: Ray, plane: Plane) -> tuple[Float[Array, "3"], Bool[Array, ""]]:
    """Where `ray` meets `plane`, and whether it does so going forward."""
    closing = plane.normal @ ray.direction
    parallel = jnp.abs(closing) < 1e-9
    distance = (plane.offset - plane.normal @ ray.origin) / jnp.where(parallel, 1.0, closing)
    return ray.at(distance), ~parallel & (distance > 0)


def intersect_rect(ray: Ray, rect: Rect) -> tuple[Float[Array, "3"], Float[Array, "2"], Bool[Array, ""]]:
    """Where `ray` meets the plane of `rect`, as a point (m) and as fractions of the sides, and whether within them.

    The fractions are (0, 0) at left-top and (1, 1) at right-bottom.
    """
    point, forward = intersect(ray, rect.plane)
    offset = point - rect.corner
    uu, uv, vv = rect.right @ rect.right, rect.right @ rect.down, rect.down @ rect.down
    pu, pv = offset @ rect.right, offset @ rect.down
    area2 = uu * vv - uv**2
    flat = area2 <= 0
    fractions = jnp.stack([vv * pu - uv * pv, uu * pv - uv * pu]) / jnp.where(flat, 1.0, area2)
    inside = jnp.all((fractions >= 0) & (fractions <= 1))
    return point, fractions, forward & ~flat & inside
