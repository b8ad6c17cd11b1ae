"""The recipes, one page each: the only place where the rooms meet."""
