"""Allan deviation -> noise of a sensor (document A, section 3.4)."""
