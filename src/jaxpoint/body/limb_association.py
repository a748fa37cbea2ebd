"""Which long ends of several views are one arm, and which arm points.

A limb's plane and its tip in two views make a hypothesis; the other views confirm it or not. Some things
show in 3-D alone, such as which end of a bare arm is the hand, or whether a limb is a leg: an elbow must hang on a
shoulder.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.evidence.limb_slices import SLICE_M, SLICES

TIP_GAP_M = 0.07  # between the tips of two views
PLANE_ANGLE = np.deg2rad(8.0)  # between the planes of two views, thesis 7.2
GUESS_ANGLE = np.deg2rad(4.0)  # the same where other views, or the covariance, check the result
AXIS_ANGLE = np.deg2rad(14.0)  # by which a view's plane may miss the axis
AXIS_TO_TIP_M = 0.12  # a bent wrist carries the tip this far from the forearm's axis
CLOSE_M = 0.012  # a ray that passes a place so far away does not support it
VIEW_AHEAD_M, MOST_AHEAD = 0.10, 0.4  # so much farther ahead is worth one view, but never more than this part of one
_PULL = 1e-4  # of the tip on the axis, where the planes do not hold it
AXIS_SCALE = np.deg2rad(2.0)  # the miss at which a plane counts half
ELBOW_M = 0.43  # from the tip of a pointing hand to the elbow, mean of adults
SHOULDER_BELOW_M = 0.28  # under the centre of the head
ELBOW_REACH_M = (0.10, 0.68)  # from the middle between the shoulders to the elbow
BENT_M = 0.10  # nearer to the shoulders than the elbow a hand may be, where the elbow is bent
TIP_REACH_M = 1.25  # from the head
SAME_TIP_M = 0.10  # hypotheses with tips as near as this
SAME_ANGLE = np.deg2rad(20.0)  # and directions as near as this are one limb
_FOREARM = slice(round(0.17 / SLICE_M), round(0.40 / SLICE_M))


@dataclass(frozen=True)
class LimbRays:
    """N long ends of all views of one frame, as rays of the world."""

    camera: Int[np.ndarray, " N"]
    origin: Float[np.ndarray, "N 3"]  # m
    tip: Float[np.ndarray, "N 3"]  # unit
    slices: Float[np.ndarray, "N S 3"]  # unit
    held: Bool[np.ndarray, "N S"]
    weight: Float[np.ndarray, " N"]  # weight of a view: 1 for skin, less for an outline

    def __len__(self) -> int:
        """Number of long ends, N."""
        return len(self.camera)


@dataclass(frozen=True)
class Arm:
    """One limb of one frame, seen in several views."""

    members: tuple[int, ...]  # places in LimbRays, one a view
    tip: Float[np.ndarray, "3"]  # m
    direction: Float[np.ndarray, "3"]  # unit, towards the tip
    support: float  # summed weight of the views
    spread: float  # m, rms distance of the tips' rays from the tip
    foot: Float[np.ndarray, "3"]  # m, of the tip on the axis, beside which a bent wrist carries it
    alternatives: tuple[Float[np.ndarray, "3"], ...] = ()  # directions of two members each, widest planes first

    @property
    def elbow(self) -> Float[np.ndarray, "3"]:
        """Where the elbow of a mean adult would be, m."""
        return self.tip - ELBOW_M * self.direction


def associate(limbs: LimbRays, head: Float[np.ndarray, "3"] | None, most: int = 12) -> list[Arm]:
    """The limbs that at least two views agree on, best supported first.

    A long end may belong to several: measuring them shows which are real.

    Args:
        limbs: of one person in one frame.
        head: centre of the person's head, m; without it nothing is known of shoulders.
        most: limbs at most.
    """
    if len(limbs) < 2:
        return []
    normal, inward = _planes(limbs)
    pairs, tips, directions = _hypotheses(limbs, normal, inward)
    possible = _possible(tips, directions, head)
    pairs, tips, directions = pairs[possible], tips[possible], directions[possible]
    if not len(pairs):
        return []
    fit = _agreement(limbs, normal, inward, tips, directions)
    members, support = _members(limbs, fit)
    left = (members >= 0).sum(axis=1) >= 2
    arms: list[Arm] = []
    while len(arms) < most and left.any():
        best = int(np.where(left, support, -1.0).argmax())
        own = members[best]
        arms.append(_arm(limbs, normal, tuple(own[own >= 0].tolist()), directions[best], fit[best]))
        near = np.linalg.norm(tips - tips[best], axis=1) < SAME_TIP_M
        left &= ~(near & (directions @ directions[best] > np.cos(SAME_ANGLE)))
    return arms


def stretch(tip: Float[np.ndarray, "3"], head: Float[np.ndarray, "3"]) -> float:
    """How far a tip is from the body's upright axis, m; a hand above the shoulder counts as far."""
    shoulder = head - [0.0, 0.0, SHOULDER_BELOW_M]
    off = tip - shoulder
    return float(np.hypot(off[0], off[1]) + max(0.0, off[2]))


