"""Settings in; one measured question answered in a result file out.

A new study is one module with a function `study` and one line in the command's table.
"""
