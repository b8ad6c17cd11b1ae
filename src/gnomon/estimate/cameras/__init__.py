"""Lenses, poses of cameras to each other and the shape of the board, from views of the board alone."""
