"""Statistics on plain arrays: numpy and scipy, nothing of ours. One idea a file."""

from harness.stats.cells import Cells
from harness.stats.chisquare import ChiSquare, chi_square, sidak
from harness.stats.crossing import Crossing, crossing, envelope
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
    log_speed_up,
    mean_interval,
    median_interval,
    ratio_of_means,
    ratio_of_medians,
    speed_up,
)
from harness.stats.levels import (
    Spread,
    over_seeds_draws,
    share_interval,
    spread_by_level,
    two_level_mean,
)
from harness.stats.log_estimate import (
    LogEstimate,
    log_mean,
    log_median,
    log_ratio_of_medians,
)
from harness.stats.moments import one_sample_variance, variance_from_batches
from harness.stats.ztest import Agreement, agreement, holm

__all__ = [
    "Agreement",
    "Cells",
    "ChiSquare",
    "Crossing",
    "Interval",
    "LogEstimate",
    "Spread",
    "agreement",
    "chi_square",
    "chi_square_divergence",
    "crossing",
    "envelope",
    "geometric_mean",
    "geometric_mean_of",
    "holm",
    "kl_divergence",
    "log_mean",
    "log_median",
    "log_ratio_of_medians",
    "log_speed_up",
    "lost_share",
    "mean_interval",
    "mean_squared_error",
    "median_interval",
    "one_sample_variance",
    "over_seeds_draws",
    "ratio_of_means",
    "ratio_of_medians",
    "share_interval",
    "sidak",
    "speed_up",
    "spread_by_level",
    "two_level_mean",
    "variance_from_batches",
]
