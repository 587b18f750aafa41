"""Sampling weights by difficulty: sequences on which a network errs are drawn more often.

Source: hard example mining, Shrivastava et al. 2016; here for whole sequences, by their error
before the training, so that a batch still depends on seed and step alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.detect.network import DetectorNetwork
from egocap.detect.train.examples import HIDDEN, SEEN, ViewStore
from egocap.detect.train.validation import PCK_PX, Predictions, predict

MOST = 4.0
"""Most that a sequence's weight may exceed the mean, or fall below it, by its difficulty."""
_VIEWS = 8  # of a sequence, evenly spaced


def emphasised(store: ViewStore, network: DetectorNetwork, power: float) -> ViewStore:
    """The store with its sequences' sampling weights times their relative difficulty^`power`."""
    ends = np.cumsum([len(views) for views in store.sequences])
    rows = [np.unique(np.linspace(end - len(views), end - 1, _VIEWS).astype(int))
            for views, end in zip(store.sequences, ends, strict=True)]  # fmt: skip
    of_views = difficulty(predict(network, store, np.concatenate(rows)))
    parts = np.split(of_views, np.cumsum([len(r) for r in rows])[:-1])
    means = np.array([part.mean() for part in parts])
    relative = np.clip((means / max(means.mean(), 1e-9)) ** power, 1.0 / MOST, MOST)
    odds = np.ones(len(relative)) if store.odds is None else np.array(store.odds)
    return replace(store, odds=tuple((odds * relative).tolist()))


def difficulty(found: Predictions) -> Float[Array, "N"]:
    """Mean error of each view's labels, 1 at `PCK_PX` or beyond; occluded labels count half."""
    far = np.minimum(np.linalg.norm(found.off, axis=-1) * found.magnification / PCK_PX, 1.0)
    weight = np.where(found.state == SEEN, 1.0, np.where(found.state == HIDDEN, 0.5, 0.0))
    mean: Float[Array, "N"] = (weight * far).sum(1) / np.maximum(weight.sum(1), 1e-9)
    return mean
