"""What is estimated: by the model (B3, B9 of Krebs), and by name.

The steps from the basic model to the largest one (B16): which scalars of the border each of them adds.
"""

import difflib
from collections.abc import Mapping, Sequence

import numpy as np

from ...errors import OptionError
from ...frozen import value_class
from ...geometry.rotations import rotvec_from_rotation
from ...options import CameraImuOptions, stated_prior
from ...recording import Floats, Integers
from ...results.trust import BlockChange, ModelStep
from ..trust.clusters import CandidateBlock, CandidateStep, ClusterSums, model_steps
from .layout import BorderLayout, ParameterBlock, Status, parameter_blocks, sensor_priors
from .parameters import RigParameters

_MODEL_BLOCKS = {
    "basic": (),
    "scale-misalignment": ("S_a", "M_a", "S_g", "M_g", "q_bg"),
    "full": ("S_a", "M_a", "S_g", "M_g", "q_bg", "B_g"),
    "auto": ("S_a", "M_a", "S_g", "M_g", "q_bg", "B_g", "lever_arms"),
}
"""Of an IMU, what each model estimates (Table 4.1); to "auto" further blocks are added by evidence."""

_BESIDES = (
    "direction",
    "T_cam_imu.rotation",
    "T_cam_imu.translation",
    "time_shift_cam_imu",
    "T_imu_body.rotation",
    "T_imu_body.translation",
    "time_shift",
)
"""Always estimated unless fixed by name; beside them the shift of an accelerometer that has timestamps of its own."""


K3 = "distortion_coeffs[4]"
"""Where radtan5 has its third radial coefficient; options may call it k3."""

_RAY = 5e-3  # of the focal length: how far a ray may be off, by the focal length or the principal point
_PROJECTION, _BENDING, _TANGENTIAL = 0.02, 0.05, 1e-3


@value_class(eq=True)
class Choices:
    """Status of every scalar, and the standard deviations of stated priors."""

    status: dict[str, Status]
    prior_sigma: dict[str, float]


def estimation_choices(
    start: RigParameters, options: CameraImuOptions, model: str | None = None, added: Sequence[str] = ()
) -> Choices:
    """Return what is estimated.

    Parameters
    ----------
    start : start values, which tell the cameras and IMUs
    options : model, fix, free, prior
    model : instead of the options' one
    added : names of blocks that are estimated beyond the model, such as "lever_arms", of every sensor that has them

    Raises
    ------
    OptionError
        If a name is unknown, stands in two lists, or a prior is not NAME=SIGMA with SIGMA > 0.
    """
    all_blocks = parameter_blocks(start)
    estimated = (*_MODEL_BLOCKS[model or options.model], *added, *_BESIDES)
    status: dict[str, Status] = {}
    for block in all_blocks:
        kind: Status = "estimated" if block.name.partition(".")[2] in estimated else "fixed"
        status |= dict.fromkeys(block.scalars(), kind)
    for i, imu in enumerate(start.imus):
        if imu.apart:
            status[f"imu{i}.accelerometer_shift"] = "estimated"
    stated: dict[str, str] = {}
    sigma: dict[str, float] = {}
    for names, size, _ in sensor_priors(start):  # estimated jointly, of an IMU what the model has
        known = zip(names, size.tolist(), strict=True)
        sigma |= {name: value for name, value in known if status[name] == "estimated" or not name.startswith("imu")}
    if not {"intrinsics", "distortion_coeffs"}.isdisjoint(added):
        sigma = {name: value for name, value in lens_tolerances(start).items() if status[name] == "estimated"} | sigma
    status |= dict.fromkeys(sigma, "prior")
    for option, names in (("free", options.free), ("fix", options.fix)):
        for name in names:
            for scalar in _scalars(name, option, all_blocks, stated):
                status[scalar] = "estimated" if option == "free" else "fixed"
                sigma.pop(scalar, None)
    for text in options.prior:
        name, value = stated_prior(text)
        for scalar in _scalars(name, "prior", all_blocks, stated):
            status[scalar], sigma[scalar] = "prior", value
    return Choices(status=status, prior_sigma=sigma)


