"""Exchange formats of calibrations: one file a format, registered by name in `registry`."""
