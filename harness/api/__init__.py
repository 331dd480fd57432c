"""What ``import harness`` offers besides the protocol: one idea a file."""
