"""Points in 3-D through time, out to files, one format a file."""
