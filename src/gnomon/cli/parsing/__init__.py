"""Words of the command line -> a command: ordinary lines directly, help and mistakes by tyro."""
