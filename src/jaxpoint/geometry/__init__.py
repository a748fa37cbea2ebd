"""Three-dimensional geometry that knows no camera."""
