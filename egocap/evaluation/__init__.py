"""Tracks, predictions or detections and the truth in; measures under named protocols out.

A new measure is one pure function in `metrics` and one line in `measures`.
"""

from egocap.evaluation.detection_scores import DetectionScore, evaluate_detections
from egocap.evaluation.measures import MEASURES, find_measure
from egocap.evaluation.pose_errors import GroundTruth, PoseErrors
from egocap.evaluation.predictions import Predictions, load_predictions, save_predictions
from egocap.evaluation.protocol import PROTOCOLS, Protocol, find_protocol
from egocap.evaluation.report import Report
from egocap.evaluation.scoring import evaluate, evaluate_pose

__all__ = [
    "MEASURES",
    "PROTOCOLS",
    "DetectionScore",
    "GroundTruth",
    "PoseErrors",
    "Predictions",
    "Protocol",
    "Report",
    "evaluate",
    "evaluate_detections",
    "evaluate_pose",
    "find_measure",
    "find_protocol",
    "load_predictions",
    "save_predictions",
]
