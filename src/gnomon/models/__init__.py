"""Parameters -> prediction, and exact conversions between the models of the field."""
