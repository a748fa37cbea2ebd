"""From images to pixels: detectors on OpenCV and numpy."""
