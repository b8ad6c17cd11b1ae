"""Where in its period each picture is: all pictures against one that depends on the phase."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...recording import Floats
from .period import Pictures

MOST_HARMONICS, COARSE_HARMONICS = 32, 4
"""Of the picture over the phase; few where the phases that it is learned from are not yet right: its sharp features,
learned in several places, would hold the pictures there."""
_RIDGE = 1e-3
_PHASES = 240
_CHUNK = 2048
_FOR_SPREAD = 250  # pictures
_LARGEST_STEP = 0.3  # rad
_OUTLYING = 4.0  # sigma of a cell
_MISMATCH = 0.08  # of what a cell changes by at most, which the series may be wrong by
_SLACK_RAD = (0.1, 0.05, 0.02, 0.02)
"""Errors of the phase, pass by pass, that do not make a cell an outlier."""
_MOST_CELLS = 300
_WORST_CONDITION = 30.0


@value_class
class PhaseTemplate:
    """The picture as a harmonic series of the phase.

    Attributes
    ----------
    coefficients : (2 h + 1, cells) constant, then cosine and sine of each harmonic, in turn
    sigma : (cells,) by which pictures differ from it [grey]
    sampled : how many of the harmonics the phases of the pictures tell apart
    """

    coefficients: Pictures
    sigma: NDArray[np.float32]
    sampled: int

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return len(self.coefficients) // 2

    def maps(self) -> NDArray[np.complex64]:
        """Return the complex amplitude of each harmonic in each cell, (h, cells): their real part at phase 0."""
        return (self.coefficients[1::2] - 1j * self.coefficients[2::2]).astype(np.complex64)


@value_class
class Phases:
    """Phase of each picture, each by itself.

    Attributes
    ----------
    phase : (n,) [rad]
    sigma : (n,) of it, as the noise of the cells has it [rad]
    seen : (n,) share of what changes with the phase that is as it should be; low where something is in the way
    """

    phase: Floats
    sigma: Floats
    seen: Floats


def harmonic_basis(phase: Floats, harmonics: int) -> NDArray[np.float32]:
    """Return 1, cos, sin, cos 2, sin 2, ... of phases, (n, 2 h + 1)."""
    angle = phase[:, None] * np.arange(1, harmonics + 1)
    basis = np.ones((len(phase), 2 * harmonics + 1), np.float32)
    basis[:, 1::2], basis[:, 2::2] = np.cos(angle), np.sin(angle)
    return basis


def _derivative(basis: NDArray[np.float32]) -> NDArray[np.float32]:
    order = np.arange(1, basis.shape[1] // 2 + 1, dtype=np.float32)
    slope = np.zeros_like(basis)
    slope[:, 1::2], slope[:, 2::2] = -order * basis[:, 2::2], order * basis[:, 1::2]
    return slope


def learn_template(cells: Pictures, phase: Floats, most: int = MOST_HARMONICS) -> PhaseTemplate:
    """Fit a harmonic series of the phase to each cell; what is seldom in the way is left out.

    Parameters
    ----------
    cells : (n, cells) pictures
    phase : (n,) assumed [rad]
    most : harmonics; few where the phases are not yet well known
    """
    harmonics = max(1, min(most, len(phase) // 8))
    basis = harmonic_basis(phase, harmonics)
    ridge = _RIDGE * len(phase) * np.repeat(np.arange(harmonics + 1), 2)[1:] ** 2 / 16
    normal = basis.T @ basis + np.diag(ridge).astype(np.float32)
    inverse: Any = np.linalg.inv(normal.astype(np.float64)).astype(np.float32)
    coefficients: Any = inverse @ (basis.T @ cells)
    residual: Any = cells - basis @ coefficients
    limit = 2 * _spread(residual)
    np.clip(residual, -limit, limit, out=residual)
    coefficients += inverse @ (basis.T @ residual)
    some = slice(None, None, _stride(cells))
    rest: Any = cells[some] - basis[some] @ coefficients
    sigma = _spread(rest)
    return PhaseTemplate(coefficients=coefficients, sigma=sigma, sampled=_sampled_harmonics(basis, harmonics))


def _stride(cells: Pictures) -> int:
    return max(1, len(cells) // _FOR_SPREAD)


def _spread(residual: Pictures) -> NDArray[np.float32]:
    """Return a robust standard deviation of each cell, at least half of the usual one."""
    some = np.ascontiguousarray(np.abs(residual[:: _stride(residual)]).T)
    sigma = 1.4826 * np.median(some, axis=1)
    return np.maximum(sigma, 0.5 * np.median(sigma) + 0.05).astype(np.float32)


def _sampled_harmonics(basis: NDArray[np.float32], harmonics: int) -> int:
    """Return how many harmonics can be told apart where the platter stands at few phases only."""
    whole = basis.T @ basis
    for count in range(harmonics, 0, -1):
        if np.linalg.cond(whole[: 2 * count + 1, : 2 * count + 1]) < _WORST_CONDITION:
            return count
    return 0


def place_phases(cells: Pictures, template: PhaseTemplate) -> Floats:
    """Return the likeliest phase of each picture, (n,) [rad], of all phases there are."""
    trial = np.arange(_PHASES) * (2 * np.pi / _PHASES)
    weight = 1 / template.sigma**2
    models = _over_a_period(template)
    cost = 0.5 * (models**2) @ weight
    found = np.empty(len(cells))
    for first in range(0, len(cells), _CHUNK):
        part = cells[first : first + _CHUNK] - template.coefficients[0]
        limit = 6 * template.sigma + np.abs(models).max(axis=0)
        score = (np.clip(part, -limit, limit) * weight) @ models.T - cost
        found[first : first + _CHUNK] = trial[np.argmax(score, axis=1)]
    return found


def refine_phases(cells: Pictures, template: PhaseTemplate, phase: Floats) -> Phases:
    """Return the phase of each picture to a part of a cell, with gain and offset of the picture, robustly.

    Parameters
    ----------
    cells : (n, cells) pictures
    template : what they look like
    phase : (n,) where to start [rad]
    """
    telling = _telling_cells(template)
    part_of = PhaseTemplate(
        coefficients=template.coefficients[:, telling], sigma=template.sigma[telling], sampled=template.sampled
    )
    parts = [
        _refined(cells[first : first + _CHUNK, telling], part_of, phase[first : first + _CHUNK])
        for first in range(0, len(cells), _CHUNK)
    ]
    return Phases(
        phase=np.concatenate([part.phase for part in parts]),
        sigma=np.concatenate([part.sigma for part in parts]),
        seen=np.concatenate([part.seen for part in parts]),
    )


def _telling_cells(template: PhaseTemplate) -> NDArray[np.int64]:
    """Return the cells that tell most of the phase."""
    order = np.repeat(np.arange(1, template.harmonics + 1), 2)[:, None]
    information = (np.square(order * template.coefficients[1:])).sum(axis=0) / np.square(template.sigma)
    return np.argsort(-information)[:_MOST_CELLS]


def _refined(cells: Pictures, template: PhaseTemplate, phase: Floats) -> Phases:
    phase = phase.astype(np.float64)
    count = len(phase)
    gain, offset = np.ones(count), np.zeros(count)
    constant = np.ones_like(cells)
    wrong = np.square(_MISMATCH * np.ptp(_over_a_period(template), axis=0))
    variance, seen = np.full(count, np.inf), np.zeros(count)
    for slack in _SLACK_RAD:
        basis = harmonic_basis(phase, template.harmonics)
        model = basis @ template.coefficients
        slope = _derivative(basis) @ template.coefficients
        residual = cells - gain[:, None].astype(np.float32) * model - offset[:, None].astype(np.float32)
        expected = np.square(template.sigma) + wrong + np.square(np.float32(slack) * slope)
        trust = np.square(np.clip(1 - np.square(residual) / (_OUTLYING**2 * expected), 0, None))
        weight = trust / (np.square(template.sigma) + wrong)
        columns = (model, constant, slope)
        normal = np.empty((count, 3, 3))
        right = np.empty((count, 3))
        for i, one in enumerate(columns):
            weighted = weight * one
            right[:, i] = np.einsum("np,np->n", weighted, residual)
            for j in range(i, 3):
                normal[:, i, j] = normal[:, j, i] = np.einsum("np,np->n", weighted, columns[j])
        normal += np.eye(3) * (1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-12)
        step = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        gain = np.clip(gain + step[:, 0], 0.2, 5.0)
        offset = offset + step[:, 1]
        phase = phase + np.clip(step[:, 2] / gain, -_LARGEST_STEP, _LARGEST_STEP)
        variance = np.linalg.inv(normal)[:, 2, 2] / gain**2
        information = np.square(slope) / (np.square(template.sigma) + wrong)
        seen = np.einsum("np,np->n", trust, information) / np.maximum(information.sum(axis=1), 1e-12)
    return Phases(phase=phase, sigma=np.sqrt(np.maximum(variance, 1e-12)), seen=seen)


def _over_a_period(template: PhaseTemplate) -> Pictures:
    """Return what changes with the phase, at phases all around."""
    trial = np.arange(_PHASES, dtype=np.float64) * (2 * np.pi / _PHASES)
    return harmonic_basis(trial, template.harmonics)[:, 1:] @ template.coefficients[1:]
