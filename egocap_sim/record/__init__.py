"""A scene in; a sequence or a data set of episodes on disk out.

Shards and episodes are jobs for local processes or a Dask cluster. An interrupted run is resumable.
"""
