"""The error terms of gyroscope and accelerometer (Krebs, section 4.1.2).

    e_g = S_g M_g C_bg' omega + B_g f + b_g - gyroscope,     e_a = S_a M_a f + b_a - accelerometer,

with the specific force f = R' (p'' - g), R = R_target_imu(t). Their derivatives: a change d of the rotation vector
turns the body by Jr d, so that df = [f]x Jr d - R' dg + R' dp''.

Where the three accelerometers do not sit at one point, e_a has the f that each of them feels at its place r_k,

    f_k + e_k' A r_k,   A = [alpha]x + [omega]x^2,   alpha = omega',

while the gyroscope's g-sensitivity acts on f at the IMU's origin. An IMU beside the first has omega, alpha and f in its
own axes, and its places are counted from the body's origin (`felt`). Its clock, t_body = t_imu + d, moves the readings
along the trajectory: de/dd is the derivative of e by time, that by the control points times theirs.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from ....frozen import value_class
from ....geometry.bspline import basis_polynomials
from ....geometry.rotation_vector import acceleration_by_place, along_axes, skew
from ....kernel import library
from ....models.matrix_pattern import DIAGONAL, FULL, LOWER
from ....recording import Floats, Integers
from ..layout import BorderLayout
from ..parameters import RigParameters
from ..trajectory import BIAS, POSE, Bases, MotionState, Places, Trajectory
from .assembly import TRIAD, Columns
from .inertial_data import (
    ForceJacobian,
    InertialData,
    InertialNoise,
    TriadData,
    accelerometer_places,
    at_origin,
    at_places,
    jacobian_by_imu_rotation,
    motion_of_imu,
    on_grid,
    origin_places,
    some_readings,
    specific_force,
)

_DRAWN = 128  # spans whose signs are drawn together

_Columns = dict[str, Callable[[], Floats]]
"""Block of an IMU -> its columns (n, 3, k)."""


class InertialTerms:
    """Error terms of the readings of one IMU."""

    def __init__(
        self,
        data: InertialData,
        trajectory: Trajectory,
        parameters: RigParameters,
        *,
        layout: BorderLayout,
        noise: InertialNoise,
        probe: int | None,
        seed: int,
    ) -> None:
        """Put readings on the grid of a trajectory.

        Parameters
        ----------
        data : readings; those outside of the trajectory are left out
        trajectory, parameters, layout : where to linearise
        noise : standard deviations
        probe : right-hand side of the gyroscope's probe, the accelerometer's is the next; None for no probes
        seed : of the probes' random signs
        """
        self.data, self._places = on_grid(trajectory.grid, data, parameters.imus[data.imu])
        self._trajectory, self._parameters, self._noise = trajectory, parameters, noise
        mine = ("gravity.", f"imu{data.imu}.")
        probes = () if probe is None else (probe, probe + 1)
        self.columns = Columns.of(
            layout, trajectory.grid.order, lambda name: name.startswith(mine), imu=data.imu, probes=probes
        )
        self._imu = parameters.imus[data.imu]
        self._signs = None if probe is None else self._drawn_signs(np.random.default_rng(seed))
        self._chi2 = [0.0, 0.0]

    @property
    def first(self) -> Integers:
        """First control point of the span of each reading, (n,)."""
        return self._places.first

    @property
    def height(self) -> int:
        """Number of rows of each reading."""
        return TRIAD * sum(triad is not None for triad in (self.data.gyroscope, self.data.accelerometer))

    def _drawn_signs(self, rng: np.random.Generator) -> Floats:
        """Return random signs (n, 6 or 3); those of a beginning do not depend on how long the recording is."""
        signs = np.empty((len(self.first), self.height))
        edges = np.searchsorted(self.first, np.arange(0, self._trajectory.grid.controls + _DRAWN, _DRAWN))
        for begin, end in pairwise(edges.tolist()):
            for start in range(0, self.height, TRIAD):
                signs[begin:end, start : start + TRIAD] = rng.integers(0, 2, (end - begin, TRIAD)) * 2.0 - 1.0
        return signs

    def rows(self, part: slice) -> Floats:
        """Return the rows of both triads, or of the one that has these timestamps, (n, 6 or 3, w), of some readings."""
        if library.load_kernel() is not None:
            rows, chi2 = library.inertial_rows(self._readings(part), self.columns.width)
            self._count(chi2)
            return rows
        places, data = self._places.some(part), some_readings(self.data, part)
        triads = [(kind, triad) for kind, triad in enumerate((data.gyroscope, data.accelerometer)) if triad is not None]
        rows = self._rows(places, data)
        if self._signs is not None:
            for number, (kind, triad) in enumerate(triads):
                own = slice(TRIAD * number, TRIAD * (number + 1))
                rows[:, own, self.columns.side + 1 + kind] = self._signs[part, own] * triad.used[:, None]
        return rows

    def add_to(self, band: library.Band) -> Floats | None:
        """Add the products of all rows by the compiled kernel, and return those of the columns from the border on."""
        if self.columns.width > library.MOST_INERTIAL:
            return None
        products, chi2 = library.add_inertial_sums(self._readings(slice(None)), self.columns.width, band)
        self._count(chi2)
        return products

    def _count(self, chi2: Floats) -> None:
        self._chi2 = [before + more for before, more in zip(self._chi2, chi2.tolist(), strict=True)]

    def _rows(self, places: Places, data: InertialData) -> Floats:
        trajectory, index, imu = self._trajectory, self.data.imu, self._imu
        bases = Bases.at(places, trajectory.grid)
        motion = motion_of_imu(trajectory, places, bases, imu) if index else trajectory.motion(places, bases)
        at = _Readings(
            places=places,
            bases=bases,
            motion=motion,
            force=specific_force(motion, self._parameters.gravity),
            A=acceleration_by_place(motion.omega, motion.alpha) if self._has_places else None,
        )
        biases = trajectory.bias(places, index)
        rows = np.zeros((len(places.u), self.height, self.columns.width))
        begin = 0
        for kind, triad in enumerate((data.gyroscope, data.accelerometer)):
            if triad is not None:
                fill = (self._fill_gyroscope, self._fill_accelerometer)[kind]
                fill(rows[:, begin : begin + TRIAD], at, biases[kind], triad)
                begin += TRIAD
        return rows

    def _readings(self, part: slice) -> library.Readings:
        """Return some readings as the compiled kernel takes them."""
        places, data = self._places.some(part), some_readings(self.data, part)
        trajectory, grid, own = self._trajectory, self._trajectory.grid, self.columns.own
        found = (own.get(name, own.get(f"imu{self.data.imu}.{name}")) for name in library.BLOCKS[:-1])
        gyroscope, accelerometer = (
            None if triad is None else (triad.values, triad.used / sigma)
            for triad, sigma in (
                (data.gyroscope, self._noise.gyroscope),
                (data.accelerometer, self._noise.accelerometer),
            )
        )
        return library.Readings(
            places=(places.first, places.u, places.segment),
            references=grid.references(),
            bases=np.stack([basis_polynomials(grid.order, d) / grid.spacing_s**d for d in range(4)]),
            controls=trajectory.controls,
            bias_at=POSE + BIAS * self.data.imu,
            bias_offset=grid.bias_offset,
            spacing_s=grid.spacing_s,
            imu=self._packed(),
            blocks=[*(-1 if at is None else at.start for at in found), self.columns.side],
            gyroscope=gyroscope,
            accelerometer=accelerometer,
            signs=None if self._signs is None else self._signs[part],
        )

    def _packed(self) -> Floats:
        """Return what the kernel needs of the IMU and of gravity, in its order (Imu in kernel.c)."""
        imu, gravity = self._imu, self._parameters
        parts = (
            *(imu.gyroscope_sensitivity, imu.B_g, imu.C_bg, imu.S_g, LOWER.matrix(imu.M_g)),
            *(imu.accelerometer_sensitivity, imu.S_a, LOWER.matrix(imu.M_a), imu.R_imu_body),
            *(origin_places(imu), accelerometer_places(imu), imu.places_by_arms, gravity.gravity),
            *(-gravity.gravity_m_s2 * gravity.gravity_plane, -gravity.gravity_direction),
        )
        return np.concatenate([np.ravel(part) for part in parts])

    @property
    def _has_places(self) -> bool:
        """Whether it matters, or shall be seen, where the sensors are."""
        imu = self._imu
        return bool(imu.places.any() or imu.p_imu_body.any()) or self._has("lever_arms", "T_imu_body.translation")

    def _has(self, *blocks: str) -> bool:
        """Tell whether any of the blocks of this IMU has columns."""
        return any(f"imu{self.data.imu}.{block}" in self.columns.own for block in blocks)

    def chi2(self) -> tuple[float, float]:
        """Return the sum of squared whitened residuals of gyroscope and accelerometer that `rows` has met so far."""
        return self._chi2[0], self._chi2[1]

    def _fill_gyroscope(self, rows: Floats, at: "_Readings", bias: Floats, triad: TriadData) -> None:
        imu, motion, places = self._imu, at.motion, origin_places(self._imu)
        K, B = imu.gyroscope_sensitivity, imu.B_g
        weight = triad.used / self._noise.gyroscope
        force, by = at.force, ForceJacobian(phi=K @ motion.omega_by_phi, rate=K @ motion.phi_jacobian)
        if self._has("B_g") or B.any():  # the specific force acts on it
            force, by_force = at.felt(places)
            by = by.plus(by_force.scaled(B))
        residual = motion.omega @ K.T + force @ B.T + bias - triad.values
        turned = motion.omega @ imu.C_bg
        S, M = DIAGONAL.matrix(imu.S_g), LOWER.matrix(imu.M_g)
        own: _Columns = {
            "S_g": lambda: DIAGONAL.product_jacobian(turned @ M.T),
            "M_g": lambda: S @ LOWER.product_jacobian(turned),
            "q_bg": lambda: (S @ M) @ skew(turned),
            "B_g": lambda: FULL.product_jacobian(force),
            "T_imu_body.rotation": lambda: (
                (B @ jacobian_by_imu_rotation(motion, at.force, places) - K @ skew(motion.omega)) @ imu.R_imu_body
            ),
            "T_imu_body.translation": lambda: -B @ at.required_A,
            "time_shift": lambda: self._by_time(at, by, kind=0),
        }
        self._fill_local(rows, at, by, residual, weight, kind=0)
        self._fill_border(rows, own, by.acceleration, weight)

    def _fill_accelerometer(self, rows: Floats, at: "_Readings", bias: Floats, triad: TriadData) -> None:
        imu, motion, places = self._imu, at.motion, accelerometer_places(self._imu)
        K = imu.accelerometer_sensitivity
        weight = triad.used / self._noise.accelerometer
        felt, by_felt = at.felt(places)
        by = by_felt.scaled(K)
        residual = felt @ K.T + bias - triad.values
        S, M = DIAGONAL.matrix(imu.S_a), LOWER.matrix(imu.M_a)
        own: _Columns = {
            "S_a": lambda: DIAGONAL.product_jacobian(felt @ M.T),
            "M_a": lambda: S @ LOWER.product_jacobian(felt),
            "lever_arms": lambda: K @ np.einsum("nkj,kjm->nkm", at.required_A, imu.places_by_arms),
            "T_imu_body.rotation": lambda: K @ jacobian_by_imu_rotation(motion, at.force, places) @ imu.R_imu_body,
            "T_imu_body.translation": lambda: -K @ at.required_A,
            "time_shift": lambda: self._by_time(at, by, kind=1),
            "accelerometer_shift": lambda: self._by_time(at, by, kind=1),
        }
        self._fill_local(rows, at, by, residual, weight, kind=1)
        self._fill_border(rows, own, by.acceleration, weight)

    def _by_time(self, at: "_Readings", by: ForceJacobian, *, kind: int) -> Floats:
        """Return the derivative of the residual by time, (n, 3, 1)."""
        motion, jerk = at.motion, self._trajectory.jerk(at.places)
        found = np.zeros((len(jerk), TRIAD, 1))
        for matrix, rate in (
            (by.phi, motion.phi_rate),
            (by.rate, motion.phi_acceleration),
            (by.phi_acceleration, jerk[:, :3]),
            (by.acceleration, jerk[:, 3:]),
        ):
            if matrix is not None:
                found += matrix @ rate[:, :, None]
        found[:, :, 0] += self._trajectory.bias_rate(at.places, self.data.imu)[kind]
        return found

    def _fill_local(
        self,
        rows: Floats,
        at: "_Readings",
        by: ForceJacobian,
        residual: Floats,
        weight: Floats,
        *,
        kind: int,
    ) -> None:
        """Fill in the columns of pose, bias and right-hand sides; `kind` is 0 for the gyroscope, 1 for the other."""
        n, columns = len(weight), self.columns
        weighted = weight[:, None]
        pose = rows[:, :, : columns.pose].reshape(n, TRIAD, columns.order, POSE)  # a view
        bases = [(basis * weighted)[:, None, :, None] for basis in (at.bases.value, at.bases.rate)]
        np.multiply(bases[0], by.phi[:, :, None, :], out=pose[..., :3])
        if by.rate is not None:
            pose[..., :3] += bases[1] * by.rate[:, :, None, :]
        if by.acceleration is not None:
            basis = (at.bases.acceleration * weighted)[:, None, :, None]
            np.multiply(basis, by.acceleration[:, :, None, :], out=pose[..., 3:])
            if by.phi_acceleration is not None:
                pose[..., :3] += basis * by.phi_acceleration[:, :, None, :]
        for knot, share in enumerate((1 - at.places.u, at.places.u)):
            start = columns.bias(knot).start + TRIAD * kind
            for i in range(TRIAD):
                rows[:, i, start + i] = share * weight
        whitened = residual * weighted
        self._chi2[kind] += float(np.vdot(whitened, whitened))
        rows[:, :, columns.side] = -whitened

    def _fill_border(self, rows: Floats, own: _Columns, by_acceleration: Floats | None, weight: Floats) -> None:
        """Fill in the border columns: those of the triad's own parameters, and gravity's."""
        parameters = self._parameters
        blocks = {f"imu{self.data.imu}.{name}": derivative for name, derivative in own.items()}
        if by_acceleration is not None:
            g, plane, direction = parameters.gravity_m_s2, parameters.gravity_plane, parameters.gravity_direction
            blocks["gravity.direction"] = lambda: by_acceleration @ (-g * plane)
            blocks["gravity.magnitude"] = lambda: by_acceleration @ -direction[:, None]
        for name, derivative in blocks.items():
            at = self.columns.own.get(name)
            if at is not None:
                np.multiply(derivative(), weight[:, None, None], out=rows[:, :, at])


@value_class
class _Readings:
    """What is the same for both triads at some timestamps, in the IMU's axes.

    Attributes
    ----------
    places, bases : on the trajectory
    motion, force : of the body, and the specific force at its origin
    A : (n, 3, 3) [alpha]x + [omega]x^2; None where all sensors are at the body's origin
    """

    places: Places
    bases: Bases
    motion: MotionState
    force: Floats
    A: Floats | None

    @property
    def required_A(self) -> Floats:
        """[alpha]x + [omega]x^2, (n, 3, 3), where something is away from the body's origin."""
        assert self.A is not None
        return self.A

    def felt(self, places: Floats) -> tuple[Floats, ForceJacobian]:
        """Return component k of the specific force at places (3, 3), a row each, (n, 3), and its derivatives."""
        if not places.any():
            return self.force, at_origin(self.motion, self.force)
        felt = self.force + along_axes(self.required_A, places)
        return felt, at_places(self.motion, self.force, places)
