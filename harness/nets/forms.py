"""Weights in the forms that kernels read, made again when a weight has changed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from torch import Tensor


class Forms:
    """Forms of a module's weights by name. A copy of the module begins without any.

    Example:
        >>> forms = Forms()
        >>> forms.of(net.parameters(), "transposed", lambda numbers: [n.T for n in numbers])
    """

    def __init__(self) -> None:
        self._content, self._made = b"", {}

    def of(
        self,
        parameters: Iterable[Tensor],
        what: str,
        make: Callable[[list[np.ndarray]], Any],
    ) -> Any:
        """What ``make`` gave for these parameters, float32; by content, as torch's version counter
        misses the writes of fused optimisers."""
        numbers = [p.detach().float().cpu().numpy() for p in parameters]
        content = b"".join(a.tobytes() for a in numbers)
        if self._content != content:
            self._content, self._made = content, {}
        if what not in self._made:
            self._made[what] = make(numbers)
        return self._made[what]

    def __reduce__(self) -> tuple[type[Forms], tuple]:
        return Forms, ()
