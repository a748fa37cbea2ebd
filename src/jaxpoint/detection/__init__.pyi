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
