"""Pictures of a neural material beside its truth: how slices are shown."""

from pathlib import Path

import numpy as np
import pytest
import torch

from harness.core.protocol.errors import InputError
from harness.mitsuba_runtime import variant
from harness.training import preview

variant.use("cpu")


def dim(u, kernel, wi, wo):
    return torch.full((len(u), 3), 0.01)


def shown(figure):
    """The pictures of a figure's two rows."""
    images = [axes.get_images()[0].get_array() for axes in figure.axes]
    return np.array_split(np.arange(len(images)), 2), images


def test_slices_are_as_bright_as_the_truth_allows():
    truth = preview.draw(None, lambda _: dim, 32, 1, "cpu")
    half = preview.draw(None, lambda _: lambda *q: 0.5 * dim(*q), 32, 1, "cpu")
    (upper, lower), images = shown(preview._figure([truth, half], "dim"))
    for row, bright in ((upper, 1.0), (lower, 0.735)):
        for picture in (images[i] for i in row[3:]):
            # White off the disk; in it sRGB of 1, or of a half.
            assert np.allclose(picture[0, 0], 1)
            assert np.allclose(picture[4, 4], bright, atol=0.01)


def test_a_slice_that_is_no_number_is_not_hidden():
    truth = preview.draw(None, lambda _: dim, 32, 1, "cpu")
    broken = preview.draw(None, lambda _: lambda *q: dim(*q) * torch.nan, 32, 1, "cpu")
    (_, lower), images = shown(preview._figure([truth, broken], "broken"))
    assert np.isnan(np.ma.filled(images[lower[3]], np.nan)[4, 4]).all()


def test_where_a_preview_goes(tmp_path):
    """Is found out before anything is drawn: new folders, old ones, wrong names, a file above."""
    from harness.cli.material import _png

    file = tmp_path / "leather.safetensors"
    assert _png(None, file) == Path("leather-preview.png")
    assert _png(tmp_path / "new" / "x.png", file) == tmp_path / "new" / "x.png"
    assert _png(tmp_path, file) == tmp_path / "leather-preview.png"
    (tmp_path / "file").touch()
    for out, said in (("x.jpg", "ends in .png"), ("file/y.png", "cannot be written")):
        with pytest.raises(InputError, match=said):
            _png(tmp_path / out, file)
