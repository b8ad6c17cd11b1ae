"""The error terms of Krebs, section 4.1.2, written anew and literally, to test the estimation by.

Everything is computed with complex numbers and any number of variants at once, (v, ...): the derivative by a number is
the imaginary part that a step of 1e-30 i leaves, exact to rounding.
"""

import math
from dataclasses import dataclass

import numpy as np

from gnomon.estimate.camera_imu.batch import Measurements, NoiseLevels, RigState
from gnomon.estimate.camera_imu.layout import BorderLayout
from gnomon.estimate.camera_imu.trajectory import basis_matrix

STEP = 1e-30
SMOOTHNESS = 1e3  # rad/s^2 and m/s^2
FIRST_BIAS_SIGMA = (1.0, 10.0)


@dataclass(frozen=True, kw_only=True)
class Problem:
    """All that `linearised` is given."""

    measurements: Measurements
    state: RigState
    layout: BorderLayout
    noise: NoiseLevels


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """Whitened residuals (v, m); those of corners are also weighed by Huber's weights at the state, without a step.

    Attributes
    ----------
    rows : kind of term -> (v, m)
    cost : J, without the term that holds gaps together
    """

    rows: dict[str, np.ndarray]
    cost: float

    @property
    def all(self):
        return np.concatenate(list(self.rows.values()), axis=1)


def turned(phi):
    """Return Exp(phi) and its right Jacobian of phi (..., 3)."""
    x = (phi * phi).sum(axis=-1)[..., None, None]
    near = np.abs(x) < 1e-2
    theta = np.sqrt(np.where(near, 1.0, x))
    forms = []
    for closed, first in (
        (np.sin(theta) / theta, 1),
        ((1 - np.cos(theta)) / theta**2, 2),
        ((theta - np.sin(theta)) / theta**3, 3),
    ):
        series, term = 0.0, 1.0 / [1, 1, 2, 6][first]
        for n in range(8):
            series = series + term
            term = -term * x / ((2 * n + first + 1) * (2 * n + first + 2))
        forms.append(np.where(near, series, closed))
    V = np.zeros((*phi.shape, 3), dtype=complex)
    for i in range(3):
        V[..., (i + 2) % 3, (i + 1) % 3] = phi[..., i]
        V[..., (i + 1) % 3, (i + 2) % 3] = -phi[..., i]
    a, b, c = forms
    return np.eye(3) + a * V + b * V @ V, np.eye(3) - b * V + c * V @ V


def crossed(phi):
    """Return [phi]x of phi (..., 3)."""
    x, y, z = np.moveaxis(phi, -1, 0)
    zero = np.zeros_like(x)
    return np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), (0, 1), (-2, -1))


def jacobian_rate(phi, rate):
    """Return the derivative by time of the right Jacobian I - b V + c V^2 of phi (..., 3), whose derivative is rate."""
    x = (phi * phi).sum(axis=-1)[..., None, None]
    x_rate = 2 * (phi * rate).sum(axis=-1)[..., None, None]
    near = np.abs(x) < 1e-1
    theta = np.sqrt(np.where(near, 1.0, x))
    forms = []
    for closed, slope, first in (
        ((1 - np.cos(theta)) / theta**2, (theta * np.sin(theta) - 2 * (1 - np.cos(theta))) / (2 * theta**4), 2),
        ((theta - np.sin(theta)) / theta**3, (theta * (1 - np.cos(theta)) - 3 * (theta - np.sin(theta))) / 2, 3),
    ):
        terms = [(-1) ** n / math.factorial(2 * n + first) for n in range(12)]
        series = sum(term * x**n for n, term in enumerate(terms))
        bent = sum(n * term * x ** (n - 1) for n, term in enumerate(terms) if n)
        forms += [np.where(near, series, closed), np.where(near, bent, slope / (theta**5 if first == 3 else 1.0))]
    b, b_slope, c, c_slope = forms
    V, V_rate = crossed(phi), crossed(rate)
    return -b * V_rate - b_slope * x_rate * V + c * (V @ V_rate + V_rate @ V) + c_slope * x_rate * V @ V


