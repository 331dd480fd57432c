"""Statistics on plain arrays: numpy and scipy, nothing of ours. One idea a file."""

from harness.stats.cells import Cells
from harness.stats.chisquare import ChiSquare, chi_square, sidak
from harness.stats.divergence import (
    chi_square_divergence,
    kl_divergence,
    lost_share,
    mean_squared_error,
)
from harness.stats.intervals import (
    Interval,
    geometric_mean,
    geometric_mean_of,
    mean_interval,
    median_interval,
    ratio_of_means,
    ratio_of_medians,
    speed_up,
)
from harness.stats.log_estimate import LogEstimate, log_mean, log_ratio_of_medians
from harness.stats.moments import Moments, one_sample_variance, variance_from_batches
from harness.stats.ztest import Agreement, agreement, holm

__all__ = [
    "Agreement",
    "Cells",
    "ChiSquare",
    "Interval",
    "LogEstimate",
    "Moments",
    "agreement",
    "chi_square",
    "chi_square_divergence",
    "geometric_mean",
    "geometric_mean_of",
    "holm",
    "kl_divergence",
    "log_mean",
    "log_ratio_of_medians",
    "lost_share",
    "mean_interval",
    "mean_squared_error",
    "median_interval",
    "one_sample_variance",
    "ratio_of_means",
    "ratio_of_medians",
    "sidak",
    "speed_up",
    "variance_from_batches",
]