def lens_tolerances(start: RigParameters) -> dict[str, float]:
    """Return scalar of a lens -> how far a stated value may be off where nothing is known of its uncertainty.

    Intrinsics of a careful calibration, of another day or with a biased board, are off by some pixels (the published
    ones of EuRoC's cameras by 0.6 % and 3 px); the coefficients of the distortion trade with each other far more.
    """
    found: dict[str, float] = {}
    for entry in start.cameras:
        lens = entry.camera
        focal = float(np.mean(lens.intrinsics[-4:-2]))
        sizes = {"projection": _PROJECTION, "focal": _RAY * focal, "principal": _RAY * focal, "distortion": _BENDING}
        for name, kind, symbol in zip(entry.lens_names(), lens.parameter_kinds, lens.parameter_symbols, strict=True):
            found[name] = _TANGENTIAL if symbol in {"p1", "p2"} else sizes[kind]
    return found


def kept_or_prior(status: Mapping[str, Status], block: str) -> bool:
    """Tell whether any scalar of a block, such as "cam0.T_cam_imu.rotation", is held fixed or has a prior."""
    return any(kind != "estimated" for scalar, kind in status.items() if scalar.partition("[")[0] == block)


def wants_k3(name: str, options: CameraImuOptions) -> bool:
    """Tell whether the options name the third radial coefficient of a camera, which radtan has not."""
    named = {*options.free, *options.fix, *(stated_prior(text)[0] for text in options.prior)}
    return not named.isdisjoint({f"{name}.k3", f"{name}.{K3}"})


def imu_blocks(start: RigParameters) -> tuple[str, ...]:
    """Return the blocks of the full model of every IMU."""
    return tuple(f"imu{i}.{name}" for i in range(len(start.imus)) for name in _MODEL_BLOCKS["full"])


def _scalars(name: str, option: str, all_blocks: tuple[ParameterBlock, ...], stated: dict[str, str]) -> list[str]:
    """Return the scalars that a name stands for: itself, a block, or everything below it ("cam0.T_cam_imu")."""
    if name.endswith(".k3"):
        name = name.removesuffix("k3") + K3
    found = [
        scalar
        for block in all_blocks
        for scalar in block.scalars()
        if name in {scalar, block.name} or block.name.startswith(f"{name}.")
    ]
    if not found:
        known = [block.name for block in all_blocks]
        close = difflib.get_close_matches(name, known, n=1)
        hint = f" Did you mean {close[0]}?" if close else ""
        raise OptionError(f"--{option} {name}: there is no such parameter.{hint} Known: {', '.join(known)}.")
    for scalar in found:
        if stated.setdefault(scalar, option) != option:
            raise OptionError(f"--{option} {name}: {scalar} is also in --{stated[scalar]}. Keep one of them.")
    return found


ARMS, DELAY, EXPOSURE = "lever arms", "accelerometer delay", "exposure"

LADDER = {
    "scale": ("S_a", "S_g"),
    "misalignment": ("M_a", "M_g", "q_bg"),
    "g-sensitivity": ("B_g",),
    ARMS: ("lever_arms",),
    DELAY: ("accelerometer_shift",),
    EXPOSURE: ("exposure_squared",),
    "intrinsics": ("intrinsics", "distortion_coeffs"),
    "k3": (),
}
"""Step -> blocks, of every sensor that has them; k3 is the last coefficient of radtan5. An accelerometer that has
timestamps of its own has a delay in every model."""

EXTRAS = (DELAY, EXPOSURE, "intrinsics", "k3")
"""Steps beyond the model of the IMU."""

_GRAVITY = "gravity.magnitude"
"""Held at a value that is off, it makes motion look larger or smaller, as an exposure does."""

_CHANGES = 3
"""Blocks that a step is said to have moved."""


