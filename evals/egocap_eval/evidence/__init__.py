"""Committed results in; tables of README and docs, and lists of stale results, out.

`results.toml` says how every result is made; a result whose sources changed since is stale.
"""
