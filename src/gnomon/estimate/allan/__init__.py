"""Allan deviation -> noise of a sensor (Tedaldi 2014, section 3.4)."""
