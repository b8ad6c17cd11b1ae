"""What is estimated: by the model, and by names that are fixed, free or have a prior."""

import numpy as np
import pytest

from gnomon import CameraImuOptions, OptionError
from gnomon.estimate.camera_imu.choices import estimation_choices
from gnomon.estimate.camera_imu.layout import border_layout, parameter_blocks
from gnomon.estimate.camera_imu.parameters import CameraParameters, ImuParameters, RigParameters, gravity_axes
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.camera import Camera

LENSES = (
    ("cam0", "pinhole", [460.0, 458.0, 320.0, 240.0], "radtan", [-0.28, 0.07, 2e-4, 1e-4]),
    ("left", "omni", [0.9, 540.0, 536.0, 321.0, 239.0], "fov", [0.9]),
    ("cam7", "ds", [-0.2, 0.55, 290.0, 291.0, 319.0, 241.0], "none", []),
)


def start(imus=1):
    return RigParameters(
        gravity_axes=gravity_axes(np.array([0.0, -1.0, 0.1])),
        gravity_m_s2=9.81,
        target_scale=1.0,
        imus=(ImuParameters.ideal(),) * imus,
        cameras=tuple(
            CameraParameters(
                name=name,
                R_cam_imu=np.eye(3),
                p_cam_imu=np.zeros(3),
                time_shift_s=0.0,
                camera=Camera(
                    projection=projection, intrinsics=intrinsics, distortion=distortion, distortion_coeffs=coeffs,
                    resolution=(640, 480),
                ),
            )
            for name, projection, intrinsics, distortion, coeffs in LENSES
        ),
    )  # fmt: skip


def chosen(**options):
    return estimation_choices(start(), CameraImuOptions(**options))


def estimated(found):
    return {name for name, status in found.status.items() if status != "fixed"}


def scalars(*names):
    return {s for b in parameter_blocks(start()) for s in b.scalars() if b.name in names}


CAMERAS = [
    f"{name}.{block}"
    for name, *_ in LENSES
    for block in ("T_cam_imu.rotation", "T_cam_imu.translation", "time_shift_cam_imu")
]
SCALE = [f"imu0.{name}" for name in ("S_a", "M_a", "S_g", "M_g", "q_bg")]


def test_models_are_those_of_table_4_1():
    basic = scalars("gravity.direction", *CAMERAS)
    assert estimated(chosen(model="basic")) == basic
    assert estimated(chosen(model="scale-misalignment")) == basic | scalars(*SCALE)
    assert estimated(chosen(model="full")) == basic | scalars(*SCALE, "imu0.B_g")
    assert estimated(chosen()) == estimated(chosen(model="full")) | scalars("imu0.lever_arms")
    assert len(estimated(chosen())) == 2 + 3 * 7 + 24 + 6
    assert set(chosen().prior_sigma) == scalars("imu0.lever_arms")  # 10 mm for each accelerometer
    np.testing.assert_allclose(list(chosen().prior_sigma.values()), 0.01 * np.sqrt(2))


def test_every_scalar_has_a_status_and_its_name_is_unique():
    names = [scalar for block in parameter_blocks(start()) for scalar in block.scalars()]
    assert len(set(names)) == len(names)
    assert list(chosen().status) == names
    for expected in ("gravity.magnitude", "target.scale", "imu0.B_g[8]", "left.distortion_coeffs", "cam7.line_delay"):
        assert expected in names
    assert "cam7.distortion_coeffs" not in names  # of a lens without
    assert "cam7.intrinsics[5]" in names


@pytest.mark.parametrize(
    ("name", "members"),
    [
        ("imu0.B_g", [f"imu0.B_g[{k}]" for k in range(9)]),
        ("imu0.B_g[4]", ["imu0.B_g[4]"]),
        ("cam0.T_cam_imu", [f"cam0.T_cam_imu.{part}[{k}]" for part in ("rotation", "translation") for k in range(3)]),
        ("left.time_shift_cam_imu", ["left.time_shift_cam_imu"]),
        ("gravity", ["gravity.direction[0]", "gravity.direction[1]", "gravity.magnitude"]),
        ("imu0", [s for b in parameter_blocks(start()) if b.name.startswith("imu0.") for s in b.scalars()]),
    ],
)
def test_a_name_stands_for_itself_and_for_all_below_it(name, members):
    before = chosen()
    fixed = chosen(fix=(name,))
    assert estimated(fixed) == estimated(before) - set(members)
    freed = chosen(free=(name,), model="basic")
    assert estimated(freed) == estimated(chosen(model="basic")) | set(members)
    with_prior = chosen(prior=(f"{name}=0.25",), model="basic")
    assert with_prior.prior_sigma == dict.fromkeys(members, 0.25)
    assert {s for s, status in with_prior.status.items() if status == "prior"} == set(members)
    assert set(before.prior_sigma) == scalars("imu0.lever_arms")


def test_names_that_begin_alike_are_different():
    assert estimated(chosen(free=("imu0.S_a",), model="basic")).isdisjoint(scalars("imu0.S_g"))
    with pytest.raises(OptionError, match="no such parameter"):
        chosen(fix=("cam",))
    with pytest.raises(OptionError, match="no such parameter"):
        chosen(fix=("imu0.S_a[3]",))


@pytest.mark.parametrize("option", ["fix", "free", "prior"])
@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        ("imu0.Sa", "imu0.S_a"),
        ("imu.B_g", "imu0.B_g"),
        ("cam0.time_shift", "cam0.time_shift_cam_imu"),
        ("cam0.T_cam_imu.translaton", "cam0.T_cam_imu.translation"),
        ("lefft.intrinsics", "left.intrinsics"),
        ("target.scal", "target.scale"),
    ],
)
def test_unknown_names_get_a_suggestion_and_the_list(option, wrong, meant):
    text = f"{wrong}=1" if option == "prior" else wrong
    with pytest.raises(OptionError) as error:
        chosen(**{option: (text,)})
    message = str(error.value)
    assert message.startswith(f"--{option} {wrong}: there is no such parameter. Did you mean {meant}?")
    assert all(block.name in message for block in parameter_blocks(start()))


