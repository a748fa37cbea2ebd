from .camera import Camera as Camera
from .distortion import AbstractDistortion as AbstractDistortion, Brown as Brown
from .remap import undistortion_map as undistortion_map
from .resection import (
    Resection as Resection,
    decompose_projection as decompose_projection,
    projection_from_points as projection_from_points,
    resect as resect,
    resection as resection,
)
from .rig import CameraRig as CameraRig
