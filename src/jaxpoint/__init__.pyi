# Observations
from .tracks import PointPrior as PointPrior, Tracks as Tracks, join_tracks as join_tracks
from .targets import Target as Target
from .io.track_files import read_tracks as read_tracks
from .detection.light.led import detect_led as detect_led
from .detection.board.board_search import detect_board as detect_board
from .detection.board.board_spec import read_board as read_board
from .io.board_sources import open_board_sources as open_board_sources
from .config import LedSettings as LedSettings

# Calibration
from .calibration.selfcal import calibrate as calibrate
from .calibration.board_calibration import calibrate_boards as calibrate_boards
from .config import CalibrateSettings as CalibrateSettings
from .calibration.result import (
    Calibration as Calibration,
    Finding as Finding,
    PairTable as PairTable,
    Verdict as Verdict,
)
from .calibration.quality import assess as assess
from .calibration.factors import Factors as Factors, factorise as factorise
from .io.exchange import read_calibration as read_calibration, write_calibration as write_calibration
from .runs import read_run as read_run
from .report.html import write_report as write_report

# Cameras and points
from .camera.camera import Camera as Camera
from .camera.rig import CameraRig as CameraRig
from .camera.brown import Brown as Brown
from .camera.kannala_brandt import KannalaBrandt as KannalaBrandt
from .camera.lens import AbstractLens as AbstractLens
from .camera.lenses import register_lens as register_lens
from .camera.resection import resect as resect
from .geometry.pose import Pose as Pose, Similarity as Similarity
from .geometry.line import Ray as Ray
from .triangulation import Flag as Flag, Triangulation as Triangulation, triangulate as triangulate

# The room
from .calibration.alignment import (
    Alignment as Alignment,
    align_to_camera_centres as align_to_camera_centres,
    align_to_floor as align_to_floor,
    align_to_landmarks as align_to_landmarks,
    apply_alignment as apply_alignment,
)

# Uncertainty and derivatives
from .calibration.uncertainty import Uncertainty as Uncertainty, uncertainty_of as uncertainty_of
from .calibration.propagation import point_uncertainty as point_uncertainty
from .calibration.chain import Chain as Chain, chain_of as chain_of
from .compilation import jit_once as jit_once

# Pointing
from .pointing.pointing_line import PointingLine as PointingLine
from .pointing.objects import Objects as Objects
from .io.object_files import read_objects as read_objects
from .pointing.hits import Hits as Hits, intersect as intersect
from .pointing.nearest import Nearest as Nearest, nearest as nearest
from .pointing.posterior import Behaviour as Behaviour, Posterior as Posterior, posterior as posterior
from .pointing.word_evidence import words_evidence as words_evidence

# How people miss
from .pointing.bias.bias import Bias as Bias
from .pointing.bias.fit import fit_bias as fit_bias, fit_personal_bias as fit_personal_bias
from .pointing.bias.learn import learn_bias as learn_bias
from .pointing.bias.pointings import Pointings as Pointings
from .io.bias_files import read_bias as read_bias
from .io.pointing_files import read_pointings as read_pointings

# Errors
from .errors import (
    ContradictionError as ContradictionError,
    FileFormatError as FileFormatError,
    InsufficientDataError as InsufficientDataError,
    JaxpointError as JaxpointError,
    MissingDependencyError as MissingDependencyError,
    NotConvergedError as NotConvergedError,
    QualityError as QualityError,
    UsageError as UsageError,
)
