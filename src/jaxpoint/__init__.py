"""Calibrate a room of cameras from a waved light, and say what a person points at."""