def common_point(
    origins: Float[np.ndarray, "n 3"],
    rays: Float[np.ndarray, "n 3"],
    views: Int[np.ndarray, " n"],
    ahead: Float[np.ndarray, "3"],
    within_m: float = 0.02,
    beside: tuple[Float[np.ndarray, "3"], float] | None = None,
) -> tuple[Float[np.ndarray, "3"], float, list[int]] | None:
    """Where candidates of several views meet, one a view.

    Every view counts by how near it passes a place. A place farther ahead than the best one wins with a little less:
    some views lose the finger and end at the knuckles. Much less is a chance meeting of unlike ends.

    Args:
        origins: camera centres, m.
        rays: unit, through the candidates.
        views: of each candidate.
        ahead: unit direction in which a candidate that reaches farther is the better one.
        within_m: distance of a ray from the place that supports it.
        beside: a point of the axis along `ahead`, and the farthest distance from that axis, m; None for anywhere.

    Returns:
        The place (m), the rms distance of its rays (m), and which candidates support it; None where no two do.
    """
    i, j = np.triu_indices(len(views), 1)
    i, j = (index[views[i] != views[j]] for index in (i, j))
    points, gap, front = _meet(origins[i], rays[i], origins[j], rays[j])
    points = points[front & (gap < 2 * within_m)]
    if beside is not None:
        off = points - beside[0]
        points = points[np.linalg.norm(off - (off @ ahead)[:, None] * ahead, axis=1) <= beside[1]]
    if not len(points):
        return None
    off = points[:, None] - origins[None]
    along = np.einsum("hni,ni->hn", off, rays)
    distance = np.linalg.norm(off - along[..., None] * rays, axis=2)
    names = np.unique(views)
    nearest = np.stack([np.where(views == v, distance, np.inf).min(axis=1) for v in names], axis=1)
    worth = np.maximum(0.0, 1 - (nearest / CLOSE_M) ** 2).sum(axis=1)
    farther = points @ ahead - points[worth.argmax()] @ ahead
    best = int((worth + np.minimum(farther / VIEW_AHEAD_M, MOST_AHEAD)).argmax())
    own = [np.where(views == v, distance[best], np.inf).argmin() for v, d in zip(names, nearest[best]) if d < within_m]
    point, spread = _nearest_point(origins[own], rays[own], np.ones(len(own)))
    return point, spread, [int(k) for k in own]


