from .angles import azimuth_elevation as azimuth_elevation
from .linalg import null_vector as null_vector
from .line import (
    Ray as Ray,
    angle_between as angle_between,
    closest_points as closest_points,
    distance_between as distance_between,
    distance_to_point as distance_to_point,
    nearest_on_line as nearest_on_line,
)
from .plane import Plane as Plane, Rect as Rect, fit_plane as fit_plane
from .pose import Pose as Pose, Similarity as Similarity
from .rotation import nearest_rotation as nearest_rotation
from .world_axes import WORLDS as WORLDS, World as World, world_of as world_of