def times(matrix, vector):
    return (matrix @ vector[..., None])[..., 0]


def imaged(lens, parameters, point):
    """Return the pixels (v, m, 2) of points (v, m, 3) by intrinsics and coefficients (v, q), as the papers print it."""
    count = len(lens.intrinsics)
    values = [parameters[:, None, i] for i in range(parameters.shape[1])]
    *shape, fu, fv, pu, pv = values[:count]
    k = values[count:]
    x, y, z = np.moveaxis(point, -1, 0)
    rho = np.sqrt(x**2 + y**2 + z**2)
    if lens.projection == "pinhole":
        divisor = z
    elif lens.projection == "omni":
        divisor = shape[0] * rho + z
    elif lens.projection == "eucm":
        divisor = shape[0] * np.sqrt(shape[1] * (x**2 + y**2) + z**2) + (1 - shape[0]) * z
    else:
        lifted = shape[0] * rho + z
        divisor = shape[1] * np.sqrt(x**2 + y**2 + lifted**2) + (1 - shape[1]) * lifted
    mx, my = x / divisor, y / divisor
    s = mx**2 + my**2
    r = np.sqrt(s)
    dx, dy = mx, my
    if lens.distortion in {"radtan", "radtan5"}:
        radial = 1 + k[0] * s + k[1] * s**2 + (k[4] * s**3 if len(k) > 4 else 0)
        dx = mx * radial + 2 * k[2] * mx * my + k[3] * (s + 2 * mx**2)
        dy = my * radial + 2 * k[3] * mx * my + k[2] * (s + 2 * my**2)
    elif lens.distortion == "equidistant":
        theta = np.arctan(r)
        factor = theta * (1 + k[0] * theta**2 + k[1] * theta**4 + k[2] * theta**6 + k[3] * theta**8) / r
        dx, dy = mx * factor, my * factor
    elif lens.distortion == "fov":
        factor = np.arctan(2 * r * np.tan(k[0] / 2)) / (k[0] * r)
        dx, dy = mx * factor, my * factor
    return np.stack([fu * dx + pu, fv * dy + pv], axis=-1)


