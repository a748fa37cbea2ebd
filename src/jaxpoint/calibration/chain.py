"""From pixels to points of the room as one function, with derivatives by every number that goes in.

The light's pixels give the cameras (`implicit.optimum`), clicks on landmarks bring them into the room (the similarity
of `umeyama`), and other pixels become points (`triangulate`). Lines, angles and distances follow by `geometry.line`.
Every step is differentiated at its own optimum, by the implicit function theorem, so that the derivative of the whole
is what solving everything again would show. What the solves decided is frozen: which pixels are believed, and the loss.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from jaxpoint.calibration.alignment import umeyama
from jaxpoint.calibration.bundle import BLOCK, LEAST_SQUARES, CameraModel
from jaxpoint.calibration.implicit import optimum
from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.schur import Problem, SchurLevenbergMarquardt, Unknowns
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.parameters import adjusted_cameras, rig_of_parameters, rotations_of
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.geometry.arrays import AnyArray, as_float, hash_or_hint
from jaxpoint.triangulation import triangulate

RTOL, XTOL = 1e-12, 1e-8
STEPS = 200
POINT_STEPS = 20  # of a triangulated point, at most
LANDMARKS = 3  # hold a frame


class Measured(eqx.Module):
    """What the points depend on. F frames, C cameras, L landmarks, N points; hidden pixels never matter."""

    light: Float[Array, "F C 2"]  # px
    weights: Float[Array, "F C"]  # of the light's pixels: 1 where believed, 0 where not
    prior_mean: Float[Array, "C p"]  # of the cameras, see `camera.parameters`
    prior_weight: Float[Array, "C p"]  # px^2 per unit^2
    landmarks: Float[Array, "L 3"]  # m, in the room
    clicks: Float[Array, "L C 2"]  # px, on the landmarks
    pixels: Float[Array, "N C 2"]  # px, of the points that are asked for


class Chain(eqx.Module):
    """The function from `Measured` to points. Pure, for `jit`, `grad`, `jvp` and, over recordings, `vmap`."""

    start: Unknowns  # rotation vectors about `base`; where the solve begins does not matter
    base: Float[Array, "C 3 3"]
    free: Bool[Array, "C p"]
    loss_scale: Float[Array, ""]  # px
    landmark_weights: Float[Array, " L"]
    clicked: Bool[Array, "L C"]
    visible: Bool[Array, "N C"]
    image_sizes: tuple[tuple[int, int], ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    lens: type[AbstractLens] = eqx.field(static=True)

    __hash__ = hash_or_hint

    def points(self, measured: Measured) -> Float[Array, "N 3"]:
        """The points in the room, m; without landmarks in the solver's own frame and unit.

        There only what no similarity changes, such as an angle, has a derivative that means something.

        Raises:
            ValueError: the numbers are float64 and JAX would cut them to float32.
        """
        return self.rig_and_points(measured)[1]

    def rig_and_points(self, measured: Measured) -> tuple[CameraRig, Float[Array, "N 3"]]:
        """The cameras too, in the same frame as the points.

        Raises:
            ValueError: the numbers are float64 and JAX would cut them to float32.
        """
        as_float(measured.light)
        rig = self._solved(measured)
        # Clicks and points at once, in the solver's frame: it is one program, and a similarity changes no pixel.
        pixels = jnp.concatenate([measured.clicks, measured.pixels])
        visible = jnp.concatenate([self.clicked, self.visible])
        found = triangulate(rig, pixels, visible, refine_steps=POINT_STEPS, covariance=False).points
        count = len(measured.landmarks)
        if not count:
            return rig, found
        similarity = umeyama(found[:count], measured.landmarks, self.landmark_weights)
        return rig.transformed(similarity), similarity @ found[count:]

    def _solved(self, measured: Measured) -> CameraRig:
        """The cameras in the solver's own frame."""
        block = self.start.points.shape[2]
        problem = Problem(
            _in_blocks(measured.light, block),
            _in_blocks(measured.weights, block),
            self.base,
            self.free,
            measured.prior_mean,
            measured.prior_weight,
            self.loss_scale,
            jnp.asarray(STEPS),
        )
        solver = SchurLevenbergMarquardt(model=CameraModel(self.lens), rtol=RTOL, xtol=XTOL)
        return self._rig_of(optimum(solver, self.start, problem).cameras)

    def _rig_of(self, cameras: Float[Array, "C p"]) -> CameraRig:
        turned = rotations_of(cameras, self.base)
        return rig_of_parameters(cameras, turned, np.array(self.image_sizes), self.names, self.lens)


