"""``python -m harness.core.compiled``: builds the kernels for this machine, or says why not."""

from __future__ import annotations

import sys

from harness.core.compiled import library
from harness.core.protocol.errors import InputError


def main() -> int:
    """One line; status 1 where there are no kernels, 2 for a wrong environment variable."""
    try:
        made = library.found()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if isinstance(made, str):
        print(f"no compiled kernels ({made}): {library.WITHOUT}")
        return 1
    print(f"compiled kernels for {made.name}, {made.build_seconds + made.load_seconds:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
