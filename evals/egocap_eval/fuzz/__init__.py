"""Valid files and commands in; what readers do with damaged files, and commands with faults, out.

A new format is one function in `targets`; `mutations` knows the kinds of files, `study` runs them.
`faults` kills and disturbs commands.
"""
