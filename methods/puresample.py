"""The samplers of a material learned from walks: the brightest channel's flow, or all channels'."""

from __future__ import annotations

from harness.core.columns.bridge import Columns, Float
from harness.core.columns.method import ColumnMethod
from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.material import Material
from harness.core.protocol.method import refuse_unsupported

CHANNELS = ("highest", "mixture")


class PureSample(ColumnMethod):
    """Samples a material learned from walks by its own flow (Li et al. 2025, section 5.4).

    ``channel="highest"``, as published: the flow of the channel with the highest albedo, whose
    density is known as it moves: one pass of the flow a sample. Other channels' colours make the
    weights vary. ``channel="mixture"``: a channel by chance, in proportion to the luminance that it
    carries, and the density of the mixture, which is that of the luminance of f itself: the weights
    of a grey scene do not vary at all. A sample then costs three inversions as well.

    Needs no fit and has an exact density. Uses three uniforms. Per disk area.
    """

    name = "puresample"
    uniforms = 3

    def __init__(self, channel: str = "highest"):
        if channel not in CHANNELS:
            raise InputError(f"{self.name}: channel is '{channel}'{nearest(channel, CHANNELS)}")
        self.channel = channel

    def supports(self, material: Material) -> tuple[bool, str]:
        """Whether the material was learned from walks."""
        if not callable(getattr(material, "channel_sample_columns", None)):
            return False, f"material '{material.name}' was not learned from walks"
        return True, ""

    def bind(self, material: Material) -> None:
        """See :meth:`Method.bind`; refuses a material of another kind."""
        refuse_unsupported(self, material)
        super().bind(material)

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`."""
        if self.channel == "mixture":
            return self.material.native_sample_columns(c, u)
        return self.material.channel_sample_columns(c, u, self.material.brightest_columns(c))

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`."""
        if self.channel == "mixture":
            return self.material.native_pdf_columns(c, wo)
        return self.material.channel_pdf_columns(c, wo, self.material.brightest_columns(c))
