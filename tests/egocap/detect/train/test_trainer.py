"""Training learns, resumes as if uninterrupted, stops when asked, and averages its weights."""

import os
import signal
import threading
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from egocap.detect.network import CONFIGS
from egocap.detect.train.checkpoint import load_checkpoint, load_run_weights
from egocap.detect.train.config import (
    NO_AUGMENTATION,
    AugmentationConfig,
    LossConfig,
    RunConfig,
    TrainingConfig,
)
from egocap.detect.train.run import summary_text
from egocap.detect.train.trainer import Trainer
from egocap.errors import FileError, InputError
from tests.egocap.detect.synthetic_store import store

TINY = CONFIGS["tiny"]
SHORT = TrainingConfig(
    steps=8, batch=4, average=0.9, validation_views=8,
    augmentation=AugmentationConfig(background=0.5, recolour=0.5),
)  # fmt: skip


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def trainer(folder, config=SHORT, start=None, validation=None):
    folder.mkdir(exist_ok=True)
    return Trainer(TINY, config, store(8, 0, parts=True), validation, folder, start)


def test_starting_weights_are_scored_on_the_same_views(tmp_path):
    start = trainer(tmp_path / "a").network.state_dict()
    outcome = trainer(tmp_path / "b", start=start, validation=store(6, 100)).run()
    assert outcome.start_scores is not None and outcome.scores is not None
    assert outcome.held_out == (2, SHORT.validation_views)
    rows = (tmp_path / "b" / "validation.csv").read_text().splitlines()
    assert rows[1].startswith("0,") and f"{outcome.start_scores.pck:.4f}" in rows[1]
    text = summary_text(RunConfig(tmp_path / "b", (tmp_path,)), outcome)
    assert f"visible labels within 20 px {outcome.scores.pck:.1f} %" in text
    assert f"(starting weights {outcome.start_scores.pck:.1f})" in text
    assert "fewer than 5 sequences" in text


def test_learns_a_tiny_problem(tmp_path):
    config = TrainingConfig(
        steps=100, batch=16, average=0.9, learning_rate=4e-3, validation_views=40,
        augmentation=NO_AUGMENTATION,
    )  # fmt: skip
    held_out = store(20, 100)
    outcome = Trainer(TINY, config, store(60, 0), held_out, tmp_path).run()
    assert outcome.finished and outcome.scores is not None
    assert outcome.scores.median_px < 2.5  # a view's pixel counts as two
    assert outcome.scores.pck > 95 and outcome.scores.auc > 75
    assert outcome.scores.occluded_auroc > 0.95
    assert outcome.scores.normalised_error == pytest.approx(1.0, abs=0.1)
    assert (tmp_path / "curves.png").stat().st_size > 1000
    assert len((tmp_path / "log.csv").read_text().splitlines()) == 1 + 100 // 20


def test_resumed_run_ends_with_the_same_weights(tmp_path):
    whole = trainer(tmp_path / "whole")
    whole.run()
    first = trainer(tmp_path / "parts")
    stop_after(first, 3)
    assert not first.run().finished
    second = trainer(tmp_path / "parts")
    assert second.resume() and second.state.step == 3
    assert second.run().finished
    for mine, theirs in ((whole.network, second.network), (whole.average, second.average)):
        for name, value in mine.state_dict().items():
            torch.testing.assert_close(value, theirs.state_dict()[name], rtol=0, atol=0, msg=name)


def test_a_finished_run_that_is_resumed_takes_no_step(tmp_path):
    validation = store(8, 100)
    once = trainer(tmp_path / "run", validation=validation).run()
    assert once.weights is not None
    written = load_file(once.weights)
    again = trainer(tmp_path / "run", validation=validation)
    assert again.resume()
    outcome = again.run()
    assert outcome.finished and outcome.state.step == SHORT.steps
    again = load_file(once.weights)  # the header's order is not fixed
    assert again.keys() == written.keys()
    assert all(torch.equal(again[name], written[name]) for name in written)


def test_seed_changes_the_run(tmp_path):
    runs = [trainer(tmp_path / str(s), replace(SHORT, seed=s, steps=1)) for s in (0, 1)]
    for run in runs:
        run.run()
    weights = [run.network.heat.weight for run in runs]
    assert not torch.equal(*weights)


