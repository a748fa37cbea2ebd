from .led import DetectionInterrupted as DetectionInterrupted, LedDetection as LedDetection, detect_led as detect_led
