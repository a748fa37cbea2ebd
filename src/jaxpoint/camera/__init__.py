"""How a point of the room becomes a pixel."""
