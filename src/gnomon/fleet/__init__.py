"""Many devices: the library of their calibrations, and what it tells of a line, a station and a serial number."""