def evaluate_nested_models(
    sums: ClusterSums,
    layout: BorderLayout,
    parameters: RigParameters,
    forced: Mapping[str, bool],
    least: Mapping[str, float],
) -> tuple[ModelStep, ...]:
    """Return what each step brings on clusters of time that were left out, in their order.

    Parameters
    ----------
    sums : of clusters longer than the residuals' memory, over the columns of `layout`
    layout, parameters : where the sums were made
    forced : step -> whether it is in the model, of those on which the recording does not decide
    least : step -> gain of the log-likelihood that it must bring, however certain it is
    """
    held = [k for k, name in enumerate(layout.names) if name == _GRAVITY and not layout.free[k]]
    candidates = [
        CandidateBlock(
            name=name,
            columns=columns,
            away=_away(layout, parameters)[columns],
            forced=forced.get(name),
            least=least.get(name, 0.0),
            alike=name == EXPOSURE,
            beside=np.array(held if name == EXPOSURE else [], dtype=np.int64),
        )
        for name in LADDER
        if len(columns := step_columns(layout, name))
    ]
    inside = np.concatenate([np.zeros(0, np.int64), *(candidate.columns for candidate in candidates)])
    free = layout.free_index
    biases = np.arange(layout.dense, sums.pull.shape[1])
    always = np.concatenate([np.setdiff1d(free[free < layout.dense], inside), biases])
    return tuple(_told(step, layout) for step in model_steps(sums, always, candidates))


def step_columns(layout: BorderLayout, name: str) -> Integers:
    """Return the columns of a step's blocks."""
    found = [
        column
        for block, columns in layout.columns.items()
        if block.partition(".")[2] in LADDER[name]
        for column in range(columns.start, columns.stop)
        if not layout.names[column].endswith(K3) and not _has_own_stamps(layout, block, name)
    ]
    if name == "k3":
        found = [column for column, scalar in enumerate(layout.names) if scalar.endswith(K3)]
    return np.array(found, dtype=np.int64)


def _has_own_stamps(layout: BorderLayout, block: str, name: str) -> bool:
    """Tell whether a block is the delay of an accelerometer with timestamps of its own."""
    return name == DELAY and layout.start.imus[int(block.partition(".")[0].removeprefix("imu"))].apart


def _away(layout: BorderLayout, parameters: RigParameters) -> Floats:
    """Return the step (p,) from present values to those of a model without the block.

    An IMU without the block is ideal; everything else keeps its start value.
    """
    away = layout.prior_mean - layout.values(parameters)
    for i, imu in enumerate(parameters.imus):
        ideal = {
            "S_a": 1 - imu.S_a,
            "S_g": 1 - imu.S_g,
            "M_a": -imu.M_a,
            "M_g": -imu.M_g,
            "q_bg": -rotvec_from_rotation(imu.C_bg),
            "B_g": -imu.B_g.ravel(),
        }
        for block, step in ideal.items():
            if (columns := layout.get(f"imu{i}.{block}")) is not None:
                away[columns] = step
    return away


def _told(step: CandidateStep, layout: BorderLayout) -> ModelStep:
    own = set(step.candidate.columns.tolist())
    changes: list[BlockChange] = []
    for block, columns in layout.columns.items():
        if columns.start >= layout.dense or own & set(range(columns.start, columns.stop)):
            continue
        sigmas = np.abs(step.change[columns]) / step.sigma[columns]
        if not np.isfinite(sigmas).any():
            continue
        worst = columns.start + int(np.nanargmax(sigmas))
        changes.append(
            BlockChange(
                block=block,
                change=float(step.change[worst]),
                unit=layout.units[worst],
                sigmas=float(np.nanmax(sigmas)),
            )
        )
    changes.sort(key=lambda change: -change.sigmas)
    return ModelStep(
        name=step.candidate.name,
        parameters=len(step.candidate.columns),
        gain=step.gain,
        gain_sigma=step.gain_sigma,
        needed=step.needed,
        used=step.used,
        forced=step.candidate.forced is not None,
        changes=tuple(changes[:_CHANGES]),
    )
