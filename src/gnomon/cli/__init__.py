"""The command line; `gnomon.cli.main` runs a command as the program does."""

from .terminal import main, run_program

__all__ = ["main", "run_program"]
