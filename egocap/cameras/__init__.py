"""Camera and rig files in; cameras and rigs that project points and cast rays out.

A new lens model is one function in `lens.MODELS`; `camera_files`, `rig_files` hold the formats.
"""
