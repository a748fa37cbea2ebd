"""glTF 2.0 of a rig, for Blender, Unity and viewers: written only.

One node a camera with glTF's perspective camera (which has no lens and no principal point: those are lost), and the
lines of what its image sees out to `DEPTH` of the rig's extent. glTF's world has y up; ours, z up, is turned by the
root node. glTF's cameras look along -z with y up; lengths are metres.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds
from jaxpoint.io.formats.fields import centre_of, pose_of, quaternion_of
from jaxpoint.io.rig_entries import CameraEntry, SavedCalibration

TITLE = "glTF scene"
DEPTH = 0.1  # length of the drawn pyramids, as a share of the extent of the cameras
OPENGL = np.diag([1.0, -1.0, -1.0])  # between x right, y up, z back and x right, y down, z forward
Z_UP = [-0.7071067811865476, 0.0, 0.0, 0.7071067811865476]  # x, y, z, w: z up becomes y up
EDGES = [0, 1, 0, 2, 0, 3, 0, 4, 1, 2, 2, 3, 3, 4, 4, 1]  # apex 0, corners 1 to 4
FLOAT, UNSIGNED_SHORT, LINES = 5126, 5123, 1
ARRAY_BUFFER, INDEX_BUFFER = 34962, 34963


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    cameras = saved.entries()
    centres = np.array([centre_of(camera) for camera in cameras])
    depth = DEPTH * (float(np.ptp(centres, axis=0).max()) or 10.0)
    pyramids = [_pyramid(camera, depth) for camera in cameras]
    count = len(cameras)
    nodes: list[dict[str, Any]] = [_node(i, camera) for i, camera in enumerate(cameras)]
    root = {"name": "rig", "rotation": Z_UP, "children": list(range(count))}
    content = {
        "asset": {"version": "2.0", "generator": "jaxpoint"},
        "scene": 0,
        "scenes": [{"nodes": [count]}],
        "nodes": [*nodes, root],
        "cameras": [_camera(camera, depth) for camera in cameras],
        **_meshes(cameras, pyramids),
    }
    return {"rig.gltf": json.dumps(content, indent=1).encode()}


def _node(i: int, camera: CameraEntry) -> dict[str, Any]:
    w, *axis = quaternion_of(pose_of(camera)[0].T @ OPENGL)
    return {
        "name": camera.name,
        "translation": centre_of(camera).tolist(),
        "rotation": [*axis, w],
        "camera": i,
        "mesh": i,
    }


def _camera(camera: CameraEntry, depth: float) -> dict[str, Any]:
    (width, height), k = camera.size, np.array(camera.K)
    lens = {"yfov": 2 * float(np.arctan(height / 2 / k[1, 1])), "znear": depth / 1000}
    lens["aspectRatio"] = width / height * k[1, 1] / k[0, 0]
    return {"name": camera.name, "type": "perspective", "perspective": lens}


def _pyramid(camera: CameraEntry, depth: float) -> np.ndarray:
    """Apex and the image's corners at that depth, in glTF's camera axes; without the lens's distortion."""
    (width, height), k = camera.size, np.array(camera.K)
    edges = np.array([[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]])
    corners = np.hstack([(edges - k[:2, 2]) / k[[0, 1], [0, 1]], np.ones((4, 1))]) * depth
    return np.vstack([np.zeros(3), corners @ OPENGL]).astype(np.float32)


def _meshes(cameras: list[CameraEntry], pyramids: list[np.ndarray]) -> dict[str, Any]:
    """Buffers, accessors and one mesh of lines a camera; all share their edges."""
    places = np.concatenate(pyramids).astype("<f4").tobytes()
    edges = np.array(EDGES, "<u2").tobytes()
    data = base64.b64encode(places + edges).decode()
    views = [
        {"buffer": 0, "byteOffset": 0, "byteLength": len(places), "target": ARRAY_BUFFER},
        {"buffer": 0, "byteOffset": len(places), "byteLength": len(edges), "target": INDEX_BUFFER},
    ]
    accessors: list[dict[str, Any]] = [
        {
            "bufferView": 0,
            "byteOffset": i * pyramid.nbytes,
            "componentType": FLOAT,
            "count": len(pyramid),
            "type": "VEC3",
            "min": pyramid.min(axis=0).tolist(),
            "max": pyramid.max(axis=0).tolist(),
        }
        for i, pyramid in enumerate(pyramids)
    ]
    accessors.append({"bufferView": 1, "componentType": UNSIGNED_SHORT, "count": len(EDGES), "type": "SCALAR"})
    meshes = [
        {"name": camera.name, "primitives": [{"attributes": {"POSITION": i}, "indices": len(cameras), "mode": LINES}]}
        for i, camera in enumerate(cameras)
    ]
    uri = f"data:application/octet-stream;base64,{data}"
    buffers = [{"byteLength": len(places) + len(edges), "uri": uri}]
    return {"meshes": meshes, "accessors": accessors, "bufferViews": views, "buffers": buffers}


def _lost(saved: SavedCalibration) -> list[str]:
    return [f"{TITLE} has no place for lenses, principal points and image sizes: its cameras are only near to these."]


FORMAT = CalibrationFormat(
    name="gltf",
    title=TITLE,
    patterns=("*.gltf",),
    recognise=lambda path, head: False,
    holds=Holds(lenses="none (said)", unit="m", poses="world from camera, OpenGL axes", pixels="none"),
    write=_write,
    more_losses=_lost,
)
