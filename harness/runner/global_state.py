"""What a job has no business to change, looked at before and after it.

A method that sets torch's default type, replaces ``torch.Tensor.mean`` or leaves a thread running
changes the numbers and times of whatever runs after it in the same process. The difference of two
looks is a finding about the method, in words.
"""

from __future__ import annotations

import gc
import os
import random
import resource
import signal
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import BuiltinFunctionType, FunctionType, ModuleType
from typing import Any

import numpy as np
import torch

MODULES = (
    *("builtins", "math", "random", "time", "os"),
    *("numpy", "numpy.linalg", "numpy.random", "scipy.special", "scipy.stats"),
    *("torch", "torch.nn", "torch.nn.functional", "torch.linalg", "torch.special", "drjit"),
)
"""Modules whose functions and classes are to stay what they are, besides all of ours."""
CLASSES = (torch.Tensor, torch.nn.Module, torch.Generator, torch.optim.Adam)
OURS = ("harness.",)
_SHOWN = 60
_OF_PYTHON = "multiprocessing.resource_tracker"
"""A process that Python keeps beside those that it spawned."""


@dataclass(frozen=True)
class GlobalState:
    """One look: ``values`` by what they are, ``objects`` by their full names."""

    values: dict[str, Any]
    objects: dict[str, Any]


def seed_all(seed: int) -> None:
    """Seed the random numbers that anybody may draw from: of torch, numpy and Python."""
    torch.manual_seed(seed)
    np.random.seed(seed % (1 << 32))
    random.seed(seed)


def look() -> GlobalState:
    """The state now; a few milliseconds."""
    return GlobalState(_values(), dict(_objects()))


def changes(before: GlobalState, after: GlobalState) -> list[str]:
    """What is different ``after``, a sentence each; what is new is no change."""
    found = []
    for name, was in before.values.items():
        now = after.values.get(name)
        if now != was:
            found.append(_sentence(name, was, now))
    for name, was in before.objects.items():
        if name in after.objects and after.objects[name] is not was:
            found.append(f"replaces {name}")
        elif name not in after.objects:
            found.append(f"removes {name}")
    return found


def _sentence(name: str, was: Any, now: Any) -> str:
    if isinstance(was, frozenset):
        return f"leaves {name}: {_short(', '.join(sorted(map(str, now - was))) or 'fewer')}"
    if isinstance(was, dict):
        keys = sorted(k for k in {*was, *now} if was.get(k) != now.get(k))
        return f"changes {name}: {_short(', '.join(keys))}"
    if isinstance(was, int) and name.endswith("random state"):
        return f"changes {name}"
    return f"changes {name} from {_short(was)} to {_short(now)}"


def _values() -> dict[str, Any]:
    found = {
        "torch's default dtype": torch.get_default_dtype(),
        "torch's default device": str(torch.get_default_device()),
        "whether torch records gradients": torch.is_grad_enabled(),
        "torch's inference mode": torch.is_inference_mode_enabled(),
        "torch's number of threads": torch.get_num_threads(),
        "torch's deterministic mode": torch.are_deterministic_algorithms_enabled(),
        "torch's precision of matrix products": torch.get_float32_matmul_precision(),
        # Drawing from it is what initialising a torch.nn.Module does; seeding it is another thing.
        "the seed of torch's global random state": torch.initial_seed(),
        "numpy's global random state": _numbered(np.random.get_state()),
        "Python's global random state": hash(random.getstate()),
        "numpy's handling of errors": str(np.geterr()),
        "the working folder": _working_folder(),
        "environment variables": dict(os.environ),
        "handlers of signals": {s.name: str(signal.getsignal(s)) for s in signal.Signals},
        "threads running": frozenset(
            t.name for t in threading.enumerate() if t is not threading.main_thread()
        ),
        "processes running": frozenset(_children()),
        "the cores it may use": sorted(os.sched_getaffinity(0)),
        "the priority": os.getpriority(os.PRIO_PROCESS, 0),
        "the limit of open files": resource.getrlimit(resource.RLIMIT_NOFILE),
        "the limit of memory": resource.getrlimit(resource.RLIMIT_AS),
        "the recursion limit": sys.getrecursionlimit(),
        "the collection of garbage": gc.isenabled(),
        "the tracing function": str(sys.gettrace()),
        "the import path": tuple(sys.meta_path) == _META_PATH or str(sys.meta_path),
    }
    if (dr := sys.modules.get("drjit")) is not None:
        found["Dr.Jit's number of threads"] = dr.thread_count()
        found["Dr.Jit's flags"] = {f.name: dr.flag(f) for f in dr.JitFlag}
    return found


def _objects() -> Iterator[tuple[str, Any]]:
    """Functions and classes by full name; data of modules may change and do."""
    for name, module in list(sys.modules.items()):
        if name in MODULES or name.startswith(OURS):
            yield from _callables(name, vars(module))
            if name.startswith(OURS):
                for key, value in list(vars(module).items()):
                    if isinstance(value, type) and value.__module__ == name:
                        yield from _callables(f"{name}.{key}", vars(value))
    for kind in CLASSES:
        # What a class inherits may be replaced in the class itself.
        for key in dir(kind):
            if callable(value := getattr(kind, key, None)) and not isinstance(value, type):
                yield f"{kind.__module__}.{kind.__qualname__}.{key}", _itself(kind, key, value)


def _callables(name: str, names: Any) -> Iterator[tuple[str, Any]]:
    for key, value in list(names.items()):
        plain = isinstance(value, FunctionType | BuiltinFunctionType | type)
        if (plain or callable(value)) and not isinstance(value, ModuleType):
            yield f"{name}.{key}", value


def _itself(kind: type, key: str, value: Any) -> Any:
    """The object in the class that has it: a bound method is another with every look."""
    for base in kind.__mro__:
        if key in vars(base):
            return vars(base)[key]
    return value


def _numbered(state: Any) -> int:
    return hash((state[0], state[1].tobytes(), *state[2:]))


def _working_folder() -> str:
    try:
        return os.getcwd()
    except OSError:
        return "one that is gone"


def _children() -> Iterator[str]:
    """Command lines of processes that this one started and that still run."""
    for task in Path("/proc/self/task").glob("*/children"):
        for pid in task.read_text().split():
            try:
                line = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
                state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
            except OSError:
                continue
            if _OF_PYTHON not in line and state != "Z":
                yield f"{pid} {line.strip()}"


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


_META_PATH = tuple(sys.meta_path)
