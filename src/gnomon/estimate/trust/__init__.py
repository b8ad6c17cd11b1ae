"""How far sigmas hold: clusters of errors, parts of a recording, and which model it asks for."""
