"""Learning from walks: losses, sources, what is refused, and a whole small training."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import stats
from typer.testing import CliRunner

from harness.cli.main import build
from harness.core.protocol.disk import disk_to_square
from harness.core.protocol.errors import InputError
from harness.materials.puresample import files, storage
from harness.materials.puresample.architecture import Architecture
from harness.materials.puresample.network import PureSample
from harness.microgeometry.walks.description import parse
from harness.microgeometry.walks.kernel import Counts
from harness.mitsuba_runtime import variant
from harness.training.puresample import albedo, data, density, quality, recipe, sources
from harness.training.puresample.profiles import PROFILES
from tests.walks import binned, family, uniform_on_disk, z_scores

variant.use("cpu")

TINY = replace(
    PROFILES["quick"],
    architecture=Architecture(width=16, layers=2, steps=2, albedo_width=8, base="normal"),
    walks=1 << 16,
    matching_steps=20,
    matching_batch=1024,
    likelihood_steps=40,
    likelihood_batch=512,
    directions=4096,
    group=8,
    albedo_steps=300,
    albedo_batch=512,
)
BRASS = {"alpha_x": 0.5, "alpha_y": 0.2, "r0_r": 0.9, "r0_g": 0.7, "r0_b": 0.3}


def rng(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


class Matt:
    """A source without a surface: exits uniform on the disk, and an albedo of one's own."""

    name, about, grey = "matt", "x", False

    def __init__(self, *share: float):
        self.share = torch.tensor(share)

    def identity(self) -> dict:
        return {"type": "matt"}

    def walk(self, u, wi, channel, seed, device="cpu"):
        from harness.core.protocol.disk import square_to_disk
        from harness.microgeometry.walks.kernel import Exits

        random = torch.rand(len(wi), 3, generator=rng(seed))
        left = random[:, 2] < self.share[channel.long()]
        wo = torch.where(left[:, None], square_to_disk(random[:, :2]), 0)
        counts = Counts(walks=len(wi), left=int(left.sum()), interactions=len(wi))
        return Exits(wo, left, torch.ones(len(wi), dtype=torch.int32), counts)


# --- the albedo's losses ---------------------------------------------------------------


def minimiser(kind: str, share: torch.Tensor) -> float:
    """The one answer of least mean loss for these shares, by a search."""
    q = torch.linspace(0.0005, 0.9995, 2000)
    losses = [
        float(albedo.loss_of(kind, torch.logit(v).expand(len(share), 1), share[:, None])) for v in q
    ]
    return float(q[int(np.argmin(losses))])


@pytest.mark.parametrize(("a", "n"), [(0.05, 8), (0.3, 3), (0.6, 16)])
def test_two_losses_find_the_mean_of_counts_and_the_published_one_their_median(a, n):
    k = torch.from_numpy(stats.binom.rvs(n, a, size=4000, random_state=1)).float()
    share = k / n
    for kind in ("survival", "squared"):
        assert minimiser(kind, share) == pytest.approx(float(share.mean()), abs=1e-3)
    median = stats.binom.median(n, a) / n
    assert minimiser("l1", share) == pytest.approx(median, abs=1e-3)
    assert abs(median - a) > 0.01


def test_the_published_loss_darkens_what_is_dark():
    """Of an albedo of 0.04 known by 8 particles a direction, the median is nothing at all."""
    source = Matt(0.04, 0.04, 0.04)
    survival = albedo.draw(source, 4096, 8, 3)
    found = {}
    for kind in ("survival", "l1"):
        profile = replace(TINY, albedo_loss=kind)
        torch.manual_seed(0)
        network = PureSample(profile.architecture)
        albedo.fit(network, survival, profile, 0, "cpu", lambda *_: None)
        with torch.no_grad():
            wi = 0.8 * torch.rand(100, 2, generator=rng(1)) - 0.4
            found[kind] = float(network.albedo(wi[:, :0], wi).mean())
    assert found["survival"] == pytest.approx(0.04, rel=0.1)
    assert found["l1"] < 0.02


def test_shares_and_their_errors():
    source = Matt(0.2, 0.5, 1.0)
    found = albedo.draw(source, 500, 64, 1)
    assert found.share.shape == (500, 3) and found.counts.walks == 500 * 3 * 64
    for k, share in enumerate((0.2, 0.5, 1.0)):
        expected = math.sqrt(share * (1 - share) / 64)
        assert float(found.share[:, k].mean()) == pytest.approx(share, abs=0.01)
        assert float(found.share[:, k].std()) == pytest.approx(expected, rel=0.15)
        assert float(found.error[:, k].mean()) == pytest.approx(expected, rel=0.05)


