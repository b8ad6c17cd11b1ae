"""The sensor models of OpenVINS and Basalt as exact views of gnomon's own.

Definitions as stated in those projects' code; the frame and the methods are as in `models.forms`.
"""

from typing import ClassVar, Self

import numpy as np

from ..frozen import value_class
from ..geometry.so3 import invert_matrix
from .forms import AccelerometerForm, GyroscopeForm, TriadForm, in_frame, in_own_axes
from .frames import Floats


@value_class
class OpenVinsTriad(TriadForm):
    """OpenVINS: s = T R x + b; it corrects with the lower triangle of D = T^-1 ("kalibr"), or the upper one ("rpng").

    Attributes
    ----------
    T : (3, 3) [unit per SI], Tw or Ta in OpenVINS' files
    R : (3, 3), rotation from the body frame to the axes of T: R_IMUtoGYRO or R_IMUtoACC
    b : (3,) [unit]; OpenVINS estimates it
    """

    frame: ClassVar[str] = "accel-x"
    T: Floats
    R: Floats
    b: Floats

    @classmethod
    def _split(cls, sensitivity: Floats, bias: Floats) -> dict[str, Floats]:
        return {"T": sensitivity, "R": np.eye(3), "b": bias}

    def _joined(self) -> tuple[Floats, Floats]:
        return self.T @ self.R, self.b

    def _measured(self, truth: Floats) -> Floats:
        return truth @ self.R.T @ self.T.T + self.b


@value_class
class OpenVinsAccelerometer(OpenVinsTriad, AccelerometerForm):
    """OpenVINS: m = Ta R_IMUtoACC f + b; with the model "kalibr", Ta is lower triangular and R_IMUtoACC the identity.

    Attributes
    ----------
    T : (3, 3) [unit per m/s^2], Ta
    R : (3, 3), R_IMUtoACC
    b : (3,) [unit]
    """


@value_class
class OpenVinsGyroscope(OpenVinsTriad, GyroscopeForm):
    """OpenVINS: y = Tw R_IMUtoGYRO w + Tg f + b; with the model "kalibr", Tw is lower triangular.

    Tg acts on the specific force in the body frame: it is Kalibr's A C_gyro_i, not A.

    Attributes
    ----------
    T : (3, 3) [unit per rad/s], Tw
    R : (3, 3), R_IMUtoGYRO
    b : (3,) [unit]
    Tg : (3, 3) [unit per m/s^2]
    """

    Tg: Floats

    @classmethod
    def from_sensor(cls, sensitivity: Floats, bias: Floats, g_sensitivity: Floats) -> Self:
        lower, C = in_own_axes(sensitivity, cls.frame)
        return cls(T=lower, R=C, b=bias, Tg=g_sensitivity)

    def to_sensor(self) -> tuple[Floats, Floats, Floats]:
        return *self._joined(), self.Tg

    def predict(self, rate: Floats, force: Floats) -> Floats:
        return self._measured(rate) + force @ self.Tg.T


@value_class
class BasaltTriad:
    """Basalt, either triad: x = (I + S) s - b. It has no g-sensitivity.

    Attributes
    ----------
    S : (3, 3); lower triangular for the accelerometer. Measurements are in SI units, so that it is small
    b : (3,) [SI], subtracted from the corrected measurement
    """

    frame: ClassVar[str] = "accel-x"
    S: Floats
    b: Floats

    @classmethod
    def from_sensor(cls, sensitivity: Floats, bias: Floats) -> Self:
        """Convert from a sensitivity (3, 3) [SI per SI] and a bias (3,) [SI]."""
        correction = invert_matrix(sensitivity)
        return cls(S=correction - np.eye(3), b=correction @ bias)

    @classmethod
    def of_accelerometer(cls, sensitivity: Floats, bias: Floats) -> Self:
        """Convert an accelerometer, whose S has exact zeros.

        Raises
        ------
        OptionError
            If the sensitivity is not in body frame accel-x.
        """
        form = cls.from_sensor(in_frame(sensitivity, cls.frame), bias)
        return cls(S=np.tril(form.S), b=form.b)

    def to_sensor(self) -> tuple[Floats, Floats]:
        """Return the sensitivity (3, 3) and the bias (3,)."""
        sensitivity = invert_matrix(np.eye(3) + self.S)
        return sensitivity, sensitivity @ self.b

    def predict(self, truth: Floats) -> Floats:
        """Return measurements (n, 3) [SI] of specific force [m/s^2] or angular rate [rad/s], (n, 3)."""
        return (truth + self.b) @ invert_matrix(np.eye(3) + self.S).T