def agreeing_views(
    origins: Float[np.ndarray, "C 3"],
    rays: Float[np.ndarray, "C S 3"],
    held: Bool[np.ndarray, "C S"],
    focal_over_sigma: Float[np.ndarray, " C"],
    tip: Float[np.ndarray, "3"],
    ahead: Float[np.ndarray, "3"],
    within: float,
) -> tuple[Bool[np.ndarray, " C"], Float[np.ndarray, "3"]] | None:
    """The most views whose slices lie on one axis, and its direction: every two views propose one, all check it.

    Args:
        origins: camera centres, m.
        rays: unit, through the middles of slices.
        held: which slices there are; views without any are not used.
        focal_over_sigma: by which an angle becomes errors of a slice.
        tip: of the limb, near which the axis passes, m.
        ahead: rough direction towards the tip.
        within: rms in such errors up to which a view agrees.

    Returns:
        Which views agree, and the direction; None where no two do.
    """
    views = np.flatnonzero(held.any(axis=1))
    if len(views) < 2:
        return None
    moments = np.einsum("cs,csi,csj->cij", held[views].astype(float), rays[views], rays[views])
    normal = np.linalg.eigh(moments)[1][:, :, 0]
    i, j = np.triu_indices(len(views), 1)
    axis = np.cross(normal[i], normal[j])
    sine = np.linalg.norm(axis, axis=1)
    axis = axis / np.maximum(sine, 1e-12)[:, None]
    axis = axis * np.where(axis @ ahead < 0, -1.0, 1.0)[:, None]
    # The point of both planes that is nearest to the tip along the planes' normals.
    rows = np.stack([normal[i], normal[j], axis], axis=1)
    offsets = np.stack([(normal[k] * origins[views][k]).sum(axis=1) for k in (i, j)] + [axis @ tip], axis=1)
    wide = sine > np.sin(GUESS_ANGLE)
    if not wide.any():
        return None
    rows, offsets, axis = rows[wide], offsets[wide], axis[wide]
    points = np.linalg.solve(rows, offsets[..., None])[..., 0]
    across = _unit(np.cross(points[:, None] - origins[views][None], axis[:, None]))  # pairs, views
    off = np.einsum("pci,csi->pcs", across, rays[views]) * focal_over_sigma[views][:, None]
    count = held[views].sum(axis=1)
    rms = np.sqrt((np.where(held[views], off, 0.0) ** 2).sum(axis=2) / count)
    agrees = rms <= within
    near = np.linalg.norm(points - tip, axis=1) < AXIS_TO_TIP_M
    score = np.where(near, agrees.sum(axis=1), 0) + 0.9 / (1 + np.where(agrees, rms, 0.0).mean(axis=1))
    best = int(score.argmax())
    if not near[best] or agrees[best].sum() < 2:
        return None
    chosen = np.zeros(len(origins), bool)
    chosen[views[agrees[best]]] = True
    return chosen, axis[best]


def _nearest_point(origins, rays, weight) -> tuple[Float[np.ndarray, "3"], float]:
    """The point nearest to rays, and its rms distance from them, m."""
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    matrix = np.einsum("n,nij->ij", weight, across)
    point = np.linalg.solve(matrix + 1e-9 * np.eye(3), np.einsum("n,nij,nj->i", weight, across, origins))
    off = np.einsum("nij,nj->ni", across, point - origins)
    return point, float(np.sqrt((off**2).sum(axis=1).mean()))


def _planes(limbs: LimbRays) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
    """Normal of the plane through camera and axis, and the unit direction across the rays from base to tip."""
    window = np.zeros(SLICES, bool)
    window[_FOREARM] = True
    inside = limbs.held & window
    use = np.where((inside.sum(axis=1) >= 4)[:, None], inside, limbs.held)
    rank = np.cumsum(use, axis=1)
    half = (use.sum(axis=1) / 2)[:, None]
    front, back = use & (rank <= half), use & (rank > half)
    near = _mean(limbs.slices, front)
    far = _mean(limbs.slices, back)
    normal = _unit(np.cross(far, near))
    return normal, _unit(near - far)


def _mean(rays: Float[np.ndarray, "N S 3"], use: Bool[np.ndarray, "N S"]) -> Float[np.ndarray, "N 3"]:
    return _unit(np.einsum("ns,nsi->ni", use.astype(float), rays))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def _hypotheses(limbs, normal, inward):
    """Tip and direction of every pair of long ends in different views that agree."""
    i, j = np.triu_indices(len(limbs), 1)
    apart = limbs.camera[i] != limbs.camera[j]
    i, j = i[apart], j[apart]
    axis = np.cross(normal[i], normal[j])
    sine = np.linalg.norm(axis, axis=1)
    axis = axis / np.maximum(sine, 1e-12)[:, None]
    sign_i = np.sign(np.einsum("ni,ni->n", axis, inward[i]))
    sign_j = np.sign(np.einsum("ni,ni->n", axis, inward[j]))
    tip, gap, ahead = _meet(limbs.origin[i], limbs.tip[i], limbs.origin[j], limbs.tip[j])
    good = (sine > np.sin(GUESS_ANGLE)) & (sign_i == sign_j) & (gap < TIP_GAP_M) & ahead
    return np.stack([i, j], axis=1)[good], tip[good], (axis * sign_i[:, None])[good]


def _meet(a, u, b, v):
    """Middle of the shortest link of two rays, its length, and whether it lies ahead of both."""
    gap = b - a
    cosine = np.einsum("ni,ni->n", u, v)
    sine2 = np.maximum(1 - cosine**2, 1e-9)
    on_u, on_v = np.einsum("ni,ni->n", gap, u), np.einsum("ni,ni->n", gap, v)
    s = (on_u - cosine * on_v) / sine2
    t = (cosine * on_u - on_v) / sine2
    p, q = a + s[:, None] * u, b + t[:, None] * v
    return (p + q) / 2, np.linalg.norm(p - q, axis=1), (s > 0) & (t > 0)


