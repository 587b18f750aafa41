"""Annotated sequences in; calibrated detector weights out.

A training run is described by `config` and resumed from its checkpoint; torch is used here only.
"""
