from egocap.adaptation.adapt import adapt as adapt
from egocap.body.proportions import Proportions as Proportions
from egocap.calibration.rig_calibration import calibrate as calibrate
from egocap.cameras.camera import Camera as Camera
from egocap.cameras.camera_files import load_camera as load_camera
from egocap.cameras.rig import Rig as Rig
from egocap.cameras.rig_files import load_rig as load_rig
from egocap.data.detections import Detections as Detections
from egocap.data.sequence import open_sequence as open_sequence
from egocap.data.track import Track as Track
from egocap.datasets.catalogue import open_dataset as open_dataset
from egocap.datasets.scoring import evaluate_recording as evaluate_recording
from egocap.detect.detector import Detector as Detector
from egocap.detect.sources import synthetic_detections as synthetic_detections
from egocap.errors import EgocapError as EgocapError
from egocap.evaluation.scoring import evaluate as evaluate
from egocap.fitting.fit_body import fit_body as fit_body
from egocap.fitting.fit_rig import fit_rig as fit_rig
from egocap.footage.importing import import_footage as import_footage
from egocap.motion_capture.capture import mocap as mocap
from egocap.paper.tracker import PaperTracker as PaperTracker
from egocap.pose.config import TrackerConfig as TrackerConfig
from egocap.posterior.frame_posterior import sample_posterior as sample_posterior
from egocap.track.online import OnlineTracker as OnlineTracker
from egocap.track.tracker import Tracker as Tracker

__version__: str
