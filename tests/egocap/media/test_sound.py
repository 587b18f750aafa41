"""Loudness of sound tracks whose samples are known."""

from fractions import Fraction

import av
import numpy as np
import pytest

from egocap.errors import FileError
from egocap.media.sound import read_sound

RATE = 48_000


def recorded(path, samples, start=0.0, codec="pcm_s16le"):
    """A file with a mono sound track that begins at a time [s]."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=RATE, layout="mono")
        for at in range(0, len(samples), 1024):
            block = (32767 * samples[None, at : at + 1024]).astype(np.int16)
            frame = av.AudioFrame.from_ndarray(block, format="s16", layout="mono")
            frame.sample_rate, frame.time_base = RATE, Fraction(1, RATE)
            frame.pts = at + round(start * RATE)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def test_amplitude_and_time_of_a_clap(tmp_path):
    time = np.arange(2 * RATE) / RATE
    noise = np.random.default_rng(0).normal(0.0, 0.25, len(time)).clip(-1, 1)
    heard = read_sound(recorded(tmp_path / "a.mkv", noise * ((time > 1) & (time < 1.1))))
    times, amplitude = heard.loudness()
    loud = amplitude > 0.1
    assert times[loud][0] == pytest.approx(1.0, abs=0.003)
    assert times[loud][-1] == pytest.approx(1.1, abs=0.003)
    assert amplitude[np.abs(times - 1.05) > 0.06].max() < 0.01
    hearable = 0.25 * np.sqrt(16 / 48)  # of white noise, below half the reduced rate
    assert np.sqrt((amplitude[loud] ** 2).mean()) == pytest.approx(hearable, rel=0.1)


def test_files_without_sound_and_no_files(tmp_path):
    with av.open(str(tmp_path / "silent.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        frame = av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), format="rgb24")
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    assert read_sound(tmp_path / "silent.mp4") is None
    (tmp_path / "text.mp4").write_text("no video")
    with pytest.raises(FileError, match="sound cannot be read"):
        read_sound(tmp_path / "text.mp4")


def test_blocks_follow_one_another_although_their_times_are_rounded(tmp_path):
    """Matroska states times to a millisecond; gaps are kept."""
    tone = 0.5 * np.sin(2 * np.pi * 440 * np.arange(RATE) / RATE)
    heard = read_sound(recorded(tmp_path / "a.mkv", tone, start=0.25))
    assert heard.start == pytest.approx(0.25, abs=1e-3)
    inner = heard.samples[2000:14000] / 32767
    own = np.arange(len(inner)) / 16_000
    waves = np.stack([np.sin(2 * np.pi * 440 * own), np.cos(2 * np.pi * 440 * own)], 1)
    left = inner - waves @ np.linalg.lstsq(waves, inner, rcond=None)[0]
    assert np.abs(left).max() < 2e-3
