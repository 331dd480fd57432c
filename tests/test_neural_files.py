"""Neural materials on disk: ours, published checkpoints, and what is refused."""

import json
import os
import pickle
from argparse import Namespace

import pytest
import torch
from safetensors.torch import load_file, save_file

from harness.core.protocol.disk import cos_theta, square_to_disk
from harness.core.protocol.errors import InputError
from harness.materials import registry
from harness.materials.neural import checkpoint, restricted_pickle, storage, textures
from harness.materials.neural.architecture import Architecture
from harness.materials.neural.network import NeuralMBTF

SMALL = Architecture(resolution=8, channels=4, offset_resolution=4, offset_channels=3, width=8)


@pytest.fixture
def net():
    torch.manual_seed(0)
    return NeuralMBTF(SMALL).eval()


# --- ours --------------------------------------------------------------------------------------


def test_what_is_stored_comes_back(net, tmp_path):
    file = tmp_path / "m.safetensors"
    storage.save(file, net, {"seed": 3}, half_textures=False)
    again = storage.load(file)
    assert again.architecture == SMALL and storage.record(file) == {"seed": 3}
    for key, value in net.state_dict().items():
        assert torch.equal(again.state_dict()[key], value)


def test_textures_are_halved_and_networks_are_not(net, tmp_path):
    file = tmp_path / "m.safetensors"
    storage.save(file, net, {})
    stored = load_file(file)
    assert stored["texture"].dtype == stored["offset.texture"].dtype == torch.float16
    assert stored["decoder.layers.0.weight"].dtype == torch.float32
    assert torch.equal(storage.load(file).texture, net.texture.half().float())


def test_identity_is_the_reflectance_and_not_the_record(net, tmp_path):
    one, two, other = (tmp_path / f"{n}.safetensors" for n in "abc")
    storage.save(one, net, {"seed": 1})
    storage.save(two, net, {"seed": 2})
    with torch.no_grad():
        net.decoder.layers[0].bias[0] += 1
    storage.save(other, net, {"seed": 1})
    spec = [{"name": "x", "type": "neural", "file": f.name} for f in (one, two, other)]
    found = [registry.identity(s, tmp_path) for s in spec]
    assert found[0] == found[1] != found[2]
    assert str(tmp_path) not in json.dumps(found)


def test_of_a_description_only_what_is_chosen_counts(net, tmp_path):
    """A file from before a size was there has the identity of one that leaves it alone."""

    def stored(name: str, **changes: bool | str | None) -> str:
        about = {**SMALL.as_dict(), **changes}
        kept = {key: value for key, value in about.items() if value is not None}
        file = tmp_path / f"{name}.safetensors"
        labels = {"format": storage.FORMAT, "architecture": json.dumps(kept), "record": "{}"}
        save_file(net.state_dict(), file, metadata=labels)
        return storage.reflectance_hash(file)

    whole = stored("whole")
    assert stored("older", cosines=None) == whole
    assert stored("other", output="log1p") != whole


