"""Error bars: 95 % intervals of means and of shares, the same for all studies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from egocap.evaluation.table import number

LEVEL = 0.95


def mean_and_interval(values: Sequence[float | None]) -> dict[str, float] | None:
    """Mean of independent draws and half the width of its interval; None of fewer than two draws.

    Draws that could not be measured (None) do not count. Source: Student's t.
    """
    from scipy.stats import t as student

    known = np.array([v for v in values if v is not None], float)
    count = len(known)
    if count < 2:
        return None
    half = student.ppf(0.5 + LEVEL / 2, count - 1) * known.std(ddof=1) / np.sqrt(count)
    return {"mean": float(known.mean()), "half_interval": float(half)}


def share_and_interval(successes: int, trials: int) -> dict[str, float]:
    """A share in per cent and its interval, which is right near 0 and 100 % too.

    Source: Wilson, Probable inference, the law of succession, and statistical inference, 1927.
    """
    from scipy.stats import norm

    assert 0 <= successes <= trials > 0, (successes, trials)
    z = float(norm.ppf(0.5 + LEVEL / 2))
    share = successes / trials
    middle = (share + z**2 / (2 * trials)) / (1 + z**2 / trials)
    half = z / (1 + z**2 / trials) * np.sqrt(share * (1 - share) / trials + z**2 / (4 * trials**2))
    return {
        "percent": 100.0 * share,
        "low": 100.0 * max(0.0, float(middle - half)),
        "high": 100.0 * min(1.0, float(middle + half)),
        "trials": trials,
    }


def format_interval(entry: Mapping[str, float] | None) -> str:
    """A mean with its interval, for a table."""
    if entry is None:
        return "-"
    return f"{number(entry['mean'])} +- {number(entry['half_interval'])}"
