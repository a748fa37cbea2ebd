from .alignment import (
    Alignment as Alignment,
    align_to_camera_centres as align_to_camera_centres,
    align_to_floor as align_to_floor,
    align_to_landmarks as align_to_landmarks,
    apply_alignment as apply_alignment,
    umeyama as umeyama,
)
from .board_calibration import calibrate_boards as calibrate_boards
from .board_quality import assess_boards as assess_boards
from .chain import Chain as Chain, Measured as Measured, chain_of as chain_of
from .covariance import with_board_covariance as with_board_covariance
from .difference import Difference as Difference
from .expected import ExpectedError as ExpectedError, expected_error as expected_error
from .extension import extend_calibration as extend_calibration
from .factors import Factors as Factors, adjust_projective as adjust_projective, factorise as factorise
from .implicit import optimum as optimum
from .known_length import scale_by_length as scale_by_length
from .parallel import device_mesh as device_mesh, local_blocks as local_blocks, solve_on as solve_on, spread as spread
from .propagation import (
    Estimate as Estimate,
    joint_uncertainty as joint_uncertainty,
    length_uncertainty as length_uncertainty,
    line_uncertainty as line_uncertainty,
    pixel_uncertainty as pixel_uncertainty,
    point_uncertainty as point_uncertainty,
)
from .quality import Quality as Quality, assess as assess
from .result import (
    Calibration as Calibration,
    Finding as Finding,
    PairTable as PairTable,
    FrameHold as FrameHold,
    ReadoutTimes as ReadoutTimes,
    Stage as Stage,
    TimeOffsets as TimeOffsets,
    Verdict as Verdict,
)
from .schur import (
    AbstractModel as AbstractModel,
    Problem as Problem,
    SchurLevenbergMarquardt as SchurLevenbergMarquardt,
    Unknowns as Unknowns,
)
from .selfcal import calibrate as calibrate
from .still_cameras import still_cameras as still_cameras
from .stratification import Upgraded as Upgraded, Views as Views, candidates as candidates, upgrade as upgrade
from .sturm_triggs import depth_ratios as depth_ratios, fill_rank_four as fill_rank_four
from .uncertainty import Uncertainty as Uncertainty, uncertainty_of as uncertainty_of
from .track_points import TrackPoints as TrackPoints, points_of_tracks as points_of_tracks
