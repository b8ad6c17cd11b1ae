"""The program `gnomon`, also `python -m gnomon`."""

import sys

if __name__ == "__main__" and not sys.flags.safe_path:
    del sys.path[0]  # python -m puts the working directory there, and with it whatever modules a recording comes with

from .cli import run_program as main

if __name__ == "__main__":
    main()
