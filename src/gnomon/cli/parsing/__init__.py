"""Words of the command line -> a command, and the help that says which there are."""
