"""Tracks, predictions or detections and the truth in; measures under named protocols out.

A new measure is one pure function in `metrics` and one line in `measures`.
"""

from egocap.evaluation.detections import DetectionScore, evaluate_detections
from egocap.evaluation.ground_truth import Reference
from egocap.evaluation.measures import MEASURES, find_measure
from egocap.evaluation.pose import evaluate_pose
from egocap.evaluation.protocol import PROTOCOLS, Protocol, find_protocol
from egocap.evaluation.report import Report

__all__ = [
    "MEASURES",
    "PROTOCOLS",
    "DetectionScore",
    "Protocol",
    "Reference",
    "Report",
    "evaluate_detections",
    "evaluate_pose",
    "find_measure",
    "find_protocol",
]
