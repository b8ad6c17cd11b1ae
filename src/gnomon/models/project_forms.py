"""The sensor models of other projects as views of gnomon's own; the frame and the methods are as in `models.forms`.

Definitions as stated in those projects' code and compared in docs/theory. Those of imu_tk, imucal, OpenVINS and Basalt
are exact. PX4 and ArduPilot have an offset and a scale for each axis, or an offset alone: they cannot hold
misalignment; the diagonal is chosen so that the error that remains is least.
"""

from typing import ClassVar, Self

import numpy as np

from ..frozen import value_class
from ..geometry.rotations import Floats, invert_matrix
from .forms import AccelerometerForm, GyroscopeForm, TriadForm, in_frame, in_own_axes, unit_diagonal


@value_class
class DiagonalTriad:
    """PX4 and ArduPilot, the accelerometer: x = scale (s - offset), element by element.

    Attributes
    ----------
    scale : (3,) [SI per SI]
    offset : (3,) [SI], subtracted from the measurement before it is scaled
    """

    scale: Floats
    offset: Floats

    @classmethod
    def nearest(cls, sensitivity: Floats, bias: Floats) -> Self:
        """Return the triad whose error, rms over all directions of the true vector, is least.

        With s = S x + b and offset = b the error is (diag(scale) S - I) x. Row by row its squared norm is least at
        scale_i = S_ii / |S_i|^2, S_i the i-th row.

        Parameters
        ----------
        sensitivity : (3, 3) [SI per SI]
        bias : (3,) [SI]
        """
        return cls(scale=np.diag(sensitivity) / np.square(sensitivity).sum(axis=1), offset=bias)

    @classmethod
    def offset_alone(cls, bias: Floats) -> Self:
        """Return the triad of a gyroscope, for which these projects know no scale."""
        return cls(scale=np.ones(3), offset=bias)

    def to_sensor(self) -> tuple[Floats, Floats]:
        """Return the sensitivity (3, 3) and the bias (3,)."""
        return np.diag(1 / self.scale), self.offset

    def rest(self, sensitivity: Floats) -> Floats:
        """Return what is left uncorrected of a sensor of this sensitivity, (3, 3): result = (I + rest) x."""
        return self.scale[:, None] * sensitivity - np.eye(3)

    def predict(self, truth: Floats) -> Floats:
        """Return measurements (n, 3) [SI] of specific force [m/s^2] or angular rate [rad/s], (n, 3)."""
        return truth / self.scale + self.offset


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


@value_class
class ImuTkTriad:
    """imu_tk, either triad: y = T K (x - B). It has no g-sensitivity.

    Attributes
    ----------
    T : (3, 3), unit diagonal; upper triangular for the accelerometer
    K : (3,) [SI per unit], the diagonal
    B : (3,) [unit], subtracted from the measurement
    """

    frame: ClassVar[str] = "accel-z"
    T: Floats
    K: Floats
    B: Floats

    @classmethod
    def from_sensor(cls, sensitivity: Floats, bias: Floats) -> Self:
        """Convert from a sensitivity (3, 3) [unit per SI] and a bias (3,) [unit].

        Raises
        ------
        OptionError
            If an axis of the sensor does not respond to the body axis of the same name at all.
        """
        T, K = unit_diagonal(invert_matrix(sensitivity), "imu_tk's")
        return cls(T=T, K=K, B=bias)

    def to_sensor(self) -> tuple[Floats, Floats]:
        """Return the sensitivity (3, 3) and the bias (3,)."""
        return invert_matrix(self.T * self.K), self.B

    def predict(self, truth: Floats) -> Floats:
        """Return measurements (n, 3) [unit] of specific force [m/s^2] or angular rate [rad/s], (n, 3)."""
        return (truth @ invert_matrix(self.T).T) / self.K + self.B


@value_class
class ImucalTriad(TriadForm):
    """imucal (Ferraris): s = K R x + b with the rows of R of unit length; any body frame.

    Attributes
    ----------
    K : (3,) [unit per SI], the diagonal
    R : (3, 3), sensitivity axes as unit rows
    b : (3,) [unit]
    """

    frame: ClassVar[None] = None
    K: Floats
    R: Floats
    b: Floats

    @classmethod
    def _split(cls, sensitivity: Floats, bias: Floats) -> dict[str, Floats]:
        K = np.sqrt(np.square(sensitivity).sum(axis=1))
        return {"K": K, "R": sensitivity / K[:, None], "b": bias}

    def _joined(self) -> tuple[Floats, Floats]:
        return self.K[:, None] * self.R, self.b

    def _measured(self, truth: Floats) -> Floats:
        return (truth @ self.R.T) * self.K + self.b


@value_class
class ImucalAccelerometer(ImucalTriad, AccelerometerForm):
    """imucal (Ferraris): m = K R f + b with the rows of R of unit length; any body frame.

    Attributes
    ----------
    K : (3,) [unit per m/s^2], the diagonal
    R : (3, 3), sensitivity axes as unit rows
    b : (3,) [unit]
    """


@value_class
class ImucalGyroscope(ImucalTriad, GyroscopeForm):
    """imucal (Ferraris): y = K R w + K_ga f + b with the rows of R of unit length; any body frame.

    Attributes
    ----------
    K : (3,) [unit per rad/s], the diagonal
    R : (3, 3), sensitivity axes as unit rows
    K_ga : (3, 3) [unit per m/s^2], g-sensitivity
    b : (3,) [unit]
    """

    K_ga: Floats

    @classmethod
    def from_sensor(cls, sensitivity: Floats, bias: Floats, g_sensitivity: Floats) -> Self:
        return cls(**cls._split(sensitivity, bias), K_ga=g_sensitivity)

    def to_sensor(self) -> tuple[Floats, Floats, Floats]:
        return *self._joined(), self.K_ga

    def predict(self, rate: Floats, force: Floats) -> Floats:
        return self._measured(rate) + force @ self.K_ga.T
