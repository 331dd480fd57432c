"""The reader of Fu et al.'s networks: what it makes of them, and what it refuses."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.core import registry
from harness.core.columns.bridge import columns_of
from harness.core.protocol.errors import InputError
from harness.core.protocol.method import Budget, Method
from harness.nets import discrete_flow_columns, discrete_flow_inverse
from tests.materials import MATERIALS

STATES = {
    "pretrain": {"linear1": (16, 14), "output": (4, 16)},
    "rectify": {"linear1": (32, 25), "linear2": (32, 32), "linear3": (32, 32), "output": (2, 32)},
}


def states(size: float = 0.3) -> dict[str, dict[str, Tensor]]:
    """Networks of the release's shapes; the base alone has biases."""
    g = torch.Generator().manual_seed(0)
    found: dict[str, dict[str, Tensor]] = {}
    for part, layers in STATES.items():
        state = found[part] = {}
        for name, shape in layers.items():
            state[f"{name}.weight"] = size * torch.randn(shape, generator=g)
            if part == "pretrain":
                state[f"{name}.bias"] = size * torch.randn(shape[0], generator=g)
    return found


def write(folder: Path, found: dict[str, dict[str, Tensor]]) -> None:
    for part, state in found.items():
        torch.save(state, folder / f"plain_{part}.pth")


def make(folder: Path, **params) -> Method:
    method = registry.make("flow-matching-fu2024", folder=str(folder), **params)
    method.fit(MATERIALS["plain"](), Budget(), torch.Generator().manual_seed(0))
    return method


def waves(x: Tensor, count: int) -> Tensor:
    """x, then sines and cosines at 1, 2, 4, ..."""
    parts = [x]
    for k in range(count):
        parts += [(2**k * x).sin(), (2**k * x).cos()]
    return torch.cat(parts, -1)


def theirs(found: dict[str, dict[str, Tensor]], wi: Tensor, z: Tensor, steps: int) -> Tensor:
    """Where Euler steps of the networks take normals, written out."""
    base, net = found["pretrain"], found["rectify"]
    silu = torch.nn.functional.silu
    hidden = silu(waves(wi, 3) @ base["linear1.weight"].T + base["linear1.bias"])
    out = hidden @ base["output.weight"].T + base["output.bias"]
    x = out[:, :2] + z * out[:, 2:].exp()
    for k in range(steps):
        v = torch.cat([x, torch.full_like(x[:, :1], k / steps), waves(wi, 5)], 1)
        for name in ("linear1", "linear2", "linear3"):
            v = silu(v @ net[f"{name}.weight"].T)
        x = x + v @ net["output.weight"].T / steps
    return x


def test_the_networks_are_read_as_the_release_runs_them(tmp_path: Path):
    found = states(0.15)
    write(tmp_path, found)
    method = make(tmp_path)
    g = torch.Generator().manual_seed(1)
    condition, u = method.material.conditions(400, g), torch.rand(400, 3, generator=g)
    angle, radius = 2 * math.pi * u[:, 1], (-2 * (1 - u[:, 0]).log()).sqrt()
    z = radius[:, None] * torch.stack([angle.cos(), angle.sin()], -1)
    wo, pdf = method.sample(condition, u)
    torch.testing.assert_close(wo, theirs(found, condition, z, 4), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(method.pdf(condition, wo), pdf, rtol=1e-3, atol=1e-6)
    other = make(tmp_path, query="published")
    assert not torch.allclose(other.pdf(condition, wo), pdf, rtol=1e-3)


def test_an_origin_is_found_across_folds(tmp_path: Path):
    """Where Newton's method, that comes nearer every time, stops at folds: bounded steps go on."""
    found, g = states(0.15), torch.Generator().manual_seed(5)
    for name, weight in found["rectify"].items():
        size = {"linear1.weight": 0.8, "output.weight": 0.12}.get(name, 0.5)
        found["rectify"][name] = size * torch.randn(weight.shape, generator=g)
    write(tmp_path, found)
    method = make(tmp_path)
    g = torch.Generator().manual_seed(1)
    condition, u = method.material.conditions(4000, g), torch.rand(4000, 3, generator=g)
    wo, _ = method.sample(condition, u)
    net, flow = method.module, method.flow()
    with torch.no_grad():
        at, target = net.at_columns(columns_of(condition)), columns_of(wo)
        plain = discrete_flow_inverse.first_search(flow, target, at.shared)
        across = discrete_flow_inverse.invert(flow, target, at.shared)
        back = discrete_flow_columns.forward(flow, across.x, at.shared)
    stopped, missed = ~np.array(plain.found), ~np.array(across.found)
    assert stopped.sum() > 10 and missed.sum() < stopped.sum() / 3
    for there, wanted, origin, alone in zip(back.x, target, across.x, plain.x, strict=True):
        near = stopped & ~missed
        there, wanted = np.array(there)[near], np.array(wanted)[near]
        np.testing.assert_allclose(there, wanted, rtol=1e-3, atol=1e-3)
        assert (np.array(origin) == np.array(alone))[~stopped].all()
    pdf = method.pdf(condition, wo).numpy()
    assert (np.isfinite(pdf) == ~missed).all() and (pdf[~missed] >= 0).all()


def test_materials_without_networks_are_not_supported(tmp_path: Path):
    method = registry.make("flow-matching-fu2024", folder=str(tmp_path))
    able, reason = method.supports(MATERIALS["plain"]())
    assert not able and reason == f"no file plain_pretrain.pth in {tmp_path}"
    assert not method.supports(MATERIALS["tilted"]())[0]


class Malice:
    """Pickled code."""

    def __reduce__(self):
        return print, ("run",)


def test_other_files_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture):
    found = states()
    for change, said in (
        (
            {"output.weight": torch.zeros(3, 32)},
            r"'output.weight' is \(3, 32\); expected \(2, 32\)",
        ),
        ({"linear2.weight": None}, "no tensor 'linear2.weight'"),
        ({"more": Malice()}, "not a state dict of tensors alone"),
        ({"more": [1]}, "not a state dict of tensors alone"),
    ):
        state = {k: v for k, v in {**found["rectify"], **change}.items() if v is not None}
        write(tmp_path, {**found, "rectify": state})
        with pytest.raises(InputError, match=said) as refused:
            make(tmp_path)
        assert "\n" not in str(refused.value)
    (tmp_path / "plain_rectify.pth").write_bytes(b"no archive")
    with pytest.raises(InputError, match="not a state dict"):
        make(tmp_path)
    assert "run" not in capsys.readouterr().out
    for params in ({"weights": "pretrain"}, {"query": "forward"}):
        with pytest.raises(InputError, match=next(iter(params))):
            registry.make("flow-matching-fu2024", **params)
