"""Where exactly an edge, or a corner of two of them, is in an image."""
