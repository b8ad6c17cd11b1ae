"""What follows from the trust in a result: sigmas that the model does not explain, and parts that disagree."""

from collections.abc import Sequence

from ..findings import Finding, make_finding
from ..trust import SigmaRatio, Splits, Trust, TrustNote

_INCOMPLETE = 2.0
"""Published sigma over that for independent errors from which on the model leaves something out."""

_SHOWN = 3


def trust_note(trust: Trust) -> TrustNote:
    """Return what the calibration file keeps."""
    clusters = trust.clusters
    return TrustNote(
        covariance="ordinary" if clusters is None else "cluster-robust",
        clusters=0 if clusters is None else clusters.count,
        cluster_s=0.0 if clusters is None else clusters.length_s,
        sigma_ratio={entry.block: entry.ratio for entry in trust.ratios},
        split_z=float("nan") if trust.splits is None else trust.splits.z_rms,
    )


def incomplete(trust: Trust) -> list[SigmaRatio]:
    """Return the blocks whose errors are larger than independent errors would be, the worst first."""
    wide = [entry for entry in trust.ratios if entry.ratio > _INCOMPLETE]
    return sorted(wide, key=lambda entry: -entry.ratio) if trust.clusters is not None else []


def model_incomplete(trust: Trust, likely: Sequence[str] = (), cure: str = "") -> list[Finding]:
    """Say where errors are larger than independent errors would be: the model leaves something out.

    Parameters
    ----------
    trust : of a result
    likely : what the residuals show to be missing, as parts of a sentence
    cure : the next step
    """
    wide = incomplete(trust)
    if not wide or trust.clusters is None:
        return []
    listed = ", ".join(f"{entry.block} {entry.ratio:.2g} times" for entry in wide[:_SHOWN])
    more = f" and {len(wide) - _SHOWN} more" if len(wide) > _SHOWN else ""
    missing = f" Likely missing: {'; '.join(likely)}." if likely else ""
    return [
        make_finding(
            "model-incomplete/rig",
            lasting=_lasting(trust.clusters.memory_s),
            listed=listed,
            more=more,
            stretches=trust.clusters.count,
            missing=missing,
            cure=cure,
        )
    ]


def _lasting(memory_s: float) -> str:
    return f"Errors that last for {memory_s:.2g} s" if memory_s > 0 else "Errors of different size"


def parts_disagree(splits: Splits | None, cure: str = "") -> list[Finding]:
    """Say that parts of the recording contradict each other by more than their sigmas allow."""
    if splits is None or splits.z_rms <= splits.limit:
        return []
    worst = max(splits.blocks, key=lambda entry: entry.z_rms)
    return [
        make_finding(
            "parts-disagree",
            splits=", ".join(splits.splits),
            z_rms=splits.z_rms,
            limit=splits.limit,
            block=worst.block,
            largest=worst.largest,
            where=worst.where,
            case="explained" if cure else "",
            cure=cure,
        )
    ]
