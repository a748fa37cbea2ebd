"""Simulated people: who they are, how they move, how they point, and what they do when."""
