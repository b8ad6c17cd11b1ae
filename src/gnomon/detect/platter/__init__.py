"""Video of a turning platter -> its rate (document C)."""
