"""Simulate a recording with your rig, detect, track, score.

python examples/quickstart.py [RIG.toml]
"""

import sys

import egocap
import egocap_sim


def main(rig: str = "egorig1") -> None:
    """Generate two seconds of walking and print the error of the tracked pose."""
    sequence = egocap_sim.generate(
        "validation-walk", "out/quickstart", rig=rig, frames=60, size=(640, 512)
    )
    detections = egocap.Detector(sequence.rig).detect(sequence)
    tracker = egocap.Tracker(sequence.rig, sequence.body)
    track = tracker.track(detections, images=sequence.images)
    print(sequence, detections, track, sep="\n")
    print(egocap.evaluate(track, sequence))


if __name__ == "__main__":
    main(*sys.argv[1:])
