"""A Euclidean start without factorisation: focal lengths by vote of all pairs, then a chain of essential matrices.

It competes with the factorisation, and it is what two cameras with known intrinsics have.
"""

from __future__ import annotations

import numpy as np

from jaxpoint.calibration.twoview import TwoViewGeometry, fundamental, joint_choice, undistort_points

FOCAL_GRID = np.geomspace(0.4, 3.5, 24)  # half diagonals
MEAN_LOG_FOCAL, SIGMA_LOG_FOCAL = np.log(1.2), 0.6
PRIOR_WEIGHT = 0.02  # against a cost that is a mean over pairs


def voted_focals(geometry: TwoViewGeometry) -> np.ndarray:
    """Focal lengths (C,) in half diagonals under which all F together are most nearly essential matrices.

    An essential matrix has two equal singular values (Mendonca & Cipolla 1999).
    """
    cameras = len(geometry.lenses)
    weights = {pair: geometry.inliers[pair] for pair in geometry.fundamentals}
    total = max(sum(weights.values()) / max(cameras, 1), 1)
    tables = {pair: weights[pair] / total * _essential_table(f) for pair, f in geometry.fundamentals.items()}
    prior = PRIOR_WEIGHT * ((np.log(FOCAL_GRID) - MEAN_LOG_FOCAL) / SIGMA_LOG_FOCAL) ** 2
    start = np.abs(np.log(FOCAL_GRID) - MEAN_LOG_FOCAL).argmin()
    chosen, _ = joint_choice(tables, prior, np.full(cameras, start))
    return FOCAL_GRID[chosen]


def _essential_table(matrix: np.ndarray) -> np.ndarray:
    """How unequal the two singular values of K_j^T F K_i are for every two focal lengths, 0 to 1."""
    scale = np.stack([FOCAL_GRID, FOCAL_GRID, np.ones_like(FOCAL_GRID)], axis=1)
    essential = scale[None, :, :, None] * matrix * scale[:, None, None, :]
    values = np.linalg.svd(essential, compute_uv=False)
    return (values[..., 0] - values[..., 1]) / values[..., 0]


