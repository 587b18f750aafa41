import sys

import pytest

from egocap.errors import MachineError
from egocap_eval.harness import commands

_WITH_TORCH = ("egocap_eval.detection", "egocap_eval.image_model", "egocap.detect.train",
               "egocap.image_model")  # fmt: skip


@pytest.mark.parametrize("command", ["train", "image-model"])
def test_a_command_that_needs_torch_says_so(command, monkeypatch):
    monkeypatch.setattr("egocap.errors.find_spec", lambda name: None)
    for name in [name for name in sys.modules if name.startswith(_WITH_TORCH)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)  # importing it fails
    with pytest.raises(MachineError, match=r"'torch' is missing; pip install 'egocap\[train\]'"):
        commands.main([command, "--help"])
