"""What a recording may tell of its own calibration, all of it."""

import numpy as np

from gnomon.results.trust import (
    BlockAgreement,
    BlockChange,
    Clusters,
    ModelStep,
    Need,
    SigmaRatio,
    Splits,
    Trust,
    WeakDirection,
)

NEED = Need(block="rotation of cam0", sigma=0.31, needed=0.1, unit="deg", verdict="fail", cure="Turn about x.")
_STEP = ModelStep(
    name="lever arms",
    parameters=6,
    gain=412.3,
    gain_sigma=31.0,
    needed=88.0,
    used=True,
    changes=(BlockChange(block="imu0.M_a", change=5.1e-3, unit="rad", sigmas=7.2),),
)


def example_trust() -> Trust:
    blocks = (
        BlockAgreement(
            block="cam0.T_cam_imu.translation",
            comparisons=12,
            z_rms=1.21,
            z_rms_ordinary=6.8,
            largest=2.4,
            where="[2], halves",
        ),
        BlockAgreement(
            block="imu0.gyroscope.sensitivity",
            comparisons=36,
            z_rms=0.97,
            z_rms_ordinary=5.1,
            largest=2.2,
            where="[0,1], thirds",
        ),
    )
    return Trust(
        clusters=Clusters(count=24, length_s=2.0, memory_s=0.7),
        names=("imu0.accelerometer.bias[0]",),
        ordinary_sigma=np.array([1e-3]),
        sigma=np.array([4e-3]),
        ratios=(SigmaRatio(block="imu0.accelerometer.bias", ratio=4.0), SigmaRatio(block="imu0.gyroscope", ratio=1.1)),
        splits=Splits(splits=("halves", "thirds"), blocks=blocks, z_rms=1.04, z_rms_ordinary=5.5, limit=1.38),
        models=(_STEP, ModelStep(name="board", parameters=425, gain=1.2, gain_sigma=3.0, needed=9.0, used=False)),
        weak=(
            WeakDirection(
                shares=(("cam0.T_cam_imu.translation[2]", 0.98),),
                determined=0.2,
                words="The translation of cam0 along its optical axis is hardly determined.",
                cure="Shake the rig towards the board and back.",
                held=True,
            ),
        ),
    )
