"""Statistics on plain arrays: numpy and scipy, nothing of ours. One idea a file."""
