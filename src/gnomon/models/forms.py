"""The sensor models of Tedaldi, Krebs, Angrisano and Kalibr as exact views of gnomon's own.

gnomon's model, with specific force f [m/s^2] and angular rate w [rad/s] in the body frame, and measurements s in the
unit of the sensor, is

    s_acc = S_a f + b_a          s_gyro = S_g w + b_g + G f

A form holds the same sensor in the letters of a document. `from_sensor` and `to_sensor` convert, `predict` evaluates
the document's own equation, so that a test can show that the samples are the same. Each form belongs to a body frame
(`frame`): a document that makes the accelerometer's matrix triangular fixes the frame by doing so. Bring the sensor
into that frame first (`frame_rotation`). Sign conventions differ: Tedaldi adds the bias, Angrisano subtracts it. The
form of Kalibr is as stated in its code and compared in docs/theory.

How a document writes one triad, its matrix and its bias, is the same for accelerometer and gyroscope and stands once:
`CorrectedTriad`, `KrebsTriad`, `KalibrTriad`. A gyroscope's form adds where its axes lie, and the g-sensitivity.

Of some matrices a few entries are unknowns (Krebs, section 4.3 and Fig. 4.1). A `MatrixPattern` names those of a 3 x 3
matrix X. The product X v depends on each of them through one component of v: for the unknown X_ij the derivative of X v
is e_i v_j. (The Jacobians that the document prints, page 16 and 17, have the wrong component and the wrong order of
factors.)
"""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Literal, Self

import numpy as np

from ..errors import OptionError
from ..frozen import value_class
from ..geometry.rotations import Floats, fixed_entries, frame_rotation, invert_matrix

KrebsReading = Literal["chapter 3", "chapter 4"]
"""Krebs states the g-sensitivity twice: in the gyroscope's frame (chapter 3) and in the body frame (chapter 4)."""


class TriadForm(ABC):
    """One triad in the letters of a document: s = response to x, with x in axes in which the document's matrix lives.

    Attributes
    ----------
    frame : str, the body frame in which the sensor has to be stated; None where any will do
    """

    __slots__ = ()
    frame: ClassVar[Any]

    @classmethod
    @abstractmethod
    def _split(cls, sensitivity: Floats, bias: Floats) -> dict[str, Floats]:
        """Return the document's letters for a sensitivity (3, 3) in the form's own axes, and a bias (3,)."""

    @abstractmethod
    def _joined(self) -> tuple[Floats, Floats]:
        """Return the sensitivity (3, 3) in the form's own axes, and the bias (3,)."""

    @abstractmethod
    def _measured(self, truth: Floats) -> Floats:
        """Return the document's equation for specific force or angular rate (n, 3) in the form's own axes."""


class AccelerometerForm(TriadForm):
    """An accelerometer: its own axes are those of the body frame."""

    __slots__ = ()

    @classmethod
    def from_sensor(cls, sensitivity: Floats, bias: Floats) -> Self:
        """Convert from S_a (3, 3) [unit per m/s^2] in the form's frame and b_a (3,) [unit].

        Raises
        ------
        OptionError
            If the sensitivity is not in the form's frame, or the form cannot hold such a sensor.
        """
        return cls(**cls._split(sensitivity if cls.frame is None else in_frame(sensitivity, cls.frame), bias))

    def to_sensor(self) -> tuple[Floats, Floats]:
        """Return S_a (3, 3) and b_a (3,)."""
        return self._joined()

    def predict(self, force: Floats) -> Floats:
        """Return measurements (n, 3) [unit] of specific force (n, 3) [m/s^2]."""
        return self._measured(force)


class GyroscopeForm(TriadForm):
    """A gyroscope: its own axes may be turned against the body frame, and it feels specific force."""

    __slots__ = ()

    @classmethod
    @abstractmethod
    def from_sensor(cls, sensitivity: Floats, bias: Floats, g_sensitivity: Floats) -> Self:
        """Convert from S_g (3, 3) [unit per rad/s], b_g (3,) [unit] and G (3, 3) [unit per m/s^2].

        Raises
        ------
        OptionError
            If the form cannot hold such a sensor.
        """

    @abstractmethod
    def to_sensor(self) -> tuple[Floats, Floats, Floats]:
        """Return S_g (3, 3), b_g (3,) and G (3, 3)."""

    @abstractmethod
    def predict(self, rate: Floats, force: Floats) -> Floats:
        """Return measurements (n, 3) [unit] of angular rate [rad/s] and specific force [m/s^2], (n, 3) both."""


