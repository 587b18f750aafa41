"""A small network that tells when heels and toes touch the ground, from the motion around a frame.

It is learned (`egocap-eval learn-contacts`) from tracks of simulated people, whose contacts are
known, with limbs hidden for long stretches: it then relies on the other foot and on the head, whose
height and speed follow the steps.

Source: contacts learned from estimated joints: Rempe et al. 2020, "Contact and human dynamics from
monocular video", section 3.1.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.data.head_pose import HeadPoses
from egocap.errors import FileError
from egocap.files import read_npz, write_npz
from egocap.series import interpolate, runs
from egocap.world.contact_features import contact_features, sample_times

FILE = Path(__file__).with_name("contact_network.npz")


@dataclass(frozen=True, eq=False)
class ContactNetwork:
    """Three layers with rectifiers; outputs are logits of heel and toe."""

    mean: Float[Array, "F"]
    scale: Float[Array, "F"]
    w1: Float[Array, "F H"]
    b1: Float[Array, "H"]
    w2: Float[Array, "H K"]
    b2: Float[Array, "K"]
    w3: Float[Array, "K 2"]
    b3: Float[Array, "2"]

    def probabilities(self, features: Float[Array, "*batch F"]) -> Float[Array, "*batch 2"]:
        """Probability that heel and toe touch."""
        x = (features - self.mean) / self.scale
        x = np.maximum(x @ self.w1 + self.b1, 0.0)
        x = np.maximum(x @ self.w2 + self.b2, 0.0)
        return 1.0 / (1.0 + np.exp(-(x @ self.w3 + self.b3)))


def save_contact_network(network: ContactNetwork, path: Path = FILE) -> None:
    """Write a network as npz, its weights in half precision."""
    halves = {n: a.astype(np.float16 if n.startswith("w") else np.float32)
              for n, a in vars(network).items()}  # fmt: skip
    write_npz(path, **halves)


@cache
def load_contact_network(path: Path = FILE) -> ContactNetwork:
    """Read a network. Raises FileError."""
    found = read_npz(path)
    try:
        names = [field.name for field in fields(ContactNetwork)]
        network = ContactNetwork(*(found[name].astype(float) for name in names))
        sizes = [len(network.mean), len(network.b1), len(network.b2), 2]
        shapes = [network.w1.shape, network.w2.shape, network.w3.shape]
    except (KeyError, ValueError, TypeError):
        raise FileError(path, "not a contact network") from None
    fits = shapes == list(pairwise(sizes))
    if not fits or not all(np.isfinite(array).all() for array in vars(network).values()):
        raise FileError(path, "not a contact network")
    return network


def contact_probabilities(
    times: Float[Array, "T"], joints_head: Float[Array, "T 18 3"],
    sigma: Float[Array, "T 18"], heads: HeadPoses,
    network: ContactNetwork | None = None,
) -> Float[Array, "T 4"]:  # fmt: skip
    """Probability that heels and toes touch (`egocap.data.track.CONTACTS`).

    Zero in gaps of the head pose, and where only one frame has one.
    """
    network = network or load_contact_network()
    probabilities = np.zeros((len(times), 4))
    known = np.flatnonzero(heads.known)
    for run in runs(known):
        if len(run) < 2:
            continue
        features = contact_features(times[run], joints_head[run], sigma[run],
                                    heads.T_world_head[run])  # fmt: skip
        found = network.probabilities(features).reshape(len(features), 4)
        at = sample_times(times[run])
        probabilities[run] = interpolate(times[run], at, found)
    return probabilities
