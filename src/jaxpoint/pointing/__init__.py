"""From an arm in several views to its line in the room."""
