"""What every fit needs: tabulated targets, and one training loop."""

from harness.fitting.flow_method import FlowMethod
from harness.fitting.lobe_method import LobeMethod
from harness.fitting.module_method import ModuleMethod
from harness.fitting.targets import Targets
from harness.fitting.train import minimise

__all__ = ["FlowMethod", "LobeMethod", "ModuleMethod", "Targets", "minimise"]