# --- sources ---------------------------------------------------------------------------


def test_a_familys_particles_go_where_its_own_walk_goes():
    """Per channel the same energy in every cell as the walk's weights bring."""
    material = family("ggx-conductor", **BRASS)
    source, n = sources.FamilyWalks(material, "x"), 1 << 17
    row = torch.tensor([0.5, -0.3])
    wi = row.expand(n, 2).contiguous()
    expected = binned(material, row, n, 5)
    from harness.core.protocol.disk import disk_to_square
    from tests.walks import CELLS

    for k in range(3):
        found = source.walk(wi, wi, torch.full((n,), k), 6 + k)
        assert found.counts.above_one == 0 and found.counts.left == int(found.left.sum())
        cell = (disk_to_square(found.wo[found.left].double()) * CELLS).long().clamp(0, CELLS - 1)
        count = torch.bincount(cell[:, 0] * CELLS + cell[:, 1], minlength=CELLS**2) / n
        error = (count * (1 - count) / n).sqrt()
        z = z_scores((count.double(), error.double()), (expected[0][:, k], expected[1][:, k]))
        assert float(z.square().mean()) < 1.4 and float(z.abs().max()) < 5.5


def test_lossless_families_return_every_particle():
    white = {"r0_r": 1.0, "r0_g": 1.0, "r0_b": 1.0, "alpha_x": 0.4, "alpha_y": 0.4}
    source = sources.FamilyWalks(family("ggx-conductor", **white), "x")
    walked = data.draw(source, 1 << 15, 1)
    assert walked.left.all() and uniform_on_disk(walked.wo).p_value > 1e-4


def test_descriptions_of_families(tmp_path: Path):
    file = tmp_path / "brass.yaml"
    lines = [f"  {key}: {value}" for key, value in BRASS.items()]
    file.write_text("name: brass\nabout: x\nfamily: ggx-conductor\nfix:\n" + "\n".join(lines))
    assert sources.load(file).name == "brass" and sources.load(file).about == "x"
    for text, message in (
        ("name: a\nfamily: ggx-conductor\n", "expected all parameters fixed; free: alpha_x"),
        ("name: a\nfamily: disney\n", "'disney' has no random walk"),
        ("name: a\nfamily: ggx-conducter\n", "ggx-conducter.*ggx-conductor"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=message) as refused:
            sources.load(file)
        assert "\n" not in str(refused.value) and "brass.yaml" in str(refused.value)


# --- refused surfaces ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("counts", "message"),
    [
        (Counts(10_000, 3, 0, 10_000, 0), "3 of 10000 particles leave, the others are absorbed"),
        (Counts(10_000, 5000, 50, 90_000, 0), "0.5% of the particles had not left"),
        (Counts(10_000, 5000, 0, 10_000, 200), "weight is above one at 2.0%"),
    ],
)
def test_what_cannot_be_learned_is_refused(counts, message):
    with pytest.raises(InputError, match=message) as refused:
        data.check(Matt(0, 0, 0), counts)
    assert "matt" in str(refused.value) and "\n" not in str(refused.value)


def test_a_walk_that_never_leaves_is_refused(tmp_path):
    """Lossless matt grains that touch: some particles stay in the crevices beyond any bound."""
    grains = {"shape": "sphere", "arrangement": "grid", "per_side": 2, "size": 0.5}
    surface = parse({"name": "trap", "about": "x", "primitives": grains, "micro": "lambertian",
                     "bound": 4})  # fmt: skip
    walked = data.draw(surface, 1 << 14, 1)
    with pytest.raises(InputError, match="trap.*had not left"):
        data.check(surface, walked.counts)


# --- trainings -------------------------------------------------------------------------


def test_a_matt_source_is_learned():
    source = Matt(0.2, 0.5, 0.8)
    walked, survival = data.draw(source, TINY.walks, 1), albedo.draw(source, 4096, 8, 2)
    network = recipe.fitted(TINY, walked, survival, 0)
    held = quality.Held.draw(source, 9, conditions=3, walks=1 << 16, directions=20, group=4096)
    found = held.measure(network)
    assert abs(found.kl) < 0.01 and found.kl_worst < 0.02
    assert abs(found.albedo_bias) < 0.01 and found.albedo_within > 0.5


