from .brown import Brown as Brown
from .camera import Camera as Camera
from .kannala_brandt import KannalaBrandt as KannalaBrandt
from .lens import AbstractLens as AbstractLens, Coefficient as Coefficient
from .lenses import LENSES as LENSES, register_lens as register_lens
from .pinhole import Pinhole as Pinhole
from .rational import Rational as Rational
from .rectification import Rectification as Rectification, rectify as rectify
from .remap import undistortion_map as undistortion_map
from .resection import (
    Resection as Resection,
    decompose_projection as decompose_projection,
    projection_from_points as projection_from_points,
    resect as resect,
    resection as resection,
)
from .rig import CameraRig as CameraRig
