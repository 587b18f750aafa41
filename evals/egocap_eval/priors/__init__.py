"""Folders of motions in; the tracker's learned pose and motion priors out.

Run for a release only; the priors are package data of `egocap.pose`.
"""
