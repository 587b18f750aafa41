"""Commands of the camera calibration: calibrate and print-board."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from egocap.cli.registry import app
from egocap.commandline import DONE
from egocap.locks import locks
from egocap.options import several


@app.command
@locks("out", "page")
def calibrate(
    sources: Positional[Annotated[tuple[Path, ...], several("FOLDER|VIDEO")]],
    /,
    board: str,
    out: Path,
    model: str | None = None,
    mount: Path | None = None,
    lag: bool = False,
    readout: bool = False,
    page: Path | None = None,
    fixed_boards: bool = False,
    json: bool = False,
) -> int:
    """Calibrate the cameras of a rig from pictures or videos of a printed board.

    Print a board with `egocap calibrate print-board board.pdf --board ...`.

    Args:
        sources: a folder of pictures per camera, of which those of the same name were taken
            together; or a video per camera, started together.
        board: checkerboard:COLUMNSxROWS:SQUARE, charuco:COLUMNSxROWS:SQUARE:MARKER[:DICTIONARY] or
            aprilgrid:COLUMNSxROWS:TAG:SPACING; counts of squares (tags), sizes in metres.
        out: rig to write, .toml or .json.
        model: equidistant, kannala_brandt or ocam; by default chosen by the held-out error.
        mount: rig file with the same views; the calibrated cameras are placed on the head like its.
        lag: estimate how much later each camera exposes than the first, from videos of a board
            that moves slowly.
        readout: estimate the seconds from a picture's first row to its last (rolling shutter),
            from videos of a board that moves; printed, since rig files have no place for them.
        page: HTML report to write.
        fixed_boards: each camera saw a board of its own, fixed in the room, while the rig was
            moved; for cameras that never see one board together.
        json: print the parameters and their standard deviations as JSON.
    """
    import logging

    from egocap.calibration.report.page import check_page_name, print_report, write_page
    from egocap.calibration.report.rig_output import check_rig_name, write_rig
    from egocap.calibration.rig_calibration import calibrate as calibrate_rig
    from egocap.cameras.rig_files import load_rig

    check_rig_name(out)
    if page is not None:
        check_page_name(page)
    log = logging.getLogger(__name__)
    nominal = load_rig(mount) if mount else None
    found = calibrate_rig(sources, board, model=model, mount=nominal, name=out.stem,
                          fixed_boards=fixed_boards, lag=lag, readout=readout,
                          on_step=log.info)  # fmt: skip
    write_rig(out, found.rig, found.notes)
    if page is not None:
        write_page(found, page)
    print_report(found, out, as_json=json)
    return DONE


@app.command
def print_board(out: Positional[Path], board: str) -> int:
    """Write a calibration board as a PDF at true scale.

    Args:
        out: PDF to write.
        board: as for `egocap calibrate`.
    """
    from egocap.boards.board import parse_board
    from egocap.boards.sheet import print_board as write_board

    described = parse_board(board)
    paper = write_board(described, out)
    width, height = (1000 * side for side in described.size)
    print(f"{out}: {described}, {width:.1f} x {height:.1f} mm on {paper}; print at 100 %, "
          "check the ruler, and glue it to something flat")  # fmt: skip
    return DONE
