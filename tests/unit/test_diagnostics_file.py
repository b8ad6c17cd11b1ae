"""diagnostics.npz holds every field of the diagnostics, in plain arrays, always in the same bytes."""

from dataclasses import replace

import numpy as np

from gnomon.writers.diagnostics_file import save_diagnostics


def test_every_field_is_there_and_reads_back(make_result, tmp_path):
    diagnostics = make_result().diagnostics
    save_diagnostics(diagnostics, tmp_path / "d.npz")
    with np.load(tmp_path / "d.npz", allow_pickle=False) as arrays:
        np.testing.assert_array_equal(arrays["intervals.direction"], diagnostics.intervals.direction)
        np.testing.assert_array_equal(arrays["gyroscope.high"], diagnostics.gyroscope.high)
        assert arrays["intervals.used"].dtype == bool
        assert tuple(arrays["intervals.reason"]) == diagnostics.intervals.reason
        assert arrays["detector.multiplier"] == diagnostics.detector.multiplier
        assert arrays["allan.t_init_s"] == diagnostics.allan.t_init_s
        assert list(arrays["trials.model"]) == ["basic", "g-sensitivity"]
        assert arrays["noise.gyroscope.density"] == diagnostics.noise["gyroscope.density"]
        roots = {name.split(".")[0] for name in arrays}
    assert roots == set(type(diagnostics).__slots__)


def test_what_a_result_does_not_have_has_no_key(make_result, tmp_path):
    diagnostics = replace(make_result(gyroscope=False).diagnostics, trials=())
    save_diagnostics(diagnostics, tmp_path / "d.npz")
    with np.load(tmp_path / "d.npz", allow_pickle=False) as arrays:
        assert not any(name.startswith(("gyroscope.", "allan.", "trials.")) for name in arrays)


def test_the_same_diagnostics_give_the_same_bytes(make_result, tmp_path):
    for name in ("a.npz", "b.npz"):
        save_diagnostics(make_result().diagnostics, tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
