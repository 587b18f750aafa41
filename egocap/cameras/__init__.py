"""Camera and rig files in; cameras that project points and cast rays, and rigs of them, out.

Lens models are rows of `lens.MODELS`; file formats live in `camera_files` and `rig_files` alone.
"""
