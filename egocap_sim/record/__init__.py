"""A scene in; a sequence or a data set of episodes on disk out.

Work is split into shards and episodes, done by local processes or a Dask cluster, and resumable.
"""
