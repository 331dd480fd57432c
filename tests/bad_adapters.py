"""Adapters that do what no adapter should, each in a few lines, and what a run has to say of it."""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from pathlib import Path

GOOD = '''
"""Adapters for tests."""
import atexit, builtins, ctypes, gc, math, os, random, resource, signal, subprocess, sys
import threading, time
import numpy as np
import torch
from harness import DiskSample, FitReport, Method, square_to_disk


class Good(Method):
    """Uniform on the disk, and a state that is drawn from the generator."""

    def __init__(self):
        self.weights = torch.zeros(3)

    def fit(self, material, budget, generator):
        self.material = material
        self.weights = torch.rand(3, generator=generator)
        self.trouble()
        return FitReport(steps=1, parameters=3)

    def trouble(self):
        pass

    def state_dict(self):
        return {"weights": self.weights}

    def load_state_dict(self, state):
        self.weights = state["weights"]

    def sample(self, condition, u):
        return DiskSample(square_to_disk(u[:, :2]), torch.full((len(u),), 1 / math.pi))

    def pdf(self, condition, wo):
        return torch.full((len(wo),), 1 / math.pi)


class Later(Good):
    """Is measured well, and then is not."""

    calls = 0

    def sample(self, condition, u):
        Later.calls += 1
        if not torch.is_inference_mode_enabled() or Later.calls > 3:
            self.trouble()
        return super().sample(condition, u)
'''


@dataclass(frozen=True)
class Bad:
    """``code`` of a method; ``says`` (a pattern) is what is stored of it.

    ``in_``: the method that does it, ``trouble`` being in the middle of a fit. ``fails``: with
    which status; "" where its trials end well and a finding is stored beside them.
    """

    name: str
    code: str
    says: str
    fails: str = ""
    in_: str = "trouble(self)"

    @property
    def source(self) -> str:
        """The class."""
        body = textwrap.indent(textwrap.dedent(self.code).strip(), 8 * " ")
        return f"\n\nclass {self.name}(Good):\n    def {self.in_}:\n{body}\n"

    @property
    def pattern(self) -> re.Pattern[str]:
        """Of the reason, or of the finding."""
        return re.compile(self.says)


