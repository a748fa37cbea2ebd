"""The rasteriser against rays that are intersected with every triangle."""

import numpy as np
import pytest

from jaxpoint.simulate.raster import NOTHING, rasterise, weights_on

SIZE = (40, 30)
FOCAL = 35.0


def triangles_before_the_eye(seed, count=60):
    """Corners (T, 3, 3) in the camera's frame, m, turned so that their outside is seen."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform([-1.0, -0.8, 2.0], [1.0, 0.8, 4.0], (count, 1, 3))
    corners = middle + rng.normal(0.0, 0.25, (count, 3, 3))
    pixels = corners[..., :2] / corners[..., 2:]
    a, b = pixels[:, 1] - pixels[:, 0], pixels[:, 2] - pixels[:, 0]
    inside_out = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] > 0
    corners[inside_out] = corners[inside_out][:, ::-1]
    return corners


def by_rays(corners, sample):
    """Triangle and depth that the ray of one sample meets first (Moeller and Trumbore 1997)."""
    ray = np.array([(sample[0] - SIZE[0] / 2) / FOCAL, (sample[1] - SIZE[1] / 2) / FOCAL, 1.0])
    nearest, found, margin = np.inf, NOTHING, np.inf
    for i, (a, b, c) in enumerate(corners):
        u, v, t = np.linalg.solve(np.stack([b - a, c - a, -ray], axis=1), -a)
        inside = min(u, v, 1 - u - v)
        margin = min(margin, abs(inside))
        if inside >= 0 and 0 < t < nearest:
            nearest, found = t, i
    return found, nearest, margin


@pytest.fixture(scope="module")
def projected():
    corners = triangles_before_the_eye(3)
    return corners, corners[..., :2] / corners[..., 2:] * FOCAL + np.array(SIZE) / 2, corners[..., 2]


def test_every_sample_sees_the_triangle_that_its_ray_meets_first(projected):
    corners, pixels, depth = projected
    raster = rasterise(pixels, depth, SIZE)
    compared = 0
    for y in range(SIZE[1]):
        for x in range(SIZE[0]):
            found, nearest, margin = by_rays(corners, (x, y))
            if margin < 1e-3:  # on an edge either answer is right
                continue
            compared += 1
            assert raster.triangle[y, x] == found
            assert raster.depth[y, x] == pytest.approx(nearest, rel=1e-4)
    assert compared > 0.9 * SIZE[0] * SIZE[1]
    assert 0.2 < (raster.triangle == NOTHING).mean() < 0.9


def test_weights_lead_to_the_point_that_is_seen(projected):
    corners, pixels, depth = projected
    raster = rasterise(pixels, depth, SIZE)
    y, x = np.nonzero(raster.triangle != NOTHING)
    triangle = raster.triangle[y, x]
    weights = weights_on(pixels, depth, triangle, np.stack([x, y], axis=1).astype(float))
    point = np.einsum("ni,nic->nc", weights, corners[triangle])
    np.testing.assert_allclose(point[:, :2] / point[:, 2:] * FOCAL + np.array(SIZE) / 2, np.stack([x, y], 1), atol=1e-8)
    np.testing.assert_allclose(point[:, 2], raster.depth[y, x], rtol=1e-4)


def test_what_is_behind_turned_away_or_without_number_is_not_drawn(projected):
    _, pixels, depth = projected
    behind, unknown = depth.copy(), pixels.copy()
    behind[::2, 1], unknown[1::2, 2, 0] = -1.0, np.nan
    assert (rasterise(unknown, behind, SIZE).triangle == NOTHING).all()
    assert (rasterise(pixels[:, ::-1], depth[:, ::-1], SIZE).triangle == NOTHING).all()
    either = rasterise(pixels[:, ::-1], depth[:, ::-1], SIZE, both_sides=True)
    np.testing.assert_array_equal(either.triangle, rasterise(pixels, depth, SIZE).triangle)
