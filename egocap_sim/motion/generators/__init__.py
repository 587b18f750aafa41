"""A seed and parameters in; procedural motions out.

A new motion is one module and one line in `registry.MOTIONS`.
"""
