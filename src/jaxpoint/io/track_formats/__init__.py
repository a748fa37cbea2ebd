"""Tracks in files, one format a file."""
