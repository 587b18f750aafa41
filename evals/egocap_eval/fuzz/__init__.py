"""Valid files of every format in; what the readers do with damaged ones out.

A new format is one function in `targets`; `mutations` knows the kinds of files, `study` runs them.
"""
