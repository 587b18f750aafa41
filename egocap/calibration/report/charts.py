"""Charts of the calibration page, as SVG data URLs."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable

import cv2
import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from egocap.calibration.report.advice import lens_uncertainty
from egocap.calibration.report.summary import corner_angles
from egocap.calibration.rig_calibration import Calibration

_INK, _QUIET, _BLUE, _ORANGE = "#22262b", "#8a929c", "#3b6ea8", "#d98032"
_STYLE = {
    "font.size": 9, "axes.edgecolor": _QUIET, "axes.labelcolor": _INK, "text.color": _INK,
    "xtick.color": _INK, "ytick.color": _INK, "axes.spines.top": False,
    "axes.spines.right": False, "axes.titlesize": 9, "svg.hashsalt": "egocap",
}  # fmt: skip
_ARROW_PX = 60.0  # length of the arrow of the 95th percentile, in pixels of the image
_BINS = 12  # of the angle


def arrows(figure: Figure, calibration: Calibration, view: int) -> None:
    """Draw every corner in the image with its residual, enlarged, over the mean picture."""
    own = calibration.corners.view == view
    width, height = calibration.views[view].view.size
    at, residual = calibration.corners.pixels[own], calibration.adjusted.residuals[own]
    length = np.linalg.norm(residual, axis=1)
    times = _ARROW_PX / max(float(np.percentile(length, 95)), 1e-3)
    axes = figure.subplots()
    axes.imshow(_mean_picture(calibration, view), cmap="gray", vmin=-150, vmax=255,
                extent=(-0.5, width - 0.5, height - 0.5, -0.5))  # fmt: skip
    drawn = axes.quiver(*at.T, *(residual * times).T, length, angles="xy", scale_units="xy",
                        scale=1, width=0.0016, cmap="plasma")  # fmt: skip
    figure.colorbar(drawn, ax=axes, label="residual, px", shrink=0.8)
    title = f"{calibration.views[view].view.name}: residuals {times:.0f} times enlarged"
    axes.set(xlim=(0, width), ylim=(height, 0), xticks=[], yticks=[], title=title)


def against_angle(figure: Figure, calibration: Calibration, view: int) -> None:
    """Draw residuals, number of corners, and the uncertainty of the lens against the angle."""
    own = calibration.corners.view == view
    angle = np.degrees(corner_angles(calibration)[own])
    residual = calibration.adjusted.residuals[own]
    camera = calibration.rig.cameras[view]
    top = float(np.degrees(camera.max_angle))
    first, second, third = figure.subplots(1, 3)
    first.plot(angle, np.linalg.norm(residual, axis=1), ".", color=_BLUE, markersize=2, alpha=0.5)
    edges = np.linspace(0.0, top, _BINS + 1)
    place = np.digitize(angle, edges) - 1
    rms = [np.sqrt(np.mean(residual[place == b] ** 2)) if (place == b).any() else np.nan
           for b in range(_BINS)]  # fmt: skip
    first.stairs(rms, edges, color=_ORANGE, label="rms of a coordinate")
    first.set(xlabel="degrees off axis", ylabel="residual, px", xlim=(0, top), ylim=(0, None))
    first.legend(frameon=False)
    second.hist(angle, edges, color=_BLUE)
    second.set(xlabel="degrees off axis", ylabel="corners", xlim=(0, top))
    theta = np.linspace(0.01, camera.max_angle, 80)
    third.plot(np.degrees(theta), lens_uncertainty(calibration, view, theta), color=_BLUE)
    third.axvline(float(angle.max()), color=_QUIET, linestyle=":", label="outermost corner")
    third.set(xlabel="degrees off axis", ylabel="lens, standard deviation, px", xlim=(0, top),
              ylim=(0, None))  # fmt: skip
    third.legend(frameon=False)


def resolution(figure: Figure, calibration: Calibration) -> None:
    """Draw pixels per degree along the radius, and the radius itself, of every camera."""
    first, second = figure.subplots(1, 2)
    for mount in calibration.rig.mounts:
        camera = mount.camera
        theta = np.linspace(0.0, camera.max_angle, 100)
        scale = float(np.sqrt(np.linalg.det(np.array(camera.affine))))
        radius, slope = camera.radial.radius(theta)
        first.plot(np.degrees(theta), scale * slope * np.pi / 180, label=mount.name)
        second.plot(np.degrees(theta), scale * radius, label=mount.name)
    first.set(xlabel="degrees off axis", ylabel="pixels per degree", ylim=(0, None))
    second.set(xlabel="degrees off axis", ylabel="radius in the image, px", ylim=(0, None))
    first.legend(frameon=False)


def draw(calibration: Calibration) -> dict[str, str]:
    """Draw every chart by name: 'resolution', and 'arrows NAME', 'angle NAME' of each view."""
    with rc_context(_STYLE):  # pyright: ignore[reportArgumentType]
        charts = {"resolution": _svg(2.8, resolution, calibration)}
        for v, view in enumerate(calibration.views):
            charts[f"arrows {view.view.name}"] = _svg(5.6, arrows, calibration, v)
            charts[f"angle {view.view.name}"] = _svg(2.6, against_angle, calibration, v)
        return charts


def _mean_picture(calibration: Calibration, view: int) -> np.ndarray:
    """Every point's largest grey value over the used pictures, at most 640 pixels wide."""
    own = np.unique(calibration.corners.instant[calibration.corners.view == view])
    pictures = calibration.views[view].view.pictures
    shape = next(iter(pictures.values())).shape
    size = (640, round(640 * shape[0] / shape[1]))
    small = [cv2.resize(pictures[int(i)], size, interpolation=cv2.INTER_AREA) for i in own]
    return np.max(small, axis=0)


def _svg(height: float, chart: Callable[..., None], *arguments: object) -> str:
    figure = Figure(figsize=(8.6, height), layout="constrained", dpi=110)
    chart(figure, *arguments)
    content = io.BytesIO()
    figure.savefig(content, format="svg", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(content.getvalue()).decode()