class Variants:
    """Constant parameters after steps of the border (v, p); a rotation's step is on its right."""

    def __init__(self, problem, border):
        self.layout, self.parameters, self.border = problem.layout, problem.state.parameters, border

    def step(self, name, size):
        columns = self.layout.get(name)
        return np.zeros((len(self.border), size)) if columns is None else self.border[:, columns]

    def gravity(self):
        direction = self.parameters.gravity_direction
        moved = direction + self.step("gravity.direction", 2) @ self.parameters.gravity_plane.T
        moved = moved / np.sqrt((moved**2).sum(axis=1, keepdims=True))
        return moved * (self.parameters.gravity_m_s2 + self.step("gravity.magnitude", 1))

    def scale(self):
        return self.parameters.target_scale + self.step("target.scale", 1)

    def corners(self, exposures):
        """Return where the corners are on the board, (v, m, 3) or (m, 3)."""
        board = self.parameters.board
        if board is None:
            return exposures.points
        offsets = board.offsets + self.step("target.offsets", board.offsets.size).reshape(-1, *board.offsets.shape)
        return exposures.points + offsets[:, exposures.point]

    def imu(self, i):
        imu, name = self.parameters.imus[i], f"imu{i}"
        diagonal, lower = {}, {}
        for triad in "ag":
            S = getattr(imu, f"S_{triad}") + self.step(f"{name}.S_{triad}", 3)
            yz, zy, zx = (getattr(imu, f"M_{triad}") + self.step(f"{name}.M_{triad}", 3)).T
            one, zero = np.ones_like(yz), np.zeros_like(yz)
            diagonal[triad] = S[:, :, None] * np.eye(3)
            lower[triad] = np.moveaxis(np.array([[one, zero, zero], [yz, one, zero], [zy, zx, one]]), 2, 0)
        C_bg = imu.C_bg @ turned(self.step(f"{name}.q_bg", 3))[0]
        B_g = imu.B_g + self.step(f"{name}.B_g", 9).reshape(-1, 3, 3)
        return diagonal["a"] @ lower["a"], diagonal["g"] @ lower["g"] @ np.swapaxes(C_bg, 1, 2), B_g

    def places(self, i):
        """Return where the three accelerometers of an IMU sit, (v, 3, 3), a row each."""
        imu = self.parameters.imus[i]
        arms = imu.lever_arms + self.step(f"imu{i}.lever_arms", 6)
        zero = np.zeros_like(arms[:, :3])
        from_x = np.stack([zero, arms[:, :3], arms[:, 3:]], axis=1)
        weights, offset = imu.origin.combination
        return from_x - (np.einsum("kij,vkj->vi", weights, from_x) + offset)[:, None]

    def pose_and_clock(self, i):
        """Return R_imu_body, p_imu_body, and the shifts of the IMU and of its accelerometer, (v, ...)."""
        imu, name = self.parameters.imus[i], f"imu{i}"
        R = imu.R_imu_body @ turned(self.step(f"{name}.T_imu_body.rotation", 3))[0]
        p = imu.p_imu_body + self.step(f"{name}.T_imu_body.translation", 3)
        shift = imu.time_shift_s + self.step(f"{name}.time_shift", 1)
        return R, p, shift, imu.accelerometer_shift_s + self.step(f"{name}.accelerometer_shift", 1)

    def camera(self, i):
        entry = self.parameters.cameras[i]
        name, lens = entry.name, entry.camera
        R = entry.R_cam_imu @ turned(self.step(f"{name}.T_cam_imu.rotation", 3))[0]
        p = entry.p_cam_imu + self.step(f"{name}.T_cam_imu.translation", 3)
        shift = entry.time_shift_s + self.step(f"{name}.time_shift_cam_imu", 1)
        delay = lens.line_delay_s + self.step(f"{name}.line_delay", 1)
        own = lens.parameters + np.concatenate(
            [
                self.step(f"{name}.intrinsics", len(lens.intrinsics)),
                self.step(f"{name}.distortion_coeffs", len(lens.distortion_coeffs)),
            ],
            axis=1,
        )
        return R, p, shift, delay, entry.exposure_s2 + self.step(f"{name}.exposure_squared", 1), own


class Splines:
    """The splines of control points (v, n, d)."""

    def __init__(self, grid, controls):
        self.grid, self.controls = grid, controls

    def at(self, t_s):
        """Return segment (m,), first control point and place u (v, m) of instants (v, m)."""
        grid, t = self.grid, t_s[0].real
        starts = np.array([segment.start_s for segment in grid.segments])
        which = np.maximum(np.searchsorted(starts, t, side="right") - 1, 0)
        spans = np.array([segment.spans for segment in grid.segments])[which]
        position = (t - starts[which]) / grid.spacing_s
        inside = (position >= 0) & (position <= spans)
        number = np.clip(np.floor(position), 0, spans - 1)
        first = np.array([segment.first for segment in grid.segments])[which] + number.astype(int)
        return which, first, (t_s - starts[which]) / grid.spacing_s - number, inside

    def motion(self, t_s, exposure_s2=0.0):
        """Return R, omega, p and its acceleration at instants (v, m); R and p of what is mean over an exposure."""
        which, _, _, inside = self.at(t_s)
        value, rate, curvature = self.pose(t_s)
        value = value + curvature * np.reshape(exposure_s2, (-1, 1, 1)) / 24
        R, J = turned(value[..., :3])
        references = np.array([segment.R_reference for segment in self.grid.segments])[which]
        return references @ R, times(J, rate[..., :3]), value[..., 3:], curvature[..., 3:], inside

    def alpha(self, t_s):
        """Return the angular acceleration at instants (v, m)."""
        value, rate, curvature = (derived[..., :3] for derived in self.pose(t_s))
        return times(jacobian_rate(value, rate), rate) + times(turned(value)[1], curvature)

    def pose(self, t_s):
        """Return the pose's scalars and their first two derivatives at instants (v, m)."""
        grid = self.grid
        _, first, u, inside = self.at(t_s)
        u = np.where(inside, u, 0.0)
        pose = self.controls[:, first[:, None] + np.arange(grid.order), :6]
        derived = []
        for derivative in range(3):
            matrix = basis_matrix(grid.order)
            for _ in range(derivative):
                matrix = matrix[1:] * np.arange(1, len(matrix))[:, None]
            weights = (u[..., None] ** np.arange(len(matrix))) @ matrix / grid.spacing_s**derivative
            derived.append((weights[..., None] * pose).sum(axis=-2))
        return derived

    def bias(self, t_s, start):
        """Return the three biases from scalar `start` on, linear between knots, (v, m, 3)."""
        _, first, u, _ = self.at(t_s)
        knot = first + (self.grid.order - 2) // 2
        values = self.controls[:, :, start : start + 3]
        return values[:, knot] * (1 - u[..., None]) + values[:, knot + 1] * u[..., None]


