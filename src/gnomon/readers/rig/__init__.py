"""A recording of cameras and IMUs as samples and corners, and the files that describe its sensors."""
