"""How far a result can be trusted, as the recording itself tells: values that estimators of all kinds hand on.

Parameters are grouped in blocks, named by their path in the calibration file, such as
"imu0.accelerometer.sensitivity", "cam0.T_cam_imu.translation" or "cam0.time_shift_cam_imu".
"""

from collections.abc import Mapping
from dataclasses import field
from typing import Literal, get_args

from ..frozen import value_class
from ..recording import Floats

Verdict = Literal["pass", "warn", "fail"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
"""The best first."""
CovarianceKind = Literal["cluster-robust", "ordinary", "between-recordings"]


@value_class(eq=True)
class Clusters:
    """Clusters of time whose residuals are taken for independent of each other.

    Attributes
    ----------
    count : number of clusters
    length_s : length of one [s]
    memory_s : after which residuals have forgotten each other [s]
    """

    count: int
    length_s: float
    memory_s: float


@value_class(eq=True)
class SigmaRatio:
    """How much larger the published sigmas of a block are than those for independent errors (Fisher).

    Attributes
    ----------
    block : path
    ratio : root mean square over the scalars of the block that were estimated
    """

    block: str
    ratio: float


@value_class(eq=True)
class BlockAgreement:
    """How parts of one recording agree on a block of parameters.

    z is the difference of two parts' estimates over its standard deviation.

    Attributes
    ----------
    block : path
    comparisons : number of z values
    z_rms : by the published covariance; 1 is honest
    z_rms_ordinary : by the covariance for independent errors
    largest : largest |z|, published covariance
    where : what disagrees most, such as "[0], first and second half"
    """

    block: str
    comparisons: int
    z_rms: float
    z_rms_ordinary: float
    largest: float
    where: str


@value_class(eq=True)
class Splits:
    """Parts of one recording, each calibrated for itself and compared.

    Attributes
    ----------
    splits : how it was cut, such as ("halves", "thirds")
    blocks : one by one
    z_rms, z_rms_ordinary : pooled over all blocks and splits
    limit : pooled z_rms that honest sigmas exceed in one of a hundred recordings
    """

    splits: tuple[str, ...]
    blocks: tuple[BlockAgreement, ...]
    z_rms: float
    z_rms_ordinary: float
    limit: float


@value_class
class ParameterChange:
    """A block of parameters that differs between two parts of one recording, all others being common to both.

    Attributes
    ----------
    block : path
    names : (k,) of its scalars
    values : (k,) second part minus first [published unit]
    covariance : (k, k) of these, by the scatter of what is left once the change is in the model
    where : the parts, such as "after 61.2 s, against the time before"
    at_s : from when on, where it changed at once; else nan [s]
    chance : that a recording in which nothing changed shows as much, all looks counted
    """

    block: str
    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    where: str
    chance: float
    at_s: float = float("nan")


@value_class(eq=True)
class BlockChange:
    """How far a step of the model moved a block: largest change [unit], and in sigmas of the larger model."""

    block: str
    change: float
    unit: str
    sigmas: float


@value_class(eq=True)
class ModelStep:
    """One step of the model choice: a block of parameters that may be added to the model.

    Attributes
    ----------
    name : "basic", "scale", "misalignment", "g-sensitivity", "lever arms", "board", "intrinsics", "coloured noise", ...
    parameters : scalars that it adds
    gain : held-out log-likelihood that it adds, summed over the clusters of time
    gain_sigma : its standard deviation, from the scatter between the clusters
    needed : what the gain must exceed, the number of tries accounted for
    used : whether it is in the model
    forced : whether a person said so
    changes : what it moved, most first
    """

    name: str
    parameters: int
    gain: float
    gain_sigma: float
    needed: float
    used: bool
    forced: bool = False
    changes: tuple[BlockChange, ...] = ()


@value_class(eq=True)
class WeakDirection:
    """A combination of parameters that the recording hardly determines.

    Attributes
    ----------
    shares : scalar name -> its part of the unit vector, in sigmas of what was assumed beforehand; largest first
    determined : share of the prior's variance that the recording removed, 0 (nothing) to 1
    words : a sentence in motions and parameters
    cure : the motion that would determine it
    held : whether a prior holds it
    """

    shares: tuple[tuple[str, float], ...]
    determined: float
    words: str
    cure: str
    held: bool


@value_class
class Trust:
    """All that one recording tells of its own calibration's uncertainty.

    Attributes
    ----------
    clusters : from which the covariance came; None where it is that for independent errors
    names : (n,) scalars as in `Covariance.names`, those that were estimated
    ordinary_sigma : (n,) standard deviations for independent errors
    sigma : (n,) published standard deviations
    ratios : of both, block by block
    splits : None where the recording is too short to be cut
    models : steps of the model choice, in their order; empty where there was no choice
    weak : directions that are hardly determined, the weakest first
    changes : blocks that changed during the recording, most certain first
    """

    clusters: Clusters | None
    names: tuple[str, ...]
    ordinary_sigma: Floats
    sigma: Floats
    ratios: tuple[SigmaRatio, ...] = ()
    splits: Splits | None = None
    models: tuple[ModelStep, ...] = ()
    weak: tuple[WeakDirection, ...] = ()
    changes: tuple[ParameterChange, ...] = ()


@value_class(eq=True)
class Need:
    """What a use needs of a block, and what the calibration offers.

    Attributes
    ----------
    block : what is needed, such as "rotation of cam0" or "gyroscope scale"
    sigma : largest published standard deviation of it [unit]
    needed : standard deviation up to which it passes [unit]
    unit : such as "deg", "mm", "ms", "%"
    verdict : "pass"; "warn" beyond what is needed; "fail" far beyond
    cure : the next action, where it does not pass
    floor : standard deviation by which the sensor itself differs on another occasion, which one recording cannot know
        and `sigma` therefore does not hold [unit]; 0 where `sigma` holds it, as of several recordings
    """

    block: str
    sigma: float
    needed: float
    unit: str
    verdict: Verdict
    cure: str = ""
    floor: float = 0.0


@value_class(eq=True)
class QuantityChange:
    """A quantity that changed during the recording.

    Attributes
    ----------
    block : path of the parameters that changed
    quantity : such as "gyroscope_scale", as in a file of requirements; "lens" [px, rms over the image]
    sensor : such as "imu0" or "cam0"
    size, sigma : of the change [SI, px]
    where : between which parts of the recording
    at_s : from when on, where it changed at once [s]
    """

    block: str
    quantity: str
    sensor: str
    size: float
    sigma: float
    where: str
    at_s: float | None = None


@value_class(eq=True)
class UncertaintySummary:
    """What the calibration file keeps of all this.

    Attributes
    ----------
    covariance : "cluster-robust" or "ordinary"; of several recordings "between-recordings": that of the sensor as it is
        on another occasion, about the mean
    clusters, cluster_s : number and length [s] of the clusters; 0 for the ordinary covariance
    sigma_ratio : block -> published sigmas over those for independent errors
    split_z : pooled z rms of halves and thirds; nan where the recording was not cut
    added : steps of the model choice beyond the IMU's model that are in the model, such as "intrinsics"
    tries : number of models that were compared
    use : what it was judged for, such as "vio"; "" where for no special use
    needs : what that use needs
    recordings : how many recordings of one sensor were joined; 0 of a single one
    between : quantity, such as "accelerometer_scale" -> standard deviation from recording to recording [SI], part of
        the covariance; empty of a single recording
    changes : what changed during the recording
    """

    covariance: CovarianceKind = "ordinary"
    clusters: int = 0
    cluster_s: float = 0.0
    sigma_ratio: Mapping[str, float] = field(default_factory=dict[str, float])
    split_z: float = float("nan")
    added: tuple[str, ...] = ()
    tries: int = 0
    use: str = ""
    needs: tuple[Need, ...] = ()
    recordings: int = 0
    between: Mapping[str, float] = field(default_factory=dict[str, float])
    changes: tuple[QuantityChange, ...] = ()