def residuals(problem, controls_step, border_step):
    """Return all residuals after steps of the control points (v, n, d) and of the border (v, p)."""
    state, noise, grid = problem.state, problem.noise, problem.state.trajectory.grid
    varied = Variants(problem, border_step)
    splines = Splines(grid, state.trajectory.controls + controls_step)
    rows, cost = {}, 0.0
    for number, data in enumerate(problem.measurements.inertial):
        found = inertial(data, splines, varied, noise.imus[data.imu])
        for name, values in found.items():
            rows[f"{name} {number}"] = values
            cost += 0.5 * (values[0].real ** 2).sum()
    for number, (data, used) in enumerate(zip(problem.measurements.visual, problem.measurements.used, strict=True)):
        values, robust_cost = visual(data, used, splines, varied, noise)
        rows[f"corners {number}"] = values
        cost += robust_cost
    for name, values in (("walk", walks(splines, noise)), ("prior", priors(problem, border_step))):
        rows[name] = values
        free = values[0].real if name == "walk" else priors(problem, -unmoved(problem)[None])[0]
        cost += 0.5 * (free**2).sum()
    rows["smoothness"] = smoothness(splines)
    return Residuals(rows=rows, cost=float(cost))


def inertial(data, splines, varied, noise):
    R_imu_body, p_imu_body, *shifts = varied.pose_and_clock(data.imu)
    K_a, K_g, B_g = (matrix[:, None] for matrix in varied.imu(data.imu))
    start = 6 + 6 * data.imu
    found = {}
    for name, triad, sigma, at, shift in (
        ("gyroscope", data.gyroscope, noise.gyroscope, start, shifts[0]),
        ("accelerometer", data.accelerometer, noise.accelerometer, start + 3, shifts[0] + shifts[1]),
    ):
        if triad is None:
            continue
        t_s = data.t_s + shift
        R, omega, _, acceleration, inside = splines.motion(t_s)
        force = times(np.swapaxes(R, -1, -2), acceleration - varied.gravity()[:, None])
        alpha = splines.alpha(t_s)

        def felt(place, omega=omega, alpha=alpha, force=force):
            """Return the force at a place of the IMU's frame, in its axes: there, in those of the body, and back."""
            of_body = times(np.swapaxes(R_imu_body, -1, -2), place - p_imu_body)[:, None]
            there = force + np.cross(alpha, of_body) + np.cross(omega, np.cross(omega, of_body))
            return times(R_imu_body[:, None], there)

        if name == "gyroscope":
            prediction = times(K_g, times(R_imu_body[:, None], omega)) + times(B_g, felt(np.zeros(3)))
        else:  # sensor k feels the force at its place
            places = np.moveaxis(varied.places(data.imu), 1, 0)
            prediction = times(K_a, np.stack([felt(place)[..., k] for k, place in enumerate(places)], axis=-1))
        error = (prediction + splines.bias(t_s, at) - triad.values) / sigma
        found[name] = error[:, triad.used & inside].reshape(len(error), -1)
    return found


