from egocap_sim.verification.integrity import verify as verify
