"""Peak memory of one piece of work, by the system's own account of this process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import drjit as dr
import torch

from harness.core import allocator
from harness.core.protocol.errors import Unsupported

_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def peak_bytes(work: Callable[[], object], device: str) -> int:
    """Bytes above what was held before, at the worst moment of ``work``.

    On the CPU the kernel's high-water mark of resident memory, of the whole process: run it
    in one that does nothing else. (``ru_maxrss`` will not do, for a child inherits its
    parent's.) Elsewhere what torch and Dr.Jit allocated on the device.

    Raises:
        Unsupported: the system does not let a process reset its high-water mark.
    """
    _give_back()
    return _on_cpu(work) if device == "cpu" else _on_gpu(work, device)


def _give_back() -> None:
    """What is free in this process, to the system: to use it again counts as much as new memory."""
    dr.flush_malloc_cache()
    allocator.give_back()


def _on_cpu(work: Callable[[], object]) -> int:
    try:
        # 5: set the high-water mark to what is resident now; see proc(5).
        _RESET.write_text("5")
    except OSError as error:
        raise Unsupported(f"{_RESET}: {error.strerror}; there is no peak without it") from None
    before = _high_water()
    kept = work()
    after = _high_water()
    del kept
    return after - before


def _high_water() -> int:
    for line in _STATUS.read_text().splitlines():
        if line.startswith("VmHWM:"):
            return 1024 * int(line.split()[1])
    raise Unsupported(f"{_STATUS} has no VmHWM")


def _on_gpu(work: Callable[[], object], device: str) -> int:
    torch.cuda.synchronize(device)
    torch.cuda.empty_cache()
    torch.cuda.reset_peak_memory_stats(device)
    held = torch.cuda.memory_allocated(device)
    # Dr.Jit keeps what it freed, so that what the device lacks afterwards, over torch's own
    # pool, is the most that Dr.Jit held.
    pool, free = torch.cuda.memory_reserved(device), torch.cuda.mem_get_info(device)[0]
    kept = work()
    torch.cuda.synchronize(device)
    pool = torch.cuda.memory_reserved(device) - pool
    lacking = free - torch.cuda.mem_get_info(device)[0]
    peak = torch.cuda.max_memory_allocated(device) - held
    del kept
    return peak + lacking - pool
