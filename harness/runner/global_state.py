"""What a job has no business to change, looked at before and after it.

A method that sets torch's default type, replaces ``torch.Tensor.mean`` or leaves a thread running
changes the numbers and times of whatever runs after it in the same process. The difference of two
looks is a finding about the method, in words.
"""

from __future__ import annotations

import gc
import operator
import os
import random
import resource
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
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
FOLLOWS = ("torch.Storage",)
"""What is another object where a value above is another."""
WORKER = "BSDF_HARNESS_WORKER"
"""Environment variable with the process of a worker, for what it starts."""
_SHOWN = 60
_OF_PYTHON = "multiprocessing.resource_tracker"
"""A process that Python keeps beside those that it spawned."""


@dataclass(frozen=True)
class _Names:
    """What a module or class holds, by name; of a class also those that it inherits from."""

    inside: dict[str, Any]
    bases: tuple[type, ...] = ()


@dataclass(frozen=True)
class GlobalState:
    """One look: ``values`` by what they are, ``names`` by the full name of a module or class."""

    values: dict[str, Any]
    names: dict[str, _Names]


def settle() -> None:
    """Let torch change itself, which it does when an optimiser first steps: no method did it.

    The import of its compiler replaces ``torch.manual_seed`` and sets an environment variable, the
    first step replaces ``Adam.step``. No thread is started.
    """
    import torch._dynamo

    parameter = torch.nn.Parameter(torch.zeros(1))
    parameter.grad = torch.zeros(1)
    torch.optim.Adam([parameter]).step()


def seed_all(seed: int) -> None:
    """Seed the random numbers that anybody may draw from: of torch, numpy and Python."""
    torch.manual_seed(seed)
    np.random.seed(seed % (1 << 32))
    random.seed(seed)


def look(known: GlobalState | None = None) -> GlobalState:
    """The state now; some milliseconds, less with an earlier look since which no name changed."""
    return GlobalState(_values(), known.names if known is not None else _names())


def changes(before: GlobalState, after: GlobalState) -> list[str]:
    """What is different ``after``, a sentence each; what is new is no change."""
    found = []
    for name, was in before.values.items():
        now = after.values.get(name)
        if now != was:
            found.append(_sentence(name, was, now))
    for name, held in before.names.items():
        if name in after.names and not _same(held.inside, after.names[name].inside):
            found += _replaced(name, held, after.names[name])
    return found


def _same(before: dict[str, Any], now: dict[str, Any]) -> bool:
    """Whether the same names hold the same objects, in the same order."""
    return [*before] == [*now] and all(map(operator.is_, before.values(), now.values()))


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


def _names() -> dict[str, _Names]:
    """The names of every module and class that is watched."""
    found = {}
    for name, module in list(sys.modules.items()):
        if name in MODULES or name.startswith(OURS):
            inside = dict(vars(module))
            found[name] = _Names(inside)
            if name.startswith(OURS):
                found |= {f"{name}.{k.__name__}": _of(k) for k in _classes(name, inside)}
    return found | {f"{kind.__module__}.{kind.__qualname__}": _of(kind) for kind in CLASSES}


def _of(kind: type) -> _Names:
    return _Names(dict(vars(kind)), kind.__mro__[1:])


def _classes(name: str, inside: dict[str, Any]) -> list[type]:
    """Classes that a module defines; looked for again when its names are more or fewer."""
    known = _CLASSES.get(name)
    if known is None or known[0] != len(inside):
        found = [v for v in inside.values() if isinstance(v, type) and v.__module__ == name]
        known = _CLASSES[name] = len(inside), found
    return known[1]


_CLASSES: dict[str, tuple[int, list[type]]] = {}


def _replaced(name: str, before: _Names, after: _Names) -> Iterator[str]:
    """Functions and classes that are others; data of modules may change and do."""
    now = after.inside
    for key, was in before.inside.items():
        if now.get(key) is not was and _counts(was) and f"{name}.{key}" not in FOLLOWS:
            yield f"{'replaces' if key in now else 'removes'} {name}.{key}"
    if before.bases:
        for key in now.keys() - before.inside.keys():
            if _counts(now[key]) and any(key in vars(base) for base in before.bases):
                yield f"replaces {name}.{key}"  # which was inherited


def _counts(value: Any) -> bool:
    code = callable(value) or isinstance(value, property | classmethod | staticmethod)
    return code and not isinstance(value, ModuleType)


def _numbered(state: Any) -> int:
    return hash((state[0], state[1].tobytes(), *state[2:]))


def _working_folder() -> str:
    try:
        return os.getcwd()
    except OSError:
        return "one that is gone"


def _children() -> Iterator[str]:
    """Command lines of processes that this one started and that still run."""
    own = f"{WORKER}={os.environ.get(WORKER, '')}".encode()
    for parent in (os.getpid(), os.getppid()):
        for pid in _children_of(parent):
            try:
                line = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
                state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
                # The parent of a worker takes in what workers left; this tells whose it was.
                known = parent == os.getpid() or own in _environment(pid) and own[-1:] != b"="
            except OSError:
                continue
            if known and _OF_PYTHON not in line and state != "Z":
                yield f"{pid} {line.strip()}"


def _children_of(pid: int) -> Iterator[str]:
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            yield from task.read_text().split()


def _environment(pid: str) -> list[bytes]:
    return Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


_META_PATH = tuple(sys.meta_path)