def _possible(tips, directions, head) -> Bool[np.ndarray, " H"]:
    """Whether a person with this head can have this arm."""
    if head is None:
        return np.ones(len(tips), bool)
    shoulder = head - np.array([0.0, 0.0, SHOULDER_BELOW_M])
    elbow = np.linalg.norm(tips - ELBOW_M * directions - shoulder, axis=1)
    out = np.linalg.norm(tips - shoulder, axis=1)
    near = np.linalg.norm(tips - head, axis=1) < TIP_REACH_M
    # A hand that points is farther out than its elbow; the other end of a bare arm is not.
    return near & (elbow > ELBOW_REACH_M[0]) & (elbow < ELBOW_REACH_M[1]) & (out > elbow - BENT_M)


def _agreement(limbs, normal, inward, tips, directions) -> Float[np.ndarray, "H N"]:
    """Between 0 and 1: how well each long end fits each hypothesis."""
    gap = limbs.origin[None] - tips[:, None]
    along = np.einsum("hni,ni->hn", gap, limbs.tip)
    off = np.linalg.norm(gap - along[..., None] * limbs.tip[None], axis=2)
    miss = np.abs(directions @ normal.T)
    same = directions @ inward.T > 0
    near = np.clip(1 - off / TIP_GAP_M, 0, 1)
    flat = np.clip(1 - miss / np.sin(AXIS_ANGLE), 0, 1)
    return np.where(same & (along < 0), np.sqrt(near * flat), 0.0) * limbs.weight


def _members(limbs: LimbRays, fit: Float[np.ndarray, "H N"]) -> tuple[Int[np.ndarray, "H V"], Float[np.ndarray, " H"]]:
    """The long end of each view that fits each hypothesis best, -1 where none does; and the sum of how they fit."""
    members, support = [], np.zeros(len(fit))
    for camera in np.unique(limbs.camera):
        own = np.flatnonzero(limbs.camera == camera)
        best = own[fit[:, own].argmax(axis=1)]
        value = fit[np.arange(len(fit)), best]
        members.append(np.where(value > 0, best, -1))
        support += value
    return np.stack(members, axis=1), support


def _arm(limbs, normal, members, direction, fit) -> Arm:
    """The limb of the members: its tip nearest to their rays, its axis nearest to their planes."""
    index = np.array(members)
    weight = fit[index]
    tip, spread = _nearest_point(limbs.origin[index], limbs.tip[index], weight)
    axis = direction
    for _ in range(6):  # planes that miss the axis lose weight
        trusted = weight / (1 + (normal[index] @ axis / np.sin(AXIS_SCALE)) ** 2)
        _, vectors = np.linalg.eigh(np.einsum("n,ni,nj->ij", trusted, normal[index], normal[index]))
        axis = vectors[:, 0] if vectors[:, 0] @ direction > 0 else -vectors[:, 0]
    foot = _foot(normal[index], limbs.origin[index], trusted, tip, axis)
    return Arm(members, tip, axis, float(weight.sum()), spread, foot, _of_pairs(normal[index], direction))


def _foot(normal, origin, weight, tip, axis) -> Float[np.ndarray, "3"]:
    """The point of the axis, where the planes meet, that is beside the tip."""
    matrix = np.einsum("n,ni,nj->ij", weight, normal, normal) + _PULL * weight.sum() * np.eye(3)
    right = np.einsum("n,ni->i", weight * (normal * origin).sum(axis=1), normal) + _PULL * weight.sum() * tip
    point = np.linalg.solve(matrix, right)
    return point + ((tip - point) @ axis) * axis


def _of_pairs(normal: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "3"]) -> tuple[np.ndarray, ...]:
    """Where the planes of each two views meet, the pair nearest to a right angle first."""
    i, j = np.triu_indices(len(normal), 1)
    axis = np.cross(normal[i], normal[j])
    sine = np.linalg.norm(axis, axis=1)
    axis = axis / np.maximum(sine, 1e-12)[:, None]
    axis = axis * np.where(axis @ direction < 0, -1.0, 1.0)[:, None]
    return tuple(axis[k] for k in np.argsort(-sine) if sine[k] > np.sin(GUESS_ANGLE))
