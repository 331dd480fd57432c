"""``python -m harness.bench.release FOLDER``: samplers beside those of NeuSample's authors.

``FOLDER`` is a clone of their public code, ``bing-xu-graphics/neusample_release`` on GitHub. One
line a sampler: million samples (each with its density) and million densities a second, ours and
theirs, and the ratio of both together. Networks have the same widths and random weights; ours also
see to what theirs leave out (a uniform share, the density of the rounded sample). Rounds are
interleaved and ratios are medians over them. On a CPU one thread and the processor's clock, which
other work on the machine lengthens less than that of the wall.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import drjit as dr
import numpy as np
import torch

from harness.bench.interleaved import Work, interleaved
from harness.core import registry
from harness.core.compiled import library
from harness.core.protocol.method import Budget
from harness.materials import registry as materials
from harness.mitsuba_runtime import variant

MODELS = ("improved-baseline", "two-lobe", "neural-spline-flow")
FEATURES = 8


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="a clone of their code")
    parser.add_argument("--material", default="leather", help="whose conditions ours see")
    parser.add_argument("--rows", type=int, default=1 << 18)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    options = parser.parse_args()
    where = options.folder / "neusample" / "histogram"
    if not (where / "model").is_dir():
        parser.error(f"{options.folder}: expected a clone of their code; there is no {where}/model")
    sys.path.insert(0, str(where))
    variant.use(options.device)
    if options.device == "cpu":
        torch.set_num_threads(1)
        dr.set_thread_count(1)
    print(f"{options.rows:,} rows on {options.device}; compiled kernels: {library.name()}")
    head = ("ours", "theirs", "ours, pdf", "theirs, pdf", "ratio")
    print(f"{'':20}" + "".join(f"{word:>13}" for word in head))
    for name in MODELS:
        works = _works(name, options)
        with torch.inference_mode():
            seconds = interleaved(works, options.rounds, options.device)
        rates = {work: np.median(options.rows / each / 1e6) for work, each in seconds.items()}
        theirs, ours = (seconds[who] + seconds[f"{who}, pdf"] for who in ("theirs", "ours"))
        line = "".join(f"{rates[word]:13.2f}" for word in head[:-1])
        print(f"{name:20}{line}{np.median(theirs / ours):13.2f}", flush=True)


def _works(name: str, options: argparse.Namespace) -> dict[str, Work]:
    device, rows = options.device, options.rows
    generator = torch.Generator().manual_seed(0)
    release = _theirs(name).to(device)
    material = materials.make(options.material)
    method = registry.make(name)
    method.fit(material, Budget(steps=1, pool=64, device=device), generator)
    condition = material.conditions(rows, generator, device)
    u = torch.rand(rows, 3, generator=generator).to(device)
    wo = 1.2 * torch.rand(rows, 2, generator=generator).to(device) - 0.6
    seen = torch.cat([torch.rand(rows, FEATURES).to(device), condition[:, -2:]], 1)
    # Theirs writes into what it is given.
    return {
        "ours": lambda: method.sample(condition, u),
        "theirs": lambda: release(u.clone(), seen, inverse=True),
        "ours, pdf": lambda: method.pdf(condition, wo),
        "theirs, pdf": lambda: release(wo.clone(), seen),
    }


def _theirs(name: str) -> torch.nn.Module:
    # Of the clone, whose folder was put on the path.
    from model.gmm import GMM, BaseLine
    from model.nsf import NSF_prior

    return dict(zip(MODELS, (BaseLine, GMM, NSF_prior), strict=True))[name]()


if __name__ == "__main__":
    main()
