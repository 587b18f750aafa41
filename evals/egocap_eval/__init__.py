"""Sequences, tracks and settings in; scores, studies and reports out: the command `egocap-eval`.

`harness` runs and reports; the other rooms hold studies, each a module with a function `study`.
"""
