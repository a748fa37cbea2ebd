from .board.abstract_board import AbstractBoard as AbstractBoard, BoardCorners as BoardCorners
from .board.board_search import BoardDetection as BoardDetection, detect_board as detect_board
from .board.board_spec import read_board as read_board
from .disparity import disparity_of as disparity_of
from .light.led import (
    DetectionInterrupted as DetectionInterrupted,
    LedDetection as LedDetection,
    detect_led as detect_led,
)
from .person.detectors import (
    PeopleRequest as PeopleRequest,
    detect_people as detect_people,
    register_detector as register_detector,
    unregister_detector as unregister_detector,
)