def test_divergence_is_that_of_known_densities():
    """Walks of another density than the network's: KL by a sum over cells, without bias."""
    network = PureSample(Architecture(base="normal", width=8, layers=1))  # draws the uniform disk
    count = torch.zeros(3, quality.CELLS**2, dtype=torch.long)
    p = torch.full((quality.CELLS**2,), 0.5 / quality.CELLS**2)
    p[: len(p) // 2] *= 3
    expected = float((p * (p * quality.CELLS**2).log()).sum())
    for i in range(3):
        index = torch.multinomial(p, 100_000, replacement=True, generator=rng(i))
        count[i] = torch.bincount(index, minlength=len(p))
    held = quality.Conditions(torch.zeros(3, 2), torch.zeros(3, 2), torch.arange(3), count)
    with torch.no_grad():
        found, lost = quality.divergences(network, held)
    assert float(found.mean()) == pytest.approx(expected, abs=2e-3)
    assert float(lost.max()) == 0


def test_directions_without_a_density_are_counted(monkeypatch):
    """Those of every other cell have none: half of them, and the other cells are as they were."""
    network, nowhere = PureSample(Architecture(base="normal", width=8, layers=1)), torch.zeros(2)
    at = quality.cell_points()
    with torch.no_grad():
        whole, none = quality.cell_masses(network, nowhere, nowhere, 0, at)
    assert float(none) == 0
    known = PureSample.log_density

    def torn(self, features, channel, wi, wo):
        index = (disk_to_square(wo.double()) * quality.CELLS).long()[:, 0]
        return torch.where(index % 2 == 0, torch.nan, known(self, features, channel, wi, wo))

    monkeypatch.setattr(PureSample, "log_density", torn)
    with torch.no_grad():
        mass, lost = quality.cell_masses(network, nowhere, nowhere, 0, at)
    assert float(lost) == 0.5
    rows = mass.view(quality.CELLS, -1)
    assert rows[::2].abs().max() == 0
    assert torch.equal(rows[1::2], whole.view(quality.CELLS, -1)[1::2])
    met = torch.zeros(1, quality.CELLS**2).index_fill(1, torch.tensor([quality.CELLS]), 1.0)
    held = quality.Conditions(nowhere[None], nowhere[None], torch.zeros(1).long(), met)
    with torch.no_grad():
        found, lost = quality.divergences(network, held)
    assert float(lost) == 0.5
    assert found.isnan().all(), "though the one cell that walks met has a mass"


def test_total_variation_smooths_the_texture():
    source = Matt(0.5, 0.5, 0.5)
    sizes = replace(TINY.architecture, resolution=8, channels=2)
    walked = data.draw(source, 1 << 14, 1).survivors()
    rough = {}
    for tv in (0.0, 10.0):
        profile = replace(TINY, architecture=sizes, tv=tv, likelihood_steps=5)
        torch.manual_seed(0)
        network = PureSample(sizes)
        before = float(density.variation(network, 0, 2).detach())
        density.fit(network, walked, profile, 0, "cpu", lambda *_: None)
        rough[tv] = float(density.variation(network, 0, 2).detach()) / before
    assert rough[10.0] < 0.3 < 0.6 < rough[0.0]


def test_the_albedo_leaves_the_texture_alone():
    sizes = replace(TINY.architecture, resolution=8, channels=2, residual=True, albedo_layers=5)
    profile, source = replace(TINY, architecture=sizes), Matt(0.3, 0.5, 0.7)
    torch.manual_seed(0)
    network = PureSample(sizes)
    state = {k: v.clone() for k, v in network.state_dict().items()}
    albedo.fit(network, albedo.draw(source, 1024, 8, 1), profile, 0, "cpu", lambda *_: None)
    for key, value in network.state_dict().items():
        assert torch.equal(value, state[key]) == (not key.startswith("albedo_net"))


class Chequered(Matt):
    """A tint by place, which changes no direction."""

    def walk(self, u, wi, channel, seed, device="cpu"):
        bright = ((u * 2).floor().sum(1) % 2 > 0)[:, None]
        found = super().walk(u, wi, channel, seed, device)
        thinned = torch.rand(len(u), 1, generator=rng(seed + 1)) < 0.25
        left = found.left & (bright | thinned)[:, 0]
        return found._replace(left=left)


def test_channels_of_its_own_teach_the_albedo_a_tint():
    sizes = replace(TINY.architecture, resolution=8, channels=2, albedo_channels=2)
    profile = replace(TINY, architecture=sizes, albedo_steps=400, tv=0.0)
    torch.manual_seed(0)
    network = PureSample(sizes)
    before = network.texture.detach().clone()
    counts = albedo.draw(Chequered(0.8, 0.8, 0.8), 1 << 14, 8, 1)
    albedo.fit(network, counts, profile, 0, "cpu", lambda *_: None)
    after = network.texture.detach()
    assert torch.equal(after[:, :2], before[:, :2])
    assert not torch.equal(after[:, 2:], before[:, 2:])
    u, wi = torch.tensor([[0.25, 0.25], [0.25, 0.75]]), torch.zeros(2, 2)
    with torch.no_grad():
        found = network.albedo(network.features(u), wi)
        torch.testing.assert_close(found[0], torch.full((3,), 0.2), rtol=0, atol=0.04)
        torch.testing.assert_close(found[1], torch.full((3,), 0.8), rtol=0, atol=0.04)
        # The density does not see them.
        rows = network.condition(network.features(u), torch.zeros(2).long(), wi)
    assert rows.shape == (2, 2 + 3 + 2)


SETTINGS = ("walks=60000", "width=16", "layers=2", "steps=2", "matching_steps=10",
            "likelihood_steps=10", "likelihood_batch=256", "directions=2048",
            "albedo_steps=50")  # fmt: skip


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("trained") / "beads.safetensors"
    small = {"conditions": 3, "walks": 1 << 14, "directions": 8, "group": 1024}
    patch = pytest.MonkeyPatch()
    draw = quality.Held.draw.__func__
    patch.setattr(quality.Held, "draw", classmethod(lambda *a, **k: draw(*a, **{**k, **small})))
    with patch.context():
        settings = [part for change in SETTINGS for part in ("--set", change)]
        run = ["material", "train", "clay-beads", "--kind", "puresample", "--out", str(out)]
        done = CliRunner().invoke(build(), [*run, *settings])
        assert done.exit_code == 0, done.output
        assert "clay-beads" in done.output and "albedo within 3 %" in done.output
        measured = CliRunner().invoke(build(), ["material", "measure", str(out)])
        assert measured.exit_code == 0, measured.output
    patch.undo()
    return out


def test_a_training_by_command(trained, tmp_path):
    record = storage.record(trained)
    assert record["name"] == "clay-beads" and record["walks"]["walks"] == 60000
    assert record["profile"]["name"] == "quick" and record["measured"]["seed"] == 0
    assert set(record["quality"]) == set(quality.Quality.__dataclass_fields__)
    assert files.is_one(trained)
    out = tmp_path / "look.png"
    run = ["material", "preview", str(trained), "--out", str(out), "--size", "64", "--spp", "1"]
    done = CliRunner().invoke(build(), run)
    assert done.exit_code == 0 and out.stat().st_size > 10_000, done.output
    run = ["material", "bench", str(trained), "--rows", "512", "--rounds", "3"]
    done = CliRunner().invoke(build(), run)
    assert done.exit_code == 0 and "published density" in done.output, done.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["bronze-grains", "--kind", "puresampel"], "puresampel"),
        (["bronze-grains"], "--kind puresample"),
        (["bronze-grains", "--kind", "puresample", "--resume"], "--resume"),
        (["bronze-grains", "--kind", "puresample", "--profile", "relief"], "relief"),
        (["bronze-grains", "--kind", "puresample", "--set", "walks=few"], "walks=few"),
        (["bronze-grains", "--kind", "puresample", "--set", "albedo_loss=l3"], "l3"),
        (["bronze-grain", "--kind", "puresample"], "bronze-grains"),
    ],
)
def test_refused_commands(arguments, message, tmp_path):
    out = str(tmp_path / "x.safetensors")
    done = CliRunner().invoke(build(), ["material", "train", *arguments, "--out", out])
    assert isinstance(done.exception, InputError) and message in str(done.exception)
    assert "\n" not in str(done.exception)


def test_a_direction_that_rounds_to_horizontal_is_not_learned():
    """It has no place on the plane and would make the loss infinite; its neighbour is kept."""
    rows = 64
    near = torch.tensor([math.sqrt(1 - 1e-6), 0.0])
    wo = near.repeat(rows, 1)
    wo[0] = torch.tensor([1.0, 0.0])
    at = torch.zeros(rows, 2)
    left = torch.ones(rows, dtype=torch.bool)
    walked = data.Walked(at, at, torch.zeros(rows).long(), wo, left, Counts(walks=rows))
    kept = walked.survivors()
    assert len(kept) == rows - 1 and torch.equal(kept.wo, near.expand(rows - 1, 2))
    profile = replace(
        TINY,
        architecture=replace(TINY.architecture, domain="plane", base="lobes"),
        matching_steps=3,
        matching_batch=rows,
        likelihood_steps=3,
        likelihood_batch=rows,
    )
    network = PureSample(profile.architecture)
    losses = density.fit(network, kept, profile, 0, "cpu", lambda *_: None)
    assert all(math.isfinite(loss) for loss in losses.values())
