"""Commands of detector weights: weights list, weights show."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional, arg

from egocap.cli.registry import app
from egocap.commandline import DONE
from egocap.errors import one_line

_LONGEST = 2000  # characters of a line; a command may be long


@dataclass(frozen=True)
class List:
    """List the shipped detector weights."""

    json: bool = False
    """Print them as JSON."""


@dataclass(frozen=True)
class Show:
    """Show what a weights file is: its network, calibration, scores and training."""

    weights: Positional[Path | None] = None
    """Detector weights, safetensors; those shipped by default."""
    json: bool = False
    """Print it as JSON."""


@app.command(name="weights")
def weights_command(
    do: Annotated[
        Annotated[List, tyro.conf.subcommand("list")]
        | Annotated[Show, tyro.conf.subcommand("show")],
        arg(name=""),
    ],
) -> int:
    """List or show detector weights."""
    from egocap.detect.weights import open_weights
    from egocap.detect.weights_card import card, shipped_weights

    if isinstance(do, List):
        cards = [card(weights) for weights in shipped_weights()]
        if do.json:
            print(json.dumps(cards, indent=1))
        else:
            for one in cards:
                print(_line(one))
        return DONE
    one = card(open_weights(do.weights))
    print(
        json.dumps(one, indent=1)
        if do.json
        else "\n".join(one_line(line, _LONGEST) for line in _lines(one))
    )
    return DONE


def _line(one: dict[str, Any]) -> str:
    width, height = one["view"]
    return (
        f"{one['name']}: {one['parameters'] / 1e6:.1f} million parameters, "
        f"{one['bytes'] / 1e6:.1f} MB, canonical view {width} x {height}, {one['file']}"
    )


def _lines(one: dict[str, Any]) -> list[str]:
    lines = [_line(one), f"sha256 {one['sha256']}"]
    if one["scores"]:
        lines.append("on sequences held out from its training: " + ", ".join(
            f"{name} {value:.3g}" for name, value in sorted(one["scores"].items())))  # fmt: skip
    for stage in one["stages"]:
        lines.append("trained: " + stage.get("command", "no command recorded"))
        if "steps" in stage:
            minutes = stage.get("seconds", 0.0) / 60.0
            lines.append(f"  {stage['steps']} steps, {minutes:.0f} min")
        for key, words in (("averaged_with", "averaged with"), ("adapted_from", "adapted from")):
            if key in stage:
                lines.append(f"  {words} {stage[key]['name']}")
    return lines
