"""Images of a rig's cameras in; `Detections` of the 18 body parts in every view out.

`detector` runs the shipped network, `synthetic` draws detections from the truth.
`sources` opens either by name.
"""