@value_class
class CorrectedTriad(TriadForm):
    """Tedaldi and Angrisano write the correction of a measurement: x = T K (s - b), or x = T K (s + b) in Tedaldi.

    Attributes
    ----------
    T : (3, 3), unit diagonal
    K : (3,) [SI per unit], the diagonal
    b : (3,) [unit]
    whose : the form's owner, for messages
    bias_sign : +1 if the document subtracts b from the measurement, -1 if it adds it
    """

    whose: ClassVar[str]
    bias_sign: ClassVar[int]
    T: Floats
    K: Floats
    b: Floats

    @classmethod
    def _split(cls, sensitivity: Floats, bias: Floats) -> dict[str, Floats]:
        T, K = unit_diagonal(invert_matrix(sensitivity), cls.whose)
        return {"T": T, "K": K, "b": cls.bias_sign * bias}

    def _joined(self) -> tuple[Floats, Floats]:
        return invert_matrix(self.T * self.K), self.bias_sign * self.b

    def _measured(self, truth: Floats) -> Floats:
        return (truth @ invert_matrix(self.T).T) / self.K + self.bias_sign * self.b


@value_class
class TedaldiAccelerometer(CorrectedTriad, AccelerometerForm):
    """Tedaldi, Eqs. (2.6), (3.3): a_O = T K (a_S + b), with T = [1 -yz zy; 0 1 -zx; 0 0 1].

    Attributes
    ----------
    T : (3, 3), unit upper triangular
    K : (3,) [m/s^2 per unit], the diagonal
    b : (3,) [unit], added to the measurement
    """

    frame: ClassVar[str] = "accel-z"
    whose: ClassVar[str] = "Tedaldi's"
    bias_sign: ClassVar[int] = -1


@value_class
class TedaldiGyroscope(CorrectedTriad, GyroscopeForm):
    """Tedaldi, Eqs. (2.7), (3.5): w_O = T K (w_S + b), with T = [1 -yz zy; xz 1 -zx; -xy yx 1].

    Joined with Krebs's g-sensitivity: w_O = T K (w_S + b - B f_O); Tedaldi has B = 0.

    Attributes
    ----------
    T : (3, 3), unit diagonal
    K : (3,) [rad/s per unit], the diagonal
    b : (3,) [unit], added to the measurement
    B : (3, 3) [unit per m/s^2], g-sensitivity on the calibrated specific force
    """

    frame: ClassVar[str] = "accel-z"
    whose: ClassVar[str] = "Tedaldi's"
    bias_sign: ClassVar[int] = -1
    B: Floats

    @classmethod
    def from_sensor(cls, sensitivity: Floats, bias: Floats, g_sensitivity: Floats) -> Self:
        return cls(**cls._split(sensitivity, bias), B=g_sensitivity)

    def to_sensor(self) -> tuple[Floats, Floats, Floats]:
        return *self._joined(), self.B

    def predict(self, rate: Floats, force: Floats) -> Floats:
        return self._measured(rate) + force @ self.B.T


@value_class
class AngrisanoAccelerometer(CorrectedTriad, AccelerometerForm):
    """Angrisano, Eqs. (1), (2): s = T K (s_out - b), with T = [1 az ay; 0 1 ax; 0 0 1].

    Attributes
    ----------
    T : (3, 3), unit upper triangular
    K : (3,) [m/s^2 per unit], the diagonal
    b : (3,) [unit], subtracted from the measurement
    """

    frame: ClassVar[str] = "accel-z"
    whose: ClassVar[str] = "Angrisano's"
    bias_sign: ClassVar[int] = 1


@value_class
class AngrisanoGyroscope(CorrectedTriad, GyroscopeForm):
    """Angrisano, Eqs. (1), (2), for the gyroscope, in an orthogonal frame G of its own: w_G = T K (y - b).

    Norms of rates cannot tell how G lies to the body; C_gb, which Angrisano leaves open, completes the model, as does
    Krebs's g-sensitivity: T K (y - b - B f) = C_gb w.

    Attributes
    ----------
    T : (3, 3), unit upper triangular
    K : (3,) [rad/s per unit], the diagonal
    b : (3,) [unit], subtracted from the measurement
    B : (3, 3) [unit per m/s^2], g-sensitivity, on the body's specific force
    C_gb : (3, 3), rotation from the body frame to G
    """

    frame: ClassVar[str] = "accel-z"
    whose: ClassVar[str] = "Angrisano's"
    bias_sign: ClassVar[int] = 1
    B: Floats
    C_gb: Floats

    @classmethod
    def from_sensor(cls, sensitivity: Floats, bias: Floats, g_sensitivity: Floats) -> Self:
        upper, C_gb = in_own_axes(sensitivity, cls.frame)
        return cls(**cls._split(upper, bias), B=g_sensitivity, C_gb=C_gb)

    def to_sensor(self) -> tuple[Floats, Floats, Floats]:
        sensitivity, bias = self._joined()
        return sensitivity @ self.C_gb, bias, self.B

    def predict(self, rate: Floats, force: Floats) -> Floats:
        return self._measured(rate @ self.C_gb.T) + force @ self.B.T


