"""Images of the simulated room: the room itself once a camera, and people drawn into it frame by frame.

Corners are projected by the camera's own lens, so nothing is remapped. Four samples a pixel; where something moves
they also lie at four moments of the exposure. Everything is linear light in OpenCV's order of colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxpoint.simulate.lighting import MAP_PX, LightPoint, RoomLight, is_lit
from jaxpoint.simulate.mesh import PARTS_A_PERSON, Mesh
from jaxpoint.simulate.raster import NOTHING, Raster, rasterise, weights_on
from jaxpoint.simulate.scene import Scene
from jaxpoint.simulate.viewpoints import Viewpoint

SAMPLES = 2  # a pixel, in each direction
COARSE = 4  # pixels between the places where shadows of people are looked up
MOVES_PX = 0.5  # what moves less during the exposure is drawn at rest
CHUNK = 400_000  # samples shaded at once
SHADOW_BLUR_PX = 1.6  # of the lamps' maps, for the lamps' size
SKIN_BIAS_M = 0.05


@dataclass(frozen=True)
class RoomView:
    """The empty room as one camera sees it."""

    image: Float[np.ndarray, "H W 3"]  # linear blue, green, red
    depth: Float[np.ndarray, "H2 W2"]  # m, of every sample
    lamp_places: tuple[Float[np.ndarray, "2 h w"], ...]  # x and y, where each lamp's map shows every COARSE-th pixel
    lamp_distances: Float[np.ndarray, "L h w"]  # m
    lamp_shares: Float[np.ndarray, "L h w"]  # of the light there


@dataclass(frozen=True)
class LitPeople:
    """People at one moment, lit: the same for all cameras."""

    start: Float[np.ndarray, "V 3"]  # m, corners when the shutter opens
    end: Float[np.ndarray, "V 3"]  # m, and when it closes
    triangles: Int[np.ndarray, "T 3"]
    parts: UInt8[np.ndarray, " V"]
    colour: Float[np.ndarray, "V 3"]  # linear blue, green, red
    coverage: Float[np.ndarray, "L M M"]  # share of each lamp's light that they take, on its map
    distance: Float[np.ndarray, "L M M"]  # m, from the lamp to them

    @property
    def middle(self) -> Float[np.ndarray, "V 3"]:
        """Corners in the middle of the exposure, which is the moment of the truth, m."""
        return (self.start + self.end) / 2


@dataclass(frozen=True)
class Drawn:
    """One camera's picture of the room with people, and whose pixel is which."""

    image: Float[np.ndarray, "H W 3"]  # linear blue, green, red
    labels: UInt8[np.ndarray, "H W"]  # `Part`, plus PARTS_A_PERSON times the person
    pixels: Int[np.ndarray, "256"]  # how many pixels each label has
    samples: Int[np.ndarray, "256"]  # and how many samples


