"""Starting values of the cameras' poses on the rig, from boards that two of them saw together.

Or from boards that stand still, one before each camera, while the rig moves: hand-eye calibration
for robot and world. With A_i and B_i the poses of the first and of another camera's board,
X A_i W = B_i for the camera's pose X and the board's place W, so that relative motions turn about
axes that X maps to each other.

Source: Shah 2013, "Solving the robot-world/hand-eye calibration problem"; Park and Martin 1994.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation

from egocap.boards.board import Board
from egocap.calibration.view_calibration import ViewCalibration
from egocap.errors import InputError
from egocap.geometry import inverse, rigid

LEAST_SHARED = 3  # boards that two views saw together
SAME_INSTANTS = "pictures of the same instants, with the same names"
_HALF_TURN = np.diag([-1.0, -1.0, 1.0])
_APART = np.deg2rad(10.0)  # between two estimates that agree, or that many per _APART_M
_APART_M = 0.05
_TURNED = np.deg2rad(3.0)  # rms of relative rotations about the second axis
_CLEAR = np.deg2rad(150.0)  # a rotation near half a turn has no sign
_STANDS_M = 0.03  # median change of a fixed board's place that lenses known roughly explain


def start_poses(views: Sequence[ViewCalibration], board: Board) -> Float[Array, "V 4 4"]:
    """T_view_rig of every view; the rig's frame is the first view's.

    Views are joined one by one to those already placed. Raises InputError for views that share too
    few boards with all others, and where fewer than half of the shared boards agree on a pose.
    """
    T_view_rig = {0: np.eye(4)}
    while len(T_view_rig) < len(views):
        links = [(shared_pose(views[p], views[v], board), p, v) for p in T_view_rig
                 for v in range(len(views)) if v not in T_view_rig]  # fmt: skip
        (T, agree, shared), placed, new = max(links, key=_certainty)
        if 2 * agree < shared:
            raise InputError(
                f"{views[new].view.name}: only {agree} of {shared} pictures that show the board "
                f"agree on where {views[placed].view.name} is",
                valid=SAME_INSTANTS,
            )
        if agree < LEAST_SHARED:
            names = ", ".join(v.view.name for i, v in enumerate(views) if i not in T_view_rig)
            raise InputError(
                f"{names}: only {agree} boards are seen together with another camera",
                valid=f"pictures taken at the same instant, with the same name, {LEAST_SHARED} or "
                "more of them with the board in both cameras (a larger board reaches farther); or "
                "--fixed-boards, a board fixed before each camera while the rig moves",
            )
        T_view_rig[new] = T @ T_view_rig[placed]
    return np.array([T_view_rig[v] for v in range(len(views))])


def _certainty(link: tuple[tuple[Array, int, int], int, int]) -> tuple[bool, int]:
    """Of two views: whether enough of their boards agree, and how many do."""
    (_, agree, shared), *_ = link
    return LEAST_SHARED <= agree >= shared / 2, agree


def shared_pose(
    first: ViewCalibration, second: ViewCalibration, board: Board
) -> tuple[Float[Array, "4 4"], int, int]:
    """T_second_first that most boards seen by both agree on; how many do, and of how many."""
    a, b = first.poses, second.poses
    shared = sorted(a.keys() & b.keys())
    turns = [np.eye(4), half_turn(board)] if board.symmetric else [np.eye(4)]
    found = np.array([b[i] @ turn @ inverse(a[i]) for i in shared for turn in turns])
    if not len(found):
        return np.eye(4), 0, 0
    apart = _distance(found)
    best = int((apart < 1.0).sum(1).argmax())
    agree = found[apart[best] < 1.0]
    R = Rotation.from_matrix(agree[:, :3, :3]).mean().as_matrix()
    return rigid(R, np.median(agree[:, :3, 3], axis=0)), len(agree), len(shared)


def fixed_boards(
    views: Sequence[ViewCalibration], board: Board
) -> tuple[Float[Array, "V 4 4"], Float[Array, "V 4 4"]]:
    """T_view_rig of every view, and where its board stands: T_board_own, in the first one's frame.

    Raises InputError for a board that looks the same after half a turn, and for motions that do not
    determine the poses.
    """
    if board.symmetric:
        raise InputError(f"{board} fixed in the room looks the same after half a turn",
                         valid="a ChArUco board or an AprilGrid")  # fmt: skip
    found = [(np.eye(4), np.eye(4)), *(hand_eye(views[0], view) for view in views[1:])]
    cameras, boards = (np.array(each) for each in zip(*found, strict=True))
    return cameras, boards


def hand_eye(
    first: ViewCalibration, second: ViewCalibration
) -> tuple[Float[Array, "4 4"], Float[Array, "4 4"]]:
    """T_second_first and T_board_own from the poses of two boards that stand still."""
    shared = sorted(first.poses.keys() & second.poses.keys())
    name = second.view.name
    if len(shared) < LEAST_SHARED:
        raise InputError(f"{name}: it and {first.view.name} see their boards at only {len(shared)} "
                         "instants", valid="20 or more pictures taken at the same instant, with "
                         "the same name, each camera before its own board")  # fmt: skip
    A, B = (np.array([view.poses[i] for i in shared]) for view in (first, second))
    i, j = np.triu_indices(len(shared), 1)
    of_A, of_B = A[j] @ inverse(A[i]), B[j] @ inverse(B[i])
    axes = [Rotation.from_matrix(T[:, :3, :3]).as_rotvec() for T in (of_A, of_B)]
    if np.linalg.svd(axes[0], compute_uv=False)[1] < _TURNED * np.sqrt(len(i)):
        raise InputError(f"{name}: the rig hardly turned between the pictures", valid="pictures "
                         "with the rig tilted, turned and rolled by 20 degrees or more, about "
                         "more than one axis")  # fmt: skip
    clear = np.linalg.norm(axes, axis=2).max(0) < _CLEAR
    R = Rotation.align_vectors(axes[1], axes[0], clear)[0].as_matrix()
    system = (np.eye(3) - of_B[:, :3, :3]).reshape(-1, 3)
    shift = (of_B[:, :3, 3] - of_A[:, :3, 3] @ R.T).ravel()
    X = rigid(R, np.linalg.lstsq(system, shift, rcond=None)[0])
    places = inverse(A) @ inverse(X) @ B
    W = rigid(Rotation.from_matrix(places[:, :3, :3]).mean().as_matrix(),
              np.median(places[:, :3, 3], axis=0))  # fmt: skip
    off = float(np.median(np.linalg.norm(places[:, :3, 3] - W[:3, 3], axis=1)))
    if off > _STANDS_M:
        raise InputError(f"{name}: its board moved by {100 * off:.0f} cm against that of "
                         f"{first.view.name}", valid="boards that stand still, and pictures of "
                         "the same instants")  # fmt: skip
    return X, W


def same_way_round(
    views: Sequence[ViewCalibration], T_view_rig: Float[Array, "V 4 4"], board: Board
) -> list[ViewCalibration]:
    """The views with boards that look the same after half a turn numbered alike in all of them.

    A board counts as turned where that agrees better with the first view that saw it.
    """
    if not board.symmetric:
        return list(views)
    turn, placed, found = half_turn(board), {}, []
    for view, T in zip(views, T_view_rig, strict=True):
        poses = {i: inverse(T) @ pose for i, pose in view.poses.items()}
        turned = {i for i, pose in poses.items() if i in placed
                  and _apart(placed[i], pose @ turn) < _apart(placed[i], pose)}  # fmt: skip
        placed = {i: pose @ turn if i in turned else pose for i, pose in poses.items()} | placed
        found.append(_turned(view, turned, turn, len(board.points)) if turned else view)
    return found


def _apart(a: Float[Array, "4 4"], b: Float[Array, "4 4"]) -> float:
    return float(_distance(np.array([a, b]))[0, 1])


def _turned(view: ViewCalibration, instants: set[int], turn: Array, count: int) -> ViewCalibration:
    """The view with the boards of some instants turned by half a turn."""
    corners, adjusted = view.corners, view.adjusted
    at = np.isin(corners.instant, list(instants))
    numbers = np.where(at, count - 1 - corners.corner, corners.corner)
    boards = adjusted.state.T_rig_board.copy()
    boards[list(instants)] = boards[list(instants)] @ turn
    state = replace(adjusted.state, T_rig_board=boards)
    return replace(view, corners=replace(corners, corner=numbers),
                   adjusted=replace(adjusted, state=state))  # fmt: skip


def half_turn(board: Board) -> Float[Array, "4 4"]:
    """The turn of a board's points by 180 degrees about its middle."""
    width, height = board.size
    return rigid(_HALF_TURN, np.array([width, height, 0.0]))


def _distance(T: Float[Array, "n 4 4"]) -> Float[Array, "n n"]:
    """Difference of all pairs of poses; below 1 they agree."""
    turn = np.einsum("aij,bij->ab", T[:, :3, :3], T[:, :3, :3])
    angle = np.arccos(np.clip((turn - 1) / 2, -1, 1))
    shift = np.linalg.norm(T[:, None, :3, 3] - T[None, :, :3, 3], axis=-1)
    return angle / _APART + shift / _APART_M
