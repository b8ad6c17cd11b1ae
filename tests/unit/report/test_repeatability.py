"""Tables B.4 to B.7 of Krebs: 18 calibrations of one real rig; their means and standard deviations come out."""

import numpy as np
import pytest

from gnomon.calibrate.comparison import compare
from gnomon.formats.foreign import ForeignCalibration
from gnomon.geometry.rotations import normalise_quaternion, rotation_from_quaternion
from gnomon.models.camera import Camera
from gnomon.report.comparison import comparison_page
from gnomon.report.page import render_page
from gnomon.results.calibration import AccelerometerCalibration, CameraCalibration, GyroscopeCalibration, ImuCalibration
from gnomon.writers.tables import comparison_csv
from html_page import Page

ROWS = """
-0.0814675 -0.0107283 -0.0221052 0.9999917 0.0036003 -0.0018889 -0.0000851 0.0011379 -0.0026489 0.0043349
0.0012658 0.0063978 0.0169799 1.0027612 0.9986304 1.0062298 1.0025823 0.9974070 1.0054031
-0.0796690 -0.0121275 -0.0227065 0.9999907 0.0035072 -0.0023752 0.0008416 -0.0022313 -0.0001358 0.0018826
0.0012050 0.0070666 0.0150924 1.0043414 0.9992792 1.0093589 1.0042454 0.9976496 1.0046972
-0.0817452 -0.0106617 -0.0233265 0.9999907 0.0039168 -0.0016294 0.0007829 -0.0016830 0.0006303 -0.0000705
0.0024825 0.0062270 0.0156844 1.0031097 0.9987360 1.0079992 1.0040931 0.9974098 1.0045415
-0.0841572 -0.0124307 -0.0232560 0.9999936 0.0035651 -0.0001582 0.0003244 -0.0011915 0.0033081 0.0009306
0.0007084 0.0027507 0.0157472 1.0018780 0.9992454 1.0094814 1.0044117 0.9976504 1.0047849
-0.0842336 -0.0113979 -0.0220847 0.9999910 0.0041508 0.0007445 0.0004832 -0.0018711 0.0063627 -0.0031930
0.0020242 0.0014798 0.0160220 1.0032742 1.0003065 1.0090443 1.0042010 0.9966733 1.0048935
-0.0824905 -0.0116150 -0.0233321 0.9999943 0.0031938 -0.0008774 0.0005902 -0.0016257 0.0007016 -0.0020333
0.0013074 0.0032202 0.0161520 1.0021418 1.0006684 1.0095405 1.0049157 0.9977059 1.0045361
-0.0834794 -0.0103483 -0.0232185 0.9999911 0.0041903 -0.0005241 0.0002260 -0.0000502 0.0022021 -0.0006508
0.0010151 0.0030258 0.0168013 1.0004808 1.0007987 1.0130320 1.0049358 0.9959325 1.0049690
-0.0831370 -0.0131885 -0.0223356 0.9999939 0.0033470 -0.0003061 0.0009255 -0.0018897 0.0020636 0.0003383
0.0020530 0.0032834 0.0148868 1.0012811 1.0002110 1.0117446 1.0041234 0.9963138 1.0047671
-0.0832175 -0.0106924 -0.0216024 0.9999917 0.0038492 -0.0012330 0.0005769 -0.0017184 0.0009591 0.0040355
0.0004394 0.0039338 0.0175789 1.0010886 1.0009130 1.0129002 1.0031473 0.9958562 1.0045545
-0.0851357 -0.0109839 -0.0208408 0.9999902 0.0043592 -0.0007157 0.0002007 -0.0001875 0.0014457 0.0015593
0.0001917 0.0031287 0.0174659 1.0021604 0.9995972 1.0116586 1.0025070 0.9959216 1.0047270
-0.0823265 -0.0119045 -0.0218685 0.9999936 0.0032703 -0.0013627 0.0005803 0.0000419 -0.0005931 0.0013508
0.0009553 0.0040070 0.0158705 1.0028810 1.0001337 1.0102772 1.0030916 0.9968580 1.0047188
-0.0838004 -0.0112025 -0.0216063 0.9999893 0.0045955 -0.0003251 0.0002783 -0.0006409 0.0023493 -0.0015320
0.0009998 0.0029195 0.0171606 1.0031269 1.0003004 1.0134755 1.0036973 0.9960863 1.0040788
-0.0832232 -0.0115068 -0.0227816 0.9999916 0.0040343 -0.0006696 0.0001075 -0.0003727 0.0001355 -0.0008174
0.0004546 0.0032902 0.0162917 1.0021462 0.9996706 1.0100027 1.0042043 0.9962371 1.0036410
-0.0826915 -0.0117618 -0.0222614 0.9999942 0.0032802 -0.0008635 0.0003831 -0.0019641 0.0006359 0.0030820
0.0008978 0.0028400 0.0162886 1.0008640 1.0003236 1.0115004 1.0031423 0.9972290 1.0051345
-0.0834032 -0.0124469 -0.0234505 0.9999950 0.0030235 -0.0006847 0.0006805 -0.0025815 -0.0004793 0.0003531
0.0010446 0.0023977 0.0148602 1.0012814 1.0004662 1.0115395 1.0045132 0.9979315 1.0052403
-0.0830507 -0.0132863 -0.0222781 0.9999947 0.0030550 -0.0006312 0.0009331 -0.0026264 -0.0000660 0.0042180
0.0014329 0.0029595 0.0152608 1.0009238 1.0002328 1.0092339 1.0034577 0.9968443 1.0053799
-0.0845442 -0.0109724 -0.0225447 0.9999926 0.0038453 -0.0001949 0.0001625 -0.0004065 0.0036200 0.0012821
0.0011487 0.0029724 0.0175789 1.0029187 1.0015154 1.0133440 1.0039494 0.9978997 1.0045469
-0.0840182 -0.0101441 -0.0218156 0.9999893 0.0046035 -0.0004515 -0.0002200 -0.0008757 0.0041765 0.0014230
0.0000221 0.0029615 0.0182283 1.0025101 1.0004577 1.0139522 1.0026965 0.9962358 1.0044969
"""
"""Datasets 05 to 22, two lines each: p_cb (table B.4); q_bg, w first (B.5); M_a and M_g, yz zy zx each (B.6); S_a and
S_g (B.7)."""

