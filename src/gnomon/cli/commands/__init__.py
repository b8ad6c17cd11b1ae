"""The commands: one file each, or a few that belong together; each only parses, calls and prints."""
