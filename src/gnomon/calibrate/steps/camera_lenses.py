"""Which lens model each camera has: as stated, or the simplest that predicts hold-out views as well as any.

Every candidate is estimated from the views of its camera. What it says of a view that it has not seen follows from the
sums of the views (`estimate.trust.clusters`): the estimate without the view, which then takes the best pose of its own.
Views that an estimate left out as misfits are posed, and count like the others.
"""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...errors import GnomonError, OptionError, SolveError
from ...estimate.cameras.first_lens import fit_lens_model, general_lens
from ...estimate.cameras.first_rig import first_rig, held_out_residuals
from ...estimate.cameras.rig import RigSolution, RigViews, SeenCorners, view_corners, views_alike
from ...estimate.cameras.solution import solve_rig
from ...estimate.trust.clusters import ClusterSums, cluster_length, correlation_time, held_out_costs, leave_clusters_out
from ...frozen import value_class
from ...models.camera import PROJECTIONS, Camera
from ...models.distortions import DISTORTIONS
from ...models.lens_names import read_everywhere
from ...recording import Floats, Integers
from ...results.camera_diagnostics import LensTrial

CANDIDATES = ("ds-none", "eucm-none", "pinhole-radtan", "pinhole-equidistant", "pinhole-radtan5")
"""Models that are tried, the simplest first. That of omni-radtan, whose xi, k1 and k2 do nearly the same, has to be
stated: its parameters are hardly determined, and ds and eucm see as wide."""

_PARAMETERS = {
    f"{projection}-{distortion}": len(one.names) + 4 + len(other.names)
    for projection, one in PROJECTIONS.items()
    for distortion, other in DISTORTIONS.items()
}
"""Model -> number of its parameters; four are focal lengths and principal point."""

_FEW_VIEWS, _SOON = 15, 15
"""Views and iterations after which a model is given up whose residuals are then `_HOPELESS` times those of the best."""

_HOPELESS = 1.25
_MATTERS = 1.03
_FEWEST_GROUPS = 15
_HUBER = 3.0
_FAR = 20.0  # sigmas: as far as a corner counts that the lens has no image of
_LEAST_GAIN = 2.0
"""Of the held-out log-likelihood: less is no difference, however well the views agree on it."""


@value_class
class LensChoice:
    """The model of one camera.

    Attributes
    ----------
    camera : its name
    lens : of the model that is taken, as these views tell it
    trials : all that were tried, the one that is taken first
    better : a model that predicts hold-out views better than the stated one, by more than chance; "" where there is
        none
    gain, gain_sigma : by how much the held-out log-likelihood of `better` is larger, and its standard deviation
    """

    camera: str
    lens: Camera
    trials: tuple[LensTrial, ...] = ()
    better: str = ""
    gain: float = 0.0
    gain_sigma: float = 0.0

    @property
    def fits(self) -> bool:
        """Whether no other model predicts hold-out views better by so much that it matters."""
        px = {trial.model: trial.holdout_rms_px for trial in self.trials}
        return not self.better or px[self.lens.model] < _MATTERS * px[self.better]


def stated_models(stated: Sequence[str], cameras: Sequence[str]) -> dict[str, str]:
    """Return the model of each camera for which one was stated.

    Parameters
    ----------
    stated : such as ("pinhole-radtan",) for all cameras, or ("cam0=pinhole-radtan", "cam1=ds-none")
    cameras : names of the cameras of the recording

    Raises
    ------
    OptionError
        If there is no such camera or no such model.
    """
    found: dict[str, str] = {}
    for text in stated:
        camera, equals, model = text.rpartition("=")
        if equals and camera not in cameras:
            raise OptionError(f"model {text}: there is no {camera} in this recording, which has {', '.join(cameras)}.")
        check_model(model)
        for name in [camera] if equals else cameras:
            if found.setdefault(name, model) != model:
                raise OptionError(f"model: {name} is stated to be {found[name]} and {model}. Keep one of them.")
    return found


