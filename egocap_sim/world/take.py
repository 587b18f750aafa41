"""A simulated take: the data of a sequence before rendering."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from egocap.data.truth import Truth
from egocap.files import disk_errors
from egocap_sim.sensor.config import SensorTable
from egocap_sim.sensor.plan import DRAFTS, SensorPlan

_TRUTH = "truth.draft.tmp"


@dataclass(frozen=True, eq=False)
class Take:
    """The truth before rendering, and the effect of the sensor on each frame.

    `visibility` of the truth holds only VISIBLE and OUT_OF_VIEW; rendering adds occlusion.
    """

    truth: Truth
    sensor_plan: SensorPlan | None  # None: a perfect sensor

    def save(self, folder: Path) -> None:
        """Write it into a sequence's folder, under temporary names, for worker processes."""
        with disk_errors(folder):
            self.truth.save(folder / _TRUTH)
            if self.sensor_plan is not None:
                self.sensor_plan.save(folder)

    @classmethod
    def load(
        cls, drafts: Path | Mapping[str, bytes], sensor: SensorTable | None, seed: int
    ) -> Take:
        """Read a saved take from its folder, or from the result of `read_drafts`."""
        if not isinstance(drafts, Path):
            with tempfile.TemporaryDirectory(prefix="egocap-") as folder:
                for name, content in drafts.items():
                    (Path(folder) / name).write_bytes(content)
                return cls.load(Path(folder), sensor, seed)
        sensor_plan = None if sensor is None else SensorPlan.load(drafts, sensor, seed)
        return cls(Truth.load(drafts / _TRUTH), sensor_plan)


def read_drafts(folder: Path) -> dict[str, bytes]:
    """The files that `Take.save` wrote into a folder, by name."""
    names = (_TRUTH, *DRAFTS)
    return {name: (folder / name).read_bytes() for name in names if (folder / name).exists()}


def remove_drafts(folder: Path) -> None:
    """Delete the files that `Take.save` wrote into a folder."""
    for name in (_TRUTH, *DRAFTS):
        (folder / name).unlink(missing_ok=True)