def test_a_material_from_a_suite(net, tmp_path):
    storage.save(tmp_path / "m.safetensors", net, {})
    spec = {"name": "mine", "type": "neural", "file": "m.safetensors"}
    registry.validate(spec, tmp_path)
    material = registry.make(spec, tmp_path)
    assert material.name == "mine" and material.n_features == 4 and material.effects == {"parallax"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t, m: t.pop("texture"), "no tensor 'texture'"),
        (lambda t, m: t.update(extra=torch.zeros(1)), "'extra' is none of its description's"),
        (lambda t, m: t.update(texture=torch.zeros(3, 4)), r"is \[3, 4\]; expected \[64, 4\]"),
        (lambda t, m: t["texture"].fill_(float("nan")), "not finite"),
        (lambda t, m: m.update(format="other"), "format is 'other'"),
        (lambda t, m: m.update(architecture="{"), "expected a JSON mapping"),
        (lambda t, m: m.update(architecture='{"width": 0}'), "width: expected at least 1"),
    ],
)
def test_a_file_that_does_not_hold_together_is_refused(net, tmp_path, change, message):
    file = tmp_path / "m.safetensors"
    storage.save(file, net, {})
    tensors, metadata = load_file(file), storage.metadata(file)
    change(tensors, metadata)
    save_file(tensors, file, metadata=metadata)
    with pytest.raises(InputError, match=message):
        storage.load(file)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"file": "m.pth"}, "expected .ckpt or .safetensors"),
        ({"file": "none.ckpt"}, "no such file: none.ckpt"),
        ({"file": "text.safetensors"}, "cannot be read"),
        ({"fil": "x.ckpt"}, "unknown key 'fil'; did you mean 'file'"),
        ({}, "unknown neural material 'mine'"),
    ],
)
def test_a_bad_specification_is_refused(tmp_path, spec, message):
    (tmp_path / "text.safetensors").write_text("no tensors here, but some text")
    (tmp_path / "m.pth").write_text("")
    with pytest.raises(InputError, match=message):
        registry.validate({"name": "mine", "type": "neural", **spec}, tmp_path)


# --- published checkpoints ---------------------------------------------------------------------


def published(resolution: int = 6) -> dict[str, torch.Tensor]:
    """Tensors in the names and layout of the release, small."""
    g = torch.Generator().manual_seed(1)

    def layers(name: str, widths: list[int]) -> dict[str, torch.Tensor]:
        found = {}
        for i, (a, b) in enumerate(zip(widths[:-1], widths[1:], strict=True)):
            found[f"{name}.layers.{2 * i}.weight"] = torch.randn(b, a, generator=g) / a**0.5
            found[f"{name}.layers.{2 * i}.bias"] = torch.randn(b, generator=g) / 4
        return found

    return {
        "offset_texture.texture": torch.randn(8, resolution, resolution, generator=g),
        "rgb_texture.texture": torch.randn(8, resolution, resolution, generator=g),
        **layers("offset_network", [10, 32, 32, 32, 1]),
        **layers("rgb_network", [12, 32, 32, 32, 3]),
    }


class Trap:
    """Does something when it is unpickled the ordinary way."""

    def __reduce__(self):
        return os.system, ("touch trapped",)


def lightning(state):
    return {
        "state_dict": {f"model.{k}": v for k, v in state.items()},
        "hyper_parameters": {"args": Namespace(a=1), "trap": Trap(), "list": [Trap(), {1, 2}]},
        "callbacks": {Trap: 3},
        "epoch": 7,
    }


def bare(state):
    return {k.replace("_texture.texture", "_texture"): v for k, v in state.items()}


@pytest.mark.parametrize("form", [lightning, bare])
def test_both_published_forms_are_read_and_nothing_is_executed(tmp_path, monkeypatch, form):
    monkeypatch.chdir(tmp_path)
    state = published()
    torch.save(form(state), "x.ckpt")
    net = checkpoint.load(tmp_path / "x.ckpt")
    assert not (tmp_path / "trapped").exists()
    assert net.architecture == Architecture(resolution=6, offset_resolution=6)
    assert torch.equal(net.decoder.layers[2].weight, state["rgb_network.layers.4.weight"])