def render_room(view: Viewpoint, scene: Scene, light: RoomLight) -> RoomView:
    """Draw the empty room."""
    surfaces = scene.surfaces
    pixels, depth = view.project(surfaces.vertices)
    corners = (SAMPLES * pixels + (SAMPLES - 1) / 2)[surfaces.triangles].astype(np.float32)
    depths = depth[surfaces.triangles].astype(np.float32)
    width, height = view.size
    size = (SAMPLES * width, SAMPLES * height)
    raster = rasterise(corners, depths, size)
    seen = np.flatnonzero(raster.triangle.ravel() != NOTHING)
    image = np.zeros((size[0] * size[1], 3), np.float32)
    for part in np.array_split(seen, max(1, len(seen) // CHUNK)):
        triangle, weights = _on_triangles(raster, corners, depths, part)
        image[part] = _shaded(scene, light, triangle, weights)
    image = _averaged(image.reshape(size[1], size[0], 3))[..., ::-1]
    return RoomView(np.ascontiguousarray(image), raster.depth, *_lamps_at(scene, light, raster, corners, depths))


def light_people(start: Mesh, end: Mesh, light: RoomLight) -> LitPeople:
    """Light people whose corners move from one mesh to the other (of equal triangles) while the shutter is open."""
    points = (start.vertices + end.vertices) / 2
    direct, rest = light.on(points, start.normals)
    seen = [lamp.seen_by(points, start.triangles) for lamp in light.lamps]
    for lamp, own, amount in zip(light.lamps, seen, direct):
        lifted = points + SKIN_BIAS_M * start.normals
        amount *= is_lit(own, *lamp.on_map(lifted))[:, None]
    hanging = 0.75 + 0.25 * start.normals[:, 2:]  # less light from below
    colour = start.albedo * (direct.sum(axis=0) + rest * hanging)
    near = np.stack([_nearest_around(own) for own in seen])
    coverage = np.stack([cv2.GaussianBlur(np.isfinite(own).astype(np.float32), (0, 0), SHADOW_BLUR_PX) for own in seen])
    return LitPeople(
        start.vertices,
        end.vertices,
        start.triangles,
        start.parts,
        np.ascontiguousarray(colour[:, ::-1], np.float32),
        coverage,
        near,
    )


def draw_people(view: Viewpoint, room: RoomView, people: LitPeople) -> Drawn:
    """Draw people into the room: hidden by furniture, shading floor and walls, smeared by their motion."""
    image = room.image.copy()
    _cast_shadows(image, room, people)
    start, depth = view.project(people.start)
    end = view.project(people.end)[0]
    depth = depth.astype(np.float32)
    window = _window(np.concatenate([start, end]), view.size)
    if window is None:
        return nobody(image)
    x, y, width, height = window
    part, colour, far = _samples(start - (x, y), end - (x, y), depth, people, (width, height))
    hidden = far > room.depth[SAMPLES * y : SAMPLES * (y + height), SAMPLES * x : SAMPLES * (x + width)]
    part[hidden] = 0
    labels = np.zeros(image.shape[:2], np.uint8)
    covered = part > 0
    share = _averaged(covered.astype(np.float32))
    colour[hidden] = 0.0
    place = np.s_[y : y + height, x : x + width]
    image[place] = (1 - share)[..., None] * image[place] + _averaged(colour)
    labels[place] = np.where(share >= 0.5, _first(part), 0)
    pixels, samples = (np.bincount(values.ravel(), minlength=256) for values in (labels[place], part))
    return Drawn(image, labels, pixels, samples)


def nobody(image: Float[np.ndarray, "H W 3"]) -> Drawn:
    """A picture without people."""
    none = np.zeros(256, np.int64)
    return Drawn(image, np.zeros(image.shape[:2], np.uint8), none, none)


def samples_alone(view: Viewpoint, people: LitPeople, label: int, around: Sequence[int]) -> int:
    """How many samples a part of a person has when only it and the parts around it are drawn.

    What lies beyond the image's edges counts too. The parts around it hide the ends that are sunk into them.
    """
    drawn = np.isin(people.parts, (label, *around))
    number = np.cumsum(drawn) - 1
    triangles = number[people.triangles[drawn[people.triangles[:, 0]] & drawn[people.triangles[:, 2]]]]
    part = people.parts[drawn]
    pixels, depth = view.project(people.middle[drawn])
    own = pixels[part == label]
    if not len(own) or not np.isfinite(pixels).all():
        return 0
    low = np.floor(own.min(axis=0)) - 1
    width, height = (np.ceil(own.max(axis=0)) + 2 - low).astype(int).tolist()
    corners = SAMPLES * (pixels - low) + (SAMPLES - 1) / 2
    raster = rasterise(corners[triangles], depth[triangles], (SAMPLES * width, SAMPLES * height))
    found = raster.triangle[raster.triangle != NOTHING]
    return int((part[triangles[found, 0]] == label).sum())


def label_of(part: int, person: int) -> int:
    """The value that marks a part of a person in images of labels."""
    return part + PARTS_A_PERSON * person


def _samples(start, end, depth, people: LitPeople, size) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Part (0: nobody), colour and depth of every sample of a window."""
    width, height = size
    moved = np.abs(end - start)
    if np.nanmax(np.where(np.isfinite(moved), moved, 0.0)) < MOVES_PX:
        corners = SAMPLES * (start + end) / 2 + (SAMPLES - 1) / 2
        return _sampled(corners, depth, people, (SAMPLES * width, SAMPLES * height))
    part = np.empty((SAMPLES * height, SAMPLES * width), np.uint8)
    colour = np.empty((*part.shape, 3), np.float32)
    far = np.empty(part.shape, np.float32)
    # Neighbouring samples are half an exposure apart: a smear without a direction of its own.
    for i, (row, column) in enumerate(((0, 0), (1, 1), (0, 1), (1, 0))):
        moment = (i + 0.5) / SAMPLES**2
        offset = np.array([column, row]) / SAMPLES - (SAMPLES - 1) / (2 * SAMPLES)
        corners = (1 - moment) * start + moment * end - offset
        place = np.s_[row::SAMPLES, column::SAMPLES]
        part[place], colour[place], far[place] = _sampled(corners, depth, people, size)
    return part, colour, far


def _sampled(corners, depth, people: LitPeople, size) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    corner = corners[people.triangles].astype(np.float32)
    raster = rasterise(corner, depth[people.triangles], size)
    part = np.zeros(raster.triangle.shape, np.uint8)
    colour = np.zeros((*part.shape, 3), np.float32)
    row, column = np.nonzero(raster.triangle != NOTHING)
    triangle = raster.triangle[row, column]
    part[row, column] = people.parts[people.triangles[:, 0]][triangle]
    colour[row, column] = _blended(corner, people.colour[people.triangles], triangle, column, row)
    return part, colour, raster.depth


def _blended(corner, value, triangle, column, row) -> np.ndarray:
    """Values of the corners, linear across each triangle: enough for triangles of a few pixels."""
    seen = np.zeros(len(corner), bool)
    seen[triangle] = True
    corner, value = corner[seen], value[seen]
    triangle = (np.cumsum(seen, dtype=np.int32) - 1)[triangle]
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    rise_a, rise_b = value[:, 1] - value[:, 0], value[:, 2] - value[:, 0]
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    inverse = (1 / np.where(area == 0, 1, area))[:, None]
    slope_x = (rise_a * b[:, 1:] - rise_b * a[:, 1:]) * inverse
    slope_y = (rise_b * a[:, :1] - rise_a * b[:, :1]) * inverse
    start = value[:, 0] - slope_x * corner[:, 0, :1] - slope_y * corner[:, 0, 1:]
    planes = np.concatenate([start, slope_x, slope_y], axis=1).astype(np.float32)[triangle]
    blended = planes[:, :3] + planes[:, 3:6] * column[:, None] + planes[:, 6:] * row[:, None]
    return np.clip(blended, 0.0, None)


def _cast_shadows(image: np.ndarray, room: RoomView, people: LitPeople) -> None:
    """Darken the room, in place, where people stand between it and a lamp."""
    lost = np.zeros(room.lamp_shares.shape[1:], np.float32)
    for place, distance, share, coverage, near in zip(
        room.lamp_places, room.lamp_distances, room.lamp_shares, people.coverage, people.distance
    ):
        taken = cv2.remap(coverage, place[0], place[1], cv2.INTER_LINEAR)
        first = cv2.remap(near, place[0], place[1], cv2.INTER_NEAREST)
        lost += share * taken * (distance > first + SKIN_BIAS_M)
    rows, columns = np.nonzero(lost > 0.004)
    if not len(rows):
        return
    top, bottom, left, right = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
    part = lost[top:bottom, left:right]
    large = cv2.resize(part, None, fx=COARSE, fy=COARSE, interpolation=cv2.INTER_LINEAR)
    shaded = image[COARSE * top : COARSE * bottom, COARSE * left : COARSE * right]
    shaded *= 1 - large[: shaded.shape[0], : shaded.shape[1], None]  # the last places may reach beyond the image


def _nearest_around(seen: np.ndarray) -> np.ndarray:
    """A lamp's map with every distance spread over the blur of its shadow; far where nobody is near."""
    finite = np.where(np.isfinite(seen), seen, 1e3).astype(np.float32)
    return cv2.erode(finite, np.ones((9, 9), np.uint8))


def _window(pixels: np.ndarray, size: tuple[int, int]) -> tuple[int, int, int, int] | None:
    """The part of the image (x, y, width, height) that holds these pixels."""
    known = pixels[np.isfinite(pixels).all(axis=1)]
    if not len(known):
        return None
    low = np.clip(np.floor(known.min(axis=0)) - 1, 0, size).astype(int)
    high = np.clip(np.ceil(known.max(axis=0)) + 2, 0, size).astype(int)
    if (high <= low).any():
        return None
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def _on_triangles(raster: Raster, corners, depths, places) -> tuple[np.ndarray, np.ndarray]:
    """Triangle, and weights of its corners, at some samples (flat indices)."""
    width = raster.triangle.shape[1]
    triangle = raster.triangle.ravel()[places]
    sample = np.stack([places % width, places // width], axis=1).astype(np.float32)
    return triangle, weights_on(corners, depths, triangle, sample)


def _shaded(scene: Scene, light: RoomLight, triangle, weights) -> np.ndarray:
    """What samples send to the camera: linear red, green, blue."""
    surfaces = scene.surfaces
    corner = surfaces.triangles[triangle]
    uv = _mixed(weights, surfaces.uv[corner])
    arriving = _mixed(weights, light.total[corner])
    colour = np.empty((len(triangle), 3), np.float32)
    kind = surfaces.texture[triangle]
    order = np.argsort(kind, kind="stable")
    starts = np.searchsorted(kind[order], np.arange(len(surfaces.textures) + 1))
    for texture, first, last in zip(surfaces.textures, starts[:-1], starts[1:]):
        if first < last:
            chosen = order[first:last]
            found = _looked_up(texture.image, uv[chosen])
            colour[chosen] = found if texture.shines else found * arriving[chosen]
    return colour


def _looked_up(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """A repeated picture at places (N, 2) on it, between its pixels."""
    height, width = image.shape[:2]
    inside = uv - np.floor(uv - (uv == np.floor(uv)) * 1e-6)  # 1.0 is the right edge, not the left
    place = (inside * [width, height] - 0.5).astype(np.float32)
    rows = -(-len(place) // 4096)
    padded = np.zeros((2, rows * 4096), np.float32)  # cv2.remap takes no long rows
    padded[:, : len(place)] = place.T
    x, y = padded.reshape(2, rows, 4096)
    found = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return found.reshape(-1, 3)[: len(place)]


def _lamps_at(scene: Scene, light: RoomLight, raster: Raster, corners, depths) -> tuple[tuple, np.ndarray, np.ndarray]:
    """For every COARSE-th pixel: its place on each lamp's map, its distance, and the lamp's share of its light."""
    step, half = SAMPLES * COARSE, SAMPLES * COARSE // 2 - 1
    height, width = raster.triangle.shape
    rows, columns = (np.minimum(np.arange(half, size + half, step), size - 1) for size in (height, width))
    row, column = np.meshgrid(rows, columns, indexing="ij")
    places = (row * width + column).ravel()
    seen = raster.triangle.ravel()[places] != NOTHING
    triangle, weights = _on_triangles(raster, corners, depths, np.where(seen, places, 0))
    weights[~seen] = 0.0
    corner = scene.surfaces.triangles[triangle]
    points = _mixed(weights, scene.surfaces.vertices[corner])
    total = np.maximum(_mixed(weights, light.total[corner]).mean(axis=1), 1e-6)
    shape = row.shape
    found = [_lamp_at(lamp, points, shape) for lamp in light.lamps]
    shares = [_mixed(weights, direct[corner]).mean(axis=1) / total for direct in light.direct]
    shining = np.array([texture.shines for texture in scene.surfaces.textures])[scene.surfaces.texture[triangle]]
    kept = seen & ~shining
    return (
        tuple(place for place, _ in found),
        np.stack([distance for _, distance in found]),
        np.stack([(share * kept).reshape(shape) for share in shares]).astype(np.float32),
    )


def _lamp_at(lamp: LightPoint, points: np.ndarray, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    place, distance = lamp.on_map(points)
    outside = np.nan_to_num(place, nan=-2.0 * MAP_PX).astype(np.float32)
    return np.ascontiguousarray(outside.T).reshape(2, *shape), distance.reshape(shape).astype(np.float32)


def _mixed(weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (N, 3 corners, C) by the weights (N, 3) of their corners."""
    return weights[:, :1] * values[:, 0] + weights[:, 1:2] * values[:, 1] + weights[:, 2:] * values[:, 2]


def _averaged(samples: np.ndarray) -> np.ndarray:
    """Pixels of samples."""
    height, width = samples.shape[:2]
    return cv2.resize(samples, (width // SAMPLES, height // SAMPLES), interpolation=cv2.INTER_AREA)


def _first(part: np.ndarray) -> np.ndarray:
    """The part of the first sample of every pixel that shows a person."""
    found = part[::SAMPLES, ::SAMPLES].copy()
    for row, column in ((1, 1), (0, 1), (1, 0)):
        other = part[row::SAMPLES, column::SAMPLES]
        found = np.where(found > 0, found, other)
    return found
