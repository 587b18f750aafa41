"""In: jobs and a task that does them. Out: files in a folder, made here, by processes or a cluster.

The same task gives the same files on every executor. Edited here: how jobs are spread and retried.
"""
