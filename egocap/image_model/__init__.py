"""A posed Gaussian body and images in; visibilities and the colour energy (Eq. 4-6) out.

`visibility`, `appearance` and `reference` are the readable form; `model` runs the compiled kernels.
"""