def relative_pose(essential: np.ndarray, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Rotation and unit translation second_from_first with most points in front of both, and how many are.

    Args:
        essential: E with ray_second^T E ray_first = 0.
        first, second: (N, 3) rays of the matches.
    """
    u, _, vt = np.linalg.svd(essential)
    u, vt = u * np.sign(np.linalg.det(u)), vt * np.sign(np.linalg.det(vt))
    swap = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    best = (np.eye(3), u[:, 2], -1)
    for turn in (u @ swap @ vt, u @ swap.T @ vt):
        for shift in (u[:, 2], -u[:, 2]):
            near, far = _ray_depths(turn, shift, first, second)
            count = int(((near > 0) & (far > 0)).sum())
            if count > best[2]:
                best = (turn, shift, count)
    return best


def _ray_depths(turn, shift, first, second) -> tuple[np.ndarray, np.ndarray]:
    """Reach along the rays (depths, as rays have third coordinate 1) of both views to their nearest points."""
    turned = first @ turn.T
    aa, bb, ab = (turned**2).sum(1), (second**2).sum(1), (turned * second).sum(1)
    at, bt = turned @ shift, second @ shift
    determinant = np.maximum(aa * bb - ab**2, 1e-12)
    return (ab * bt - bb * at) / determinant, (aa * bt - ab * at) / determinant


def chain(
    geometry: TwoViewGeometry, points: np.ndarray, kept: np.ndarray, focals: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """cam_from_world rotations (C, 3, 3) and translations (C, 3), camera by camera; None where a camera is not reached.

    A new camera takes its rotation and the direction of its translation from the partner with most inliers, and the
    length of the translation from the points already known (the median of what each asks for).

    Args:
        points: (N, C, 2) normalised and distorted.
        kept: (N, C) observations to use.
        focals: (C,) half diagonals.
    """
    cameras = len(focals)
    straight, weight = undistort_points(points, geometry.lenses)
    rays = np.concatenate([straight / focals[:, None], np.ones((*straight.shape[:2], 1))], axis=-1)
    usable = kept & (weight > 0)
    poses = {pair: _pair_pose(geometry, pair, rays, usable, focals) for pair in geometry.fundamentals}
    strength = {pair: pose[2] * _parallax(pose, rays, usable, pair) for pair, pose in poses.items()}
    first, second = max(strength, key=lambda pair: strength[pair])
    rotation, translation = np.zeros((cameras, 3, 3)), np.zeros((cameras, 3))
    rotation[first] = np.eye(3)
    rotation[second], translation[second] = poses[first, second][:2]
    done = [first, second]
    while len(done) < cameras:
        edges = [pair for pair in poses if (pair[0] in done) != (pair[1] in done)]
        edges.sort(key=lambda pair: -strength[pair])
        if not any(_add(pair, poses[pair], rays, usable, rotation, translation, done) for pair in edges):
            return None
    return rotation, translation


def _pair_pose(geometry, pair, rays, usable, focals):
    i, j = pair
    scale_i, scale_j = np.diag([focals[i], focals[i], 1.0]), np.diag([focals[j], focals[j], 1.0])
    both = usable[:, i] & usable[:, j]
    return relative_pose(scale_j @ fundamental(geometry, i, j) @ scale_i, rays[both, i], rays[both, j])


def _parallax(pose, rays, usable, pair) -> float:
    """Median angle between the two rays of a match, rad, at most 0.5: more is not better."""
    i, j = pair
    both = usable[:, i] & usable[:, j]
    if not both.any():
        return 0.0
    first, second = rays[both, i] @ pose[0].T, rays[both, j]
    cosine = (first * second).sum(1) / np.linalg.norm(first, axis=1) / np.linalg.norm(second, axis=1)
    return float(min(np.median(np.arccos(np.clip(cosine, -1.0, 1.0))), 0.5))


def _add(pair, pose, rays, usable, rotation, translation, done) -> bool:
    """Add the camera of the pair that is not done yet; False where no common point fixes its distance."""
    old, new = pair if pair[0] in done else pair[::-1]
    turn, shift = pose[:2] if old == pair[0] else (pose[0].T, -pose[0].T @ pose[1])
    placed, where = _place_points(rays, usable, rotation, translation, done)
    both = where & usable[:, old] & usable[:, new]
    if both.sum() < 5:
        return False
    turned = turn @ rotation[old]
    local = placed[both] @ turned.T + turn @ translation[old]
    # ray x (local + s shift) = 0 for every point: least squares for s, then the median.
    a, b = np.cross(rays[both, new], shift), np.cross(rays[both, new], local)
    lengths = -(a * b).sum(1) / np.maximum((a**2).sum(1), 1e-12)
    rotation[new], translation[new] = turned, turn @ translation[old] + np.median(lengths) * shift
    done.append(new)
    return True


def _place_points(rays, usable, rotation, translation, done) -> tuple[np.ndarray, np.ndarray]:
    """Least-squares points (N, 3) of the rays of the cameras done, and which frames two of them saw."""
    unit = rays[:, done] / np.linalg.norm(rays[:, done], axis=-1, keepdims=True)
    unit = np.einsum("cji,ncj->nci", rotation[done], unit)
    centers = -np.einsum("cji,cj->ci", rotation[done], translation[done])
    weight = usable[:, done].astype(float)
    across = weight[..., None, None] * (np.eye(3) - unit[..., :, None] * unit[..., None, :])
    normal, right = across.sum(axis=1), np.einsum("ncij,cj->ni", across, centers)
    where = weight.sum(axis=1) >= 2
    normal[~where] = np.eye(3)
    return np.linalg.solve(normal + 1e-9 * np.eye(3), right[..., None])[..., 0], where