@value_class
class KrebsTriad(TriadForm):
    """Krebs writes the measurement: s = S M x + b, with M unit lower triangular.

    Attributes
    ----------
    S : (3,) [unit per SI], the diagonal
    M : (3, 3), unit lower triangular
    b : (3,) [unit]
    """

    frame: ClassVar[str] = "accel-x"
    S: Floats
    M: Floats
    b: Floats

    @classmethod
    def _split(cls, sensitivity: Floats, bias: Floats) -> dict[str, Floats]:
        S = np.diag(sensitivity).copy()
        return {"S": S, "M": sensitivity / S[:, None], "b": bias}

    def _joined(self) -> tuple[Floats, Floats]:
        return self.S[:, None] * self.M, self.b

    def _measured(self, truth: Floats) -> Floats:
        return (truth @ self.M.T) * self.S + self.b


@value_class
class KrebsAccelerometer(KrebsTriad, AccelerometerForm):
    """Krebs, chapter 3: a~ = S M f + b, with M unit lower triangular, [1 0 0; yz 1 0; zy zx 1].

    Against the angles of Tedaldi: M_yz = -alpha_yz, M_zy = +alpha_zy, M_zx = -alpha_zx.

    Attributes
    ----------
    S : (3,) [unit per m/s^2], the diagonal
    M : (3, 3), unit lower triangular
    b : (3,) [unit]
    """


@value_class
class KrebsGyroscope(KrebsTriad, GyroscopeForm):
    """Krebs: w~ = S M C_bg' w + B C_bg' f + b (chapter 3), or with B f in place of B C_bg' f (chapter 4).

    Attributes
    ----------
    S : (3,) [unit per rad/s], the diagonal
    M : (3, 3), unit lower triangular
    C_bg : (3, 3), rotation from the gyroscope's frame to the body frame
    B : (3, 3) [unit per m/s^2], g-sensitivity
    b : (3,) [unit]
    reading : "chapter 3" or "chapter 4"
    """

    C_bg: Floats
    B: Floats
    reading: KrebsReading = "chapter 3"

    @classmethod
    def from_sensor(
        cls, sensitivity: Floats, bias: Floats, g_sensitivity: Floats, reading: KrebsReading = "chapter 3"
    ) -> Self:
        lower, C_gb = in_own_axes(sensitivity, cls.frame)
        B = g_sensitivity @ C_gb.T if reading == "chapter 3" else g_sensitivity
        return cls(**cls._split(lower, bias), C_bg=C_gb.T, B=B, reading=reading)

    def to_sensor(self) -> tuple[Floats, Floats, Floats]:
        sensitivity, bias = self._joined()
        G = self.B @ self.C_bg.T if self.reading == "chapter 3" else self.B
        return sensitivity @ self.C_bg.T, bias, G

    def predict(self, rate: Floats, force: Floats) -> Floats:
        acting = force @ self.C_bg if self.reading == "chapter 3" else force
        return self._measured(rate @ self.C_bg) + acting @ self.B.T


@value_class
class KalibrTriad(TriadForm):
    """Kalibr, "scale-misalignment": s = M x + b with M lower triangular and its diagonal free.

    Attributes
    ----------
    M : (3, 3) [unit per SI], lower triangular
    b : (3,) [unit]; Kalibr lets it vary with time
    """

    frame: ClassVar[str] = "accel-x"
    M: Floats
    b: Floats

    @classmethod
    def _split(cls, sensitivity: Floats, bias: Floats) -> dict[str, Floats]:
        return {"M": sensitivity, "b": bias}

    def _joined(self) -> tuple[Floats, Floats]:
        return self.M, self.b

    def _measured(self, truth: Floats) -> Floats:
        return truth @ self.M.T + self.b


@value_class
class KalibrAccelerometer(KalibrTriad, AccelerometerForm):
    """Kalibr, "scale-misalignment": m = M f + b with M lower triangular and its diagonal free.

    Attributes
    ----------
    M : (3, 3) [unit per m/s^2], lower triangular
    b : (3,) [unit]; Kalibr lets it vary with time
    """


