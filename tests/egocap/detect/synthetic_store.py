"""A tiny problem that a tiny network can learn: labels are coloured dots on a dark ground."""

import numpy as np

from egocap.detect.train.examples import HIDDEN, OUTSIDE, SEEN, Views, ViewStore

SIZE = 64


def dots(count: int, seed: int, parts: bool = False) -> Views:
    """Views whose 18 labels are dots at two corners of a moving square; half are OUTSIDE."""
    rng = np.random.default_rng(seed)
    images = rng.integers(0, 30, (count, SIZE, SIZE, 3), dtype=np.uint8)
    points = np.zeros((count, 18, 2), np.float32)
    state = np.full((count, 18), OUTSIDE, np.uint8)
    v, u = np.mgrid[:SIZE, :SIZE]
    for i in range(count):
        at = rng.uniform(14, 50, 2)
        for label, colour in enumerate(((255, 0, 0), (0, 255, 0), (0, 0, 255))):
            place = at + (8 * label - 8, 4 * (label % 2))
            images[i][np.hypot(u - place[0], v - place[1]) < 3] = colour
            points[i, label] = place
            state[i, label] = HIDDEN if label == 2 else SEEN
    labels = np.where((images > 100).any(-1), 3, 100).astype(np.uint8) if parts else None
    return Views(images, labels, points, state, np.full((count, 18), 2.0, np.float32))


def store(count: int, seed: int, parts: bool = False) -> ViewStore:
    """Two sequences of such views."""
    return ViewStore((dots(count, seed, parts), dots(count, seed + 1, parts)))
