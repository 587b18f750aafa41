"""The sources of each study: the code and data whose change makes its results stale.

Studies are named as in `egocap_eval.harness.commands`, benchmarks by their path. A study without a
line here has results of its own input only (`pose`, `compare`), which are not kept.
"""

from __future__ import annotations

from itertools import chain

DETECTOR = ("egocap/detect/*.py", "egocap/detect/shipped/*.safetensors")
CAMERAS = tuple(f"egocap/cameras/{module}.py" for module in (
    "camera", "camera_files", "camera_set", "lens", "ray_kernel", "rig", "rig_files"))  # fmt: skip
"""Without the formats of other programs."""
GEOMETRY = ("egocap/geometry.py", *CAMERAS, "egocap/body")
COLOUR_TRACKER = ("egocap/appearance", "egocap/track/colour_tracker.py")
TRACK = ("egocap/track!colour_tracker,consistency,view_agreement",)
TRACKER = (*GEOMETRY, "egocap/pose", *TRACK, "egocap/series.py")
CONFIDENCE = ("egocap/consistency", "egocap/track/consistency.py",
              "egocap/track/view_agreement.py")  # fmt: skip
"""What a track says of its inputs; poses do not depend on it."""
LIVE = ("egocap/cli/live.py", *(f"egocap/view/{module}.py" for module in (
    "capture", "feeds", "live_run", "pose_log")))  # fmt: skip
"""Without what it shows and records on request."""
IN_WORLD = ("egocap/world", "egocap/data/head_pose.py")
SCORES = ("egocap/evaluation/*.py",)
WORLD = (*(f"egocap_sim/{room}" for room in (
    "assets", "core", "crowd", "environment", "human", "motion", "physics", "props", "render",
    "scene", "sensor", "truth", "world")), "scenes")  # fmt: skip
NOISE = ("egocap/detect/synthetic.py",)
MOTION_TRUTH = ("egocap_eval/harness/motion_truth.py",)
HARNESS = ("egocap_eval/harness/footage.py",)
TRAINING = (*DETECTOR, "egocap/detect/train")
IMAGE_MODEL = ("egocap/image_model",)
FITTED = ("egocap/fitting/body_prior.json", *(f"egocap/fitting/{module}.py" for module in (
    "appearance_fit", "body_prior", "bundle_adjustment", "config", "fit_body",
    "wearer")))  # fmt: skip
HEAD_POSE = ("egocap/odometry", "egocap/head_pose", "egocap/world")
PAPER = (*IMAGE_MODEL, "egocap/paper")
FOOTAGE_TRACKED = (*DETECTOR, *TRACKER, *SCORES, *WORLD, *HARNESS)
SMALL_DETECTORS = (*TRAINING, *WORLD, "egocap_eval/studies/small_detectors.py")
VALIDATION_FRAMES = ("egocap_eval/detection/validation_frames.py",)

IMPORTED = ("egocap/data", "egocap/footage", "egocap/media", "egocap_sim/export",
            "egocap_eval/footage/synchronisation.py")  # fmt: skip
FORMULA_TESTS: dict[str, tuple[str, ...]] = {
    "egocap/cameras/lens.py": ("tests/egocap/cameras/test_lens.py",
                               "tests/egocap/cameras/test_camera.py"),
    "egocap/cameras/camera.py": ("tests/egocap/cameras/test_camera.py",),
    "egocap/image_model/colour_measure.py": ("tests/egocap/image_model/test_colour_measure.py",),
    "egocap/pose/energy.py": ("tests/egocap/pose/test_energy.py",),
    "egocap/evaluation/metrics.py": ("tests/egocap/evaluation/test_metrics.py",
                                     "tests/egocap/evaluation/test_foot_contact.py"),
    "egocap/evaluation/alignment.py": ("tests/egocap/evaluation/test_alignment.py",),
    "egocap/posterior/information.py": ("tests/egocap/posterior/test_information.py",),
}  # fmt: skip
"""The formula modules, and the tests of each that must notice its mutants."""
CAPTURED = (*FOOTAGE_TRACKED, *IMPORTED, *FITTED, *HEAD_POSE, "egocap/motion_capture")

