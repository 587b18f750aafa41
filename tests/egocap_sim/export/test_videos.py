"""Camera files read back with PyAV: the times, frames and colours that planted.json states."""

import json
from types import SimpleNamespace

import av
import numpy as np
import pytest

from egocap.cameras.rig import Mount, Rig
from egocap.data.sequence import Frame
from egocap.errors import InputError
from egocap_sim.export.videos import PLANTED, write_videos
from egocap_sim.scene.rig_sampler import sample_rig

FPS = 30000 / 1001
FRAMES = 120
LATE, DRIFT = 0.011, 50e-6


class Footage:
    """A grey ramp that grows brighter by one level every two frames."""

    def __init__(self, width: int = 96, frames: int = FRAMES) -> None:
        rig = sample_rig(np.random.default_rng(1))
        mounts = tuple(Mount(m.name, m.camera.resized(width, 64), m.T_head_camera)
                       for m in rig.mounts)  # fmt: skip
        self.rig = Rig("two", mounts)
        self.manifest = SimpleNamespace(name="ramp", fps=FPS, views=self.rig.views, seed=4)
        self.times = np.arange(frames) / FPS
        taken = np.stack([self.times, self.times * (1 + DRIFT) + LATE], 1)
        contact = (self.times % 0.5 < 0.25)[:, None] & np.ones(4, bool)  # two steps a second
        self.truth = SimpleNamespace(contact=contact)
        self.sensor = SimpleNamespace(time=taken, dropped=np.zeros((frames, 2), bool))
        self._shape = (64, width, 3)

    def __len__(self) -> int:
        return len(self.times)

    def __iter__(self):
        for i in range(len(self)):
            image = np.full(self._shape, 60 + i // 2, np.uint8)
            yield Frame(i, self.times[i], (image, image), (True, True))


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    out = tmp_path_factory.mktemp("videos") / "out"
    seen = []
    write_videos(Footage(), out, seen.append)
    assert sum(seen) == FRAMES
    return out, json.loads((out / PLANTED).read_text())


def decoded(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [(float(f.pts * f.time_base), f.to_ndarray(format="rgb24").mean((0, 1)))
                  for f in container.decode(stream)]  # fmt: skip
        return stream.codec_context.name, *map(np.array, zip(*frames, strict=True))


def test_pictures_have_the_times_of_the_cameras_own_clock(exported):
    out, planted = exported
    for view, told in planted["views"].items():
        codec, times, _ = decoded(out / f"{view}.mp4")
        assert codec == "h264"
        np.testing.assert_allclose(times, np.array(told["places"]) / FPS, atol=2e-5)
        assert len(told["lost"]) == 3 and not set(told["lost"]) & set(told["places"])
        assert len(told["repeated"]) == 1


def test_pictures_show_the_frames_that_are_stated(exported):
    out, planted = exported
    for view, told in planted["views"].items():
        shown = decoded(out / f"{view}.mp4")[2]
        level = 60 + np.array(told["frames"]) // 2
        expected = np.clip(level[:, None] * np.sqrt(told["gain"]), 0, 255)
        assert np.abs(shown - expected).max() < 4
        assert np.abs(shown - expected).mean() < 1.5


def test_clocks_are_relative_to_the_first_file(exported):
    told = exported[1]["views"]
    first, other = (told[view] for view in told)
    assert (first["offset_s"], first["drift_ppm"]) == (0.0, 0.0)
    assert other["drift_ppm"] == pytest.approx(50, abs=1e-6)
    start = other["frames"][0] / FPS * (1 + DRIFT) + LATE - first["frames"][0] / FPS
    assert other["offset_s"] == pytest.approx(start, abs=1e-9)
    assert not [path.name for path in exported[0].iterdir() if "truth" in path.name]


def test_what_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(InputError, match="even width"):
        write_videos(Footage(width=95), tmp_path / "odd", print)
    with pytest.raises(InputError, match="too few"):
        write_videos(Footage(frames=9), tmp_path / "short", print)
    lost = Footage()
    lost.sensor.dropped[2:] = True
    with pytest.raises(InputError, match="frames of the view 'left' were not dropped"):
        write_videos(lost, tmp_path / "lost", print)


def test_sound_states_the_clocks(exported):
    from egocap.footage.signals import sound_signal
    from egocap.footage.synchronisation import coarse_lag, refine_clock
    from egocap.media.sound import read_sound

    out, planted = exported
    heard = [read_sound(out / f"{view}.mp4") for view in planted["views"]]
    left, right = (sound_signal(*track.loudness()) for track in heard)
    lag, correlation, _ = coarse_lag(left, right)
    offset, drift, _ = refine_clock(left, right, lag)
    told = list(planted["views"].values())[1]
    middle = float(right.time.mean())
    assert correlation > 0.7
    assert abs(offset - told["offset_s"] + (drift - 1e-6 * told["drift_ppm"]) * middle) < 3e-4
