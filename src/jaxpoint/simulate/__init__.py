"""Rooms and recordings whose truth is known."""
