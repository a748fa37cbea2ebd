"""Heads seen by several cameras become tracks of people in space."""
