"""Video files and folders of pictures in; RGB images with their times out.

Decoding alone: which views belong together, and when, is the business of `egocap.footage`.
"""
