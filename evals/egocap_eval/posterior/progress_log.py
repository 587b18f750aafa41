"""Scores of finished frames in a file, so that a long study that was stopped goes on.

One JSON object a line: a name of everything the score depends on, and the score. Lines that a kill
cut short are passed over when the file is read, and their frames done again.
"""

from __future__ import annotations

import json
from pathlib import Path

from egocap.errors import FileError
from egocap.files import disk_errors, make_folder
from egocap_eval.posterior.coverage import FrameScore


class ScoreLog:
    """Finished frames by name; without a file, in memory alone. Raises FileError for a file of
    something else."""

    def __init__(self, path: Path | None = None) -> None:
        self._path, self._scores = path, {}
        if path is None:
            return
        make_folder(path.parent)
        if path.exists():
            self._read(path)

    def __contains__(self, key: str) -> bool:
        return key in self._scores

    def __getitem__(self, key: str) -> FrameScore:
        return self._scores[key]

    def add(self, key: str, score: FrameScore) -> None:
        """Keep a score, in the file as well."""
        self._scores[key] = score
        if self._path is not None:
            with disk_errors(self._path.parent), self._path.open("a") as file:
                file.write("\n" + json.dumps({"frame": key, "score": score.to_dict()}))

    def _read(self, path: Path) -> None:
        try:
            lines = path.read_text().split("\n")
        except (OSError, UnicodeDecodeError) as error:
            raise FileError(path, f"cannot be read: {error}") from None
        filled = [line for line in lines if line]
        for line in filled:
            try:
                row = json.loads(line)
                self._scores[row["frame"]] = FrameScore.from_dict(row["score"])
            except (ValueError, KeyError, TypeError):
                continue
        if len(filled) > 1 and not self._scores:
            raise FileError(path, "holds no scores of frames", valid="a file this study made")
