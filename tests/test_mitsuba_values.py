"""Transforms in a suite's dictionaries are those of Mitsuba's XML."""

from __future__ import annotations

import numpy as np
import pytest

from harness.core.protocol.errors import InputError
from harness.materials.mitsuba_values import checked, matrix

XML = """<scene version="3.0.0"><shape type="sphere"><transform name="to_world">{}</transform>
</shape></scene>"""


@pytest.mark.parametrize(
    ("value", "xml"),
    [
        ({"scale": 8}, '<scale value="8"/>'),
        ({"scale": [4, 2, 3]}, '<scale x="4" y="2" z="3"/>'),
        ({"translate": [1, 2, -3]}, '<translate x="1" y="2" z="-3"/>'),
        ({"rotate": {"z": 1, "angle": 30}}, '<rotate z="1" angle="30"/>'),
        (
            {"rotate": {"axis": [0.6, 0, 0.8], "angle": -70}},
            '<rotate x="0.6" z="0.8" angle="-70"/>',
        ),
        (
            {"scale": 2, "rotate": {"x": 1, "angle": 40}, "translate": [1, 0, 0]},
            '<scale value="2"/><rotate x="1" angle="40"/><translate x="1"/>',
        ),
        (
            [{"translate": [1, 0, 0]}, {"rotate": {"y": 1, "angle": 90}}, {"translate": [0, 1, 0]}],
            '<translate x="1"/><rotate y="1" angle="90"/><translate y="1"/>',
        ),
        (
            {"look_at": {"origin": [3, 1, 2], "target": [0, 1, 0], "up": [0, 1, 0]}},
            '<lookat origin="3,1,2" target="0,1,0" up="0,1,0"/>',
        ),
        (
            [1, 2, 0, 4, 0, 1, 3, 5, 0, 0, 2, 6, 0, 0, 0, 1],
            '<matrix value="1 2 0 4 0 1 3 5 0 0 2 6 0 0 0 1"/>',
        ),
        (
            {"matrix": [[1, 2, 0, 4], [0, 1, 3, 5], [0, 0, 2, 6], [0, 0, 0, 1]]},
            '<matrix value="1 2 0 4 0 1 3 5 0 0 2 6 0 0 0 1"/>',
        ),
    ],
)
def test_as_in_xml(value, xml):
    """The matrix that Mitsuba's parser makes of the same steps."""
    import mitsuba as mi

    from harness.mitsuba_runtime.variant import use

    use("cpu")
    state = mi.parser.parse_string(mi.parser.ParserConfig("llvm_ad_rgb"), XML.format(xml))
    expected = np.array(state.nodes[1].props["to_world"].matrix)
    assert matrix(value, "here") == pytest.approx(expected, abs=1e-6)


def test_of_a_texture(tmp_path):
    """Nine numbers are of the plane: a checkerboard of eight times eight squares."""
    import drjit as dr

    from harness.materials.mitsuba_values import mitsuba_values
    from harness.mitsuba_runtime.variant import use

    mi = use("cpu")
    uv = np.random.default_rng(0).random((2, 500)).astype(np.float32)
    si = dr.zeros(mi.SurfaceInteraction3f, 500)
    si.uv = mi.Point2f(mi.Float(uv[0]), mi.Float(uv[1]))
    u, v = 8 * uv[0] + 0.3, 4 * uv[1]
    expected = (u % 1 > 0.5) != (v % 1 > 0.5)
    for to_uv in ([8, 0, 0.3, 0, 4, 0, 0, 0, 1], {"scale": [8, 4], "translate": [0.3, 0]}):
        board = {"type": "checkerboard", "color0": 1.0, "color1": 0.0, "to_uv": to_uv}
        texture = mi.load_dict(mitsuba_values(checked(board, "here", tmp_path)))
        assert (np.array(texture.eval_1(si)) == expected).mean() > 0.99


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ({"scle": 8}, "did you mean 'scale'"),
        ({"scale": "big"}, "expected two or three numbers"),
        ({"rotate": {"axis": [0, 0, 0], "angle": 3}}, "expected degrees"),
        ({"look_at": {"origin": [0, 0, 0], "target": [0, 0, 0], "up": [0, 1, 0]}}, "apart"),
        ([1, 2, 3], "expected a transform"),
        ([0] * 9, "no inverse"),
        ("x", "expected a transform"),
        ([{"scale": 2}, {"shear": 1}], r"\[1\]: unknown step 'shear'"),
    ],
)
def test_refusals(value, said):
    """One line with the key."""
    with pytest.raises(InputError, match=said) as refused:
        matrix(value, "m.to_uv")
    assert str(refused.value).startswith("m.to_uv")
