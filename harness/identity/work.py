"""What a computation makes the machine do: kernels of Dr.Jit and operations of torch.

Equal numbers may take unequal time. A time stands after a change of code only if the same kernels
run on the same sizes, and the same tensor operations in the same order.
"""

from __future__ import annotations

import gc
import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any


@dataclass
class Work:
    """``kernels`` as (size, operations, inputs) and ``operations`` as (name, shapes), in order.

    The hash of a kernel is left out: it differs between two scenes that are built alike.
    """

    kernels: list[tuple[int, int, int]] = field(default_factory=list)
    operations: list[tuple[str, str]] = field(default_factory=list)

    @property
    def digest(self) -> str:
        """Equal for equal work."""
        text = repr((self.kernels, self.operations))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


@contextmanager
def recorded() -> Iterator[Work]:
    """The work of the block; known when it ends."""
    import drjit as dr
    from torch.utils._python_dispatch import TorchDispatchMode

    from harness.core.compiled import history

    work = Work()
    gc.collect()  # what is freed meanwhile would be evaluated first
    dr.sync_thread()

    class Watch(TorchDispatchMode):
        def __torch_dispatch__(
            self, func: Any, types: Any, args: Any = (), kwargs: Any = None
        ) -> Any:
            shapes = [tuple(a.shape) for a in args if hasattr(a, "shape")]
            work.operations.append((str(func), str(shapes)))
            return func(*args, **(kwargs or {}))

    before = dr.flag(dr.JitFlag.KernelHistory)
    dr.set_flag(dr.JitFlag.KernelHistory, True)
    dr.kernel_history_clear()
    try:
        with Watch(), history.recorded() as runs:
            yield work
        dr.sync_thread()
        work.operations += [(run.what, str(run.rows)) for run in runs]
        work.kernels += [
            (int(entry["size"]), int(entry["operation_count"]), int(entry["input_count"]))
            for entry in dr.kernel_history()
            if entry["type"] == dr.KernelType.JIT
        ]
    finally:
        dr.kernel_history_clear()
        dr.set_flag(dr.JitFlag.KernelHistory, before)
