"""``harness check``: is an adapter a correct sampler? Properties, each with its own test."""

from harness.check.finding import Finding
from harness.check.run import CHECK_BUDGET, FALSE_ALARM, run_checks

__all__ = ["CHECK_BUDGET", "FALSE_ALARM", "Finding", "run_checks"]
