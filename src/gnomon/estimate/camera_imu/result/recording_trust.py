"""How far a recording lets its own calibration be trusted: published sigmas against ordinary ones, and its parts."""

import numpy as np

from ....recording import Floats, Integers
from ....results.parameters import covariance_names
from ....results.trust import SigmaRatio, Splits, Trust
from ...trust.changes import parameter_changes
from ...trust.parts import Split, part_agreement, part_differences
from .publish import PublishedRig
from .uncertainty import TimeClusters, Uncertainty, cluster_robust_covariance

_LABELS = {
    "halves": ("first half", "second half"),
    "thirds": ("first third", "second third", "last third"),
}
_SHORTEST_PART_S = 5.0
"""A shorter part determines too little for itself."""


def recording_trust(result: PublishedRig, found: Uncertainty) -> Trust:
    """Return what the recording tells of the uncertainty of what is published."""
    names = np.array(covariance_names(result.imus, result.cameras))
    estimated = np.diag(result.ordinary) > 0
    sigma, ordinary = (np.sqrt(np.diag(covariance)) for covariance in (result.covariance, result.ordinary))
    paths = [name.partition("[")[0] for name in names.tolist()]
    blocks = {path: np.flatnonzero(estimated & (np.array(paths) == path)) for path in dict.fromkeys(paths)}
    blocks = {path: members for path, members in blocks.items() if len(members)}
    by_time = found.by_time
    return Trust(
        clusters=None if by_time is None else by_time.clusters,
        names=tuple(names[estimated].tolist()),
        ordinary_sigma=ordinary[estimated],
        sigma=sigma[estimated],
        ratios=tuple(
            SigmaRatio(block=path, ratio=float(np.sqrt(np.mean((sigma[members] / ordinary[members]) ** 2))))
            for path, members in blocks.items()
        ),
        splits=None if by_time is None else _splits(by_time, result.jacobian, names, blocks),
        changes=()
        if by_time is None
        else parameter_changes(by_time.stretches, result.jacobian @ by_time.scalars, names.tolist(), judged=estimated),
    )


def _splits(by_time: TimeClusters, jacobian: Floats, names: np.ndarray, blocks: dict[str, Integers]) -> Splits | None:
    """Compare halves and thirds in everything but the biases, which wander indeed."""
    compared = {path: members for path, members in blocks.items() if not path.endswith(".bias")}
    counts = np.zeros(len(names), dtype=bool)
    counts[np.concatenate([np.zeros(0, np.int64), *compared.values()])] = True
    since = by_time.stretches.t_s - by_time.stretches.t_s[0]
    share = since / (since[-1] + since[1])
    splits = [
        Split(name=name, part=np.floor(len(labels) * share).astype(np.int64), labels=labels, counts=counts)
        for name, labels in _LABELS.items()
        if since[-1] > len(labels) * _SHORTEST_PART_S
    ]
    if not splits or not counts.any():
        return None
    scalars = jacobian @ by_time.scalars
    number = np.unique([name.partition("[")[0] for name in names], return_inverse=True)[1].astype(np.int64)
    wider = cluster_robust_covariance(by_time.phases, scalars, number)
    found = part_differences(by_time.stretches, scalars, wider, splits)
    return part_agreement(found, splits, tuple(names.tolist()), compared) if len(found) else None