STATED = {
    "cam0.translation": ([-0.0830995, -0.0115222, -0.0224119], [0.0012752, 0.0009137, 0.0007291]),
    "imu0.accelerometer.misalignment": ([-0.0011520, 0.0013704, 0.0009163], [0.0010360, 0.0020968, 0.0021365]),
    "imu0.gyroscope.misalignment": ([0.0010916, 0.0036034, 0.0163306], [0.0006390, 0.0014719, 0.0010106]),
    "imu0.accelerometer.scale": ([1.0021761, 1.0000826, 1.0107953], [0.0010350, 0.0007576, 0.0021172]),
    "imu0.gyroscope.scale": ([1.0037730, 0.9968801, 1.0047284], [0.0007670, 0.0007429, 0.0004332]),
}
"""Rows "Mean" and "sigma_cal" of the tables."""

LENS = Camera(projection="pinhole", intrinsics=[460.0, 459.0, 376.0, 240.0], distortion="none", distortion_coeffs=[],
              resolution=(752, 480))  # fmt: skip


def triad(S, M):
    return np.diag(S) @ np.array([[1, 0, 0], [M[0], 1, 0], [M[1], M[2], 1]])


def dataset(numbers):
    p, q, M_a, M_g, S_a, S_g = np.split(numbers, [3, 7, 10, 13, 16])
    C_bg = rotation_from_quaternion(normalise_quaternion(q))
    T = np.eye(4)
    T[:3, 3] = p
    zero = np.zeros(3)
    imu = ImuCalibration(
        accelerometer=AccelerometerCalibration(sensitivity=triad(S_a, M_a), bias=zero, unit="m/s^2"),
        gyroscope=GyroscopeCalibration(
            sensitivity=triad(S_g, M_g) @ C_bg.T, bias=zero, g_sensitivity=np.zeros((3, 3)), unit="rad/s"
        ),
    )
    camera = CameraCalibration(T_cam_body=T, time_shift_cam_imu=0.0, camera=LENS)
    return ForeignCalibration(imus={"imu0": imu}, frame="accel-x", cameras={"cam0": camera}, format="document B")


@pytest.fixture(scope="module")
def found():
    numbers = np.array([float(word) for word in ROWS.split()]).reshape(18, 19)
    calibrations = [dataset(row) for row in numbers]
    return compare(*calibrations, names=[f"{number:02d}" for number in range(5, 23)])


@pytest.mark.parametrize("path", STATED)
def test_mean_and_standard_deviation(found, path):
    mean, scatter = STATED[path]
    block = found.block(path)
    assert len(block.names) == 18
    np.testing.assert_allclose(block.mean, mean, atol=6e-8)
    np.testing.assert_allclose(block.scatter, scatter, atol=6e-8)


def test_rotation_from_body_to_gyroscope(found):
    """Table B.5 states the scatter of the quaternion, whose vector is half the rotation vector."""
    block = found.block("imu0.gyroscope.rotation")
    np.testing.assert_allclose(block.scatter / 2, [0.0005055, 0.0007179, 0.0003362], atol=2e-6)
    angle = np.degrees(np.arccos((np.trace(block.reference) - 1) / 2))
    assert angle == pytest.approx(0.450318, abs=0.02)  # the mean of the angles is larger than the angle of the mean


def test_nobody_stands_out_and_nothing_is_claimed_without_sigmas(found):
    assert found.outside == ()
    assert found.verdict == "warn"
    assert np.isnan(found.z_rms)
    assert "nothing says what differences mean" in found.headline


def test_the_page_and_the_table(found):
    words = Page(render_page(comparison_page(found)).decode()).words
    assert {"−11.52", "0.914"} <= set(words)  # mean and scatter of the second scalar of table B.4 [mm]
    lines = comparison_csv(found).splitlines()
    assert lines[0] == "calibration,path,element,value,sigma,unit"
    assert "05,cam0.translation,x,-0.0814675,,m" in lines