@value_class
class KalibrGyroscope(KalibrTriad, GyroscopeForm):
    """Kalibr, "scale-misalignment": y = M C w + A C f + b with M lower triangular and C = C_gyro_i.

    Attributes
    ----------
    M : (3, 3) [unit per rad/s], lower triangular
    C_gyro_i : (3, 3), rotation from the body frame to the gyroscope's
    A : (3, 3) [unit per m/s^2], g-sensitivity, on the specific force in the gyroscope's frame
    b : (3,) [unit]; Kalibr lets it vary with time
    """

    C_gyro_i: Floats
    A: Floats

    @classmethod
    def from_sensor(cls, sensitivity: Floats, bias: Floats, g_sensitivity: Floats) -> Self:
        lower, C = in_own_axes(sensitivity, cls.frame)
        return cls(**cls._split(lower, bias), C_gyro_i=C, A=g_sensitivity @ C.T)

    def to_sensor(self) -> tuple[Floats, Floats, Floats]:
        sensitivity, bias = self._joined()
        return sensitivity @ self.C_gyro_i, bias, self.A @ self.C_gyro_i

    def predict(self, rate: Floats, force: Floats) -> Floats:
        return self._measured(rate @ self.C_gyro_i.T) + force @ self.C_gyro_i.T @ self.A.T


@value_class(eq=True)
class MatrixPattern:
    """The unknown entries (row, column) of a 3 x 3 matrix, in the order of its parameters; the others are of I."""

    entries: tuple[tuple[int, int], ...]

    def matrix(self, parameters: Floats) -> Floats:
        """Return the matrix (3, 3) with these parameters."""
        matrix = np.zeros((3, 3)) if len(self.entries) == 9 else np.eye(3)
        for entry, value in zip(self.entries, parameters, strict=True):
            matrix[entry] = value
        return matrix

    def parameters(self, matrix: Floats) -> Floats:
        """Return the parameters of a matrix (3, 3) of this pattern."""
        return np.array([matrix[entry] for entry in self.entries])

    def product_jacobian(self, v: Floats) -> Floats:
        """Return the derivative of X v by the parameters, (n, 3, number of parameters), of vectors (n, 3)."""
        jacobian = np.zeros((len(v), 3, len(self.entries)))
        for k, (i, j) in enumerate(self.entries):
            jacobian[:, i, k] = v[:, j]
        return jacobian


DIAGONAL = MatrixPattern(entries=((0, 0), (1, 1), (2, 2)))
"""Scale factors S (section 3.2.3)."""


LOWER = MatrixPattern(entries=((1, 0), (2, 0), (2, 1)))
"""Misalignment M (section 3.2.1): M_yz, M_zy, M_zx below a diagonal of ones."""


FULL = MatrixPattern(entries=tuple((i, j) for i in range(3) for j in range(3)))
"""Influence B_g of the specific force on the gyroscope (section 3.2.4), row by row."""


def in_frame(sensitivity: Floats, frame: str) -> Floats:
    """Return the accelerometer's sensitivity (3, 3) with the entries that `frame` makes zero exactly zero.

    Raises
    ------
    OptionError
        If it is not in that frame.
    """
    entries = tuple(np.transpose(fixed_entries(frame)))
    if np.abs(sensitivity[entries]).max() > 1e-9 * np.abs(sensitivity).max():
        raise OptionError(
            f"this model lives in body frame {frame}, where three entries of the accelerometer's sensitivity are zero; "
            f"found {sensitivity[entries].tolist()}. Bring the calibration into that frame first: in_frame({frame!r})."
        )
    exact = sensitivity.copy()
    exact[entries] = 0.0
    return exact


def in_own_axes(sensitivity: Floats, frame: str) -> tuple[Floats, Floats]:
    """Return a gyroscope's sensitivity (3, 3) in axes of its own, triangular as `frame` asks, and C (3, 3) into them.

    Raises
    ------
    OptionError
        If the frame is neither "accel-x" nor "accel-z".
    """
    C = frame_rotation(sensitivity, frame)
    own = sensitivity @ C.T
    own[tuple(np.transpose(fixed_entries(frame)))] = 0.0
    return own, C


def unit_diagonal(correction: Floats, whose: str) -> tuple[Floats, Floats]:
    """Split a correction matrix (3, 3) into T with a unit diagonal and the diagonal K (3,), correction = T diag(K).

    Raises
    ------
    OptionError
        If a diagonal entry vanishes, so that no such T exists.
    """
    K = np.diag(correction).copy()
    weak = np.abs(K) <= 1e-9 * np.abs(correction).max(axis=0)
    if weak.any():
        axis = "xyz"[int(np.argmax(weak))]
        raise OptionError(
            f"{whose} model needs every sensor axis to respond to the body axis of the same name; the {axis} axis does "
            "not, so that its scale factor is zero. Relabel the axes of the recording (--columns), or use another form."
        )
    return correction / K + 0.0, K  # no minus zeros
