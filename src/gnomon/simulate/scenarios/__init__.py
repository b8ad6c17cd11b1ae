"""What can be simulated: the options of each simulation, as values."""
