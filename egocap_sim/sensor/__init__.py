"""Perfect images in; images with the faults of a real camera out.

Every fault is a setting of `config`, off by default; `faults` draws them from the seed.
"""
