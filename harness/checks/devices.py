"""The same rows on the CPU and on a GPU."""

from __future__ import annotations

import copy

import torch

from harness.checks.calling import QUADRANTS, TOLERANCE, compare
from harness.checks.finding import Finding, rounded
from harness.checks.subject import Subject
from harness.core.protocol.method import DiskSample

TESTS = 0

ROWS = 1025


def check_devices(subject: Subject) -> Finding:
    """Property ``devices``: CPU and CUDA give the same rows within rounding; skip without CUDA."""
    if not torch.cuda.is_available():
        return Finding("devices", "all", "skip", "no CUDA on this machine")
    return across(subject, "cpu" if subject.device.startswith("cuda") else "cuda")


def across(subject: Subject, device: str) -> Finding:
    """The comparison: ``subject`` where it is, against its state loaded on ``device``."""
    name = "devices"
    method = copy.deepcopy(subject.blank)
    method.bind(subject.material)
    method.load_state_dict({k: v.to(device) for k, v in subject.method.state_dict().items()})
    there = Subject(method, subject.blank, subject.material, device, subject.generator)
    distinct = subject.conditions(len(QUADRANTS)).clone()
    condition = distinct.repeat_interleave(-(-ROWS // len(QUADRANTS)), 0)[:ROWS].clone()
    u = subject.uniforms(ROWS)
    base = subject.sample(condition, u)
    other = there.sample(condition.to(device), u.to(device))
    if other.wo.device.type != torch.device(device).type:
        text = f"inputs on {device}, samples on {other.wo.device}"
        return Finding(name, "all", "fail", text)
    got = DiskSample(other.wo.to(subject.device), other.pdf.to(subject.device))
    rows = torch.arange(ROWS, device=subject.device)
    finding = compare(subject, name, "all", condition, u, base, got, rows)
    if not finding.ok:
        return finding
    here = subject.pdf(condition, base.wo)
    pdf = there.pdf(condition.to(device), base.wo.to(device)).to(subject.device)
    # Samples lie off the edges of cells but by chance, where the two may round apart.
    off = ~((pdf - here).abs() <= TOLERANCE * torch.maximum(pdf.abs(), here.abs()))
    if float(off.double().mean()) > TOLERANCE:
        k = int(off.nonzero()[0, 0])
        worst = {
            "condition": rounded(condition[k]),
            "wo": rounded(base.wo[k]),
            "got": f"{rounded(pdf[k])} on {device}",
            "expected": rounded(here[k]),
        }
        text = f"pdf differs in {int(off.sum())} of {ROWS} rows"
        return Finding(name, "all", "fail", text, worst)
    return Finding(name, "all", "pass", f"{ROWS} rows alike on {subject.device} and {device}")