def test_a_published_lookup_is_followed_to_the_letter(tmp_path):
    """Against an evaluation written out here: 1 - v, wrap, half texels, the two blurs."""
    state = published(12)
    torch.save(lightning(state), tmp_path / "x.ckpt")
    net = checkpoint.load(tmp_path / "x.ckpt")
    u = torch.rand(200, 6, generator=torch.Generator().manual_seed(0)).double()
    uv, wi, wo = 4 * u[:, :2] - 2, square_to_disk(u[:, 2:4]), square_to_disk(u[:, 4:])

    def look(name: str, sigma: float, at: torch.Tensor) -> torch.Tensor:
        from scipy.ndimage import gaussian_filter

        image = state[f"{name}.texture"].double().numpy()
        image = gaussian_filter(image, (0, sigma, sigma), mode="wrap", truncate=8)
        image = torch.from_numpy(image)
        x, y = at[:, 0] * 12 - 0.5, (1 - at[:, 1]) * 12 - 0.5
        i, j = x.floor().long(), y.floor().long()
        s, t = x - i, y - j
        total = 0
        for di, dj, w in (
            (0, 0, (1 - s) * (1 - t)),
            (1, 0, s * (1 - t)),
            (0, 1, (1 - s) * t),
            (1, 1, s * t),
        ):
            total = total + image[:, (j + dj) % 12, (i + di) % 12] * w
        return total.T

    def run(name: str, x: torch.Tensor) -> torch.Tensor:
        for k in (0, 2, 4, 6):
            x = x @ state[f"{name}.layers.{k}.weight"].double().T
            x = x + state[f"{name}.layers.{k}.bias"].double()
            x = torch.where(x > 0, x, 0.01 * x) if k < 6 else x
        return x

    depth = run("offset_network", torch.cat([look("offset_texture", 2, uv), wi], 1))
    moved = uv + depth / cos_theta(wi).clamp(min=0.6)[:, None] * wi
    expected = run("rgb_network", torch.cat([wo, wi, look("rgb_texture", 0.5, moved)], 1)).relu()
    with torch.no_grad():
        net = net.double()
        found = net.reflectance(net.features(uv, wi), wi, wo)
    assert expected.max() > 0.1
    assert torch.allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.pop("rgb_texture.texture"), "no tensor 'rgb_texture.texture'"),
        (
            lambda s: s.update({"offset_texture.texture": torch.zeros(8, 4, 6)}),
            r"expected \[C, R, R\]",
        ),
        (lambda s: s.pop("rgb_network.layers.2.bias"), "rgb_network.layers.2.weight"),
        (
            lambda s: s.update({"rgb_network.layers.0.weight": torch.zeros(32, 9)}),
            r"expected \[32, 12\]",
        ),
    ],
)
def test_a_checkpoint_of_another_kind_is_refused(tmp_path, change, message):
    state = published()
    change(state)
    torch.save(state, tmp_path / "x.ckpt")
    with pytest.raises(InputError, match=message):
        checkpoint.load(tmp_path / "x.ckpt")


def test_damaged_files_are_refused(tmp_path):
    good = tmp_path / "good.ckpt"
    torch.save(published(), good)
    content = good.read_bytes()
    for name, data in (
        ("text.ckpt", b"nothing"),
        ("half.ckpt", content[: len(content) // 2]),
        ("plain.ckpt", pickle.dumps({"a": 1})),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError, match=name):
            checkpoint.load(tmp_path / name, name)
    with pytest.raises(InputError, match="no such file"):
        checkpoint.load(tmp_path / "none.ckpt")


def test_the_restricted_reader_agrees_with_torch(tmp_path):
    base = torch.arange(24.0)
    state = {
        "view": base.view(4, 6)[1:, ::2],
        "parameter": torch.nn.Parameter(torch.randn(3)),
        "half": torch.randn(5).half(),
        "whole": torch.arange(3),
        "scalar": torch.tensor(2.5),
        "empty": torch.empty(0, 4),
    }
    torch.save(state, tmp_path / "x.ckpt")
    found = restricted_pickle.tensors(tmp_path / "x.ckpt")
    assert set(found) == set(state)
    for key, value in torch.load(tmp_path / "x.ckpt", weights_only=True).items():
        assert torch.equal(found[key], value) and found[key].dtype == value.dtype


def test_a_blurred_texture_is_stored_blurred(net):
    before = net.texture.detach().clone()
    net.bake(0.5)
    assert torch.allclose(net.texture, textures.blur(before, 8, 0.5))
