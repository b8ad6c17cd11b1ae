"""Published experiments: many simulated recordings through one estimator, and what became of them."""
