"""A lens that a program does not know is fitted anew: how near it comes is right, and stands in the file."""

import re
from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.errors import OptionError
from gnomon.formats.conversion import export_texts
from gnomon.formats.foreign_files import load_foreign
from gnomon.formats.shared.lens_refit import with_known_lenses
from gnomon.models.camera import Camera, knows_lens
from gnomon.models.lens_names import PROGRAMS, models_of, refit_models
from gnomon.results.calibration import Covariance
from gnomon.results.sensors import covariance_names

EUCM = Camera(
    projection="eucm", intrinsics=[0.62, 1.08, 458.0, 456.5, 362.2, 246.1], distortion="none", distortion_coeffs=[],
    resolution=(752, 480), topic="/left",
)  # fmt: skip
FISHEYE = replace(EUCM, projection="ds", intrinsics=[-0.2, 0.59, 160.0, 160.2, 359.0, 241.5])
SIGMA = np.array([1e-4, 1e-4, 0.05, 0.05, 0.1, 0.1])


@pytest.fixture
def rig(camera_calibration):
    """A rig with one camera of a lens, whose covariance it has."""

    def make(lens, sigma=SIGMA):
        made = camera_calibration(0, cameras=1)
        cameras = {"cam0": replace(made.cameras["cam0"], camera=lens)}
        names = covariance_names(made.imus, cameras)
        old = {name: i for i, name in enumerate(made.uncertainty.names)}
        matrix = np.zeros((len(names), len(names)))
        shared = [(i, old[name]) for i, name in enumerate(names) if name in old and "intrinsics" not in name]
        here, there = np.array(shared).T
        matrix[np.ix_(here, here)] = made.uncertainty.matrix[np.ix_(there, there)]
        own = [i for i, name in enumerate(names) if name.startswith("cam0.intrinsics")]
        matrix[own, own] = sigma[: len(own)] ** 2
        return replace(made, cameras=cameras, uncertainty=Covariance(names=names, matrix=matrix))

    return make


@pytest.mark.parametrize("to", PROGRAMS)
def test_what_is_stated_is_how_far_the_lenses_are_apart(rig, to):
    calibration = rig(EUCM)
    found, losses = with_known_lenses(calibration, to)
    lens = found.cameras["cam0"].camera
    assert knows_lens(to, lens)
    if knows_lens(to, EUCM):
        assert losses == ()
        assert found is calibration
        return
    (loss,) = losses
    assert lens.model in refit_models(to)
    mean, worst, u, v = map(
        float, re.findall(r"([\d.e-]+) px off .* ([\d.e-]+) px at worst, at \((\d+), (\d+)\)", loss.size)[0]
    )
    grid = np.column_stack([axis.ravel() for axis in np.meshgrid(np.linspace(8, 743, 90), np.linspace(8, 471, 60))])
    rays, _ = EUCM.unproject(grid)
    apart = np.linalg.norm(lens.project(rays).pixels - grid, axis=1)
    assert mean == pytest.approx(apart.mean(), rel=0.25)
    assert worst == pytest.approx(apart.max(), rel=0.35)
    at = np.linalg.norm(grid - [u, v], axis=1) < 30
    assert apart[at].max() > 0.6 * apart.max()
    assert apart.max() < 0.2  # of a lens that is seen 60 deg wide


def test_the_covariance_follows(rig):
    """Drawn lenses, each fitted anew, scatter as the covariance says that was carried along."""
    calibration = rig(EUCM)
    found, _ = with_known_lenses(calibration, "okvis")
    lens = found.cameras["cam0"].camera
    block = [i for i, name in enumerate(found.uncertainty.names) if "intrinsics" in name or "distortion" in name]
    carried = found.uncertainty.matrix[np.ix_(block, block)]
    rays = EUCM.unproject(np.array([[100.0, 80], [376, 240], [700, 430]]))[0]
    J = np.vstack(list(lens.project(rays, parameters_jacobian=True).by_parameters))
    I = np.vstack(list(EUCM.project(rays, parameters_jacobian=True).by_parameters))  # noqa: E741
    assert np.sqrt(np.diag(J @ carried @ J.T)) == pytest.approx(np.sqrt(np.diag(I @ np.diag(SIGMA**2) @ I.T)), rel=0.1)
    other = [i for i, name in enumerate(found.uncertainty.names) if "T_cam_imu" in name]
    same = [calibration.uncertainty.names.index(found.uncertainty.names[i]) for i in other]
    ours, theirs = (c.uncertainty.matrix[np.ix_(i, i)] for c, i in ((found, other), (calibration, same)))
    assert np.array_equal(ours, theirs)


@pytest.mark.parametrize("to", [name for name in PROGRAMS if not knows_lens(name, EUCM)])
def test_every_program_gets_a_file_that_says_so(rig, to, tmp_path):
    calibration = rig(EUCM)
    losses = gnomon.convert(calibration, to, tmp_path)
    (loss,) = (loss for loss in losses if loss.what == "lens of cam0")
    texts = " ".join(
        " ".join(line.lstrip("# ") for line in path.read_text().splitlines()) for path in tmp_path.iterdir()
    )
    assert f"Lens of cam0: {loss.why} ({loss.size})" in texts
    if to not in ("ros2",):
        read = (
            load_foreign(*sorted(tmp_path.iterdir()))
            if to == "openvins"
            else load_foreign(
                next(
                    iter(
                        path
                        for path in sorted(tmp_path.iterdir())
                        if path.name in ("config.yaml", "orb_slam3.yaml", "okvis.yaml")
                    )
                )
            )
        )
        lens = {**read.lenses, **{name: camera.camera for name, camera in read.cameras.items()}}["cam0"]
        assert lens.model in models_of(to)


def test_the_fit_keeps_to_where_the_lens_is_known(rig):
    """A lens that is only known in its middle is fitted there: what it would do outside does not count."""
    wide = replace(EUCM, intrinsics=[0.62, 1.08, 250.0, 250.0, 362.2, 246.1])
    everywhere = with_known_lenses(rig(wide), "okvis")[0].cameras["cam0"].camera
    middle, losses = with_known_lenses(rig(wide, np.array([0.02, 0.05, 0.05, 0.05, 0.1, 0.1])), "okvis")
    assert "% of the image where it is known" in losses[0].why
    pixels = np.column_stack([a.ravel() for a in np.meshgrid(np.linspace(300, 420, 9), np.linspace(190, 300, 9))])
    rays, _ = wide.unproject(pixels)
    off = [
        np.linalg.norm(lens.project(rays).pixels - pixels, axis=1).max()
        for lens in (middle.cameras["cam0"].camera, everywhere)
    ]
    assert off[0] < off[1]


def test_a_lens_that_nothing_is_like_is_refused(rig):
    wider = replace(FISHEYE, intrinsics=[-0.2, 0.62, 95.0, 95.0, 376.0, 240.0])
    with pytest.raises(OptionError, match=r"cam0 is ds-none, and okvis knows .*gnomon camera --for okvis, or convert"):
        export_texts(rig(wider), "okvis")
