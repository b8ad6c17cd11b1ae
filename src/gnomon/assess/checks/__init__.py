"""The data doctor: what is good and bad about a recording before anything is estimated from it."""
