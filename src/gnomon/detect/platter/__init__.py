"""Video of a turning platter -> its rate (Angrisano)."""
