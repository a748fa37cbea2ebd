from .bias_files import read_bias as read_bias, write_bias as write_bias
from .landmark_files import read_poses as read_poses
from .calibration import write_calibration_json as write_calibration_json
from .exchange import (
    read_calibration as read_calibration,
    read_lenses as read_lenses,
    write_calibration as write_calibration,
)
from .board_sources import BoardSources as BoardSources, open_board_sources as open_board_sources
from .formats.anipose_toml import write_calibration_toml as write_calibration_toml
from .formats.calibration_format import (
    CalibrationFormat as CalibrationFormat,
    Holds as Holds,
    Request as Request,
    SourceFile as SourceFile,
)
from .formats.caliscope_toml import read_camera_array as read_camera_array
from .formats.fields import (
    camera_entry as camera_entry,
    opencv_coefficients as opencv_coefficients,
    read_image_size as read_image_size,
    read_numbers as read_numbers,
)
from .formats.format_registry import FORMATS as FORMATS, register_format as register_format
from .rig_entries import SavedCalibration as SavedCalibration
from .head_files import read_heads as read_heads, save_heads as save_heads
from .survey_files import (
    read_camera_centres as read_camera_centres,
    read_landmark_pixels as read_landmark_pixels,
    read_landmarks as read_landmarks,
    read_lengths as read_lengths,
)
from .object_files import Database as Database, read_objects as read_objects
from .ply import write_ply as write_ply
from .pointing_files import read_pointings as read_pointings, write_pointings as write_pointings
from .formats.qualisys_xml import read_qualisys as read_qualisys
from .result_files import load_result as load_result, save_result as save_result
from .session import Session as Session, open_session as open_session
from .timestamps import Timestamps as Timestamps, read_timestamps as read_timestamps, synchronise as synchronise
from .track_files import load_tracks as load_tracks, read_tracks as read_tracks, save_tracks as save_tracks
from .video import open_frames as open_frames
from .track_formats.track_format import TrackFormat as TrackFormat, TrackRequest as TrackRequest
from .track_formats.track_registry import TRACK_FORMATS as TRACK_FORMATS, register_tracks as register_tracks
from .track_formats.keypoint_cameras import CameraKeypoints as CameraKeypoints, keypoint_format as keypoint_format
from .point_formats.point_series import PointSeries as PointSeries, series_of as series_of
from .point_formats.point_files import write_points as write_points
