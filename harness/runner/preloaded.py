"""What the processes of a run have imported before they are forked."""

from __future__ import annotations

import gc


def load(device: str) -> None:
    """Import what trials need, and make Mitsuba ready where that starts no thread.

    A GPU cannot be handed to a forked process once it is in use: for one, Dr.Jit and Mitsuba are
    left to each worker.
    """
    from harness.runner import global_state

    global_state.settle()
    if device == "cpu":
        from harness.mitsuba_runtime import variant

        variant.use(device)
        from harness.runner import carry_out  # noqa: F401

        _measures()
    # What is there now is not looked at again by each worker's collector, which would copy it.
    gc.collect()
    gc.freeze()


def _measures() -> None:
    from harness.measures import registry

    for name in registry.names():
        registry.load(name)