STUDY_SOURCES: dict[str, tuple[str, ...]] = {
    "ablation": (*FOOTAGE_TRACKED, *PAPER, "egocap_eval/studies/ablation.py",
                 "egocap_eval/studies/recovery.py", "egocap_eval/studies/recorded.py",
                 "egocap_eval/sets"),
    "accuracy": (*NOISE, *TRACKER, *SCORES, *WORLD, "egocap_eval/studies/accuracy.py"),
    "adapt": (*FOOTAGE_TRACKED, *CONFIDENCE, "egocap/adaptation", "egocap/detect/train", *FITTED,
              *HEAD_POSE, "egocap/motion_capture", "egocap_eval/studies/adaptation.py",
              "egocap_eval/studies/fit_body.py"),
    "augmentation": (*SMALL_DETECTORS, "egocap_eval/studies/augmentation.py"),
    "calibrate": (*GEOMETRY, "egocap/boards", "egocap/calibration", "egocap_sim/boards",
                  "egocap_eval/calibration"),
    "calibration": (*DETECTOR, *GEOMETRY, "egocap/pose", "egocap/posterior/*.py", *WORLD,
                    "egocap_eval/posterior"),  # without the error model, which it writes
    "crash-recovery": (*WORLD, "egocap_sim/record", "egocap/data", "egocap/execution",
                       "egocap_eval/studies/crash_recovery.py"),
    "dataset": (*WORLD, "egocap_eval/studies/dataset_card.py"),
    "capture-memory": (*CAPTURED, "egocap_eval/footage"),
    "captures": (*CAPTURED, "egocap_eval/footage", "egocap_eval/sets",
                 "egocap_eval/studies/recorded.py"),
    "detector": (*DETECTOR, *GEOMETRY, *SCORES, *WORLD, *VALIDATION_FRAMES,
                 "egocap_eval/detection/detector.py"),
    "doubt": (*NOISE, *TRACKER, *CONFIDENCE, *WORLD, *HARNESS, "egocap_eval/sets",
              "egocap_eval/studies/doubt.py", "egocap_eval/studies/recorded.py"),
    "faults": ("egocap/cli", "egocap/commandline.py", "egocap/files.py", "egocap/locks.py",
               "egocap/workers.py", "egocap/data", "egocap/execution",
               "egocap_eval/fuzz/faults.py", "egocap_eval/fuzz/long_commands.py",
               "egocap_eval/fuzz/outputs.py"),
    "fit-rig": (*FOOTAGE_TRACKED, *NOISE, *MOTION_TRUTH, "egocap/fitting",
                "egocap_eval/studies/fit_rig.py"),
    "fuzz": (*GEOMETRY, "egocap/cameras", "egocap/files.py", "egocap/schema.py", "egocap/data",
             "egocap/media", *(f"egocap_eval/fuzz/{module}.py" for module in (
                 "calibration_targets", "mutations", "result_targets", "study", "targets", "trials",
                 "watchdog", "work_targets"))),
    "head-pose": (*GEOMETRY, *WORLD, *HARNESS, *HEAD_POSE, "egocap_eval/studies/head_pose.py"),
    "image-model": (*GEOMETRY, *IMAGE_MODEL, *TRACK, *COLOUR_TRACKER, *WORLD,
                    "egocap_eval/image_model"),
    "personalised": (*FOOTAGE_TRACKED, *FITTED, "egocap_eval/studies/personalised.py"),
    "physics": (*GEOMETRY, *WORLD, "egocap_eval/studies/physics.py"),
    "posterior": (*FOOTAGE_TRACKED, "egocap/posterior", "egocap_eval/posterior"),
    "recorded": (*FOOTAGE_TRACKED, *FITTED, *HEAD_POSE, "egocap_eval/sets",
                 "egocap_eval/studies/recorded.py", "egocap_eval/studies/personalised.py",
                 "egocap_eval/studies/recovery.py"),
    "rig": (*NOISE, *TRACKER, *WORLD, *MOTION_TRUTH, "egocap/posterior", "egocap_eval/rig_design"),
    "run": (*FOOTAGE_TRACKED, "egocap_eval/suites", "egocap_eval/harness/predict.py",
            "egocap_eval/harness/run.py"),
    "runtime": (*FOOTAGE_TRACKED, *PAPER, "egocap/view/live_run.py",
                "egocap_eval/studies/runtime.py"),
    "soak": (*FOOTAGE_TRACKED, "egocap_sim/record", "egocap/data", "egocap/execution", *LIVE,
             "egocap_eval/footage/soak.py"),
    "stress": (*NOISE, *TRACKER, *SCORES, *WORLD, *MOTION_TRUTH, "egocap_eval/studies/stress.py"),
    "stress-rendered": (*FOOTAGE_TRACKED, "egocap_eval/studies/stress_rendered.py"),
    "sync": (*GEOMETRY, *WORLD, *HARNESS, *IMPORTED),
    "training-set": (*SMALL_DETECTORS, "egocap_eval/studies/training_set.py"),
    "visibility": (*GEOMETRY, *WORLD, "egocap_eval/studies/visibility.py"),
    "world": (*FOOTAGE_TRACKED, *IN_WORLD, *NOISE, *MOTION_TRUTH, "egocap_sim/refinement",
              "egocap_eval/sets", "egocap_eval/world/study.py", "egocap_eval/studies/recorded.py"),
    "benchmarks/detector.py": (*DETECTOR, "benchmarks/detector.py"),
    "benchmarks/episodes.py": (*WORLD, "egocap_sim/record", "egocap/execution",
                               "benchmarks/episodes.py"),
    "benchmarks/generation.py": (*WORLD, "egocap_sim/record", "egocap/execution",
                                 "benchmarks/generation.py"),
    "benchmarks/image_model.py": (*GEOMETRY, *IMAGE_MODEL, *COLOUR_TRACKER,
                                  "benchmarks/image_model.py"),
    "benchmarks/start_up.py": (*FOOTAGE_TRACKED, "egocap_sim/record", "egocap/execution",
                               "egocap/cli", "egocap/commandline.py", "egocap_sim/cli",
                               "benchmarks/start_up.py"),
    "benchmarks/rendering.py": (*WORLD, "benchmarks/rendering.py"),
    "tools/mutation.py": (*FORMULA_TESTS, *chain.from_iterable(FORMULA_TESTS.values()),
                          "tools/mutation.py", "tools/mutation-equivalents.toml"),
}  # fmt: skip


def sources_of(command: str) -> tuple[str, ...]:
    """The sources of the study that a command line runs; empty for one without a line here."""
    words = command.split()
    name = next((w for w in words[1:] if not w.startswith("-")), "")
    return STUDY_SOURCES.get(name, ())
