"""The world study: the head poses' errors, its targets, and one short walk from start to end."""

from types import SimpleNamespace

import numpy as np
import pytest

from egocap.errors import InputError
from egocap_eval.world.study import (
    MEASURES,
    SHIFT,
    TURN,
    disturbed,
    force_error,
    missed,
    study,
)


def test_head_poses_have_the_stated_errors():
    true = np.tile(np.eye(4), (4000, 1, 1))
    found = disturbed(true, np.arange(4000) / 30, np.random.default_rng(1))
    shift = found[:, :3, 3]
    assert shift.std() == pytest.approx(SHIFT, rel=0.15)
    angle = np.arccos(np.clip((np.trace(found[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert np.sqrt((angle**2).mean()) == pytest.approx(TURN * 3**0.5, rel=0.15)
    assert np.corrcoef(shift[1:, 0], shift[:-1, 0])[0, 1] > 0.85


def test_targets():
    good = dict.fromkeys(MEASURES, 0.01) | {"contact_f1": 0.95}
    bad = good | {"foot_skate": 0.2, "contact_f1": 0.5, "root_translation_percent": None}
    rows = [{"recording": "a", "contacts": good}, {"recording": "b", "contacts": bad}]
    assert [text.split(",")[0] for text in missed(rows)] == [
        "b: foot_skate 0.2", "b: contact_f1 0.50"
    ]  # fmt: skip


def test_force_error_is_of_known_contacts_and_in_body_weights():
    frames = 4
    force = np.zeros((frames, 2, 3))
    force[:, 0, 2] = 500.0  # N, of a lighter person than the refined one
    wrench = np.zeros((frames, 6))
    wrench[3], force[3, 0, 2] = [0, 0, 500.0, 0, 0, 0], 0.0
    truth = SimpleNamespace(ground_force=force, root_wrench=wrench,
                            propped=np.arange(frames) == 3)  # fmt: skip
    support = np.zeros((frames, 10, 3))
    support[:, 0, 2] = 1.1 * 981.0
    found = SimpleNamespace(refined=np.ones(frames, bool), support=support, weight=981.0)
    assert force_error(found, truth) == pytest.approx(np.sqrt(0.1**2 / 2))
    assert force_error(SimpleNamespace(refined=np.zeros(frames, bool)), truth) is None


def test_options_are_checked(tmp_path):
    with pytest.raises(InputError, match=r"no recording .moon.*long walk"):
        study(tmp_path, subjects=("moon",))
    with pytest.raises(InputError, match="2 to 600"):
        study(tmp_path, long_s=1.0)
