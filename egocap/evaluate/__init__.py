"""How good a track or a set of detections is: measures, named protocols and reports."""

from egocap.evaluate.detections import DetectionScore, evaluate_detections
from egocap.evaluate.measures import MEASURES, find_measure
from egocap.evaluate.pose import evaluate_pose
from egocap.evaluate.protocol import PROTOCOLS, Protocol, find_protocol
from egocap.evaluate.reference import Reference
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