def check_model(model: str) -> None:
    """Check that there is a lens model.

    Raises
    ------
    OptionError
        If there is none of this name.
    """
    if model not in _PARAMETERS:
        close = difflib.get_close_matches(model, _PARAMETERS, n=1, cutoff=0.4)
        hint = f" Did you mean {close[0]}?" if close else ""
        raise OptionError(f"model {model}: there is no such lens.{hint} Usual ones: {', '.join(CANDIDATES)}.")


def chosen_lenses(
    views: Mapping[str, RigViews],
    stated: Mapping[str, str],
    *,
    among: Sequence[str] = (),
    robust: bool,
    most_iterations: int,
) -> list[LensChoice]:
    """Return the lens model of every camera; those with images of the same size get the same one.

    Parameters
    ----------
    views : "cam0", ... -> views of this camera alone
    stated : its model, where one was stated; the others are tried nevertheless
    among : models to choose from; others are tried, too. Empty for the usual ones, of which one that every program
        reads (`lens_names.read_everywhere`) is taken where its hold-out error is within 3 % of the best
    robust, most_iterations : of the estimation

    Raises
    ------
    InitialisationError
        If no lens explains what a camera saw.
    SolveError
        If a stated model cannot be estimated from the views.
    """
    for model in among:
        check_model(model)
    tried = [
        _tried(name, one, stated.get(name), among, robust=robust, most_iterations=most_iterations)
        for name, one in views.items()
    ]
    return [one.choice(_agreed(one, tried, among), restricted=bool(among)) for one in tried]


@value_class
class _Tried:
    """The models of one camera.

    Attributes
    ----------
    name : of the camera
    resolution : of its images [px]
    stated : its model, or None
    fits : model -> its estimate, or why there is none
    costs : model -> what it loses on clusters of views that it has not seen, (c,)
    px : model -> rms of the corners, and of those in views that were left out [px]
    """

    name: str
    resolution: tuple[int, int]
    stated: str | None
    fits: Mapping[str, RigSolution | GnomonError]
    costs: Mapping[str, Floats]
    px: Mapping[str, tuple[float, float]]

    def holdout_ratio(self, model: str) -> float:
        """Return the error of a model on hold-out views over that of the best."""
        return self.px[model][1] / min(self.px[one][1] for one in self.costs)

    def choice(self, model: str, *, restricted: bool) -> LensChoice:
        """Return what follows where a model is taken; `restricted` where a person had a say in it."""
        fit = self.fits[model]
        assert isinstance(fit, RigSolution)
        gain, sigma, better = _gained(self.costs, model) if self.stated or restricted else (0.0, 0.0, "")
        trials = [_trial(self.name, one, self.px.get(one), model) for one in self.fits]
        trials.sort(key=lambda trial: (not trial.chosen, np.nan_to_num(trial.holdout_rms_px, nan=np.inf)))
        return LensChoice(
            camera=self.name,
            lens=fit.rig.cameras[self.name],
            trials=tuple(trials),
            better=better,
            gain=gain,
            gain_sigma=sigma,
        )


