"""What was found of people, as tables, with a reason wherever something was not found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxpoint.body.arm import ArmReason, ArmView, PointingArm
from jaxpoint.body.following import Following
from jaxpoint.evidence.camera_evidence import AbstractCameraEvidence, FrameReason, HeadReason
from jaxpoint.io.session import Session

Columns = dict[str, list]

DETECTION_COLUMNS = (
    "frame", "time_s", "camera", "person", "reason", "edges", "box_x", "box_y", "box_width", "box_height",
    "silhouette_px", "head_x", "head_y", "head_height_px", "head_score", "head_reason", "arm_reason", "tip_x", "tip_y",
    "base_x", "base_y", "arm_rms_px", "arm_to_sight_deg",
)  # fmt: skip
ARM_COLUMNS = (
    "frame", "time_s", "person", "reason", "views", "tip_x_m", "tip_y_m", "tip_z_m", "tip_spread_m", "near_x_m",
    "near_y_m", "near_z_m", "far_x_m", "far_y_m", "far_z_m", "direction_x", "direction_y", "direction_z", "sigma_deg",
    "rms", "stretch_m",
)  # fmt: skip


def detections_table(session: Session, views: Sequence[AbstractCameraEvidence], following: Following | None) -> Columns:
    """Every frame of every camera: a line for each person seen, or one with the reason why there is none.

    `person` is the id of the head track, empty where a sighting belongs to none.
    """
    lines: list[dict[str, Any]] = []
    owners = _owners(views, following)
    edges = [view.moving_edges for view in views]
    for frame, (frame_id, time) in enumerate(zip(session.frame_ids.tolist(), session.times.tolist())):
        for camera, (name, view) in enumerate(zip(session.names, views)):
            start = {"frame": frame_id, "time_s": time, "camera": name, "edges": int(edges[camera][frame])}
            reason = FrameReason(int(view.reasons[frame]))
            sightings = view.of(frame)
            if not sightings:
                lines.append({**start, "reason": reason.name.lower()})
            for sighting in sightings:
                person = owners[camera].get(sighting)
                why = _why(reason, bool(view.colourless[frame]))
                line = {**start, "reason": why, **_sighting_columns(view, sighting)}
                if following is not None and person is not None:
                    line["person"] = int(following.tracking.heads.people[person])
                    line.update(_arm_columns(following.arms.get((frame, person)), camera))
                lines.append(line)
    return _columns(lines, DETECTION_COLUMNS)


def arms_table(session: Session, following: Following) -> Columns:
    """Every frame of every person: the arm in the room, or why there is none."""
    lines = []
    heads = following.tracking.heads
    for (frame, person), arm in sorted(following.arms.items()):
        line: dict[str, Any] = {
            "frame": int(session.frame_ids[frame]),
            "time_s": float(session.times[frame]),
            "person": int(heads.people[person]),
            "reason": "found" if arm is not None else "no_two_views_agree",
            "views": 0,
        }
        if arm is not None:
            line.update(_room_columns(arm))
        lines.append(line)
    return _columns(lines, ARM_COLUMNS)


def _room_columns(arm: PointingArm) -> dict[str, Any]:
    parts = (("tip", arm.tip, "_m"), ("near", arm.axis.near, "_m"), ("far", arm.axis.far, "_m"))
    places = {f"{name}_{axis}{unit}": float(p[i]) for name, p, unit in parts for i, axis in enumerate("xyz")}
    directions = {f"direction_{axis}": float(arm.direction[i]) for i, axis in enumerate("xyz")}
    sigma = np.degrees(np.sqrt(np.trace(np.asarray(arm.axis.direction_covariance))))
    return {
        **places,
        **directions,
        "views": arm.views_used,
        "tip_spread_m": arm.tip_spread,
        "sigma_deg": float(sigma),
        "rms": float(arm.axis.rms),
        "stretch_m": arm.stretch,
    }


def _sighting_columns(view: AbstractCameraEvidence, sighting: int) -> dict[str, Any]:
    x, y, width, height = (int(n) for n in view.box[sighting])
    seen: dict[str, Any] = {
        "box_x": x, "box_y": y, "box_width": width, "box_height": height,
        "silhouette_px": int(view.silhouette_px[sighting]),
        "head_score": float(view.head_certainty[sighting]),
        "head_reason": HeadReason(int(view.head_reason[sighting])).name.lower(),
    }  # fmt: skip
    if view.head_reason[sighting] == HeadReason.FOUND:
        seen.update(head_x=float(view.head[sighting, 0]), head_y=float(view.head[sighting, 1]))
        seen["head_height_px"] = float(view.head_height[sighting])
    return seen


def _arm_columns(arm: PointingArm | None, camera: int) -> dict[str, Any]:
    if arm is None:
        return {"arm_reason": ArmReason.NO_ARM.name.lower()}
    own: ArmView = arm.views[camera]
    line: dict[str, Any] = {"arm_reason": own.reason.name.lower(), "arm_to_sight_deg": float(np.degrees(own.angle))}
    if own.reason == ArmReason.FOUND:
        line.update(tip_x=float(own.tip[0]), tip_y=float(own.tip[1]), arm_rms_px=own.rms_px)
        line.update(base_x=float(own.base[0]), base_y=float(own.base[1]))
    return line


def _why(reason: FrameReason, grey: bool) -> str:
    return "person_without_colour" if grey else reason.name.lower()


def _owners(views: Sequence[AbstractCameraEvidence], following: Following | None) -> list[dict[int, int]]:
    """Whose each sighting is, by camera."""
    owners: list[dict[int, int]] = [{} for _ in views]
    if following is not None:
        for frame, person, camera in np.argwhere(following.sightings >= 0):
            owners[camera].setdefault(int(following.sightings[frame, person, camera]), int(person))
    return owners


def _columns(lines: Sequence[dict[str, Any]], names: Sequence[str]) -> Columns:
    return {name: [line.get(name) for line in lines] for name in names}
