"""The whole study of Angrisano: 500 runs of each setting.

`pytest tests/e2e/test_study_angrisano.py -m slow` takes some minutes;
tests/unit/study/test_study_angrisano.py is small.
"""

import os

import numpy as np
import pytest

from gnomon.study.angrisano import angrisano_claims, study_angrisano
from gnomon.study.runs import Workers


@pytest.mark.slow
def test_the_study_of_document_c():
    study = study_angrisano(runs=500, workers=Workers(jobs=os.cpu_count() or 1), progress=print)
    for sample in study.samples:
        for method in ("paper", "ours"):
            np.testing.assert_allclose(sample.ratio(method), 1.0, atol=0.15)
        assert set(sample.iterations) <= {4, 5}
    assert all(claim.holds for claim in angrisano_claims(study)), [
        claim for claim in angrisano_claims(study) if not claim.holds
    ]
