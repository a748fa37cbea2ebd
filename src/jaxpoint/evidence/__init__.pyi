from .camera_evidence import (
    AbstractCameraEvidence as AbstractCameraEvidence,
    FrameReason as FrameReason,
    HeadReason as HeadReason,
)
from .person_evidence import (
    JOINTS as JOINTS,
    AbstractPersonEvidence as AbstractPersonEvidence,
    SeenJoints as SeenJoints,
)
from .limb_slices import LimbEdges as LimbEdges, LimbEnd as LimbEnd, Pixel as Pixel
from .body_landmarks import BodyLandmarks as BodyLandmarks, LandmarkViews as LandmarkViews
from .body_landmarks import landmark_views as landmark_views
