"""A posed Gaussian body and images in; visibilities and the colour energy (Eq. 4-6) out.

`model` evaluates poses by the compiled kernels; `torch_visibility` and `torch_energy` are their
readable oracle.
"""
