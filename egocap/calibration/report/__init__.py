"""A calibration in; its numbers, advice, charts and HTML page out.

New advice is one sentence in `advice`, a new chart one function in `charts`.
"""
