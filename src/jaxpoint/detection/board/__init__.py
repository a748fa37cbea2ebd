"""Calibration boards in images: one kind of board a file."""
