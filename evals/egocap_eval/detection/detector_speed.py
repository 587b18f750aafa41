"""Speed of the detector as a whole and by stage."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from egocap.data.sequence import Sequence
    from egocap.detect.detector import Detector


def measure_speed(
    sequence: Sequence, detector: Detector, threads: int | None, frames: int = 60
) -> dict[str, Any]:
    """Stereo pairs a second as `detect` runs, and the CPU time of its stages one by one."""
    from egocap.detect.engine import available_cores
    from egocap.detect.input_images import recorded_pictures

    frames = min(frames, len(sequence))
    detector.detect(sequence, frames=min(5, frames))
    start = time.perf_counter()
    detector.detect(sequence, frames=frames)
    rate = frames / (time.perf_counter() - start)
    spent = dict.fromkeys(("decode JPEG", "canonical view", "network", "decode maps"), 0.0)
    for i in range(min(frames, 20)):
        marks = [time.process_time()]
        pictures = recorded_pictures(sequence, i)
        marks.append(time.process_time())
        views, slots = detector.canonical([pictures])
        marks.append(time.process_time())
        outputs = detector.run(views)
        marks.append(time.process_time())
        detector.read(outputs, slots, sequence.times[i : i + 1])
        marks.append(time.process_time())
        for stage, seconds in zip(spent, np.diff(marks), strict=True):
            spent[stage] += 1e3 * float(seconds) / min(frames, 20)
    return {
        "engine": detector.engine.name,
        "threads": threads or available_cores(),
        "pairs_per_second": rate,
        "stage_cpu_ms": spent,
    }