_SAMPLE, _PDF = "sample(self, condition, u)", "pdf(self, condition, wo)"
_END = "limit of this trial"
BAD = [
    Bad("HangFit", "while True: pass", _END, "timeout"),
    Bad("SleepFit", "time.sleep(1e6)", _END, "timeout"),
    Bad("HangSample", "while True: pass", _END, "timeout", _SAMPLE),
    Bad("HangPdf", "time.sleep(1e6)", _END, "timeout", _PDF),
    Bad("HangConstructor", "time.sleep(1e6)", _END, "timeout", "__init__(self)"),
    Bad("HangDeaf", """
        for number in range(1, 32):
            if number not in (signal.SIGKILL, signal.SIGSTOP):
                signal.signal(number, signal.SIG_IGN)
        while True: time.sleep(1)
        """, _END, "timeout"),
    Bad("Stops", "os.kill(os.getpid(), signal.SIGSTOP)", _END, "timeout"),
    Bad("Segfault", "ctypes.string_at(0)", "SIGSEGV", "error"),
    Bad("SegfaultPdf", "ctypes.string_at(0)", "SIGSEGV", "error", _PDF),
    Bad("SegfaultConstructor", "ctypes.string_at(0)", "SIGSEGV", "error", "__init__(self)"),
    Bad("Abort", "os.abort()", "SIGABRT", "error"),
    Bad("LeavesQuietly", "os._exit(0)", "exit status 0 in the middle", "error"),
    Bad("LeavesInSample", "os._exit(0)", "exit status 0 in the middle", "error", _SAMPLE),
    Bad("SystemExits", "sys.exit(0)", "SystemExit", "error"),
    Bad("KillsItself", "os.kill(os.getpid(), signal.SIGKILL)", "SIGKILL, 3 times", "error"),
    Bad("Terminates", "os.kill(os.getpid(), signal.SIGTERM)", "SIGTERM", "error"),
    Bad("Interrupts", "raise KeyboardInterrupt", "KeyboardInterrupt", "error"),
    Bad("RaisesBase", "raise BaseException('all')", "BaseException: all", "error"),
    Bad("Eats", "self.kept = [b'x' * (1 << 26) for _ in iter(int, 1)]", "its limit is", "error"),
    Bad("AsksTooMuch", "torch.empty(1 << 50)", "RuntimeError", "error"),
    Bad("Recurses", "self.trouble()", "RecursionError", "error"),
    Bad("ClosesFiles", "os.closerange(3, 4096)", "process", "error"),
    Bad("Type", "torch.set_default_dtype(torch.float64)", "default dtype from torch.float32"),
    Bad("Gradients", "torch.set_grad_enabled(not torch.is_grad_enabled())", "records gradients"),
    Bad("Threads", "torch.set_num_threads(torch.get_num_threads() + 1)", "number of threads"),
    Bad("Deterministic", "torch.use_deterministic_algorithms(True)", "deterministic"),
    Bad("Environment", "os.environ['OMP_PLACES'] = 'cores'", "environment variables: OMP_PLACES"),
    Bad("Moves", "os.chdir('/')", "the working folder"),
    Bad("SeedsTorch", "torch.manual_seed(1)", "seed of torch's"),
    Bad("SeedsNumpy", "np.random.seed(1)", "numpy's global random state"),
    Bad("SeedsPython", "random.seed(1)", "Python's global random state"),
    Bad("PatchesMean", "torch.Tensor.mean = lambda self, *a, **k: torch.tensor(42.0)",
        r"replaces torch\.Tensor\.mean"),
    Bad("PatchesRand", "rand = torch.rand; torch.rand = lambda *a, **k: 0.5 * rand(*a, **k)",
        r"replaces torch\.rand"),
    Bad("PatchesNumpy", "np.median = lambda *a, **k: 1.0", r"replaces numpy\.median"),
    Bad("PatchesMath", "math.sqrt = lambda x: 1.0", r"replaces math\.sqrt"),
    Bad("PatchesClock", "clock = time.perf_counter; time.perf_counter = lambda: 0.1 * clock()",
        r"replaces time\.perf_counter"),
    Bad("PatchesUs", "import harness.measures.timing as t; t.now = lambda device='cpu': 0.0",
        r"replaces harness\.measures\.timing\.now"),
    Bad("Talks", "print('x' * (1 << 23)); sys.stderr.write('y' * (1 << 23))", ""),
    Bad("LeavesChild", "subprocess.Popen(['sleep', MARK])", "processes running: .*sleep"),
    Bad("LeavesDaemon", """
        subprocess.Popen(['setsid', 'sh', '-c', f'sleep {MARK} & sleep {MARK}'],
                         start_new_session=True)
        """, "processes running"),
    Bad("LeavesThread", """
        threading.Thread(target=time.sleep, args=(1e6,), name='mine').start()
        """, "threads running: mine"),
    Bad("Handles", "signal.signal(signal.SIGALRM, lambda *_: os._exit(1))", "handlers of signals"),
    Bad("AtExit", "atexit.register(lambda: time.sleep(1e6))", ""),
    Bad("NoGarbage", "gc.disable()", "collection of garbage"),
    Bad("Files", "resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))", "limit of open files"),
    Bad("Priority", "os.nice(5)", "the priority"),
]  # fmt: skip
SHORT = (
    *("SleepFit", "Segfault", "LeavesQuietly", "Eats", "Type", "PatchesMean", "LeavesDaemon"),
    *("Interrupts", "HangConstructor"),
)
"""One of each kind, for every day."""


def write(file: Path, mark: str) -> None:
    """All of them in one file; ``mark`` is what processes that are left behind sleep for."""
    file.write_text(f"MARK = '{mark}'\n{GOOD}" + "".join(bad.source for bad in BAD))
