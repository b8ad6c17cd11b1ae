"""gnomon's own files."""
