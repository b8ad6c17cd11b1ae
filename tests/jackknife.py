"""The jackknife over clusters in its plain form."""

import numpy as np

from gnomon.estimate.trust.clusters import ClusterSums, leave_clusters_out


def jackknife_covariance(sums: ClusterSums) -> np.ndarray:
    """Return the covariance (p, p) by leaving out clusters (CR3); what was known beforehand counts as it was stated."""
    moves, count = leave_clusters_out(sums), len(sums)
    total = np.linalg.inv(sums.total)
    return (count - 1) / count * moves.T @ moves + total @ sums.prior_information @ total