def _tried(
    name: str, views: RigViews, stated: str | None, among: Sequence[str], *, robust: bool, most_iterations: int
) -> _Tried:
    """Estimate every model from the views of one camera: roughly from a few, the likely ones from all."""
    models = tuple(dict.fromkeys((*(() if stated is None else (stated,)), *among, *CANDIDATES)))
    general = general_lens(views, 0)
    pixels = view_corners(views, 0).exposures.pixels
    few = np.unique(np.linspace(0, len(views) - 1, min(len(views), _FEW_VIEWS)).round().astype(np.int64))
    start = first_rig(views, {}, {name: general})

    def estimated(model: str, lens: Camera | None, kept: Integers, most: int) -> RigSolution | GnomonError:
        """Return the estimate of a model from some views, or why there is none."""
        try:
            begun = replace(
                start,
                cameras={name: lens or fit_lens_model(general, model, pixels)},
                R_cam0_target=start.R_cam0_target[kept],
                p_cam0_target=start.p_cam0_target[kept],
            )
            with np.errstate(all="ignore"):  # what is not the model of this lens may run away
                return solve_rig(views.where(kept), begun, robust=robust, most_iterations=most)
        except GnomonError as failed:
            return failed
        except np.linalg.LinAlgError:
            return SolveError(f"{model} runs away on these views.")

    fits = {model: estimated(model, None, few, _SOON) for model in models}
    best_px = min((fit.sigma_px[name] for fit in fits.values() if isinstance(fit, RigSolution)), default=np.inf)
    every = np.arange(len(views))
    found: dict[str, RigSolution] = {}
    for model, rough in list(fits.items()):
        if isinstance(rough, RigSolution) and (
            rough.sigma_px[name] < _HOPELESS * best_px or model == stated or model in among
        ):
            fits[model] = fit = estimated(model, rough.rig.cameras[name], every, most_iterations)
            if isinstance(fit, RigSolution):
                found[model] = fit
    if among and not set(among) & set(found):
        raise SolveError(f"{name}: none of {', '.join(among)} can be estimated from its views. {fits[among[0]]}")
    if not found or (stated is not None and stated not in found):
        raise SolveError(f"{name}: {stated or 'no lens'} cannot be estimated from its views. {fits[models[0]]}")
    costs = _held_out(found, views, name)
    px = {model: rms_px(fit, name) for model, fit in fits.items() if isinstance(fit, RigSolution)}
    return _Tried(name=name, resolution=general.resolution, stated=stated, fits=fits, costs=costs, px=px)


def _agreed(one: _Tried, tried: Sequence[_Tried], among: Sequence[str]) -> str:
    """Return the model of a camera: as stated, or that which serves all cameras with images of the same size."""
    if one.stated is not None:
        return one.stated
    alike = [other for other in tried if other.stated is None and other.resolution == one.resolution]
    common = [model for model in one.costs if all(model in other.costs for other in alike)]
    if not common:
        alike, common = [one], list(one.costs)
    allowed = [model for model in common if model in among] if among else common
    if not allowed:
        alike, allowed = [one], [model for model in one.costs if model in among]
    costs = {model: np.concatenate([other.costs[model] for other in alike]) for model in allowed}
    simplest = _simplest(costs)
    return simplest if among else _read_by_all(simplest, alike, costs)


def _read_by_all(model: str, alike: Sequence[_Tried], costs: Mapping[str, Floats]) -> str:
    """Return a model that every program reads, where it predicts hold-out views of each camera about as well as any."""
    known = read_everywhere()
    near = [one for one in known if one in costs and all(other.holdout_ratio(one) < _MATTERS for other in alike)]
    if model in known or not near:
        return model
    return min(near, key=lambda one: float(costs[one].sum()))


def _held_out(found: Mapping[str, RigSolution], views: RigViews, name: str) -> dict[str, Floats]:
    """Return what each model loses on clusters of views that it has not seen, (c,), in one unit for all of them."""
    sigma_px = min(fit.sigma_px[name] for fit in found.values())
    steady = min(found.values(), key=lambda fit: fit.sigma_px[name])
    cluster = time_clusters(IndependentViews.of(steady))
    costs: dict[str, Floats] = {}
    for model, fit in found.items():
        own = _robust_costs(fit.corners[name], sigma_px, len(views))
        left = np.flatnonzero(np.bincount(fit.corners[name].view, minlength=len(views)) == 0)
        if len(left):
            apart = held_out_residuals(views.where(left), fit.rig)[name]
            own[left] = _robust_costs(apart, sigma_px, len(left))
        by_cluster = np.bincount(cluster, own)
        unseen = _rises(fit, cluster) * (fit.sigma_px[name] / sigma_px) ** 2
        costs[model] = by_cluster + unseen
    return costs


