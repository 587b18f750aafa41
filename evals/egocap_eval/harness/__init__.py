"""Suites, tracks and predictions in; scores, comparisons and the HTML report out.

What every study shares: footage, intervals, result files and the regression guard.
"""
