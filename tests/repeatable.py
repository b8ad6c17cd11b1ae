"""Where the same input gives the same bytes."""

import numpy as np
import pytest
from numpy.lib import NumpyVersion

to_the_last_digit = pytest.mark.skipif(
    NumpyVersion(np.__version__) < "2.1.0", reason="NumPy before 2.1 rounds by where arrays lie in memory"
)
