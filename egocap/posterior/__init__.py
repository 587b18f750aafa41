"""How sure a pose is: its posterior given the detections, sampled and bounded.

`log_prob` is the density, `laplace` its modes, `sampler` draws from it with emcee, `simulation`
draws people and detections that follow it exactly, `information` bounds what any method can know.
This room stands above the tracker, whose kinematics, posture prior and starting poses it uses.
"""
