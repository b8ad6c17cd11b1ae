"""diagnostics.npz holds every field of the diagnostics, in plain arrays, always in the same bytes."""

from dataclasses import replace

import numpy as np

from camera_imu_result import make_camera_imu_result
from gnomon.results.result import save_diagnostics


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


def test_samples_and_corners_are_kept_in_single_precision(tmp_path):
    diagnostics = make_camera_imu_result().diagnostics
    save_diagnostics(diagnostics, tmp_path / "d.npz")
    corners, signal, track = diagnostics.corners["cam0"], diagnostics.signals["imu0.gyroscope"], diagnostics.trajectory
    with np.load(tmp_path / "d.npz", allow_pickle=False) as arrays:
        for path, expected, most in (
            ("corners.cam0.pixels", corners.pixels, 1e-4),
            ("corners.cam0.residual", corners.residual, 1e-5),
            ("signals.imu0.gyroscope.predicted", signal.predicted, 1e-6),
            ("trajectory.p_target_imu", track.p_target_imu, 1e-6),
            ("trajectory.q_target_imu_wxyz", track.q_target_imu_wxyz, 1e-7),
        ):
            assert arrays[path].dtype == np.float32
            np.testing.assert_allclose(arrays[path], expected, rtol=0, atol=most)
        for path, expected in (
            ("signals.imu0.gyroscope.t_s", signal.t_s),
            ("trajectory.t_ns", track.t_ns),
            ("corners.cam0.frame_t_s", corners.frame_t_s),
            ("correlation", diagnostics.correlation),
        ):
            np.testing.assert_array_equal(arrays[path], expected)
        assert not any(array.dtype == np.float32 for name, array in arrays.items() if not name.startswith(
            ("corners.", "signals.", "trajectory.")))  # fmt: skip
