"""The `[sensor]` table: faults of a camera. Every fault is off by default."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from egocap.schema import Number, Strict

Share = Annotated[Number, Field(ge=0, le=1)]
Whole = Annotated[int, Field(strict=True)]
_LEAST_WELL_E = 10.0
"""Electrons at white below which images would be noise alone."""


class SensorTable(Strict):
    """Faults of the cameras. A preset sets the keys that the table omits."""

    preset: Literal["clean", "webcam", "action-camera", "harsh", "consumer", "monochrome"] = "clean"

    exposure_ev: Number = Field(default=0.0, ge=-6, le=6)  # stops brighter
    exposure_drift_ev: Number = Field(default=0.0, ge=0, le=3)  # standard deviation of a slow drift
    flicker: Share = 0.0  # modulation of the light at twice the mains frequency
    mains_hz: Literal[50, 60] = 50
    gamma: Number = Field(default=1.0, ge=0.2, le=5)  # of the displayed values; above 1 is darker
    tone: Share = 0.0  # strength of an S-shaped tone curve
    saturation: Number = Field(default=1.0, ge=0, le=3)  # 0: a monochrome camera
    warmth_ev: Number = Field(default=0.0, ge=-3, le=3)  # red over blue, of the white balance
    vignetting: Share = 0.0  # share of the light lost at the edge of the lens
    rim: Share = 0.0  # outer share of the field of view over which the image fades to black
    glare: Share = 0.0  # share of the light that the lens scatters widely
    aberration: Number = Field(default=0.0, ge=-0.05, le=0.05)  # magnification of red; blue: minus
    full_well_e: Number = Field(default=0.0, ge=0, le=1e7)  # electrons at white; 0: no shot noise
    read_noise: Number = Field(default=0.0, ge=0, le=0.5)  # std. deviation, share of white

    shutter_s: Number = Field(default=0.0, ge=0, le=0.2)  # exposure time of each row
    readout_s: Number = Field(default=0.0, ge=0, le=0.2)  # from the first row to the last
    subframes: Whole = Field(default=9, ge=1, le=65)  # at most, averaged to an image
    subframe_px: Number = Field(default=3.0, gt=0, le=100)  # motion per sub-frame
    subframe_sharpness: Number = Field(default=1.0, ge=0.3, le=1)  # of each when there are many

    jpeg_quality: Whole = Field(default=0, ge=0, le=100)  # the camera's own, 4:2:0; 0: none
    time_offset_s: Number = Field(default=0.0, ge=-0.5, le=0.5)  # delay of all views but the first
    clock_drift_ppm: Number = Field(default=0.0, ge=-1e4, le=1e4)  # of all clocks but the first's
    drop_rate: Number = Field(default=0.0, ge=0, le=0.9)  # of each view's frames, from the second
    drop: Literal["repeat", "black"] = "repeat"  # replacement of a dropped frame

    # Error of rig.json: exactly this much, in a random direction for each camera.
    calibration_rotation_deg: Number = Field(default=0.0, ge=0, le=30)
    calibration_translation_m: Number = Field(default=0.0, ge=0, le=0.2)
    calibration_focal: Number = Field(default=0.0, ge=0, le=0.3)  # share of the focal length
    calibration_centre_px: Number = Field(default=0.0, ge=0, le=100)

    @field_validator("full_well_e")
    @classmethod
    def _none_or_enough(cls, electrons: float) -> float:
        if 0.0 < electrons < _LEAST_WELL_E:
            raise ValueError(f"valid: 0, or at least {_LEAST_WELL_E:g} electrons")
        return electrons

    @model_validator(mode="before")
    @classmethod
    def _from_preset(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("preset"), str):
            return PRESETS.get(data["preset"], {}) | data
        return data

    @property
    def timed(self) -> bool:
        """Whether an image deviates from the single instant of its frame."""
        return any((self.shutter_s, self.readout_s, self.time_offset_s, self.clock_drift_ppm))

    @property
    def miscalibrated(self) -> bool:
        """Whether rig.json differs from the rig that was rendered."""
        return any((self.calibration_rotation_deg, self.calibration_translation_m,
                    self.calibration_focal, self.calibration_centre_px))  # fmt: skip

    @property
    def active(self) -> bool:
        """Whether any fault is on."""
        neutral = SensorTable(subframes=self.subframes, subframe_px=self.subframe_px,
                              subframe_sharpness=self.subframe_sharpness,
                              drop=self.drop, mains_hz=self.mains_hz)  # fmt: skip
        return self.model_copy(update={"preset": "clean"}) != neutral


PRESETS: dict[str, dict[str, Any]] = {
    "clean": {},
    "webcam": {
        "exposure_drift_ev": 0.15, "gamma": 1.1, "vignetting": 0.25,
        "full_well_e": 3000.0, "read_noise": 0.004,
        "shutter_s": 1 / 60, "readout_s": 0.02, "jpeg_quality": 75,
        "time_offset_s": 0.008, "drop_rate": 0.005,
        "calibration_rotation_deg": 0.3, "calibration_translation_m": 0.002,
        "calibration_focal": 0.004, "calibration_centre_px": 1.5,
    },
    "action-camera": {
        "exposure_drift_ev": 0.1, "gamma": 0.95, "vignetting": 0.35,
        "full_well_e": 8000.0, "read_noise": 0.002,
        "shutter_s": 1 / 120, "readout_s": 0.012, "jpeg_quality": 90,
        "time_offset_s": 0.003,
        "calibration_rotation_deg": 0.1, "calibration_translation_m": 0.001,
        "calibration_focal": 0.002, "calibration_centre_px": 0.7,
    },
    "consumer": {
        "exposure_ev": 0.7, "exposure_drift_ev": 0.25, "tone": 0.6, "saturation": 1.35,
        "warmth_ev": 0.25, "vignetting": 0.4, "rim": 0.06, "glare": 0.06, "aberration": 0.003,
        "full_well_e": 4000.0, "read_noise": 0.003,
        "shutter_s": 1 / 100, "readout_s": 0.015, "jpeg_quality": 60,
        "calibration_rotation_deg": 0.2, "calibration_translation_m": 0.002,
        "calibration_focal": 0.003, "calibration_centre_px": 1.0,
    },
    "monochrome": {
        "exposure_drift_ev": 0.2, "gamma": 1.05, "tone": 0.2, "saturation": 0.0,
        "vignetting": 0.5, "rim": 0.1, "glare": 0.03, "full_well_e": 2000.0, "read_noise": 0.008,
        "shutter_s": 1 / 200, "jpeg_quality": 80,
        "calibration_rotation_deg": 0.1, "calibration_translation_m": 0.001,
        "calibration_focal": 0.002, "calibration_centre_px": 0.7,
    },
    "harsh": {
        "exposure_ev": -0.7, "exposure_drift_ev": 0.35, "gamma": 1.25, "vignetting": 0.6,
        "full_well_e": 600.0, "read_noise": 0.015, "flicker": 0.3, "mains_hz": 60,
        "shutter_s": 1 / 30, "readout_s": 0.03, "jpeg_quality": 45,
        "time_offset_s": 0.016, "drop_rate": 0.05,
        "calibration_rotation_deg": 1.0, "calibration_translation_m": 0.006,
        "calibration_focal": 0.01, "calibration_centre_px": 4.0,
    },
}  # fmt: skip
"""Settings of each preset: plausible for such cameras, not measured."""
