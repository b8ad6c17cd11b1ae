"""The steps of the recipes in which rooms meet."""
