"""The commands that make pictures and other formats: preview, export, calibration boards."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from egocap.commandline import DONE, progress
from egocap_sim.boards.settings import BoardRecording
from egocap_sim.cli.registry import app
from egocap_sim.world.overrides import shown


@app.command
def preview(sequence: Positional[Path], out: Path, rows: int = 6, width: int = 480) -> int:
    """Write a contact sheet: every view, joints over the image, part labels.

    Args:
        sequence: folder of a sequence, or a folder of sequences.
        out: PNG or JPEG file to write.
        rows: frames to show, spread over the sequence.
        width: width of one picture in pixels.
    """
    from egocap_sim import api

    api.preview(sequence, out, rows=rows, width=width)
    print(out)
    return DONE


@app.command
def export(
    sequence: Positional[Path],
    out: Path,
    format: Annotated[str, shown("coco|unrealego|mp4|videos|head-pose|imu")],
) -> int:
    """Export a sequence to another format.

    Args:
        sequence: folder of a sequence, or a folder of sequences.
        out: new folder, or the .mp4, .npz (head-pose) or .csv (imu) file; of several sequences, the
            folder that holds theirs.
        format: coco (keypoints JSON and images), unrealego (a JSON file a frame, in cm), mp4 (a
            video with the joints drawn) or videos (a file of every camera as a camera would write
            it, without truth; planted.json says what was changed), head-pose (the true head poses,
            for `egocap track --head-pose`) or imu (gyroscope and accelerometer in the head frame,
            at 200 Hz, with noise and bias).
    """
    from egocap.data.dataset import find_sequences
    from egocap.data.sequence import Sequence
    from egocap_sim.export.formats import ENDINGS
    from egocap_sim.export.formats import export as export_sequence

    found = find_sequences([sequence])
    opened = [Sequence(folder) for folder in found]
    ending = ENDINGS.get(format, "")
    with progress(format, sum(map(len, opened))) as advance:
        for folder, each in zip(found, opened, strict=True):
            into = out if folder == sequence else out / f"{folder.name}{ending}"
            export_sequence(each, format, into, advance)
    print(out)
    return DONE


@app.command
def calibration_board(
    out: Path,
    board: str = "charuco:5x7:0.0325:0.024",
    rig: str = "egorig1",
    settings: Annotated[BoardRecording, tyro.conf.OmitArgPrefixes] = BoardRecording(),  # noqa: B008
    size: Annotated[tuple[int, int] | None, shown("WIDTH HEIGHT")] = None,
) -> int:
    """Render a calibration board that a hand moves before a rig.

    Writes a folder of pictures per camera for `egocap calibrate`, and truth.json to score it with.

    Args:
        out: new folder.
        board: the board, as in `egocap calibrate`.
        rig: name of a built-in rig, or a rig file.
        settings: pictures and camera faults.
        size: image size in pixels; the rig is scaled to it.
    """
    from egocap.boards.board import parse_board
    from egocap.cameras.rig_files import load_rig
    from egocap_sim.boards.record import record_board
    from egocap_sim.core.resources import find_file

    opened = load_rig(find_file("rig", rig))
    opened = opened.resized(*size) if size else opened
    with progress("pictures", settings.count * len(opened.views), unit="pictures") as advance:
        record_board(parse_board(board), opened, settings, out, advance)
    print(out)
    return DONE
