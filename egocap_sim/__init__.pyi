from egocap_sim.api import generate as generate
from egocap_sim.api import generate_episodes as generate_episodes
from egocap_sim.api import preview as preview
from egocap_sim.refinement.refine import refine as refine
from egocap_sim.verification.integrity import verify as verify
