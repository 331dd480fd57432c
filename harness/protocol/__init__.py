"""The floor of the harness: what a method and a material are. Imports torch alone."""

from harness.protocol.disk import (
    cos_theta,
    disk_to_solid_angle,
    disk_to_square,
    inside_disk,
    luminance,
    solid_angle_to_disk,
    square_to_disk,
    to_direction,
)
from harness.protocol.errors import (
    BudgetExceeded,
    InputError,
    StateRefused,
    Unsupported,
    nearest,
)
from harness.protocol.material import Material
from harness.protocol.method import Budget, DiskSample, FitReport, Knob, Method, WeightedSample

__all__ = [
    "Budget",
    "BudgetExceeded",
    "DiskSample",
    "FitReport",
    "InputError",
    "Knob",
    "Material",
    "Method",
    "StateRefused",
    "Unsupported",
    "WeightedSample",
    "cos_theta",
    "disk_to_solid_angle",
    "disk_to_square",
    "inside_disk",
    "luminance",
    "nearest",
    "solid_angle_to_disk",
    "square_to_disk",
    "to_direction",
]
