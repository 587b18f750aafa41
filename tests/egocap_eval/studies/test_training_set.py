"""The training-set study: subsets hold what they say, of both cameras, without copies."""

import numpy as np
import pytest

from egocap.data.sequence import Sequence
from egocap.detect.train.examples import Views, ViewStore
from egocap.errors import InputError
from egocap_eval.studies.small_detectors import Trainings
from egocap_eval.studies.training_set import (
    SUBSETS,
    every_nth,
    half_of_people,
    identify_people,
    study,
)


def views(first: int, count: int) -> Views:
    """Views whose pictures say which they are: even for the left camera, odd for the right."""
    images = np.broadcast_to(
        np.arange(first, first + count, dtype=np.uint8)[:, None, None, None], (count, 4, 4, 3)
    )
    labels = np.zeros((count, 18))
    return Views(images, None, np.zeros((count, 18, 2)), labels.astype(np.uint8), labels)


@pytest.fixture
def store():
    return ViewStore((views(0, 40), views(100, 20), views(200, 20)))


def shown(part: ViewStore) -> list[int]:
    return sorted(int(image[0, 0, 0]) for s in part.sequences for image in s.images)


@pytest.mark.parametrize("n", [2, 10])
def test_every_nth_frame_keeps_both_cameras(store, n):
    rows = shown(every_nth(store, n))
    assert len(rows) == 80 / n
    assert rows[:2] == [0, 1]
    assert np.mean([row % 2 for row in rows]) == 0.5
    frames = sorted({row // 2 for row in rows if row < 40})
    assert (np.diff(frames) == n).all()


def test_half_of_the_people_are_whole(store):
    assert shown(half_of_people(store, [0, 1, 0])) == [*range(40), *range(200, 220)]
    assert len(half_of_people(store, [0, 0, 1])) == 60


def test_slices_are_no_copies(store):
    part = every_nth(store, 2)
    assert np.shares_memory(part.sequences[0].images, store.sequences[0].images)


def test_same_person_has_the_same_number(tiny_sequence):
    assert identify_people([tiny_sequence, tiny_sequence]) == [0, 0]


def test_one_person_cannot_be_halved(tiny_sequence, tmp_path):
    if Sequence(tiny_sequence).mask(0, "left") is None:
        pytest.skip("no part labels")
    with pytest.raises(InputError, match="one person"):
        one = (tiny_sequence,)
        study(Trainings(one, one, one, 1, batch=2, seeds=1, network="tiny", views=4,
                        store=tmp_path))  # fmt: skip


def test_paper_rows_name_the_losses():
    from egocap_eval.harness.suite import FOLDER, load_suite

    places = {row.ours for row in load_suite(FOLDER / "quick.toml").rows}
    for key, _ in SUBSETS.values():
        assert f"training_set.json:{key}.mean" in places
