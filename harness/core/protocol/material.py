"""A material: a reflectance function, and how to draw conditions from it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import torch
from torch import Tensor

from harness.core.protocol.disk import luminance, square_to_disk
from harness.core.protocol.errors import Unsupported


class Material(ABC):
    """A reflectance function of a condition and a direction.

    A condition is one row ``[address, features, wi.xy]`` of width ``n_condition``:

    - ``n_address`` columns say *where* on the material the row is (``u, v``); only the
      material itself reads them, to evaluate exactly. Zero where the features suffice.
    - ``n_features`` columns say *what* is there: inputs for a fitted method.
    - two columns ``wi.xy``, the given direction on the projected disk.
    """

    name: str
    n_address: int = 0
    n_features: int = 0
    effects: frozenset[str] = frozenset()
    """Names of what it can do without (:mod:`harness.effects`), such as ``parallax``."""
    family: str = ""
    """Name of the parametric family it belongs to."""
    parameters: tuple[Any, ...] = ()
    """A family's parameters, which are its features."""
    renders_in_columns: bool = False
    """Whether a render calls its ``condition_columns(si)`` and ``eval_columns``, with no tensor."""
    both_sides: bool = False
    """Whether it reflects from behind, too, and there as it does from the front."""
    prefilters: bool = False
    """Whether ``condition_columns`` takes the footprint of a ray as well."""

    @property
    def n_condition(self) -> int:
        """Width of a condition row."""
        return self.n_address + self.n_features + 2

    @abstractmethod
    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """BSDF [N, 3] without cosine, per steradian, at ``condition`` [N, C], ``wo`` [N, 2].

        Zero outside the disk. May be negative where the data is (measured materials).
        """

    @abstractmethod
    def identity(self) -> dict[str, Any]:
        """What determines the reflectance, as JSON data without absolute paths (for hashes)."""

    def places(self, uv: Tensor) -> Tensor:
        """Address and features [N, n_address + n_features] at texture coordinates [N, 2]."""
        if self.n_address + self.n_features:
            raise NotImplementedError(f"{type(self).__name__} has features but no places()")
        return uv.new_empty(len(uv), 0)

    def peaks(self, condition: Tensor) -> Tensor:
        """Where f is concentrated, [N, K, 2]: places of the plane that an integral must visit.

        For checks that integrate f. They look around the mirrored direction by themselves;
        name what lies elsewhere. A lobe's centre may lie outside the disk.
        """
        return condition.new_empty(len(condition), 0, 2)

    def mitsuba_bsdf(self) -> Any:
        """The Mitsuba BSDF that it is, which renders then evaluate; None if it is none."""
        return None

    def with_effects(self, effects: frozenset[str]) -> Material:
        """The material that runs only those of its own ``effects``; itself, if it has none.

        Names that are not its own are ignored. Its conditions keep their columns, so that a
        method fitted to the whole samples it too.
        """
        return self

    def eval_luminance(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Luminance [N] of :meth:`eval`; overridden where one channel costs less than three."""
        return luminance(self.eval(condition, wo))

    def conditions(self, n: int, generator: torch.Generator, device: str = "cpu") -> Tensor:
        """``n`` random conditions [n, C]: random places, ``wi`` uniform on the disk."""
        u = torch.rand(n, 4, generator=generator).to(device)
        return torch.cat([self.places(u[:, :2]), square_to_disk(u[:, 2:])], 1)

    def target(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Unnormalised target density [N]: absolute luminance of the BSDF at ``wo``.

        Measured data is negative in places. A density in proportion to ``|f|`` is the one
        of least variance for a signed integrand, and it covers those places too.
        """
        return luminance(self.eval(condition, wo)).abs()

    def target_grid(self, condition: Tensor, wo: Tensor) -> Tensor:
        """:meth:`target` of every condition [N, C] at all its directions [N or 1, M, 2]: [N, M].

        For tables. A material that can avoid the copies of the rows overrides it.
        """
        n, m = len(condition), wo.shape[1]
        rows = condition.repeat_interleave(m, 0)
        return self.target(rows, wo.expand(n, m, 2).reshape(-1, 2)).view(n, m)

    def why_no_gradient(self) -> str:
        """Why :meth:`target_gradient` has no answer; empty where it has one.

        By default it is asked for one condition. A material overrides it that knows.
        """
        generator = torch.Generator().manual_seed(0)
        try:
            self.target_gradient(self.conditions(1, generator), torch.full((1, 2), 0.1))
        except Unsupported as error:
            return str(error)
        return ""

    def target_gradient(self, condition: Tensor, wo: Tensor) -> tuple[Tensor, Tensor]:
        """:meth:`target` [N] and its derivative [N, 2] by ``wo``, per unit of the disk's radius.

        By torch. Where f jumps the derivative is that of either side, as of its absolute value
        at 0.

        Raises:
            Unsupported: :meth:`eval` is no differentiable function of ``wo``.
        """
        with torch.inference_mode(False), torch.enable_grad():
            leaf = wo.detach().clone().requires_grad_()
            found = self.target(condition.detach().clone(), leaf)
            if not found.requires_grad:
                raise Unsupported(
                    f"material '{self.name}' gives no gradient of f: its values do not come from"
                    " torch operations on wo"
                )
            (slope,) = torch.autograd.grad(found.sum(), leaf)
        return found.detach(), slope
