"""``harness check``: is an adapter a correct sampler? Properties, each with its own test."""
