"""The whole study of Tedaldi: 30 recordings of each of 40 parameter sets.

`pytest tests/e2e/test_study_tedaldi.py -m slow` takes some twenty minutes of one core;
tests/unit/study/test_study_tedaldi.py is small.
"""

import os

import pytest

from gnomon.study.runs import Workers
from gnomon.study.tedaldi import GROUPS, group_errors, study_tedaldi, tedaldi_claims
from gnomon.study.tedaldi_trial import METHODS


@pytest.mark.slow
def test_the_study_of_document_a():
    study = study_tedaldi(runs=30, workers=Workers(jobs=os.cpu_count() or 1), progress=print)
    for method in METHODS:
        print(method, dict(zip(GROUPS, 1e3 * group_errors(study, method), strict=True)))
    assert all(claim.holds for claim in tedaldi_claims(study)), [
        claim for claim in tedaldi_claims(study) if not claim.holds
    ]
    for (name, (_, theirs)), ours in zip(GROUPS.items(), group_errors(study, "gnomon"), strict=True):
        assert ours <= (0.6 if name.startswith("gyroscope") else 1.0) * theirs, name