def chain_of(
    calibration: Calibration,
    pixels: Float[AnyArray, "N C 2"],
    visible: Bool[AnyArray, "N C"],
    *,
    landmarks: Float[AnyArray, "L 3"] | None = None,
    clicks: Float[AnyArray, "L C 2"] | None = None,
    clicked: Bool[AnyArray, "L C"] | None = None,
    sigmas: Float[AnyArray, " L"] | None = None,
) -> tuple[Chain, Measured]:
    """How points hang on everything measured, for a calibration as `calibrate` returned it, aligned or not.

    Use both in float64. What the calibration does not believe has weight 0.

    Args:
        pixels: of the points that are asked for, px.
        visible: which of them there are; two or more a point.
        landmarks: known places, m; without them the points stay in the solver's frame.
        clicks: where the landmarks are seen, px.
        clicked: which of these there are; two or more a landmark.
        sigmas: standard deviation of each landmark's coordinates, m, as given to `align_to_landmarks`.

    Raises:
        UsageError: the calibration does not say which parameters were free (it was read from a file, or made by hand),
            or has targets, known points or shared lenses.
        InsufficientDataError: fewer than three landmarks, or a landmark or point with fewer than two pixels.
    """
    if calibration.freedom is None:
        raise UsageError(
            "This calibration does not say which of its parameters were free; calibrate again from its tracks."
        )
    if calibration.tracks.targets or calibration.tracks.prior is not None or calibration.freedom.owner is not None:
        raise UsageError(
            "A calibration with targets, known points or shared lenses has no derivatives by its observations yet; "
            "calibrate from the light alone for these."
        )
    count = calibration.tracks.cameras
    if landmarks is None:
        landmarks, clicks, clicked = np.zeros((0, 3)), np.zeros((0, count, 2)), np.zeros((0, count), bool)
    elif clicks is None or clicked is None:
        raise UsageError(f"The clicks on the {len(landmarks)} landmarks are missing; give clicks and clicked too.")
    elif len(landmarks) < LANDMARKS:
        raise InsufficientDataError(f"{len(landmarks)} landmarks do not hold a frame; measure {LANDMARKS} or more.")
    for what, seen in (("Landmark", clicked), ("Point", visible)):
        few = np.flatnonzero(np.asarray(seen).sum(axis=1) < 2)
        if len(few):
            views = int(np.asarray(seen)[few[0]].sum())
            raise InsufficientDataError(f"{what} {few[0]} is seen by {views} cameras; a point needs two or more.")
    weights = np.ones(len(landmarks)) if sigmas is None else (np.min(sigmas) / np.asarray(sigmas)) ** 2
    with jax.enable_x64(True):
        return _chain(calibration, weights, clicked, visible), _measurements(
            calibration, landmarks, np.where(np.asarray(clicked)[..., None], clicks, 0.0), pixels, visible
        )


def _chain(calibration: Calibration, weights, clicked, visible) -> Chain:
    rig, freedom = calibration.rig, calibration.freedom
    assert freedom is not None
    points = jnp.asarray(calibration.points, float)
    scale = LEAST_SQUARES if calibration.loss_scale is None else calibration.loss_scale
    return Chain(
        Unknowns(jnp.asarray(adjusted_cameras(rig)), _in_blocks(points, min(BLOCK, len(points)))),
        jnp.asarray(rig.cameras.cam_from_world.rotation),
        jnp.asarray(freedom.free),
        jnp.asarray(scale, float),
        jnp.asarray(weights),
        jnp.asarray(clicked),
        jnp.asarray(visible),
        tuple((int(width), int(height)) for width, height in np.asarray(rig.image_sizes)),
        rig.names,
        type(rig.cameras.lens),
    )


def _measurements(calibration: Calibration, landmarks, clicks, pixels, visible) -> Measured:
    assert calibration.freedom is not None
    freedom = calibration.freedom.at_noise(calibration.sigma_px)
    believed = calibration.kept & calibration.point_valid[:, None]
    parts = (
        np.where(believed[..., None], calibration.tracks.pixels, 0.0),
        believed,
        freedom.prior_mean,
        np.where(freedom.free, freedom.prior_weight, 0.0),
        landmarks,
        clicks,
        np.where(np.asarray(visible)[..., None], pixels, 0.0),
    )
    return Measured(*(jnp.asarray(part, float) for part in parts))


def _in_blocks(values: Shaped[Array, "F ..."], block: int) -> Shaped[Array, "NB ... B"]:
    """With zeros at the end, so that all blocks are full."""
    padded = jnp.pad(values, ((0, -len(values) % block), *[(0, 0)] * (values.ndim - 1)))
    return jnp.moveaxis(padded.reshape(-1, block, *values.shape[1:]), 1, -1)
