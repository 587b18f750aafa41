"""What the public objects print: one line with the essential numbers."""

from dataclasses import replace

import numpy as np

from egocap.data.sequence import Sequence
from egocap.data.track import Track
from egocap.detect.sources import synthetic_detections


def make_track(frames=250):
    return Track(
        np.arange(frames) / 30, np.zeros((frames, 37)), np.zeros((frames, 18, 3)), np.zeros(frames),
        np.arange(frames) >= 2, np.zeros(frames), 0.001, {},
    )  # fmt: skip


def test_tracks_name_frames_seconds_and_frame():
    track = make_track()
    assert repr(track) == "Track(250 frames, 8.3 s, 248 converged, head frame)"
    assert "head and world" in repr(replace(track, joints_world=track.joints_head))
    assert "0 frames, 0.0 s" in repr(make_track(0))


def test_sequences_and_what_they_hold_fit_a_line(tiny_sequence):
    sequence = Sequence(tiny_sequence)
    assert "7 frames at 30 Hz, 2 views)" in repr(sequence)
    found = synthetic_detections(sequence)
    assert repr(found).startswith("Detections(7 frames, 2 views, ")
    assert repr(found).endswith(" per frame, simulated:2.0)")
    assert repr(sequence.body).startswith("Proportions(arm 0.")
    camera = sequence.rig.cameras[0]
    assert repr(camera) == f"Camera(equidistant, {camera.width} x {camera.height}, 180 degrees)"
    assert repr(sequence.rig).count("Camera(") == 2
    for value in (sequence, found, sequence.body, sequence.rig, camera):
        assert len(repr(value)) < 160 and "\n" not in repr(value)


def test_notebooks_show_images_of_a_sequence(tiny_sequence):
    page = Sequence(tiny_sequence)._repr_html_()
    assert page.count('<img src="data:image/jpeg;base64,/9j/') == 2
    assert "7 frames at 30 Hz" in page


def test_notebooks_show_the_uncertainty_of_a_track():
    track = make_track()
    assert "<table>" not in track._repr_html_()
    covariance = np.broadcast_to(np.eye(3) * 0.01**2, (250, 18, 3, 3))
    page = replace(track, covariance=covariance)._repr_html_()
    assert page.count("<td>10.0</td>") == 18 and "<td>left wrist</td>" in page
