"""What measured BRDFs over columns have in common, whatever is stored of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.core.columns.bridge import Columns
from harness.core.columns.material import ColumnMaterial


class MeasuredColumns(ColumnMaterial):
    """An untextured BRDF whose condition is ``wi.xy``, azimuths counted from the tangent dp_du."""

    renders_in_columns = True

    def __init__(self, name: str, identity: dict[str, Any]):
        self.name, self._identity = name, identity

    def identity(self) -> dict[str, Any]:
        """See :meth:`Material.identity`."""
        return self._identity

    def condition_columns(self, si: Any) -> Columns:
        """The condition at surface interactions, as a renderer meets it."""
        return [si.wi.x, si.wi.y]


class MeasuredTable(MeasuredColumns):
    """One whose values ``rgb`` [3, ...] are gathered from a table."""

    def __init__(self, name: str, rgb: NDArray[np.float32], identity: dict[str, Any]):
        super().__init__(name, identity)
        self._rgb = np.moveaxis(rgb, 0, -1).reshape(-1)
        self._loaded: dict[type, Any] = {}

    def table(self, array: type) -> Any:
        """All values as a Dr.Jit array of the type ``array``; red, green, blue of an entry follow
        each other."""
        if array not in self._loaded:
            self._loaded[array] = array(self._rgb)
        return self._loaded[array]
