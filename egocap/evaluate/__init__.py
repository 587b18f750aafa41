"""Tracks, predictions or detections and the truth in; measures under named protocols out.

A new measure is one pure function in `metrics` and one line in `measures`.
"""

from egocap.evaluate.detections import DetectionScore, evaluate_detections
from egocap.evaluate.ground_truth import Reference
from egocap.evaluate.measures import MEASURES, find_measure
from egocap.evaluate.pose import evaluate_pose
from egocap.evaluate.protocol import PROTOCOLS, Protocol, find_protocol
from egocap.evaluate.report import Report

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
