"""Images of cameras: folders, videos and datasets, with their timestamps."""