def test_a_name_like_nothing_gets_the_list_alone():
    with pytest.raises(OptionError, match=r"no such parameter\. Known: gravity\.direction, "):
        chosen(free=("xyzzy",))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fix": ("imu0.S_a",), "free": ("imu0.S_a",)}, r"--fix imu0.S_a: imu0.S_a\[0\] is also in --free. Keep one"),
        ({"free": ("target.scale",), "prior": ("target.scale=0.1",)}, "--prior target.scale.* is also in --free"),
        ({"fix": ("cam0",), "prior": ("cam0.intrinsics[1]=2",)}, r"cam0.intrinsics\[1\] is also in --fix"),
        ({"fix": ("imu0.B_g[2]",), "free": ("imu0",)}, r"imu0.B_g\[2\] is also in --free"),
    ],
)
def test_a_parameter_in_two_lists_is_refused(options, message):
    with pytest.raises(OptionError, match=message):
        chosen(**options)


def test_the_same_name_twice_in_one_list_is_harmless():
    assert chosen(fix=("imu0.B_g", "imu0.B_g[3]")) == chosen(fix=("imu0.B_g",))
    assert chosen(prior=("imu0.B_g=1e-3", "imu0.B_g[3]=1e-4")).prior_sigma["imu0.B_g[3]"] == 1e-4


@pytest.mark.parametrize(
    "text",
    ["cam0.intrinsics", "cam0.intrinsics=", "cam0.intrinsics=two", "cam0.intrinsics=0", "cam0.intrinsics=-1",
     "cam0.intrinsics=nan", "cam0.intrinsics=inf", "cam0.intrinsics 2", "=2"],
)  # fmt: skip
def test_priors_that_are_none_are_refused(text):
    with pytest.raises(OptionError, match="--prior") as error:
        chosen(prior=(text,))
    assert "NAME=SIGMA with SIGMA greater than zero" in str(error.value) or text == "=2"


def test_layout_has_columns_for_what_is_estimated_or_considered():
    found = chosen(free=("left.distortion_coeffs",), fix=("imu0.M_a[1]", "cam0.T_cam_imu"), prior=("imu0.B_g=1e-3",))
    columns = border_layout(start(), found.status, found.prior_sigma, consider=("target.scale",))
    assert set(np.array(columns.names)[columns.free]) == estimated(found)
    assert set(np.array(columns.names)[~columns.free]) == {"imu0.M_a[1]", "target.scale"}
    assert columns.get("cam0.T_cam_imu.rotation") is None
    assert [columns.names[i] for i in columns.free_index] == [n for n in found.status if n in estimated(found)]
    of = columns.get("imu0.B_g")
    np.testing.assert_array_equal(columns.prior_sigma[of], 1e-3)
    assert not columns.weak[of].any()
    assert columns.weak[columns.get("imu0.S_a")].all()
    assert columns.weak.sum() == len(columns) - 9 - 6
    assert np.isfinite(columns.prior_sigma).all()
    assert len(columns.units) == len(columns)


def test_without_columns_nothing_moves():
    status = dict.fromkeys(chosen().status, "fixed")
    columns = border_layout(start(), status, {})
    assert len(columns) == 0
    assert columns.free.dtype == columns.weak.dtype == bool
    parameters = start()
    assert columns.plus(parameters, np.empty(0)) is parameters


def test_steps_move_what_they_name_and_are_read_back():
    everything = dict.fromkeys(chosen().status, "estimated")
    columns = border_layout(start(imus=1), everything, {})
    step = 1e-3 * np.random.default_rng(0).normal(size=len(columns))
    step[columns.get("cam0.line_delay")] = 1e-5
    moved = columns.plus(start(), step)
    # rotations about a start: small angles add up, to second order
    np.testing.assert_allclose(columns.values(moved) - columns.values(start()), step, atol=1e-5)
    camera = moved.cameras[moved.camera_index("left")]
    of = columns.get("left.T_cam_imu.rotation")
    np.testing.assert_allclose(camera.R_cam_imu, rotation_from_rotvec(step[of]), atol=1e-15)
    assert camera.camera.distortion_coeffs[0] == 0.9 + step[columns.get("left.distortion_coeffs")][0]
    np.testing.assert_allclose(moved.gravity_axes.T @ moved.gravity_axes, np.eye(3), atol=1e-15)
    assert np.linalg.norm(moved.gravity) == pytest.approx(9.81 + step[columns.get("gravity.magnitude")][0])
    np.testing.assert_array_equal(moved.imus[0].B_g.ravel(), step[columns.get("imu0.B_g")])
    # one scalar at a time leaves all others as they are
    for k, name in enumerate(columns.names):
        alone = np.zeros(len(columns))
        alone[k] = step[k]
        change = columns.values(columns.plus(start(), alone)) - columns.values(start())
        assert change[k] == pytest.approx(step[k], rel=1e-5), name
        np.testing.assert_allclose(np.delete(change, k), 0.0, atol=1e-15)


def test_a_lens_may_not_leave_its_domain():
    everything = dict.fromkeys(chosen().status, "estimated")
    columns = border_layout(start(), everything, {})
    step = np.zeros(len(columns))
    step[columns.get("cam0.intrinsics").start] = -500.0
    with pytest.raises(OptionError, match="focal length"):
        columns.plus(start(), step)