def test_sigterm_ends_at_a_step_with_a_checkpoint(tmp_path):
    run = trainer(tmp_path / "run", replace(SHORT, steps=10_000))
    timer = threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGTERM))
    timer.start()
    outcome = run.run()
    assert not outcome.finished and 0 < outcome.state.step < 10_000
    found = load_checkpoint(tmp_path / "run")
    assert found is not None and found.state["step"] == outcome.state.step
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_warm_start_begins_with_the_weights(tmp_path):
    run = trainer(tmp_path / "run")
    path = run.run().weights
    assert path is not None
    again = trainer(tmp_path / "again", start=load_run_weights(tmp_path / "run"))
    for name, value in load_run_weights(path).items():
        torch.testing.assert_close(again.network.state_dict()[name], value)


def test_weights_without_a_loss_stay_as_they_are(tmp_path):
    config = replace(SHORT, loss=LossConfig(visibility=0.0, spread=0.0))
    run = trainer(tmp_path / "run", config)
    before = {name: value.clone() for name, value in run.network.state_dict().items()}
    run.run()
    for network in (run.network, run.average):
        for name, value in network.state_dict().items():
            if name.startswith("info."):
                torch.testing.assert_close(value, before[name], rtol=0, atol=0, msg=name)
    assert not torch.equal(run.network.heat.weight, before["heat.weight"])


def test_rows_of_a_killed_run_are_written_once(tmp_path, monkeypatch):
    monkeypatch.setattr("egocap.detect.train.curves.draw_curves", lambda folder: None)
    config = replace(SHORT, steps=70, batch=2, augmentation=NO_AUGMENTATION, validate_minutes=1e-9)
    first = trainer(tmp_path / "run", config, validation=store(2, 100))
    stop_after(first, 30)
    first.run()
    checkpoint = (tmp_path / "run" / "checkpoint.pt").read_bytes()
    second = trainer(tmp_path / "run", config, validation=store(2, 100))
    second.resume()
    stop_after(second, 50)
    second.run()
    (tmp_path / "run" / "checkpoint.pt").write_bytes(checkpoint)  # killed before it wrote another
    third = trainer(tmp_path / "run", config, validation=store(2, 100))
    assert third.resume() and third.state.step == 30
    third.run()
    for name, steps in (("log.csv", [20, 40, 60]), ("validation.csv", [*range(1, 71)])):
        head, *rows = (tmp_path / "run" / name).read_text().splitlines()
        assert head.startswith("step,")
        assert [int(row.split(",")[0]) for row in rows] == steps


def test_rate_rises_and_falls(tmp_path):
    run = trainer(tmp_path / "run", replace(SHORT, steps=100, warm_up=0.1))
    rates = []
    for step in range(100):
        run.state.step = step
        rates.append(run._rate())
    top = int(np.argmax(rates))
    assert top == 10 and rates[top] == pytest.approx(SHORT.learning_rate)
    assert (np.diff(rates[:10]) > 0).all() and (np.diff(rates[10:]) < 0).all()
    assert rates[-1] < 0.02 * SHORT.learning_rate


def test_damaged_checkpoints_are_refused(tmp_path):
    run = trainer(tmp_path / "run", replace(SHORT, steps=1))
    run.run()
    path = tmp_path / "run" / "checkpoint.pt"
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(FileError, match="not a whole checkpoint"):
        trainer(tmp_path / "run").resume()


def test_no_checkpoint_is_no_error(tmp_path):
    assert not trainer(tmp_path / "run").resume()
    with pytest.raises(FileError, match="no such file"):
        load_run_weights(tmp_path / "run" / "final.safetensors")


def test_impossible_settings_are_refused():
    with pytest.raises(InputError, match="batch 1"):
        TrainingConfig(batch=1)
    with pytest.raises(InputError, match="minutes"):
        TrainingConfig(minutes=0)


def stop_after(run: Trainer, steps: int) -> None:
    """Have SIGTERM arrive in the step of that number."""
    step = run._step

    def counted(batch):
        if run.state.step == steps - 1:
            os.kill(os.getpid(), signal.SIGTERM)
        return step(batch)

    run._step = counted