def _rises(fit: RigSolution, cluster: Integers) -> Floats:
    """Return how much larger the cost of each cluster is where the estimate has not seen it, (c,); never smaller.

    At a minimum it is s' (S - S_c)^-1 s / 2 and more; where the iterations did not come to rest the sums mislead.
    """
    return np.maximum(held_out_costs(fit.sums.gathered(cluster)), 0.0)


@value_class
class IndependentViews:
    """Views of an estimate, in groups that look alike; each its own where groups are few.

    Attributes
    ----------
    group : (v,) number of the group of each view
    sums : of the groups
    moves : (g, p) how the estimate moves when each group is left out
    """

    group: Integers
    sums: ClusterSums
    moves: Floats

    @classmethod
    def of(cls, fit: RigSolution) -> "IndependentViews":
        """Return the groups of the views of an estimate."""
        alike = views_alike(fit.views)
        group = alike if len(alike) and alike[-1] + 1 >= _FEWEST_GROUPS else np.arange(len(fit.views))
        sums = fit.sums.gathered(group)
        return cls(group=group, sums=sums, moves=leave_clusters_out(sums))


def time_clusters(views: IndependentViews) -> Integers:
    """Return the number of the cluster of each view, (v,): views of one cluster may share errors, as in a video."""
    memory = correlation_time(views.moves, np.zeros(views.moves.shape[1], dtype=np.int64))
    return views.group // cluster_length(len(views.sums), memory)


def _robust_costs(seen: SeenCorners, sigma_px: float, views: int) -> Floats:
    """Return the robust cost of the corners of each view, (views,)."""
    distance = np.linalg.norm(seen.residual, axis=1) / (sigma_px * seen.spread)
    distance = np.where(np.isfinite(distance), np.minimum(distance, _FAR), _FAR)
    cost = np.where(distance < _HUBER, distance**2 / 2, _HUBER * (distance - _HUBER / 2))
    return np.asarray(np.bincount(seen.view, cost, views), dtype=np.float64)


def _simplest(costs: Mapping[str, Floats]) -> str:
    """Return the model with the fewest parameters that is not worse than the best beyond their difference's scatter."""
    best = min(costs, key=lambda model: float(costs[model].sum()))
    for model in sorted(costs, key=_PARAMETERS.__getitem__):
        loss, sigma = _difference(costs[model], costs[best])
        if loss <= max(sigma, _LEAST_GAIN):
            return model
    return best


def _gained(costs: Mapping[str, Floats], stated: str) -> tuple[float, float, str]:
    """Return what the best model gains over the stated one, its standard deviation, and its name if that is certain."""
    best = min(costs, key=lambda model: float(costs[model].sum()))
    gain, sigma = _difference(costs[stated], costs[best])
    return gain, sigma, best if gain > max(3 * sigma, 2 * _LEAST_GAIN) else ""


def _difference(one: Floats, other: Floats) -> tuple[float, float]:
    """Return the sum of the differences of clusters, and its standard deviation."""
    apart = one - other
    return float(apart.sum()), float(np.sqrt(len(apart)) * np.std(apart, ddof=1)) if len(apart) > 1 else 0.0


def _trial(name: str, model: str, px: tuple[float, float] | None, chosen: str) -> LensTrial:
    rms, unseen = px or (float("nan"), float("nan"))
    return LensTrial(
        camera=name,
        model=model,
        chosen=model == chosen,
        holdout_rms_px=unseen,
        rms_px=rms,
        parameters=_PARAMETERS[model],
    )


def rms_px(fit: RigSolution, name: str) -> tuple[float, float]:
    """Return the rms of the corners of the only camera, per axis, and what it is in views that were left out [px]."""
    residual = fit.corners[name].residual
    residual = residual[np.isfinite(residual[:, 0])]
    square = float(np.sum(residual**2))
    more = 2 * fit.sigma_px[name] ** 2 * float(_rises(fit, time_clusters(IndependentViews.of(fit))).sum())
    count = max(residual.size, 1)
    return float(np.sqrt(square / count)), float(np.sqrt(max(square + more, 0.0) / count))
