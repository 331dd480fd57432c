"""What a method costs before its first sample: loading, compiling, memory; in a fresh process.

``python -m harness.measures.cold_start FOLDER`` is that process: it reads ``FOLDER/ask.json`` and
``FOLDER/state.safetensors`` and writes ``FOLDER/answer.json``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save_file

from harness.core.protocol.errors import Unsupported
from harness.measures.memory import peak_bytes
from harness.measures.timing import now, seconds_of

_STATE, _ASK, _ANSWER = "state.safetensors", "ask.json", "answer.json"
_ROWS = 1024
"""Rows of the call that compiles: a kernel is the same for all sizes, and few run fast."""


@dataclass(frozen=True)
class ColdStarts:
    """``load`` and ``compile`` seconds of every start, ``peak`` bytes of one sampling call.

    ``load``: from the safetensors file to a ready method, its material being there already.
    ``compile``: the first call less a later one, with no compiled kernel in memory or on
    disk; nothing to compile shows as noise around zero. ``peak`` is None where the system
    does not tell, and ``no_peak`` says why. ``size`` is that of the file, 0 without a state.
    """

    load: list[float]
    compile: list[float]
    peak: int | None
    no_peak: str
    size: int


def cold_starts(
    method: str,
    params: dict[str, Any],
    material: Any,
    state: dict[str, torch.Tensor],
    device: str,
    rows: int,
    starts: int,
) -> ColdStarts:
    """Load and first call ``starts`` times, then one call of ``rows`` rows for its memory.

    ``method`` and ``material`` are as a suite names them.

    Raises:
        RuntimeError: the process failed; with the last line that it said.
    """
    with tempfile.TemporaryDirectory(prefix="harness-cold-start-") as name:
        folder = Path(name)
        ask = {
            "method": method,
            "params": params,
            "material": material,
            "device": device,
            "rows": rows,
            "starts": starts,
        }
        (folder / _ASK).write_text(json.dumps(ask), encoding="utf-8")
        # The format wants memory that is contiguous and not shared between tensors.
        tensors = {key: t.detach().cpu().contiguous().clone() for key, t in state.items()}
        save_file(tensors, folder / _STATE)
        environment = os.environ | {"DRJIT_CACHE_DIR": str(folder / "kernels")}
        done = subprocess.run(
            [sys.executable, "-m", "harness.measures.cold_start", str(folder)],
            env=environment,
            capture_output=True,
            text=True,
        )
        if done.returncode:
            said = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
            raise RuntimeError(f"{method}: the process for a cold start failed: {said}")
        size = (folder / _STATE).stat().st_size if state else 0
        return ColdStarts(**json.loads((folder / _ANSWER).read_text(encoding="utf-8")), size=size)


def _main(folder: Path) -> None:
    from harness.core import registry
    from harness.materials import registry as materials
    from harness.mitsuba_runtime import variant

    ask = json.loads((folder / _ASK).read_text(encoding="utf-8"))
    device, rows = ask["device"], ask["rows"]
    variant.use(device)
    material = materials.make(ask["material"])
    generator = torch.Generator().manual_seed(0)

    def make() -> Any:
        return registry.make(ask["method"], **ask["params"])

    def inputs(count: int) -> tuple[torch.Tensor, torch.Tensor]:
        condition = material.conditions(count, generator, device)
        return condition, torch.rand(count, 3, generator=generator).to(device)

    make()  # imports the adapter
    few = inputs(min(_ROWS, rows))
    method, load, compiling = None, [], []
    for _ in range(ask["starts"]):
        _forget_kernels(folder / "kernels")
        begin = now(device)
        method = make()
        method.bind(material)
        method.load_state_dict(load_file(folder / _STATE, device=device))
        load.append(now(device) - begin)
        call = _sampling(method, few)
        first, *later = (seconds_of(call, device) for _ in range(3))
        compiling.append(first - min(later))
    peak, why = None, ""
    try:
        with torch.inference_mode():
            peak = peak_bytes(_sampling(method, inputs(rows)), device)
    except Unsupported as error:
        why = str(error)
    answer = ColdStarts(load, compiling, peak, why, size=0)
    found = {key: value for key, value in asdict(answer).items() if key != "size"}
    (folder / _ANSWER).write_text(json.dumps(found), encoding="utf-8")


def _sampling(method: Any, given: tuple[torch.Tensor, torch.Tensor]) -> Callable[[], object]:
    return lambda: method.sample(*given)


def _forget_kernels(kept: Path) -> None:
    """Both of Dr.Jit's stores of kernels, in memory and on disk."""
    import drjit as dr

    dr.sync_thread()
    dr.flush_kernel_cache()
    for file in kept.glob("*.bin"):
        file.unlink()


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