def visual(data, used, splines, varied, noise):
    exposures = data.exposures
    R_cam_imu, p_cam_imu, shift, delay, exposure_s2, own = varied.camera(data.camera)
    R, _, p, _, inside = splines.motion(data.t_s + shift + exposures.delay_rows * delay, exposure_s2)
    of = exposures.of_corner
    R, p = R[:, of], p[:, of]
    body = times(np.swapaxes(R, -1, -2), varied.scale()[:, :, None] * varied.corners(exposures) - p)
    point = times(R_cam_imu[:, None], body) + p_cam_imu[:, None]
    lens = varied.parameters.cameras[data.camera].camera
    kept = (used & inside)[of]
    off = (imaged(lens, own, point) - exposures.pixels)[:, kept] / noise.pixel_sigma[data.camera]
    distance = np.sqrt((off[0].real ** 2).sum(axis=1))
    far = distance > noise.huber
    huber = noise.huber if far.any() else 0.0
    root = np.sqrt(np.where(far, huber / distance, 1.0))
    cost = np.where(far, huber * (distance - 0.5 * huber), 0.5 * distance**2).sum()
    return (off * root[:, None]).reshape(len(off), -1), cost


def walks(splines, noise):
    grid, order = splines.grid, splines.grid.order
    found = []
    for i, pair in enumerate(noise.walks):
        for k, walk in enumerate(pair):
            bias = splines.controls[:, :, 6 + 6 * i + 3 * k : 9 + 6 * i + 3 * k]
            found.append(bias[:, 0] / FIRST_BIAS_SIGMA[k])
            for number, segment in enumerate(grid.segments):
                count = segment.spans + order - 1
                own = bias[:, segment.first : segment.first + count]
                found += list(np.moveaxis(np.diff(own, axis=1), 1, 0) / (walk * np.sqrt(grid.spacing_s)))
                if number + 1 < len(grid.segments):
                    following = grid.segments[number + 1]
                    gap_s = following.start_s - segment.start_s - segment.spans * grid.spacing_s
                    offset = (order - 2) // 2
                    step = bias[:, following.first + offset] - bias[:, segment.first + offset + segment.spans]
                    found.append(step / (walk * np.sqrt(gap_s)))
    return np.concatenate(found, axis=1)


def smoothness(splines):
    grid = splines.grid
    found = []
    for segment in grid.segments:
        own = splines.controls[:, segment.first : segment.first + segment.spans + grid.order - 1, :6]
        found.append(np.diff(own, n=2, axis=1).reshape(len(own), -1))
    return np.concatenate(found, axis=1) / (grid.spacing_s**2 * SMOOTHNESS)


def unmoved(problem):
    """Return how far scalars that are held are off their priors, (p,): it costs nothing."""
    layout = problem.layout
    return np.where(layout.free, 0.0, layout.values(problem.state.parameters) - layout.prior_mean)


def priors(problem, border_step):
    layout = problem.layout
    difference = layout.values(problem.state.parameters) - layout.prior_mean
    rows = (difference + border_step) / layout.prior_sigma
    columns = layout.get("target.offsets")
    if columns is None:
        return rows
    # A shift, a turn or another size of the whole board: none, by a thousandth of the prior of a corner.
    board = problem.state.parameters.board
    centred = board.points - board.points.mean(axis=0)
    moves = [np.tile(axis, (len(centred), 1)) for axis in np.eye(3)]
    moves += [np.cross(axis, centred) for axis in np.eye(3)] + [centred]
    basis = np.linalg.svd(np.array([move.ravel() for move in moves]), full_matrices=False)[2]
    held = (difference + border_step)[:, columns] @ basis.T / (1e-3 * board.sigma_m)
    return np.concatenate([rows, held], axis=1)


def differentiated(problem):
    """Return residuals (m,), their Jacobian (m, n d + p), kind by kind, and the cost."""
    controls, p = problem.state.trajectory.controls, len(problem.layout)
    count = controls.size + p
    steps = 1j * STEP * np.eye(count)
    found = residuals(problem, steps[:, : controls.size].reshape(count, *controls.shape), steps[:, controls.size :])
    values = {name: rows[0].real for name, rows in found.rows.items()}
    jacobians = {name: rows.imag.T / STEP for name, rows in found.rows.items()}
    return values, jacobians, found.cost
