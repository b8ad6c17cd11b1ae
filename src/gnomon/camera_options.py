"""What a person may choose about the calibration of cameras; the command line is made from these classes."""

from dataclasses import dataclass
from typing import Literal, get_args

from .errors import OptionError
from .ranges import check_ranges

BoardModel = Literal["auto", "stated", "aspect", "bow", "corners"]
CovarianceKind = Literal["robust", "ordinary"]
BOARDS, COVARIANCES = get_args(BoardModel), get_args(CovarianceKind)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraOptions:
    """How to calibrate one or several cameras from views of a board."""

    model: tuple[str, ...] = ()
    """Lens model of every camera, such as pinhole-radtan, or of each, cam0=pinhole-radtan cam1=ds-none; chosen by
    hold-out where it is not given."""

    among: tuple[str, ...] = ()
    """Lens models to choose from, such as pinhole-radtan pinhole-equidistant; the usual ones where not given, of which
    one that every program reads is taken where it predicts hold-out views within 3 % of the best."""

    board: BoardModel = "auto"
    """What of the board is estimated: nothing (stated), its scale along y over that along x (aspect), how it bends too
    (bow), the place of every corner (corners), or what the views prove to be there (auto)."""

    views: int | None = None
    """Most views to use, the most informative ones; chosen by what further ones would add where it is not given."""

    baseline: float | None = None
    """Measured distance of cam1 from cam0 in metres, which tells the true size of the board."""

    baseline_sigma: float = 1e-4
    """Standard deviation of that distance in metres."""

    robust: bool = True
    """Single corners that fit badly count less (Huber), and whole views that do are left out; with --no-robust all of
    them count alike."""

    covariance: CovarianceKind = "robust"
    """Take the uncertainty from the scatter between views, which holds where the errors of a view are correlated
    (robust), or count all errors as independent (ordinary)."""

    max_iterations: int = 50
    """Most iterations of one solution."""

    def __post_init__(self) -> None:
        check_ranges(self)
        if isinstance(self.model, str):  # one name, as people write it in Python
            object.__setattr__(self, "model", (self.model,))
        if isinstance(self.among, str):
            object.__setattr__(self, "among", (self.among,))
        if self.model and self.among:
            raise OptionError("model states the lens, and among from which it is chosen. Leave out one of them.")
        for name, known in (("board", BOARDS), ("covariance", COVARIANCES)):
            if getattr(self, name) not in known:
                raise OptionError(f"{name} {getattr(self, name)!r} must be one of {', '.join(known)}.")
        for name in ("views", "baseline", "baseline_sigma", "max_iterations"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise OptionError(f"{name} {value:g} must be greater than zero.")
