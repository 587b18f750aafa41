"""No test of networks writes into the user's cache."""

import pytest


@pytest.fixture(scope="session", autouse=True)
def own_cache(empty_cache):
    pass
