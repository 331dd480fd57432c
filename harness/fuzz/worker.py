"""``python -m harness.fuzz.worker KIND``: tries inputs by their seeds, a line of input each.

A kind is one of ``KINDS``, or the class of another as ``module:Class``.

A process of its own, since what is wrong may hang, take all memory or end the process. It may
take ``MEMORY`` bytes beyond what it has once all is imported.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import sys
import tempfile
import traceback
from importlib import import_module
from pathlib import Path

from harness.fuzz.attempt import Fuzz, outcome

KINDS = {
    "suites": "harness.fuzz.suites:Suites",
    "stores": "harness.fuzz.stores:Stores",
    "checkpoints": "harness.fuzz.checkpoints:Checkpoints",
    "scenes": "harness.fuzz.scenes:Scenes",
}
MEMORY = 2**30


def main() -> None:
    """Read seeds until there are none; say a line of JSON about each."""
    said = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print is no answer
    module, _, name = KINDS.get(sys.argv[1], sys.argv[1]).partition(":")
    with tempfile.TemporaryDirectory(prefix="harness-fuzz-") as folder:
        fuzz: Fuzz = getattr(import_module(module), name)(Path(folder))
        most = _taken() + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        print("ready", file=said, flush=True)
        for line in sys.stdin:
            print(json.dumps(_tried(fuzz, int(line))), file=said, flush=True)


def _tried(fuzz: Fuzz, seed: int) -> dict[str, str]:
    here = os.getcwd()
    try:
        kind, text = outcome(fuzz, seed)
        return {"kind": kind, "text": text}
    except MemoryError:
        return {"kind": "wrong", "text": "more than 1 GiB of memory: " + traceback.format_exc()}
    except Exception:
        return {"kind": "wrong", "text": traceback.format_exc()}
    finally:
        os.chdir(here)
        for item in fuzz.folder.iterdir():
            if item.is_dir() and not item.is_symlink():
                shutil.rmtree(item)
            else:
                item.unlink()


def _taken() -> int:
    """Bytes of address space of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return pages * os.sysconf("SC_PAGE_SIZE")


if __name__ == "__main__":
    main()
