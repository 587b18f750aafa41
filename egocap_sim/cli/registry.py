"""The commands of `egocap-sim`: each of the modules beside this one adds its own."""

import json

from tyro.extras import SubcommandApp

app = SubcommandApp()
"""The program `egocap-sim`."""


def print_json(content: object) -> None:
    """Print what --json asks for."""
    print(json.dumps(content, indent=1))
